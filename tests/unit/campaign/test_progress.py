from __future__ import annotations

import signal

import pytest
from thermostat import Thermostat

from pytest_dura import Runner
from pytest_dura.campaign import Progress
from pytest_dura.campaign.fault_tracing import TWINS_SUBJECT
from pytest_dura.library import load_library, role_of_fixture
from pytest_dura.requirements import Requirement
from pytest_dura.search import falsify_case
from pytest_dura.search.falsify import Falsified

SCENARIO = """
name: room/{name}
simulator: thermostat:Thermostat
duration: 1.0
runs: {runs}
roles: {{generator: "thermostat:Controller"}}
faults: {faults}
requirements: []
"""
BIAS = "{type: bias, target: clock, activation: {at: 0.2}, parameters: {offset: 3.0}}"
RATE = Requirement("T-1", check="always (temperature > -300)", at_most=0.5)


@pytest.fixture
def told():
    return []


@pytest.fixture
def bench(tmp_path, told):
    for name, runs, faults in (("warm", 4, "[]"), ("faulty", 2, "[bias]")):
        text = SCENARIO.format(name=name, runs=runs, faults=faults)
        text = text.replace("[bias]", f"[{BIAS}]")
        (tmp_path / f"{name}.yaml").write_text(text)
    varied = SCENARIO.format(name="varied", runs=2, faults="[]")
    (tmp_path / "varied.yaml").write_text(
        varied + "world: {start: 18.0}\nvariation: {world.start: {min: 15.0, max: 20.0}}\n"
    )
    library = load_library([tmp_path], builtin=False)
    found = Runner(lambda: library, falsifier=falsify_case)

    def tell(event):
        if event.budget:  # there may be no twins to be run
            told.append((event.bounded(), event.ended))

    found.events.subscribe(Progress, tell)
    return found


def shown(told, *names):
    return [tuple(getattr(one, name) for name in names) for one, ended in told if not ended]


def ends(told):
    return [ended for _, ended in told]


def test_a_campaign_tells_before_each_run_and_at_its_end(bench, told):
    bench.campaign("room/warm").judge(RATE)
    assert shown(told, "case", "subject", "done", "budget") == [
        ("room/warm", "T-1", done, 4) for done in range(4)
    ]
    assert ends(told) == [False] * 4 + [True]


def test_violations_are_told_and_the_bound_where_a_rate_is_to_be_decided(bench, told):
    bench.campaign("room/warm").judge(Requirement("T-2", check="always (temperature > 300)"))
    assert shown(told, "violations", "upper") == [(done, None) for done in range(4)]
    told.clear()
    bench.campaign("room/warm").judge(RATE)
    # Without a violation in n episodes, (1 - upper)^n = 1 - confidence.
    bounds = shown(told, "violations", "upper", "confidence")
    assert bounds[0] == (0, None, None)
    for done in (1, 2, 3):
        violations, upper, confidence = bounds[done]
        assert (violations, confidence) == (0, 0.95)
        assert (1 - upper) ** done == pytest.approx(0.05)


def test_nothing_is_said_of_violations_where_nothing_is_judged(bench, told):
    assert len(bench.campaign("room/warm").episodes) == 4
    assert set(shown(told, "violations", "upper", "subject")) == {(None, None, "")}


def test_a_campaign_that_ends_once_it_is_decided_says_that_it_may(bench, told):
    bench.campaign("room/warm", 90, until_decided=True).judge(RATE)
    assert set(shown(told, "may_end_early", "budget")) == {(True, 90)}
    assert 0 < len(shown(told)) < 90
    assert ends(told)[-1]
    told.clear()
    bench.campaign("room/warm").judge(RATE)
    assert set(shown(told, "may_end_early")) == {(False,)}


def test_runs_at_hand_are_told_as_taken_over_until_one_is_simulated(bench, told):
    bench.run("room/warm", run=0)
    bench.run("room/warm", run=1)
    bench.run("room/warm", run=3)
    bench.campaign("room/warm").judge(RATE)
    assert shown(told, "done", "taken_over") == [(0, 0), (1, 1), (2, 2), (3, 2)]
    told.clear()
    bench.campaign("room/warm").judge(RATE)
    assert shown(told, "done", "taken_over") == [(done, done) for done in range(4)]


def test_a_search_takes_over_what_it_had_before_and_says_so_of_nothing_else(bench, told):
    for expected in ({0}, {0, 1, 2, 3, 4, 5}):
        bench.campaign("room/varied").falsify("always (temperature > -300)", budget=5)
        assert shown(told, "done", "budget")[0] == (0, 5)
        assert set(shown(told, "taken_over")) == {(one,) for one in expected}
        told.clear()


def test_baselines_simplification_and_regions_of_a_search_are_shown_too(bench, told):
    with pytest.raises(Falsified):
        bench.campaign("room/varied").falsify(
            "always (temperature > 300)", budget=5, all=True, region_runs=3, shrink=4
        )
    search, *alone, simpler, region = dict.fromkeys(shown(told, "subject", "budget"))
    check = "always (temperature > 300)"
    assert (search, simpler, region) == (
        (f"search {check}", 5), (f"simpler {check}", 4), (f"region of {check}", 3)
    )  # fmt: skip
    assert {name for name, _ in alone} >= {"random seeds alone", "uniform alone"}
    assert {budget for _, budget in alone} == {5}
    assert told[-1][1]


class Interrupted(Thermostat):
    def reset(self, scenario, seed):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("hears_keys")
def test_the_end_is_told_also_of_a_campaign_that_is_broken_off(bench, told):
    for _ in bench.campaign("room/warm"):
        break
    assert ends(told) == [False, True]
    told.clear()
    bench.simulator = role_of_fixture("simulator", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        bench.campaign("room/warm").judge(RATE)
    assert ends(told) == [False, True]


def test_runs_in_place_of_invalid_ones_join_the_budget_and_twins_are_told_as_such(bench, told):
    # No role reads the clock, so that no fault ever manifests.
    bench.campaign("room/faulty").judge(RATE)
    assert shown(told, "subject", "done", "budget") == [
        ("T-1", 0, 2), ("T-1", 1, 3), ("T-1", 2, 3),
        (TWINS_SUBJECT, 0, 3), (TWINS_SUBJECT, 1, 3), (TWINS_SUBJECT, 2, 3),
    ]  # fmt: skip
    assert ends(told) == [False, False, False, True] * 2
