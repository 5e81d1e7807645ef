"""What one pair of runs comes to: spoilt, violated only with it, vacuous, or a growth."""

from __future__ import annotations

import math
from typing import Any

import pytest
from episodes import episode, idle

from pytest_dura.requirements import (
    EpisodeVerdict,
    Paired,
    Requirement,
    change_verdict,
    pair_verdict,
)
from pytest_dura.requirements.runs import Run


def verdict(word: Any, run: int, *, case: str = "case", **fields: Any) -> EpisodeVerdict:
    plain = {
        "requirement": "R", "episode": f"{case}#{run}", "component": "Planner", "verdict": word,
        "margin": None, "time": None, "detail": "", "proposals": 10, "valid_proposals": 10,
    }  # fmt: skip
    return EpisodeVerdict(**{**plain, **fields})


def test_a_pair_is_spoilt_by_either_run_and_says_which() -> None:
    own = verdict("satisfied", 0)
    twin = verdict("missing", 0, case="case~role", detail="infrastructure: simulator")
    found = pair_verdict(own, twin)
    assert (found.verdict, found.episode) == ("missing", "case#0")
    assert found.detail == "infrastructure: simulator, in case~role#0"
    found = pair_verdict(verdict("invalid", 0, detail="never manifested"), own)
    assert (found.verdict, found.detail) == ("invalid", "never manifested")


def test_a_missing_run_says_more_than_an_invalid_one() -> None:
    own = verdict("invalid", 0, detail="never manifested")
    twin = verdict("missing", 0, case="case~role", detail="infrastructure: simulator")
    for one in (pair_verdict(own, twin), pair_verdict(twin, own)):
        assert one.verdict == "missing"
        assert "infrastructure: simulator" in one.detail


@pytest.mark.parametrize(
    "own, twin, word, margin",
    [
        (2.0, 5.0, "satisfied", 2.0),
        (-2.0, 5.0, "violated", -2.0),
        (-2.0, -3.0, "satisfied", 3.0),
        (1.0, -3.0, "satisfied", 3.0),
        (None, -3.0, "satisfied", None),
    ],
)
def test_the_margin_of_a_pair_is_that_of_the_implication(
    own: float | None, twin: float, word: str, margin: float | None
) -> None:
    words = ["violated" if one is not None and one < 0 else "satisfied" for one in (own, twin)]
    found = pair_verdict(verdict(words[0], 0, margin=own), verdict(words[1], 0, margin=twin))
    assert (found.verdict, found.margin) == (word, margin)


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("twin", [True, False])
def test_a_pair_is_vacuous_if_the_condition_held_in_neither_run(own: bool, twin: bool) -> None:
    found = pair_verdict(
        verdict("satisfied", 0, vacuous=own), verdict("satisfied", 0, vacuous=twin)
    )
    assert found.vacuous == (own and twin)


def test_a_condition_that_only_the_twin_met_is_not_vacuous() -> None:
    kept_away = verdict("satisfied", 0, vacuous=True)
    assert not pair_verdict(kept_away, verdict("violated", 0)).vacuous


def test_a_measure_of_a_missing_run_is_missing_whatever_the_other_is() -> None:
    unreached, broken = episode(faults=(idle(),)), episode(failure="infrastructure: simulator")
    for one, twin in ((unreached, broken), (broken, unreached)):
        found = change_verdict(GROWTH, Run.of(one), Run.of(twin), (None, None))
        assert (found.verdict, found.margin) == ("missing", None)
        assert found.detail == "infrastructure: simulator, in case#0"
    assert (
        change_verdict(GROWTH, Run.of(episode()), Run.of(unreached), (1.0, None)).verdict
        == "invalid"
    )


GROWTH = Requirement("R", paired=Paired("faults", "pkg:time", 2.0))


@pytest.mark.parametrize(
    "values, word",
    [
        ((12.0, 10.0), "satisfied"),
        ((12.1, 10.0), "violated"),
        ((12.0 + 1e-6, 10.0), "violated"),
        ((1.0, 10.0), "satisfied"),
        ((math.nan, 10.0), "violated"),
        ((math.inf, 10.0), "violated"),
        ((10.0, math.nan), "satisfied"),
        ((math.nan, math.nan), "invalid"),
    ],
)
def test_growth_up_to_the_bound_is_accepted_and_no_value_is_more_than_any(
    values: tuple[float, float], word: str
) -> None:
    one = Run.of(episode())
    assert change_verdict(GROWTH, one, one, values).verdict == word


def test_a_growth_of_whole_ticks_equals_its_bound_wherever_it_begins() -> None:
    one, dt = Run.of(episode()), 0.1
    times = [(tick * dt, (tick - 20) * dt) for tick in range(20, 400)]
    assert any(own - twin > 2.0 for own, twin in times)
    for values in times:
        found = change_verdict(GROWTH, one, one, values)
        assert (found.verdict, found.margin == 0.0) == (
            "satisfied", abs(values[0] - values[1] - 2.0) < 1e-9,
        )  # fmt: skip
