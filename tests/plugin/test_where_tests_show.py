"""Where editors show scenario items, and by which names they run them again.

The readers are written after what the pytest adapters of VS Code and PyCharm do with items.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ITEMS = ["corridor/free::GAP-1", "corridor/free::GO-1", "corridor/tight::GAP-1"]
CORRIDOR = ["--dura-scenarios", "--dura-select=corridor/*"]


class Collected:
    """Plugin that keeps the items of a session, as an editor's adapter does."""

    def pytest_collection_finish(self, session):
        self.items = [
            (item.nodeid, Path(item.path), item.location, item.reportinfo(), chain(item))
            for item in session.items
        ]
        self.root = session.config.rootpath


def chain(item):
    return [(node.nodeid, Path(node.path)) for node in item.iter_parents()]


def collect(project, *arguments):
    collected = Collected()
    project.pytester.runpytest_inprocess("--collect-only", "-q", *arguments, plugins=[collected])
    return collected


def ids(result):
    return [line for line in result.outlines if "::" in line and not line.startswith(" ")]


def vscode_id(nodeid, path):
    return "::".join([str(path), *nodeid.split("::")[1:]])


def test_items_are_placed_where_their_scenario_names_the_requirement(project):
    collected = collect(project, *CORRIDOR)
    assert [nodeid for nodeid, *_ in collected.items] == ITEMS
    for nodeid, path, (file, line, name), info, nodes in collected.items:
        case, _, requirement = nodeid.partition("::")
        assert path.is_relative_to(project.path / "scenarios")
        assert path.suffix == ".yaml"
        text = path.read_text()
        assert f"name: {case}\n" in text
        assert requirement in text.splitlines()[line]
        assert collected.root / file == path == Path(info[0])
        assert (line, name) == (info[1], nodeid)
        assert nodes[1] == (case, path)
        assert nodes[-1] == ("", collected.root)
        assert nodeid.startswith(nodes[1][0])


def test_each_line_of_a_list_of_requirements_is_a_place(project):
    project.write(
        "scenarios/corridor/listed.yaml",
        "name: corridor/listed\nsimulator: corridor:Corridor\nduration: 4.0\nruns: 1\n"
        "roles: {generator: {path: 'corridor:Careful'}}\n"
        "requirements:\n  - GO-1\n  # why\n  - GAP-1\n",
    )
    collected = collect(project, "corridor/listed")
    lines = {nodeid: location[1] for nodeid, _, location, *_ in collected.items}
    assert lines == {"corridor/listed::GO-1": 6, "corridor/listed::GAP-1": 8}


def test_node_ids_are_accepted_as_they_are_printed(project):
    printed = ids(project.run(*CORRIDOR, "--collect-only", "-q"))
    assert printed == ITEMS == ids(project.run(*CORRIDOR, "--collect-only", "-q"))
    for flags in ([], ["--dura-scenarios"]):
        for nodeid in printed:
            assert ids(project.run(nodeid, *flags, "--collect-only", "-q")) == [nodeid]
        assert ids(project.run(*printed[1:], *flags, "--collect-only", "-q")) == printed[1:]


def test_node_ids_are_the_same_in_workers(project):
    result = project.run(*CORRIDOR, "-n", "2", "-v")
    result.assert_outcomes(passed=3)
    shown = {word for line in result.outlines for word in line.split() if word in ITEMS}
    assert shown == set(ITEMS)
    project.run(*ITEMS[:2], "-n", "2").assert_outcomes(passed=2)


def test_node_ids_are_the_same_from_elsewhere(project, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    place = [f"--rootdir={project.path}", "-c", str(project.path / "pytest.ini")]
    assert ids(project.run(*CORRIDOR, *place, "--collect-only", "-q")) == ITEMS
    result = project.run(ITEMS[1], *place)
    result.assert_outcomes(passed=1)


@pytest.mark.parametrize("flags", [[], ["--dura-scenarios"]], ids=["alone", "with the flag"])
def test_vs_code_runs_what_it_has_found(project, flags):
    """It names a test by the item's path and what follows the first colons of its node id."""
    collected = collect(project, *CORRIDOR)
    names = {vscode_id(nodeid, path): nodeid for nodeid, path, *_ in collected.items}
    assert len(names) == len(ITEMS)
    for name, nodeid in names.items():
        again = collect(project, name, *flags)
        assert [(vscode_id(found, path), found) for found, path, *_ in again.items] == [
            (name, nodeid)
        ]
    everything = collect(project, *names, *flags)
    assert [nodeid for nodeid, *_ in everything.items] == ITEMS


def test_a_scenario_file_is_an_argument(project):
    project.run("scenarios/corridor/free.yaml").assert_outcomes(passed=2)
    project.run("scenarios/corridor/free.yaml::GO-1").assert_outcomes(passed=1)
    result = project.run("scenarios/corridor/free.yaml::GAP-9")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*the case 'corridor/free' has no requirement 'GAP-9'"])


def test_a_yaml_file_of_somebody_else_is_left_to_pytest(project):
    project.write("test_api.tavern.yaml", "test_name: theirs\n")
    project.write(
        "conftest.py",
        "import pytest\n"
        "class Item(pytest.Item):\n"
        "    def runtest(self): pass\n"
        "class File(pytest.File):\n"
        "    def collect(self): yield Item.from_parent(self, name='theirs')\n"
        "def pytest_collect_file(file_path, parent):\n"
        "    if file_path.name.endswith('.tavern.yaml'):\n"
        "        return File.from_parent(parent, path=file_path)\n",
    )
    project.run("test_api.tavern.yaml").assert_outcomes(passed=1)


def test_built_in_scenarios_lie_in_the_package_and_obey_the_root_conftest(project):
    """Whatever their files' folder is, the project's own conftest is asked."""
    project.write(
        "conftest.py",
        "def pytest_runtest_setup(item):\n    print('asked for', item.nodeid)\n"
        "def pytest_itemcollected(item):\n    print('collected', item.nodeid)\n",
    )
    nodeid = "intersection/nominal::SAF-1"
    collected = collect(project, nodeid)
    ((found, path, location, *_),) = collected.items
    assert found == nodeid
    assert path.is_absolute()
    assert path.read_text().count("name: intersection/nominal\n") == 1
    assert not path.is_relative_to(project.path)
    assert os.path.normpath(collected.root / location[0]) == str(path)
    assert [item[0] for item in collect(project, vscode_id(nodeid, path)).items] == [nodeid]
    result = project.run(nodeid, "--dura-runs=1", "-s")
    assert f"collected {nodeid}" in result.stdout.str()
    assert f"asked for {nodeid}" in result.stdout.str()


def test_a_conftest_beside_the_scenario_does_not_apply(project):
    project.write("scenarios/conftest.py", "def pytest_runtest_setup(item): raise ValueError\n")
    project.run("corridor/free").assert_outcomes(passed=2)


def test_pycharm_gets_a_relative_file_a_line_from_0_and_a_name(project):
    collected = collect(project, *CORRIDOR)
    for nodeid, path, location, *_ in collected.items:
        file, line, name = location
        assert isinstance(location, tuple)
        assert (type(file), type(line), type(name)) == (str, int, str)
        assert not Path(file).is_absolute()
        assert 0 <= line < len(path.read_text().splitlines())
        assert name == nodeid
