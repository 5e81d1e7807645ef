"""Workers of pytest-xdist: what a session comes to is the same, whoever schedules its items."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from corridors import requirement, scenario
from outputs import output

TESTS = """
import pytest

@pytest.mark.dura(scenario="corridor/pairs")
@pytest.mark.requirement("GAP-1")
def test_run(episode):
    assert not episode.collided

@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.dura(scenario=["corridor/pairs", "corridor/other"])
@pytest.mark.requirement("GO-1")
def test_case(campaign, number):
    campaign.require()
"""
FOREIGN = "import pytest\n\n@pytest.mark.parametrize('n', range(9))\ndef test_it(n): pass\n"
KEYS = {"cases", "episodes", "verdicts", "requirements", "waivers", "doubts", "gate", "overall"}


@pytest.fixture
def sessions(project, monkeypatch):
    """Runs scenario items with pairs and twins, and tests on the same cases, by these arguments."""
    log = project.path / "log"
    monkeypatch.setenv("CORRIDOR_LOG", str(log))
    paired = {"kind": "recovery", "paired": "{without: recovery_planner}"}
    requirement(project, "always (gap > 0)", "PAIR-1", **paired)
    requirements = "[GAP-1, GO-1, PAIR-1]"
    for name in ("pairs", "other"):
        faults = "[{type: bias, target: gap, activation: {at: 0.1}, parameters: {offset: 0.3}}]"
        roles = {"recovery_planner": "Brake", "faults": faults}
        scenario(project, name, requirements=requirements, duration=1.5, **roles)
    project.write("test_it.py", TESTS)
    project.write("test_other.py", FOREIGN)

    def run(*arguments):
        log.unlink(missing_ok=True)
        select = ("--dura-scenarios", "--dura-select=corridor/[po]*")
        result = project.run("test_it.py", "test_other.py", *select, *arguments)
        record = project.evidence().to_json(include=KEYS)
        for episode in record["episodes"]:
            del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
        return result, record, Counter(log.read_text().splitlines())

    return run


@pytest.fixture
def alone(sessions):
    return sessions()


def test_a_session_of_workers_is_that_of_one_process_and_each_episode_is_simulated_once(
    sessions, alone
):
    result, record, simulated = sessions("-n", "2")
    assert result.parseoutcomes() == {**alone[0].parseoutcomes(), **result.parseoutcomes()}
    assert record == alone[1]
    assert simulated == alone[2]


@pytest.mark.parametrize("dist", ["load", "loadscope", "worksteal"])
def test_a_session_that_is_scheduled_otherwise_is_the_same_but_for_what_is_simulated(
    sessions, alone, dist
):
    result, record, simulated = sessions("-n", "2", "--dist", dist)
    assert result.ret == alone[0].ret
    assert record == alone[1]
    assert simulated.keys() == alone[2].keys()


def test_the_header_says_where_processes_would_be_faster(project):
    def told(*arguments, select="corridor/free"):
        lines = project.scenarios(*arguments, "--dura-runs=1", select=select).outlines
        return [line for line in lines if re.match("dura: .* faster", line)]

    line = (
        "dura: this session is faster without -n: one worker simulates all of a scenario, and "
        "2 workers have 1 scenario"
    )
    assert told("-n", "2") == [line]
    assert told("-n", "1") == told("-n", "2", select="corridor/*") == told() == []
    assert told("-n", "2", "--dist", "load") == []


def test_tests_that_name_a_scenario_are_kept_together_without_any_option(project, monkeypatch):
    project.write("test_it.py", TESTS)
    for name in ("pairs", "other"):
        scenario(project, name, duration=1.5, runs=6)
    log = project.path / "log"
    monkeypatch.setenv("CORRIDOR_LOG", str(log))
    project.run("test_it.py", "-n", "2").assert_outcomes(passed=10)
    simulated = Counter(log.read_text().splitlines())
    # The first of each case is repeated.
    assert Counter(simulated.values()) == {1: 10, 2: 2}


def test_two_workers_die_of_a_case_at_most_and_its_other_items_fail(project):
    scenario(project, "a", requirements="[GAP-1]", runs=1)
    for number in (1, 2, 3):
        requirement(project, "always (gap > 0)", f"R-{number}")
    scenario(project, "d", requirements="[R-1, R-2, R-3, GAP-1]", runs=1, world="{dies: true}")
    scenario(project, "d/near", requirements="[GAP-1]", runs=1)
    scenario(project, "e", requirements="[GAP-1]", runs=1)
    result = project.scenarios("-n", "2", select="corridor/[ade]*")
    shown = output(result)
    crashes = re.findall(r"^worker 'gw\d' crashed while running '(.*)'$", shown, re.MULTILINE)
    assert sorted(crashes) == ["corridor/d::R-1", "corridor/d::R-2"]
    given_up = re.findall("^FAILED (.*) - 2 workers died in items on the same", shown, re.MULTILINE)
    assert given_up == ["corridor/d::R-3", "corridor/d::GAP-1"]
    words = project.verdicts()
    undecided = {case for (case, _), word in words.items() if word != "supported"}
    assert undecided == {"corridor/d"}
    assert len(words) == 7
    assert set(project.evidence().failed_items) == {
        f"corridor/d::{name}" for name in ("R-1", "R-2", "R-3", "GAP-1")
    }
    assert result.ret == 1
    assert "to go on: pytest" in shown
