"""Laws of what a search may say: of repeatable violations, of others, and of nothing found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from campaign_rooms import BIAS, rooms

from pytest_dura import Falsification, Falsified, Runner

HOT, COLD = "always (temperature > 99)", "always (temperature < 99)"
DRIFTING = "campaign_rooms:Drifting"
DRIFTING_AT_NOMINAL = "{path: campaign_rooms:Drifting, params: {where: 15.0}}"
ADDED = {
    "type": "bias",
    "target": "thermometer",
    "activation": {"at": 0.1},
    "parameters": {"offset": 5.0},
}


def searched(bench: Runner, check: str, case: str = "room/it", **keys: Any) -> Falsification:
    try:
        return bench.campaign(case).falsify(check, **{"budget": 12, "shrink": 40, **keys})
    except Falsified as error:
        return error.falsification


OUTCOMES: dict[str, tuple[dict[str, Any], str, dict[str, Any], str]] = {
    "always the same violation": ({}, HOT, {}, "falsified"),
    "violations that all differ": ({"generator": DRIFTING}, HOT, {}, "not repeatable"),
    "the same violation, other ones once simpler": (
        {"generator": DRIFTING_AT_NOMINAL}, HOT, {}, "falsified",
    ),
    "no violation": ({}, COLD, {}, "nothing found"),
    "no violation, and faults that act": ({}, COLD, {"faults": [ADDED]}, "nothing found"),
    "no violation, and no added fault ever acts": (
        {"injector": "campaign_rooms:NeverInjects"}, COLD, {"faults": [ADDED]}, "undecided",
    ),
    "no violation, and no fault of the case ever acts": (
        {"injector": "campaign_rooms:NeverInjects", "faults": BIAS}, COLD, {}, "undecided",
    ),
}  # fmt: skip


@pytest.mark.parametrize("room, check, keys, status", OUTCOMES.values(), ids=list(OUTCOMES))
def test_a_search_says_no_more_than_its_simulations_show(
    tmp_path: Path, room: dict[str, Any], check: str, keys: dict[str, Any], status: str
) -> None:
    search = searched(rooms(tmp_path, **room), check, **keys)
    (outcome,) = search.outcomes
    assert outcome.status == status
    assert (outcome.counterexample is not None) == (status in ("falsified", "not repeatable"))
    if outcome.counterexample is None:
        assert search.simulations == search.budget
        return
    repeats = outcome.counterexample.repeats
    if status == "falsified":
        assert (repeats.runs, repeats.violated, repeats.equal) == (1, 1, 1)
    else:
        assert repeats.equal < repeats.violated == repeats.runs == 10
        assert outcome.counterexample.shrinking is None
        assert outcome.counterexample.file is None


def test_a_simpler_case_is_kept_only_where_it_repeats_itself(tmp_path: Path) -> None:
    (steady,) = searched(rooms(tmp_path / "steady"), HOT).outcomes
    assert steady.counterexample.changes == ()
    assert steady.counterexample.shrinking.after == 0
    bench = rooms(tmp_path / "drifting", generator=DRIFTING_AT_NOMINAL)
    (uncertain,) = searched(bench, HOT).outcomes
    assert uncertain.counterexample.repeats.confirmed
    assert uncertain.counterexample.shrinking is None
    assert "world.start" in {change.path for change in uncertain.counterexample.changes}


def test_each_case_component_session_and_requirement_is_searched_by_draws_of_its_own(
    tmp_path: Path,
) -> None:
    bench, other = rooms(tmp_path, faults=BIAS), rooms(tmp_path, faults=BIAS, base_seed=1)
    searches = [
        searched(bench, COLD),
        searched(bench, COLD, case="room/it+none"),
        searched(bench, COLD, case="room/it~safety_monitor"),
        searched(bench, "always (temperature < 98)"),
        searched(other, COLD),
    ]
    assert len({search.seed for search in searches}) == len(searches)
    assert searched(bench, COLD).seed == searches[0].seed
