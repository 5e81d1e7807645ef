"""Runs that go on until a rate is decided, within a budget."""

from __future__ import annotations

import re

import pytest
from corridors import expect, requirement, scenario
from outputs import shown_of

BUDGET = "{until: decided, at_most: 40}"
METHODS = {
    "sprt": {"at_most": 0.3, "method": "sprt", "p0": 0.01},
    "e-process": {"at_most": 0.3, "method": "e-process"},
    "default": {"at_most": 0.3},
}


def write(project, runs=BUDGET, *, method="default", world="{wall: 4.0}", **keys):
    requirement(project, "always (gap > 0)", **METHODS[method])
    scenario(project, runs=runs, world=world, requirements="[R-1]", **keys)


def saved(project, result, verdict):
    """How many runs were saved, by the evidence and by the terminal with ``-v``."""
    count = verdict.saved
    shown = " ".join(result.stdout.str().split())
    place = f"{verdict.requirement} on {verdict.case}"
    assert f"{place}: {count} of 40 runs saved" in shown
    assert f"method: {verdict.method}; {verdict.bound.method}" in shown
    assert count == verdict.planned - verdict.run
    assert f" {verdict.episodes}/40 " in result.stdout.str()
    assert len(project.evidence().episodes) == verdict.run
    return count


@pytest.mark.parametrize("method", METHODS)
def test_a_hopeless_component_is_rejected_after_few_runs(project, method):
    write(project, method=method, generator="Reckless")
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "violated", "0.95 confidence rejects a rate of at most 0.3")
    assert found.violations == found.run == found.episodes
    assert found.run <= 5
    assert saved(project, result, found) >= 35
    assert found.method == ("sprt" if method == "sprt" else "e-process")


@pytest.mark.parametrize("method", METHODS)
def test_a_perfect_component_is_accepted_early(project, method):
    write(project, method=method)
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "supported", "supports a rate of at most 0.3")
    assert found.violations == 0
    # No method may accept 0 of n while n such runs are likely at the limit.
    assert 0.7**found.run <= 0.05
    assert saved(project, result, found) > 0
    assert found.bound.upper <= 0.3


def test_a_budget_that_is_used_up_is_undecided(project):
    runs = "{until: decided, at_most: 6}"
    write(project, runs, world="{wall: 4.0}")
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "undecided", "has not decided on at most 0.3 within 6 runs")
    assert (found.planned, found.run, found.saved) == (6, 6, 0)
    assert not re.search(r"\d saved", result.stdout.str().partition("= dura =")[2])


def test_a_component_that_fails_too_often_but_not_always_is_rejected(project):
    variation = "{world.wall: {choice: [1.0, 90.0]}}"
    write(project, world="{wall: 90.0}", variation=variation, generator="Reckless")
    found = expect(project, project.run("-v", "corridor/it"), "violated")
    assert 0 < found.violations < found.episodes < 40


def test_a_fixed_number_of_runs_ends_where_the_rest_cannot_change_it(project):
    """18 of 40 are too many for 0.3 though all others be clean, and 17 are not."""
    requirement(project, "always (gap > 0)", at_most=0.3, method="fixed")
    scenario(project, runs=BUDGET, generator="Reckless", world="{wall: 1.0}", requirements="[R-1]")
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "violated", "at 0.95 confidence the rate is above 0.31")
    assert (found.run, saved(project, result, found)) == (18, 22)


def test_without_a_rate_runs_end_at_the_first_violation(project):
    world = "{wall: 1.0}"
    scenario(project, runs=BUDGET, requirements="[GAP-1]", generator="Reckless", world=world)
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "violated", "1 of 1 valid", requirement="GAP-1")
    assert saved(project, result, found) == 39


def test_a_missing_episode_ends_the_runs_and_is_undecided(project):
    write(project, world="{breaks_at: 2}")
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "undecided", "1 of 1 episodes are missing (infrastructure)")
    assert (found.run, found.saved) == (1, 0)


TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/it", runs={runs})
def test_it(campaign):
    campaign.require("always (gap > 0)", {rate})
"""
SPRT = "at_most=0.3, method='sprt', p0=0.01"


@pytest.mark.parametrize(
    "runs, rate, method",
    [
        ("{'until': 'decided', 'at_most': 40}", "at_most=0.3", "e-process"),
        ("{'until': 'decided', 'at_most': 40}", SPRT, "sprt"),
        ("40", SPRT, "sprt"),
        ("40", "at_most=0.3, method='e-process'", "e-process"),
    ],
)
def test_a_marker_may_set_the_budget_and_a_test_the_method(project, runs, rate, method):
    project.write("test_it.py", TEST.format(runs=runs, rate=rate))
    for generator, word in (("Careful", "supported"), ("Reckless", "violated")):
        scenario(project, world="{wall: 4.0}", generator=generator)
        result = project.run("-v", "test_it.py")
        found = expect(project, result, word, requirement="always (gap > 0)")
        assert (found.planned, found.method) == (40, method)
        assert saved(project, result, found) > 0


@pytest.mark.parametrize(
    "runs, told",
    [
        ("{until: decided}", ["*it.yaml:5: *", "*runs*at_most*"]),
        ("{until: bored, at_most: 4}", ["*it.yaml:5: *", "*runs*until*", "*decided*"]),
        ("{until: decided, at_most: 0}", ["*it.yaml:5: *", "*runs*at_most*"]),
    ],
)
def test_a_budget_that_cannot_be_used_is_one_error(project, runs, told):
    write(project, runs)
    result = project.run("corridor/it", "--dura-scenarios")
    assert result.ret == 4
    result.stderr.fnmatch_lines(told)
    assert "Traceback" not in result.stderr.str()


WRONG_RUNS = ["{'until': 'decided'}", "{'until': 'bored', 'at_most': 4}", "{'at_most': 4}", "True"]
WRONG_RATES = {
    "method='sprt'": "E*a method decides on a rate*",
    "at_most=1.5": "E*at_most lies strictly between 0 and 1",
    "at_most=0.1, confidence=0.3": "E*confidence lies strictly between 0.5 and 1",
    "at_most=0.1, method='sprt', p0=0.2": "E*p0*",
    "at_most=0.1, method='magic'": "E*magic*",
}


def test_a_marker_and_a_test_with_what_cannot_be_used_run_nothing_and_show_the_users_line(project):
    scenario(project)
    asked = [(runs, "at_most=0.3") for runs in WRONG_RUNS] + [(2, rate) for rate in WRONG_RATES]
    text = "".join(
        TEST.format(runs=runs, rate=rate).replace("test_it", f"test_{n}")
        for n, (runs, rate) in enumerate(asked)
    )
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    assert result.ret == 1
    result.assert_outcomes(errors=len(WRONG_RUNS), failed=len(WRONG_RATES))
    shown = shown_of(result)
    wrong = "*test_it.py:*: the marker dura cannot be used: wrong `runs`"
    for n, told in enumerate([*[wrong] * len(WRONG_RUNS), *WRONG_RATES.values()]):
        shown[f"test_{n}"].fnmatch_lines([told])
    assert "pytest_dura/" not in result.stdout.str()
    assert project.evidence().episodes == []
