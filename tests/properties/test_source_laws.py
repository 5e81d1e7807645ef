"""What the episodes of a session rest on: the same wherever it lies, and every change is named."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from thermostat import Controller

from pytest_dura.core import ConfigurationError, EpisodeSpec, RoleSpec, Termination
from pytest_dura.execution import EpisodeTask, SourceRules, Sources, describe_machine, sources
from pytest_dura.execution.address import simulate
from pytest_dura.execution.sources import EpisodeFiles, LoadedModules, TooManyFilesError

lawful = settings(derandomize=True, deadline=None, max_examples=60)
IGNORED = ("*.egg", ".*", "build", "venv")
TESTS = ("test_*.py", "*_test.py")
NAMES = st.sampled_from([
    "a.py", "b/c.py", "b/d/conftest.py", "test_x.py", "build/e.py", "f.txt", "b/g_test.py",
    ".h/i.py", "j/__pycache__/k.py", "l/m.py", "out/n.py",
])  # fmt: skip
COUNTED = {"a.py", "b/c.py", "b/d/conftest.py", "l/m.py"}
TREES = st.dictionaries(NAMES, st.binary(max_size=4))


def write(root, tree):
    for name, data in tree.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)


def read(root, **rules):
    given_rules = {"ignored": IGNORED, "tests": TESTS, "outputs": (root / "out",)} | rules
    return Sources.of(SourceRules(root, **given_rules), {"Python": "3"})


@lawful
@given(TREES, TREES)
def test_what_differs_in_files_that_count_is_named_and_nothing_else_is(first, second):
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write(root / "one", first)
        write(root / "two", second)
        one, two = read(root / "one"), read(root / "two")
    assert set(one.files) == first.keys() & COUNTED
    changed = {name for name in COUNTED if first.get(name) != second.get(name)}
    assert set(two.changed_since(one)) == changed  # of five or more, a few would be named
    assert (one.digest == two.digest) == (not changed)


@lawful
@given(
    st.dictionaries(st.text(max_size=3), st.text(max_size=3)),
    st.dictionaries(st.text(max_size=3), st.text(max_size=3)),
)
def test_what_is_written_for_a_later_session_is_read_as_it_was(files, versions):
    made = Sources(files, versions)
    assert Sources.from_bytes(made.to_bytes()) == made
    data = json.loads(made.to_bytes())
    damaged = {**data, "files": {**data["files"], "one more": "0"}}
    assert Sources.from_bytes(json.dumps(damaged).encode()) is None


FILES = st.dictionaries(st.text("abc", min_size=1, max_size=2), st.text("01", max_size=1))


@lawful
@given(FILES, FILES)
def test_a_few_differences_are_named_and_the_others_counted(first, second):
    found = Sources(second, {}).changed_since(Sources(first, {}))
    every = sources.differences(first, second)
    if len(every) <= 4:
        assert list(found) == every
    else:
        assert found == (*every[:3], f"{len(every) - 3} others")


def test_versions_are_named_with_what_they_were_and_digests_without():
    old = Sources({}, {"moved": "1.0", "gone": "2", "code of pytest-dura": "a" * 64})
    new = Sources({}, {"moved": "1.1", "more": "3", "code of pytest-dura": "b" * 64})
    assert new.changed_since(old) == (
        "code of pytest-dura", "gone (2 before, none now)", "more (none before, 3 now)",
        "moved (1.0 before, 1.1 now)",
    )  # fmt: skip


@pytest.mark.parametrize(
    "patterns, counted",
    [
        (("test_*.py",), {"planner.py", "inner/check_it.py"}),
        (("check_*.py",), {"planner.py", "test_it.py"}),
        (("inner/*.py",), {"planner.py", "test_it.py", "inner/check_it.py"}),
        (("inner/check_*.py",), {"planner.py", "test_it.py"}),
        # A pattern that any module matches tells no test modules from components.
        (("*.py",), {"planner.py", "test_it.py", "inner/check_it.py"}),
    ],
)
def test_test_modules_are_those_of_pytests_patterns(tmp_path, patterns, counted):
    write(tmp_path, dict.fromkeys(["planner.py", "test_it.py", "inner/check_it.py"], b""))
    assert set(read(tmp_path, tests=patterns).files) == counted


def test_links_do_not_lead_outside_of_the_root(tmp_path):
    root, outside = tmp_path / "root", tmp_path / "outside"
    write(outside, {"package/a.py": b"1", "b.py": b"1"})
    write(root, {"own/c.py": b"1"})
    (root / "package").symlink_to(outside / "package")
    (root / "round").symlink_to(root)
    (root / "b.py").symlink_to(outside / "b.py")
    (root / "d.py").symlink_to(root / "own/c.py")
    found = read(root).files
    assert set(found) == {"own/c.py", "b.py", "d.py"}
    assert found["b.py"] == f"link to {outside / 'b.py'}"
    assert found["d.py"] == found["own/c.py"]
    if hasattr(os, "mkfifo"):
        os.mkfifo(root / "e.py")
        assert read(root).files["e.py"] == "not readable"


@pytest.mark.parametrize("mark", ["pyvenv.cfg", "conda-meta/history"])
def test_virtual_environments_are_not_read_whatever_they_are_called(tmp_path, mark):
    write(tmp_path, {"python/lib/a.py": b"", f"python/{mark}": b"", "b.py": b""})
    assert set(read(tmp_path).files) == {"b.py"}


def test_there_is_an_end_to_what_is_read(tmp_path, monkeypatch):
    write(tmp_path, dict.fromkeys(["a.py", "b.py", "c/d.py"], b""))
    monkeypatch.setattr(sources, "MAX_FILES", 3)
    assert len(read(tmp_path).files) == 3
    monkeypatch.setattr(sources, "MAX_FILES", 2)
    with pytest.raises(TooManyFilesError):
        read(tmp_path)


def test_a_project_that_is_installed_in_place_counts_by_its_files(tmp_path, monkeypatch):
    root, beside = tmp_path / "root", tmp_path / "beside"
    write(root, {"a.py": b""})
    write(beside, {"src/other/b.py": b"1"})
    url = json.dumps({"url": beside.as_uri(), "dir_info": {"editable": True}})
    write(tmp_path / "site", {"other-1.0.dist-info/direct_url.json": url.encode()})
    monkeypatch.syspath_prepend(tmp_path / "site")
    first = read(root)
    assert set(first.files) == {"a.py", "other/src/other/b.py"}
    write(beside, {"src/other/b.py": b"2"})
    assert read(root).changed_since(first) == ("other/src/other/b.py",)


class Planner(Controller):
    """A component that is defined in a test module."""


CONTROLLER = "thermostat:Controller"


@pytest.mark.parametrize(
    "generator, scenario, named",
    [
        (RoleSpec(CONTROLLER), {}, set()),
        (RoleSpec.of(Planner), {}, {"test_source_laws.py"}),
        (RoleSpec(CONTROLLER, {"weights": ["w.bin"]}), {}, {"w.bin"}),
        (RoleSpec(CONTROLLER), {"world": {"map": "w.bin"}}, {"w.bin"}),
        (RoleSpec(CONTROLLER, {"log": "out/w.bin"}), {}, set()),
        (RoleSpec(CONTROLLER, {"name": "no such file"}), {}, set()),
    ],
    ids=["none", "a test module", "a parameter", "the scenario", "an output", "other text"],
)
def test_an_episode_rests_on_the_files_that_it_names_itself(
    tmp_path, monkeypatch, generator, scenario, named
):
    write(tmp_path, {"w.bin": b"1", "out/w.bin": b"1"})
    monkeypatch.chdir(tmp_path)
    rules = SourceRules(Path(__file__).parents[2], tests=TESTS, outputs=(tmp_path / "out",))
    simulator, roles = RoleSpec("thermostat:Thermostat"), {"generator": generator}
    task = EpisodeTask(EpisodeSpec("a/b", 0, 1, simulator, roles, scenario=scenario))
    first = EpisodeFiles(rules).of(task, {"tests/support/thermostat.py"})
    assert {name.rpartition("/")[2] for name in first} == named
    write(tmp_path, {"w.bin": b"2", "out/w.bin": b"2"})
    second = EpisodeFiles(rules).of(task, {"tests/support/thermostat.py"})
    assert (first != second) == ("w.bin" in named)


def test_a_part_that_the_sources_of_the_session_lack_counts_by_itself(tmp_path):
    simulator, roles = RoleSpec("thermostat:Thermostat"), {"generator": RoleSpec(CONTROLLER)}
    task = EpisodeTask(EpisodeSpec("a/b", 0, 1, simulator, roles))
    assert set(EpisodeFiles(SourceRules(tmp_path)).of(task, ())) == {"support/thermostat.py"}


@pytest.mark.parametrize(
    "modules, refused",
    [({}, False), ({"thermostat": "0" * 16}, True), ({"not_imported": "0" * 16}, False)],
    ids=["none", "another one", "one that is not imported"],
)
def test_no_process_simulates_with_another_module_than_the_session(modules, refused):
    simulator, roles = RoleSpec("thermostat:Thermostat"), {"generator": RoleSpec(CONTROLLER)}
    task = EpisodeTask(EpisodeSpec("a/b", 0, 1, simulator, roles, termination=Termination(0.3)))
    own = LoadedModules().digests()
    assert "thermostat" in own
    conditions = {"machine": describe_machine(), "modules": {**own, **modules}}
    if refused:
        with pytest.raises(ConfigurationError, match="differs in module thermostat"):
            simulate(json.dumps(task.to_json()), conditions)
    else:
        assert simulate(json.dumps(task.to_json()), conditions)
