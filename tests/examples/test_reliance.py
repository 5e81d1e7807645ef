"""Tool confidence: planners that only their recovery keeps safe fail the bounds on reliance."""

from __future__ import annotations

from functools import cache

import pytest

from pytest_dura import CampaignVerdict, RoleSpec, Runner
from pytest_dura.library import Library, expand_cases, load_library

BAD = {
    "aggressive": "aggressive",
    "stale by 1.5 s": "unreliable:Stale",
    "half invalid": "unreliable:HalfInvalid",
}


@cache
def runner_of(generator: str) -> tuple[Library, Runner]:
    """Each runner simulates its episodes once, whatever is judged of them."""
    library = load_library([])
    return library, Runner(lambda: library, roles={"generator": RoleSpec(generator)})


@cache
def judged(generator: str, requirement: str) -> CampaignVerdict:
    library, runner = runner_of(generator)
    (case,) = expand_cases(library.scenarios, select=["*/conflicting-traffic"])
    return runner.campaign(case).judge(library.requirements[requirement])


@pytest.mark.parametrize("planner", BAD)
def test_a_planner_that_needs_rescue_in_every_crossing_fails(planner: str) -> None:
    assert judged(BAD[planner], "SAF-1").verdict == "supported", "recovery hides it"
    reliance = judged(BAD[planner], "REC-4")
    assert reliance.verdict == "violated"
    assert reliance.violations == reliance.episodes == 15


def test_a_planner_whose_every_other_answer_is_invalid_is_driven_by_recovery() -> None:
    reliance = judged(BAD["half invalid"], "REC-3")
    assert reliance.verdict == "violated"
    assert reliance.violations == 15


@pytest.mark.parametrize("requirement", ["REC-3", "REC-4"])
def test_the_reference_planner_does_without(requirement: str) -> None:
    assert judged("rule_based", requirement).verdict == "supported"


def test_reliance_is_not_asked_where_somebody_attacks_the_monitor_as_well() -> None:
    for name, scenario in load_library([]).scenarios.items():
        if scenario.on_request:  # a few seconds of a crossing
            continue
        bounds = {"REC-3", "REC-4"} & set(scenario.requirements)
        assert bounds == (set() if scenario.faults else {"REC-3", "REC-4"}), name
