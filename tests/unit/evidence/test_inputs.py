import hashlib
import importlib
import subprocess
import sys
import time

import pytest

from pytest_dura.evidence import InputFiles
from pytest_dura.provenance import (
    describe_component,
    describe_environment,
    imported_files,
    installed_folders,
    is_installed,
    recorded_path,
    sources_of,
)


def sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of the user's own with a planner, and a way to write into it."""

    def write(name, text):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    write("ownpkg/__init__.py", "")
    write("ownpkg/planners/__init__.py", "from .simple import Planner\n")
    write("ownpkg/planners/simple.py", "class Planner:\n    pass\n")
    write("ownpkg/helping.py", "def help(): return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield write
    for name in [name for name in sys.modules if name.startswith("ownpkg")]:
        del sys.modules[name]


def described(root, path="ownpkg.planners:Planner"):
    module, _, name = path.partition(":")
    return describe_component(path, getattr(importlib.import_module(module), name), {}, root=root)


def told(files, root, known=None):
    inputs = InputFiles(root, known)
    for kind, file in files:
        inputs.add(kind, file)
    return inputs.to_json()


def test_the_digest_covers_all_files_of_the_package(package, tmp_path):
    before = described(tmp_path)
    assert [one["path"] for one in before["files"]] == [
        "ownpkg/__init__.py", "ownpkg/helping.py", "ownpkg/planners/__init__.py",
        "ownpkg/planners/simple.py",
    ]  # fmt: skip
    assert before["files"][1]["sha256"] == sha256("def help(): return 1\n")
    assert before["file_count"] == 4
    package("ownpkg/helping.py", "def help(): return 2\n")
    changed = described(tmp_path)["digest"]
    package("ownpkg/helping.py", "def help(): return 1\n")
    package("ownpkg/more.py", "")
    added = described(tmp_path)["digest"]
    (tmp_path / "ownpkg/more.py").unlink()
    (tmp_path / "ownpkg/helping.py").rename(tmp_path / "ownpkg/helps.py")
    renamed = described(tmp_path)["digest"]
    (tmp_path / "ownpkg/helps.py").rename(tmp_path / "ownpkg/helping.py")
    assert len({before["digest"], changed, added, renamed}) == 4
    assert described(tmp_path) == before


def test_the_digest_does_not_depend_on_the_place_or_on_what_is_no_source(package, tmp_path):
    before = described(tmp_path)["digest"]
    package("ownpkg/__pycache__/x.py", "")
    package("ownpkg/.hidden/x.py", "")
    package("ownpkg/result.json", "{}")
    assert described(tmp_path)["digest"] == before
    (tmp_path / "other").mkdir()
    (tmp_path / "ownpkg").rename(tmp_path / "other/ownpkg")
    moved = sources_of(
        tmp_path / "other/ownpkg/planners/simple.py", "ownpkg.planners.simple", tmp_path
    )
    assert moved.digest == before
    assert moved.files[0]["path"] == "other/ownpkg/__init__.py"


def test_a_module_without_a_package_is_its_one_file(package, tmp_path):
    package("ownpkg_alone.py", "class Planner: pass\n")
    found = described(tmp_path, "ownpkg_alone:Planner")
    assert (found["file_count"], found["files"]) == (
        1,
        [{"path": "ownpkg_alone.py", "sha256": sha256("class Planner: pass\n")}],
    )


def test_a_large_package_is_named_by_its_defining_file(package, tmp_path):
    for i in range(60):
        package(f"ownpkg/part{i}.py", "")
    many = described(tmp_path)
    assert (many["file_count"], [one["path"] for one in many["files"]]) == (
        64,
        ["ownpkg/planners/simple.py"],
    )
    package("ownpkg/part59.py", "x = 1")
    assert described(tmp_path)["digest"] != many["digest"]


def test_a_component_without_sources():
    found = describe_component("builtins:dict", dict, {"a": 1})
    assert (found["digest"], found["files"], found["params"]) == (None, [], {"a": 1})


def test_an_installed_component_tells_its_distribution():
    import numpy as np

    found = describe_component("numpy.random:default_rng", np.polynomial.Polynomial, {})
    assert (found["distribution"], found["version"]) == ("numpy", np.__version__)
    assert [one["path"] for one in found["files"]] == ["numpy/polynomial/polynomial.py"]


@pytest.mark.of_guest
def test_the_digest_of_our_own_planners_is_quick():
    from pytest_dura.driving import RuleBased

    path = "pytest_dura.driving.roles.planners:RuleBased"
    described = describe_component(path, RuleBased, {})
    assert described["file_count"] > 100
    seconds = []
    for _ in range(5):
        began = time.process_time()
        describe_component(path, RuleBased, {})
        seconds.append(time.process_time() - began)
    assert min(seconds) < 0.05, "the quickest of five, on whatever else the machine does"


def test_the_environment_tells_what_digests_depend_on(tmp_path):
    import numpy as np

    found = describe_environment(tmp_path, tmp_path / "evidence")
    assert found["byte_order"] == sys.byteorder
    assert found["packages"]["numpy"] == np.__version__
    assert {"pytest-dura", "pydantic", "pyyaml"} <= {name.lower() for name in found["packages"]}
    assert all(isinstance(one, str) and one for one in found["cpu_features"])
    assert found["cpu_features"]


def test_the_commit_is_known_wherever_git_would_find_it(tmp_path):
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b"]
    inner, bare = tmp_path / "work" / "inner", tmp_path / "bare"
    inner.mkdir(parents=True)
    (inner / "a.py").touch()
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run([*git, *command], cwd=tmp_path / "work", check=True)
    subprocess.run([*git, "clone", "-q", "--bare", "work", "bare"], cwd=tmp_path, check=True)
    link = tmp_path / "link"
    link.symlink_to(inner, target_is_directory=True)
    found = [
        describe_environment(folder, folder / "evidence")["git"]["commit"]
        for folder in (inner, tmp_path / "work", bare, link, tmp_path)
    ]
    assert len(found[0]) == 40
    assert found == [found[0]] * 4 + [None]


def test_inputs_are_named_from_the_root_and_never_by_the_machine(tmp_path):
    root = tmp_path / "project"
    (root / "scenarios").mkdir(parents=True)
    inner, outer = root / "scenarios/a.yaml", tmp_path / "elsewhere.yaml"
    inner.write_text("a")
    outer.write_text("b")
    builtin = tmp_path / "builtin"
    (builtin / "deep").mkdir(parents=True)
    (builtin / "deep/c.yaml").write_text("c")
    found = told(
        [
            ("scenario", root / "scenarios/../scenarios/a.yaml"),
            ("cassette", outer),
            ("scenario", builtin / "deep/c.yaml"),
        ],
        root,
        {builtin: "pytest_dura/scenarios"},
    )
    assert [(one["path"], one["kind"], one["sha256"], one["changed"]) for one in found] == [
        ("pytest_dura/scenarios/deep/c.yaml", "scenario", sha256("c"), False),
        ("scenarios/a.yaml", "scenario", sha256("a"), False),
        (f"{tmp_path.name}/elsewhere.yaml", "cassette", sha256("b"), False),
    ]


def test_a_file_of_an_installed_package_is_named_by_the_package(tmp_path):
    file = installed_folders()[0] / "somewhere/data.yaml"
    assert recorded_path(file, tmp_path) == "somewhere/data.yaml"
    # Also where the virtual environment lies in the project.
    assert recorded_path(file, installed_folders()[0].parents[2]) == "somewhere/data.yaml"


def test_what_a_link_leads_to_outside_of_the_packages_is_developed_in_place(tmp_path):
    own, packages = tmp_path / "own", tmp_path / "site-packages"
    own.mkdir()
    packages.mkdir()
    for file in (own / "a.py", packages / "b.py"):
        file.touch()
    (packages / "a.py").symlink_to(own / "a.py")
    (packages / "package").symlink_to(own)
    (tmp_path / "packages").symlink_to(packages)
    assert is_installed(packages / "b.py")
    assert is_installed(tmp_path / "packages" / "b.py")
    assert not is_installed(packages / "a.py")
    assert not is_installed(packages / "package" / "a.py")
    assert not is_installed(own / "a.py")


def test_a_link_keeps_the_name_that_the_user_gave_it(tmp_path):
    (tmp_path / "real.yaml").write_text("a")
    (tmp_path / "root").mkdir()
    (tmp_path / "root/link.yaml").symlink_to(tmp_path / "real.yaml")
    assert recorded_path(tmp_path / "root/link.yaml", tmp_path / "root") == "link.yaml"


@pytest.mark.parametrize("change", ["write", "delete"])
def test_a_file_that_changed_meanwhile_is_told(tmp_path, change):
    file, same = tmp_path / "a.yaml", tmp_path / "b.yaml"
    file.write_text("before")
    same.write_text("same")
    inputs = InputFiles(tmp_path)
    inputs.add("scenario", file)
    inputs.add("scenario", same)
    if change == "write":
        file.write_text("after")
    else:
        file.unlink()
    inputs.add("scenario", file)  # asked for again: what it was at first counts
    assert [(one["sha256"], one["changed"]) for one in inputs.to_json()] == [
        (sha256("before"), True),
        (sha256("same"), False),
    ]


def test_what_the_session_itself_replaces_has_not_changed(tmp_path):
    file = tmp_path / "evidence.json"
    inputs = InputFiles(tmp_path)
    inputs.add("baseline", file, sha256("old"))
    file.write_text("new")
    assert inputs.to_json() == [
        {"path": "evidence.json", "kind": "baseline", "sha256": sha256("old"), "changed": False}
    ]


def test_files_that_another_process_read(tmp_path):
    (tmp_path / "a.py").write_text("a")
    inputs = InputFiles(tmp_path)
    inputs.add_reported("component", [{"path": "a.py", "sha256": sha256("older")}])
    inputs.add_reported("component", [{"path": "pkg/b.py", "sha256": sha256("b")}])
    assert [(one["path"], one["changed"]) for one in inputs.to_json()] == [
        ("a.py", True),
        ("pkg/b.py", False),
    ]


def test_a_file_that_cannot_be_read(tmp_path):
    (one,) = told([("check", tmp_path / "gone.py")], tmp_path)
    assert (one["sha256"], one["changed"]) == (None, False)


# -- The user's own files that a component comes with, as its code imports them by name ------


def written(folder, **files):
    for name, text in files.items():
        file = folder / (name.replace("__", "/") + ".py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def names(folder, file, module, root=None):
    return [path.relative_to(folder).as_posix() for path in imported_files(file, module, root)]


@pytest.mark.parametrize(
    "text, counts",
    [
        ("import other, aside", True),
        ("import other, \\\n    aside as two", True),
        ("from \\\n    aside.inner import one", True),
        ("__import__('aside')", True),
        ("import_module(\n    'aside.inner')", True),
        ("import importlib\nimportlib.import_module('aside')", True),
        ("def late():\n    if 0: import aside.inner as one", True),
        ("import aside\npattern = '\\d'", True),  # Python warns of it
        ("'import aside'\n# import aside", False),
        ("import aside\ndef (", False),  # which nothing can import
        ("from . import aside", False),
        ("from .inner import aside", False),
        ("from ..inner.most import aside, two", False),
    ],
)
def test_what_is_imported_is_found_and_what_is_called_alike_is_not(
    tmp_path, monkeypatch, text, counts
):
    monkeypatch.syspath_prepend(tmp_path)
    written(tmp_path, packed__inner="", packed__using=text, aside="")
    (tmp_path / "packed/__init__.py").touch()
    found = names(tmp_path, tmp_path / "packed/using.py", "packed.using")
    package = ["packed/__init__.py", "packed/inner.py", "packed/using.py"]
    assert found == (["aside.py"] if counts else []) + package


def test_imports_that_go_around_in_a_circle_end(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    written(
        tmp_path,
        circle_a="import circle_b, circle_a as me\n",
        circle_b="from circle_a import *\nimport no_such_module_at_all, größe\n",
        größe="x = 1\n",
    )
    found = names(tmp_path, tmp_path / "circle_a.py", "circle_a")
    assert found == ["circle_a.py", "circle_b.py", "größe.py"]


def test_files_that_are_no_python_of_this_version_are_listed_all_the_same(tmp_path):
    library = tmp_path / "fast.so"
    library.write_bytes(b"one")
    assert imported_files(library, "fast") == [library]
    library.unlink()
    assert imported_files(library, "fast") == []
    for text in (b"print 'one'", b"\0", b"# coding: none\n", b"(" * 10_000):
        (tmp_path / "old.py").write_bytes(text)
        assert names(tmp_path, tmp_path / "old.py", "old") == ["old.py"]


def test_what_lies_outside_of_the_project_is_listed_and_not_searched(tmp_path, monkeypatch):
    written(tmp_path / "root", planner="import tools\n")
    written(tmp_path / "beside", tools="import deeper\n", deeper="x = 1\n")
    monkeypatch.syspath_prepend(tmp_path / "beside")
    file = tmp_path / "root/planner.py"
    found = names(tmp_path, file, "planner", tmp_path / "root")
    assert found == ["beside/tools.py", "root/planner.py"]
    assert "beside/deeper.py" in names(tmp_path, file, "planner")


RECORDED, EDITABLE = "deeper.py,,\n", '{"dir_info":{"editable":true}}'


@pytest.mark.parametrize(
    "metadata, counts",
    [
        ({"dist-info/RECORD": RECORDED}, False),
        ({"dist-info/RECORD": "another.py,,\n"}, True),
        # A project that is installed in place, and what builds leave beside sources.
        ({"dist-info/RECORD": RECORDED, "dist-info/direct_url.json": EDITABLE}, True),
        ({"egg-info/SOURCES.txt": "deeper.py\n", "egg-info/top_level.txt": "deeper\n"}, True),
    ],
)
def test_what_a_distribution_recorded_is_not_the_projects_own_code(
    tmp_path, monkeypatch, metadata, counts
):
    written(tmp_path, planner="import deeper\n", deeper="")
    monkeypatch.syspath_prepend(tmp_path)
    for name, text in metadata.items():
        (tmp_path / f"deep-1.{name}").parent.mkdir(exist_ok=True)
        (tmp_path / f"deep-1.{name}").write_text(text)
    found = names(tmp_path, tmp_path / "planner.py", "planner")
    assert ("deeper.py" in found) == counts
