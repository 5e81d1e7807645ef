"""Fewer episodes than planned: planned and run are both recorded, and the verdict is undecided."""

from __future__ import annotations

import re

import pytest
from corridors import expect, scenario

EPISODE_TEST = """
import os
import pytest

@pytest.mark.dura(scenario="corridor/it", runs=4)
@pytest.mark.requirement("GAP-1")
def test_it(episode):
    {body}
    assert not episode.collided
"""
BREAKS = "if episode.spec.run == 1: raise OSError('no disk')"
DIES = "if episode.spec.run == 2: os._exit(3)"


def write_test(project, body="pass"):
    scenario(project)
    project.write("test_it.py", EPISODE_TEST.format(body=body))


@pytest.mark.parametrize(
    "body, arguments, run, gate",
    [
        (BREAKS, ["-x"], 2, "incomplete"),
        (BREAKS, ["--maxfail=1"], 2, "incomplete"),
        ("pass", ["-k", "it and 2"], 1, "failed"),
        ("pass", ["--deselect", "test_it.py::test_it[corridor/it#0]"], 3, "failed"),
        ("pass", ["test_it.py::test_it[corridor/it#3]"], 1, "failed"),
    ],
    ids=["-x", "--maxfail", "-k", "--deselect", "one node id"],
)
def test_fewer_episodes_than_planned_are_undecided(project, body, arguments, run, gate):
    write_test(project, body)
    paths = [] if "::" in arguments[0] else ["test_it.py"]
    result = project.run(*paths, *arguments)
    reason = f"only {run} of 4 planned episodes were run"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    assert (found.planned, found.run) == (4, run)
    assert project.evidence().gate.result == gate


def test_last_failed_runs_fewer_episodes_than_planned(project):
    write_test(project, BREAKS)
    project.run("test_it.py").assert_outcomes(passed=3, failed=1)
    write_test(project)
    result = project.run("test_it.py", "--lf")
    result.assert_outcomes(passed=1, deselected=3)
    reason = "only 1 of 4 planned episodes were run"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    assert (found.planned, found.run) == (4, 1)
    assert "the gate fails: GAP-1 on corridor/it is undecided, though" in result.stdout.str()


def test_a_time_limit_leaves_the_rest_undecided(project):
    write_test(project)
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.hookimpl(trylast=True)\n"
        "def pytest_runtest_teardown(item):\n"
        "    if '#1' in item.nodeid: item.session.shouldstop = 'the time is up'\n",
    )
    result = project.run("test_it.py", "corridor/it::GO-1")
    reason = "only 2 of 4 planned episodes were run"
    found = expect(project, result, "undecided", reason, ret=2, requirement="GAP-1")
    assert (found.planned, found.run) == (4, 2)
    never = project.verdict("GO-1")
    assert (never.verdict, never.planned, never.run) == ("undecided", 2, 0)
    assert project.evidence().status == "interrupted"


def test_a_dead_worker_leaves_its_runs_undecided(project):
    write_test(project, DIES)
    result = project.run("test_it.py", "-n", "2")
    reason = "only 3 of 4 planned episodes were run"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    assert (found.planned, found.run, found.violations) == (4, 3, 0)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_item_that_kills_its_worker_is_tried_once_and_the_others_run(
    project, monkeypatch, workers
):
    log = project.path / "log"
    monkeypatch.setenv("CORRIDOR_LOG", str(log))
    # Cases run in the order of their names here: some before and some after the one that dies.
    for name in ("a", "b", "c", "e", "f"):
        scenario(project, name, requirements="[GAP-1]", runs=1)
    scenario(project, "d", requirements="[GAP-1, GO-1]", runs=1, world="{dies: true}")
    result = project.scenarios("-n", workers, select="corridor/[a-f]")
    crashes = re.findall(
        r"^worker 'gw\d' crashed while running '(.*)'$", result.stdout.str(), re.MULTILINE
    )
    assert sorted(crashes) == ["corridor/d::GAP-1", "corridor/d::GO-1"]
    words = {case: word for (case, of), word in project.verdicts().items() if of == "GAP-1"}
    assert words.pop("corridor/d") == "undecided"
    assert words == dict.fromkeys([f"corridor/{name}" for name in "abcef"], "supported")
    simulated = [line.split()[0] for line in log.read_text().splitlines()]
    # The one that dies once for each of its two requirements, each of which cost a worker; the
    # others once and, their case being at its end, once more as the repeat of their first episode.
    assert sorted(simulated) == [f"corridor/{name}" for name in "aabbccddeeff"]
    repeats = {case.id: case.repeat for case in project.evidence().cases}
    assert repeats.pop("corridor/d") is None
    assert {repeat.result for repeat in repeats.values()} == {"equal"}
    assert result.ret == 1
