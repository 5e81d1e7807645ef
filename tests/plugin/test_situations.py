"""Runs that do not differ are one observation: no rate follows from them."""

import json

import pytest
from corridors import expect, requirement, scenario

from pytest_dura.__main__ import main

STILL = {"simulator": "Still", "requirements": "[R-1]"}
PAINT = {"world": "{paint: 1.0}", "variation": "{world.paint: {min: 0.0, max: 1.0}}"}
REPEATED = "one situation, repeated"
NO_EFFECT = "the declared variation has no effect"
SCRIPTED = """
name: junction/scripted
simulator: driving
duration: 2.0
runs: 59
world:
  ego: {distance: 50.0, speed: 8.0, turn: straight}
  vehicles: [{id: BLUE, arm: west, turn: straight, distance: 40.0, speed: 8.0}]
roles: {generator: rule_based}
requirements: [R-1]
"""


def verified(project):
    return main(["verify", str(project.path / "dura-evidence")]) == 0


def rate(project, check="always (gap > 0)", **keys):
    requirement(project, check, **({"at_most": 0.05} | keys))


def test_a_scripted_scene_of_the_driving_domain_bounds_no_rate(project):
    rate(project)
    project.write("scenarios/junction/scripted.yaml", SCRIPTED)
    result = project.scenarios(select="junction/scripted")
    reason = f"{REPEATED}: no rate can be bound"
    found = expect(project, result, "undecided", reason, case="junction/scripted")
    assert (found.run, found.saved, found.planned) == (2, 57, 59)
    assert (found.bound.upper, found.situation) == (None, "repeated")


def test_random_traffic_differs_without_a_declared_variation(project):
    rate(project, at_most=0.9)
    text = SCRIPTED.replace(
        "vehicles: [", "traffic: {headway: 9.0, arms: [west, east]}\n  vehicles: ["
    )
    project.write(
        "scenarios/junction/scripted.yaml", text.replace("runs: 59", "runs: 4").replace("BLUE", "X")
    )
    project.scenarios(select="junction/scripted")
    found = project.verdict("R-1", "junction/scripted")
    assert (found.verdict, found.run, found.situation) == ("supported", 4, None)


@pytest.mark.parametrize(
    "plan", ["59", "{until: decided, at_most: 59}"], ids=["fixed", "until decided"]
)
def test_one_situation_is_run_twice_and_no_rate_is_bound(project, plan):
    rate(project)
    scenario(project, **STILL, runs=plan)
    result = project.scenarios("-v", select="corridor/it")
    found = expect(project, result, "undecided", f"{REPEATED}: no rate can be bound")
    assert (found.run, found.saved, found.planned) == (2, 57, 59)
    assert (found.bound.upper, found.situation) == (None, "repeated")
    told = " ".join(result.stdout.str().split())
    assert f"R-1: undecided, 0 of 2 runs violate it: {REPEATED}." in told
    assert "R-1 on corridor/it undecided 2/59 0" in told
    (case,) = project.evidence().cases
    assert (case.planned, case.missing_runs_total, case.metrics.run) == (59, 0, 2)
    for name in ("summary.md", "report.html", "assurance-case.gsn.yaml"):
        assert REPEATED in (project.path / "dura-evidence" / name).read_text()
    assert verified(project)


def test_without_a_rate_one_situation_is_supported_and_bounds_none(project):
    requirement(project, "always (gap > 0)")
    scenario(project, **STILL, runs=20)
    result = project.scenarios(select="corridor/it")
    found = expect(project, result, "supported", f"all 2 valid episodes satisfied it: {REPEATED}")
    assert (found.run, found.saved, found.bound.upper) == (2, 18, None)
    assert "rate <=" not in result.stdout.str()
    assert verified(project)


@pytest.mark.parametrize("at_most", [None, 0.05])
def test_one_situation_that_violates_it_is_violated(project, at_most):
    rate(project, at_most=at_most)
    scenario(project, **STILL, runs=20, world="{wall: 4.0}", generator="Reckless")
    result = project.scenarios(select="corridor/it")
    expect(project, result, "violated", f"2 of 2 valid episodes violated it: {REPEATED}")
    assert verified(project)


@pytest.mark.parametrize("at_most", [None, 0.5])
def test_a_variation_without_effect_leaves_it_undecided(project, at_most):
    rate(project, at_most=at_most)
    scenario(project, **STILL, **PAINT, runs=10)
    result = project.scenarios(select="corridor/it")
    found = expect(project, result, "undecided", f"{NO_EFFECT}: all 10 episodes are equal")
    assert (found.run, found.bound.upper) == (10, None)
    assert found.situation == "without effect"
    assert verified(project)


def test_what_is_drawn_may_yet_differ_so_that_all_runs_are_run(project):
    rate(project, at_most=0.9)
    project.write(
        "quakes.py",
        """
from corridor import Still
from pytest_dura import stream

class Quakes(Still):
    def blow(self, seed):
        return float(stream(seed, "quake").random() < 0.2)
""",
    )
    scenario(project, simulator="quakes:Quakes", runs=12, requirements="[R-1]")
    project.scenarios(select="corridor/it")
    found = project.verdict("R-1")
    runs = {one.spec.run: one.trajectory for one in project.evidence().episodes}
    assert runs[0] == runs[1]
    assert len(set(runs.values())) == 2
    assert (found.verdict, found.run, found.situation) == ("supported", 12, None)
    assert verified(project)


def test_a_single_run_is_judged_as_ever(project):
    rate(project, at_most=0.99)
    scenario(project, **STILL, runs=1)
    found = expect(project, project.scenarios(select="corridor/it"), "supported")
    assert found.situation is None
    assert found.bound.upper is not None


def test_a_fault_that_a_case_leaves_out_varies_nothing_of_it(project):
    rate(project)
    scenario(
        project,
        **STILL,
        runs=9,
        faults='[{id: nudge, type: "oddities:Drizzle", activation: {at: 0.1}}]',
        variation="{faults.nudge.activation.at: {min: 0.1, max: 0.3}}",
    )
    project.scenarios("--dura-faults=none", select="corridor/it+none")
    assert project.verdict("R-1", "corridor/it+none").situation == "repeated"


def test_pairs_that_do_not_differ_bound_no_rate(project):
    scenario(project, simulator="Still", runs=30, recovery_planner="Brake")
    project.write(
        "test_it.py",
        """
import pytest

@pytest.mark.dura(scenario="corridor/it")
def test_it(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > 0)", at_most=0.1)
""",
    )
    result = project.run("test_it.py")
    reason = f"{REPEATED}: no rate can be bound"
    found = expect(project, result, "undecided", reason, requirement="always (gap > 0)")
    assert (found.run, found.pairs.pairs) == (2, 2)
    assert verified(project)


@pytest.mark.parametrize(
    "variation, reason",
    [({}, f"{REPEATED}: no rate can be bound"), (PAINT, f"{NO_EFFECT}: all 4 episodes are equal")],
)
def test_tests_that_look_at_one_run_each_bound_no_rate_on_equal_ones(project, variation, reason):
    rate(project, at_most=0.9)
    scenario(project, **STILL, **variation, runs=4)
    project.write(
        "test_it.py",
        """
import pytest

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("R-1")
def test_it(episode):
    assert not episode.collided
""",
    )
    expect(project, project.run("test_it.py"), "undecided", reason)
    assert verified(project)


def other_trajectory(record):
    record["episodes"][0]["trajectory"] = "0" * 64


def no_situation(record):
    record["verdicts"][0]["situation"] = None


def a_bound(record):
    record["verdicts"][0]["bound"]["upper"] = 0.04


FORGED = {
    other_trajectory: '/verdicts/0/situation: found "repeated", expected null',
    no_situation: '/verdicts/0/situation: found null, expected "repeated"',
    a_bound: "/verdicts/0/bound/upper: found 0.04, expected null",
}


def test_what_is_forged_of_it_is_found(project, capsys):
    rate(project)
    scenario(project, **STILL, runs=59)
    project.scenarios(select="corridor/it")
    file = project.path / "dura-evidence/evidence.json"
    whole = file.read_text()
    for forge, told in FORGED.items():
        record = json.loads(whole)
        forge(record)
        file.write_text(json.dumps(record))
        capsys.readouterr()
        assert not verified(project)
        assert told in capsys.readouterr().out
