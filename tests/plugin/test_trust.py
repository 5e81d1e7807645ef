"""What a stranger's record or scenario may name: nothing of it is called or imported by mistake."""

from __future__ import annotations

import shutil

import pytest
from sealing import alter, seal

TOUCH = {"command": "touch pwned"}
PLANNER = """
from pathlib import Path
from corridor import Careful
Path("imported").touch()
class Planner(Careful): pass
"""


def names(path, **params):
    """A change of a record: its generators are these."""

    def change(record):
        for episode in record["episodes"]:
            episode["spec"]["roles"]["generator"] = {"path": path, "params": params}

    return change


def scenario(project, *changes, name="named"):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    for old, new in (("corridor/tight", f"corridor/{name}"), *changes):
        assert old in text
        text = text.replace(old, new)
    project.write(f"scenarios/corridor/{name}.yaml", text)


@pytest.fixture
def free(project, made_once):
    """A session is there, whose record a test alters."""
    made_once(project, "a session to be altered", lambda: project.run("corridor/free"))


def pwned(project):
    return (project.path / "pwned").exists()


@pytest.mark.parametrize("path", ["os:system", "posix:system", "corridor:os.system"])
def test_a_replay_calls_nothing_that_is_no_role(project, free, path):
    alter(project.path / "dura-evidence", names(path, **TOUCH))
    result = project.run("--dura-replay=corridor/free#0")
    assert not pwned(project)
    assert result.ret == 4
    result.stderr.fnmatch_lines([f"ERROR: '{path}' *", "  expected: *", "  remedy: *"])


def test_a_replay_calls_no_function_that_a_conftest_imports(project):
    project.write("conftest.py", "from os import system\n")
    project.run("corridor/free")
    alter(project.path / "dura-evidence", names("conftest.py:system", **TOUCH))
    result = project.run("--dura-replay=corridor/free#0")
    assert not pwned(project)
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: 'conftest.py:system' is neither a class nor a factory *"])


def test_a_replay_calls_no_check_that_is_not_the_projects(project, free):

    def change(record):
        for one in record["requirements"]:
            one["check"] = "builtins:print"

    alter(project.path / "dura-evidence", change)
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 0
    assert "Episode" not in result.stdout.str()


@pytest.mark.parametrize("option", ["--dura-replay", "--dura-reduce"])
def test_what_the_manifest_does_not_hold_for_is_not_run(project, free, option):
    alter(project.path / "dura-evidence", names("mine:Planner"))
    project.write("mine.py", PLANNER)
    project.write("dura-evidence/summary.md", "all is well\n")
    result = project.run(f"{option}=corridor/free#0")
    assert not (project.path / "imported").exists()
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        [
            "ERROR: *evidence.json: this bundle is not as it was written: summary.md: changed *",
            "  remedy: * `python -m pytest_dura verify` *",
        ]
    )


@pytest.mark.parametrize(
    "old, new",
    [
        ("corridor:Corridor", "{path: 'os:system', params: {command: touch pwned}}"),
        ('"corridor:Careful"', "{path: 'os:system', params: {command: touch pwned}}"),
        ('"corridor:Careful"', "{path: 'corridor:os.system', params: {command: touch pwned}}"),
    ],
)
def test_a_scenario_names_roles_and_simulators_only(project, old, new):
    scenario(project, (old, new))
    result = project.run("corridor/named")
    assert not pwned(project)
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*named.yaml:*: '*:*system' *", "  key: *", "  remedy: *"])


def test_a_scenario_names_a_function_of_the_project_if_it_is_a_factory(project):
    # A module of its own: `corridor` may have been imported for another test of this process.
    project.write(
        "named_roles.py",
        "from corridor import Careful\nfrom pytest_dura import factory\n"
        "def plain(): return Careful()\n"
        "@factory\n"
        "def careful(): return Careful()\n",
    )
    scenario(project, ("corridor:Careful", "named_roles:careful"))
    assert project.run("corridor/named").ret == 0
    scenario(project, ("corridor:Careful", "named_roles:plain"))
    result = project.run("corridor/named")
    assert result.ret == 4
    assert "a function with the decorator @pytest_dura.factory" in result.stderr.str()


def test_a_function_of_a_conftest_is_a_factory_if_it_says_so(project):
    text = (
        "import pytest, pytest_dura\nfrom corridor import Careful\n{}"
        "def careful(): return Careful()\n"
        "@pytest.fixture(scope='session')\ndef generator(): return careful\n"
    )
    project.write("conftest.py", text.format(""))
    result = project.run("corridor/free")
    assert result.ret != 0
    assert "with the decorator @pytest_dura.factory" in result.stdout.str()
    project.write("conftest.py", text.format("@pytest_dura.factory\n"))
    assert project.run("corridor/free").ret == 0


@pytest.mark.parametrize("key", ["check", "paired"])
@pytest.mark.parametrize("path", ["os:system", "corridor:os.system", "numpy:sum"])
def test_checks_and_measures_are_functions_of_the_project(project, key, path):
    check = f"check: '{path}'"
    if key == "paired":
        check = f"paired: {{measure: '{path}', change_at_most: 1, without: safety_monitor}}"
    project.write(
        "scenarios/mine.yaml",
        f"requirements:\n  - {{id: MINE-1, text: T, kind: safety, {check}}}\n",
    )
    result = project.run("--dura-scenarios", "--dura-list")
    assert result.ret == 4
    result.stderr.fnmatch_lines([f"*mine.yaml:2: '{path}' *", f"  key: *{key}*"])


def stranger(project, folder):
    """A module beside files of a stranger, which can be imported."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stranger.py").write_text(PLANNER)
    return f"-opythonpath=. {folder}"


def test_a_replay_imports_nothing_that_lies_in_the_bundle(project, free):
    (project.path / "downloads").mkdir()
    bundle = shutil.move(project.path / "dura-evidence", project.path / "downloads/bundle")
    path = stranger(project, bundle / "inner")
    alter(bundle, names("stranger:Planner"))
    arguments = ("--dura-replay=corridor/free#0", "--dura-evidence=downloads/bundle", path)
    result = project.run(*arguments)
    assert not (project.path / "imported").exists()
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        ["ERROR: 'stranger:Planner' would be imported from *", "  remedy: *--dura-trust-code"]
    )
    project.run(*arguments, "--dura-trust-code")
    assert (project.path / "imported").exists()


@pytest.mark.parametrize("package", [False, True])
def test_a_bundle_below_the_root_directory_is_not_a_part_of_the_project(project, free, package):
    """Whose folder can be imported from, since folders without code count as packages."""
    (project.path / "downloads").mkdir()
    bundle = shutil.move(project.path / "dura-evidence", project.path / "downloads/bundle")
    (bundle / "stranger.py").write_text(PLANNER)
    if package:  # whose own code is imported before its modules are looked for
        (bundle / "__init__.py").write_text(PLANNER)
    name = "downloads.bundle.missing:Planner" if package else "downloads.bundle.stranger:Planner"
    alter(bundle, names(name))
    arguments = ("--dura-replay=corridor/free#0", "--dura-evidence=downloads/bundle")
    result = project.run(*arguments, "-opythonpath=.")
    assert not (project.path / "imported").exists()
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        [f"ERROR: '{name}' would be imported from *", "  remedy: *--dura-trust-code"]
    )


def test_files_from_outside_the_project_name_no_code_beside_them(project, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    path = stranger(project, outside)
    scenario(project, ("corridor:Careful", "stranger:Planner"))
    shutil.move(project.path / "scenarios/corridor/named.yaml", outside)
    arguments = ("corridor/named", f"--dura-path={outside}", path)
    result = project.run(*arguments)
    assert not (project.path / "imported").exists()
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*named.yaml:*: 'stranger:Planner' would be imported from *"])
    assert project.run(*arguments, "--dura-trust-code").ret == 0
    # What the project itself puts on its path is its own, wherever that is.
    (outside / "named.yaml").unlink()
    scenario(project, ("corridor:Careful", "stranger:Planner"))
    assert project.run("corridor/named", path).ret == 0


def test_a_bundle_names_code_of_the_project(project):
    project.write("mine.py", PLANNER)
    project.run("corridor/free", "--dura-generator=mine:Planner")
    seal(project.path / "dura-evidence")
    assert project.run("--dura-replay=corridor/free#0").ret == 0


@pytest.mark.parametrize("option", ["", "--dura-executor=processes"])
def test_a_scenario_hands_no_name_of_a_stranger_to_a_library(project, option):
    """Gymnasium imports the package of an environment, and environments import what they like."""
    stranger(project, project.path / "site-packages")
    pytest.importorskip("gymnasium")
    simulator = (
        "{path: 'pytest_dura.adapters.gymnasium:GymnasiumSimulator', params: {env: '%s', "
        "time_step: 0.1, signals: 'seen:signals', sensors: 'seen:sensors'}}"
    )
    project.write("seen.py", "def signals(o, i, r): return {'gap': 1.0}\nsensors = signals\n")
    for env in ("stranger:Thing-v0", "stranger:Planner"):
        scenario(project, ("corridor:Corridor", simulator % env))
        path = f"-opythonpath=. {project.path / 'site-packages'}"
        result = project.run("corridor/named", path, *filter(None, [option]))
        assert not (project.path / "imported").exists()
        assert result.ret == 1
        result.stdout.fnmatch_lines(["*stranger*, which registers nothing for pytest-dura*"])
