"""Laws of campaigns: how many episodes they run, of which seeds, and what they simulate beside."""

from __future__ import annotations

import math
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from campaign_rooms import BIAS, CountedRoom, rooms, warmest

from pytest_dura import Requirement, Runner

UNTIL_DECIDED = "{until: decided, at_most: 40}"
EXTRA = 0.2
"""The declared share of further runs that may follow invalid ones."""
COLD = Requirement("COLD", check="always (temperature < 99)")
HOT = Requirement("HOT", check="always (temperature > 99)")


@pytest.mark.parametrize("option, argument", list(product((None, 1, 2, 5), (None, 1, 4))))
def test_the_option_comes_before_the_call_and_the_call_before_the_scenario(
    tmp_path: Path, option: int | None, argument: int | None
) -> None:
    bench = rooms(tmp_path, runs=3)
    bench.runs = option
    campaign = bench.campaign("room/it", runs=argument)
    planned = option or argument or 3
    assert campaign.planned == len(campaign.episodes) == len(CountedRoom.seeds) == planned
    assert campaign.judge(COLD).run == planned


@pytest.mark.parametrize("planned", [1, 3, 5, 6, 10, 11])
def test_a_fixed_plan_is_followed_by_a_fifth_of_further_runs_where_runs_are_invalid(
    tmp_path: Path, planned: int
) -> None:
    idle: dict[str, Any] = {"faults": BIAS, "injector": "campaign_rooms:NeverInjects"}
    invalid = rooms(tmp_path / "invalid", runs=planned, **idle).campaign("room/it").judge(COLD)
    assert invalid.run == invalid.invalid == planned + math.ceil(EXTRA * planned)
    assert invalid.verdict == "undecided"
    valid = rooms(tmp_path / "valid", runs=planned, faults=BIAS).campaign("room/it").judge(COLD)
    assert (valid.run, valid.invalid) == (planned, 0)


def test_no_run_follows_a_plan_that_may_end_early(tmp_path: Path) -> None:
    idle: dict[str, Any] = {"faults": BIAS, "injector": "campaign_rooms:NeverInjects"}
    campaign = rooms(tmp_path, runs=UNTIL_DECIDED, **idle).campaign("room/it")
    assert len(campaign.episodes) == 40
    assert campaign.judge(COLD).run == 40


def test_no_run_follows_a_plan_that_a_sequential_method_decides(tmp_path: Path) -> None:
    idle: dict[str, Any] = {"faults": BIAS, "injector": "campaign_rooms:NeverInjects"}
    sequential = Requirement("COLD", check=COLD.check, at_most=0.5, method="e-process")
    verdict = rooms(tmp_path, runs=10, **idle).campaign("room/it").judge(sequential)
    assert verdict.run == verdict.invalid == verdict.planned == 10


RATES = {
    "e-process, violated": (HOT, {"method": "e-process"}, "violated"),
    "e-process, kept": (COLD, {"method": "e-process"}, "supported"),
    "sprt, violated": (HOT, {"method": "sprt", "p0": 0.1}, "violated"),
    "sprt, kept": (COLD, {"method": "sprt", "p0": 0.1}, "supported"),
}


@pytest.mark.parametrize("rule, keys, status", RATES.values(), ids=list(RATES))
def test_a_sequential_campaign_simulates_no_run_after_its_decision(
    tmp_path: Path, rule: Requirement, keys: dict[str, Any], status: str
) -> None:
    bench = rooms(tmp_path, runs=UNTIL_DECIDED)
    requirement = Requirement(rule.id, check=rule.check, at_most=0.5, **keys)
    verdict = bench.campaign("room/it").judge(requirement)
    assert verdict.verdict == status
    assert verdict.run == len(CountedRoom.seeds) < verdict.planned == 40
    assert verdict.saved == verdict.planned - verdict.run


def test_a_number_of_runs_that_is_given_is_run_to_its_end(tmp_path: Path) -> None:
    bench = rooms(tmp_path, runs=UNTIL_DECIDED)
    rate = Requirement("RATE", check=HOT.check, at_most=0.1)
    assert bench.campaign("room/it").judge(rate).run < 12
    given = bench.campaign("room/it", runs=12).judge(rate)
    assert (given.run, given.saved, given.verdict) == (12, 0, "violated")
    early = bench.campaign("room/it", runs=12, until_decided=True).judge(rate)
    assert early.run < 12


ARMS = ("room/it", "room/it+none", "room/it~recovery_planner", "room/it~safety_monitor")
OWN_SEED = 4711


@pytest.mark.parametrize("more", ["", f"seed: {OWN_SEED}"], ids=["of the session", "its own"])
def test_all_arms_of_a_scenario_share_the_seeds_of_their_runs(tmp_path: Path, more: str) -> None:
    bench = rooms(tmp_path, faults=BIAS, more=more)
    seeds = [[bench.run(arm, run=run).spec.seed for run in range(5)] for arm in ARMS]
    assert all(arm == seeds[0] for arm in seeds)
    assert len(set(seeds[0])) == 5
    assert (OWN_SEED in seeds[0]) == bool(more)
    assert not more or seeds[0][0] == OWN_SEED
    worlds = [[bench.run(arm, run=run).spec.scenario for run in range(5)] for arm in ARMS]
    assert all(arm == worlds[0] for arm in worlds)


def simulated(bench: Runner) -> list[int]:
    """How often each run was simulated for a verdict, sorted."""
    bench.campaign("room/it").judge(COLD)
    return sorted(Counter(CountedRoom.seeds).values())


def test_runs_without_the_fault_are_simulated_only_where_it_manifested(tmp_path: Path) -> None:
    assert simulated(rooms(tmp_path / "plain", runs=5)) == [1] * 5
    # A third simulation tells a fault's effect from a component that never repeats itself.
    assert set(simulated(rooms(tmp_path / "reached", runs=5, faults=BIAS))) == {2, 3}
    idle = rooms(tmp_path / "idle", runs=5, faults=BIAS, injector="campaign_rooms:NeverInjects")
    assert simulated(idle) == [1] * 6


@pytest.mark.parametrize("cut", [False, True])
def test_a_run_that_was_cut_once_all_was_decided_has_no_measure(tmp_path: Path, cut: bool) -> None:
    bench = rooms(tmp_path, requirements="SOON-1", end_when_decided=cut)
    campaign = bench.campaign("room/it")
    assert {episode.termination for episode in campaign.episodes} == {"decided" if cut else "time"}
    change = campaign.paired("recovery_planner").change(warmest)
    assert change.n == (0 if cut else 3)
