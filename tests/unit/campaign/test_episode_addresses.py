"""The address of an episode: equal for equal ones, and whatever changes is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from pytest_dura.core import EpisodeSpec, Fault, Policy, RoleSpec, Termination
from pytest_dura.execution import Addresses, EpisodeTask, describe_machine
from pytest_dura.execution import address as module
from pytest_dura.library import LocalRole
from pytest_dura.provenance import user_code
from pytest_dura.requirements import Requirement

FILES = {
    "planning/__init__.py": "",
    "planning/plan.py": "import shared.tools\nclass Planner:\n    pass\n",
    "planning/rest.py": "x = 1\n",
    "shared/__init__.py": "",
    "shared/tools.py": "def help():\n    import deeper as deep\n",
    "deeper.py": "x = 1\n",
    "unrelated.py": "x = 1\n",
    "watching.py": "class Monitor:\n    pass\n",
    "making.py": "import functools, watching\nmade = functools.partial(watching.Monitor)\n",
    "measure.py": "def peak(episode):\n    return 1.0\n",
}  # fmt: skip
GENERATOR, MONITOR = "planning.plan:Planner", "watching:Monitor"
CODE = "code of the generator " + GENERATOR


@pytest.fixture
def project(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in FILES:
        dotted = name.removesuffix("/__init__.py").removesuffix(".py").replace("/", ".")
        sys.modules.pop(dotted, None)


def task(**changes):
    spec = {
        "case": "a/b", "run": 1, "seed": 5,
        "simulator": RoleSpec("thermostat:Thermostat", {"gain": 1.0}),
        "roles": {"generator": RoleSpec(GENERATOR, {"x": 1}), "safety_monitor": RoleSpec(MONITOR)},
        "scenario": {"world": {"wall": 3.0}}, "faults": (Fault("bias", "f", "t"),),
    }  # fmt: skip
    own = {name: changes.pop(name) for name in list(changes) if name in EpisodeTask.__match_args__}
    return EpisodeTask(EpisodeSpec(**{**spec, **changes}), **own)


def changed(other, **before):
    """The parts that tell a task from the usual one, in processes that read the code anew."""
    first, second = Addresses().of(task(**before)), Addresses().of(other)
    assert (first.name == second.name) == (first.parts == second.parts)
    return first.changed(second.parts)


def test_an_equal_task_has_an_equal_address_in_any_process(project):
    script = f"""
import json, sys
sys.path[:0] = json.loads(sys.argv[1])
from pytest_dura.execution.address import Addresses
from pytest_dura.execution.task import EpisodeTask
print(Addresses().of(EpisodeTask.from_json(json.loads({json.dumps(task().to_json())!r}))).name)
"""
    names = set()
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        told = subprocess.run(
            [sys.executable, "-c", script, json.dumps([str(project), *sys.path])],
            env=environment, cwd="/", capture_output=True, text=True, check=True,
        )  # fmt: skip
        names.add(told.stdout.strip())
    assert names == {Addresses().of(task()).name}


def test_nothing_changes_what_is_the_same(project):
    assert changed(task()) == []
    assert changed(task(role_timeout=1.0)) == []
    one, two = {"x": 1, "y": 2}, {"y": 2, "x": 1}
    assert changed(task(scenario={"world": two}), scenario={"world": one}) == []


INPUTS = {
    "case": {"case": "a/c"},
    "run": {"run": 2},
    "seed": {"seed": 6},
    "scenario": {"scenario": {"world": {"wall": 3.5}}},
    "faults": {"faults": ()},
    "kept for viewers": {"recorded": True},
    "repetition": {"again": 1},
    "recorded timeouts": {"timeouts": (3,)},
}
ROLES = "roles and their parameters"
GROUP = "policy, end, time step and budget"


@pytest.mark.parametrize("part", INPUTS)
def test_each_input_changes_the_part_that_names_it(project, part):
    assert changed(task(**INPUTS[part])) == [part]


@pytest.mark.parametrize(
    "change",
    [
        {"policy": Policy.parse("halt")},
        {"termination": Termination(3.0)},
        {"time_step": 0.2},
        {"time_budget": 1.0},
    ],
)
def test_how_an_episode_is_run_is_one_part(project, change):
    assert changed(task(**change)) == [GROUP]


def test_parameters_of_roles_and_of_the_simulator_count(project):
    roles = task().spec.roles
    other = {**roles, "generator": RoleSpec(GENERATOR, {"x": 2})}
    assert changed(task(roles=other)) == [ROLES]
    assert changed(task(simulator=RoleSpec("thermostat:Thermostat", {"gain": 2.0}))) == [ROLES]


def test_a_role_that_is_left_out_or_another_one_is_named(project):
    left = {"generator": task().spec.roles["generator"]}
    assert changed(task(roles=left)) == [f"code of the safety_monitor {MONITOR}", ROLES]


def edited(project, name):
    first = Addresses().of(task())
    (project / name).write_text(FILES[name] + "# edited\n")
    return first.changed(Addresses().of(task()).parts)


@pytest.mark.parametrize(
    "file", ["planning/plan.py", "planning/rest.py", "shared/tools.py", "deeper.py"]
)
def test_code_that_a_role_rests_on_changes_that_role_alone(project, file):
    """Its own file, its package, what that imports, and what this imports within a function."""
    assert edited(project, file) == [CODE]


@pytest.mark.parametrize("file, counts", [("shared/tools.py", True), ("deeper.py", False)])
def test_code_outside_of_the_project_counts_where_the_project_imports_it(project, file, counts):
    """As it lies there; what it imports in turn from other folders is not looked for."""
    outside = project.parent / f"outside-{project.name}"
    for name in ("shared/__init__.py", "shared/tools.py", "deeper.py"):
        (outside / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).rename(outside / name)
    sys.path.insert(1, str(outside))  # the fixture's patch restores the path
    root = str(project)
    first = Addresses(root).of(task())
    (outside / file).write_text(FILES[file] + "# edited\n")
    assert first.changed(Addresses(root).of(task()).parts) == ([CODE] if counts else [])


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
def test_what_a_distribution_recorded_is_not_the_projects_own_code(project, metadata, counts):
    for name, text in metadata.items():
        (project / f"deep-1.{name}").parent.mkdir(exist_ok=True)
        (project / f"deep-1.{name}").write_text(text)
    assert edited(project, "deeper.py") == ([CODE] if counts else [])


def test_code_of_another_role_changes_the_other_role_alone(project):
    assert edited(project, "watching.py") == [f"code of the safety_monitor {MONITOR}"]


@pytest.mark.parametrize("file", ["unrelated.py", "measure.py"])
def test_code_that_nothing_rests_on_changes_nothing(project, file):
    assert edited(project, file) == []


def test_an_object_that_a_module_makes_is_addressed_by_that_module(project):
    roles = {**task().spec.roles, "safety_monitor": RoleSpec("making:made")}
    for file in ("making.py", "watching.py"):
        first = Addresses().of(task(roles=roles))
        (project / file).write_text(FILES[file] + "# edited\n")
        assert first.changed(Addresses().of(task(roles=roles)).parts) == [
            "code of the safety_monitor making:made"
        ]


def test_a_metric_counts_with_its_code(project):
    import measure

    metrics = {"peak": measure.peak}
    assert changed(task(metrics=metrics)) == ["code of the metric peak"]
    first = Addresses().of(task(metrics=metrics))
    (project / "measure.py").write_text(FILES["measure.py"] + "# edited\n")
    assert first.changed(Addresses().of(task(metrics=metrics)).parts) == ["code of the metric peak"]


def test_requirements_count_where_they_end_the_episode_and_for_what_ends_it(project):
    judging = (Requirement("R", "Text.", check="always (x > 0)"),)
    assert changed(task(judging=judging)) == ["requirements that end it"]
    reworded = (replace(judging[0], text="Other text.", at_most=0.1),)
    assert changed(task(judging=reworded), judging=judging) == []
    stricter = (replace(judging[0], check="always (x > 1)"),)
    assert changed(task(judging=stricter), judging=judging) == ["requirements that end it"]


@pytest.mark.parametrize("part", ["numpy", "other packages", "Python", "code of pytest-dura"])
def test_versions_of_packages_and_our_own_code_are_named(project, monkeypatch, part):
    other = {**describe_machine(), part: "0"}
    first = Addresses().of(task())
    monkeypatch.setattr(module, "describe_machine", lambda: other)
    assert first.changed(Addresses().of(task()).parts) == [part]


class Nowhere:
    """Of a module without a file, once its name says so."""


def test_what_cannot_be_compared_has_no_address(project, monkeypatch):
    roles = task().spec.roles
    bare = RoleSpec.of(Nowhere())
    assert Addresses().of(task(roles={**roles, "safety_monitor": bare})) is None
    assert Addresses().of(task(metrics={"m": lambda _: 1.0})) is None

    def inner():
        class Local:
            pass

        return Local

    local = LocalRole("conftest.py:Local", inner())
    assert Addresses().of(task(roles={**roles, "safety_monitor": local})) is None
    monkeypatch.setattr(Nowhere, "__module__", "of_no_file")
    named = LocalRole("conftest.py:Nowhere", Nowhere)
    monkeypatch.setitem(sys.modules, "of_no_file", type(sys)("of_no_file"))
    assert Addresses().of(task(roles={**roles, "safety_monitor": named})) is None


def test_a_class_of_a_conftest_is_addressed_by_its_file(project):
    (project / "conftest.py").write_text("import deeper\nclass Own:\n    pass\n")
    import importlib.util

    spec = importlib.util.spec_from_file_location("conftest", project / "conftest.py")
    found = importlib.util.module_from_spec(spec)
    before = sys.modules.get("conftest")
    sys.modules["conftest"] = found
    try:
        spec.loader.exec_module(found)
        own = LocalRole("conftest.py:Own", found.Own)
        roles = {**task().spec.roles, "safety_monitor": own}
        first = Addresses().of(task(roles=roles))
        assert "code of the safety_monitor conftest.py:Own" in first.parts
        (project / "deeper.py").write_text("x = 2\n")
        second = Addresses().of(task(roles=roles))
    finally:
        sys.modules["conftest"] = before
        if before is None:
            del sys.modules["conftest"]
    assert first.changed(second.parts) == [CODE, "code of the safety_monitor conftest.py:Own"]


def test_code_that_is_no_python_is_read_as_it_is(tmp_path):
    library = tmp_path / "fast.so"
    library.write_bytes(b"one")
    first = user_code(library, "fast")
    library.write_bytes(b"two")
    assert None not in (first, user_code(library, "fast"))
    assert first != user_code(library, "fast")
    library.unlink()
    assert user_code(library, "fast") is None


def test_imports_that_go_around_in_a_circle_end(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "circle_a.py").write_text("import circle_b, circle_a as me\n")
    (tmp_path / "circle_b.py").write_text("from circle_a import *\nimport no_such_module_at_all\n")
    first = user_code(tmp_path / "circle_a.py", "circle_a")
    (tmp_path / "circle_b.py").write_text("from circle_a import *\n")
    assert user_code(tmp_path / "circle_a.py", "circle_a") != first


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
    package = tmp_path / "packed"
    package.mkdir()
    for file in ("__init__.py", "inner.py", "aside.py"):
        (package / file).touch()
    (package / "using.py").write_text(text)
    aside = tmp_path / "aside.py"
    aside.write_text("1")
    first = user_code(package / "using.py", "packed.using")
    aside.write_text("2")
    assert (user_code(package / "using.py", "packed.using") != first) == counts


def test_a_file_that_is_no_python_of_this_version_counts_by_its_content(tmp_path):
    (tmp_path / "packed").mkdir()
    (tmp_path / "packed/__init__.py").touch()
    file = tmp_path / "packed/old.py"
    found = set()
    for text in (b"print 'one'", b"print 'two'", b"\0", b"# coding: none\n", b"(" * 10_000):
        file.write_bytes(text)
        found.add(user_code(tmp_path / "packed/__init__.py", "packed").digest)
    assert len(found) == 5


def test_a_module_with_letters_of_any_alphabet_counts(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("größe", "μ"):
        (tmp_path / f"{name}.py").write_text("1")
        using = tmp_path / f"using_{name}.py"
        using.write_text(f"from {name} import x\n")
        first = user_code(using, using.stem)
        (tmp_path / f"{name}.py").write_text("2")
        assert user_code(using, using.stem) != first


READS = """
import os
from os import environ, getenv
one, two = os.environ["{0}_ONE"], os.environ.get('{0}_TWO', "1")
three, four = getenv("{0}_THREE"), environ[
    "{0}_FOUR"
]
other = {{"{0}_OTHER": 1}}, os.getenv("API_KEY"), os.environ.get("PYTEST_XDIST_WORKER")
"""


@pytest.mark.parametrize("name", ["ONE", "TWO", "THREE", "FOUR", "OTHER", None])
def test_environment_variables_that_code_reads_by_name_are_named(project, monkeypatch, name):
    (project / "deeper.py").write_text(FILES["deeper.py"] + READS.format("DURA"))
    first = Addresses().of(task())
    for other in ("API_KEY", "PYTEST_XDIST_WORKER", "SOMETHING_ELSE"):
        monkeypatch.setenv(other, "2")
    if name is not None:
        monkeypatch.setenv(f"DURA_{name}", "2")
    again = Addresses().of(task())
    read = [] if name in (None, "OTHER") else [f"environment variable DURA_{name}"]
    assert first.changed(again.parts) == read
    # Each worker has a place of its own.
    assert first.of_any_machine == again.of_any_machine
    assert not any("DURA" in one for one in first.of_any_machine.parts)


def test_the_address_follows_a_variable_that_changes_while_the_session_runs(project, monkeypatch):
    (project / "deeper.py").write_text(FILES["deeper.py"] + READS.format("DURA"))
    addresses = Addresses()
    first = addresses.of(task())
    monkeypatch.setenv("DURA_ONE", "secret value")
    second = addresses.of(task())
    assert first.changed(second.parts) == ["environment variable DURA_ONE"]
    assert "secret value" not in str(second.parts)
