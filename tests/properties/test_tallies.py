"""Laws of accounts: whatever plain data they hold, an episode stands, and counts are counts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from entries import make
from hypothesis import given, settings
from hypothesis import strategies as st
from roads import channels_of, walker
from scipy.stats import beta

from pytest_dura.core import Percept, Tick, account_columns, account_problem, copied_account
from pytest_dura.core.codec import encode
from pytest_dura.core.metrics import EpisodeMetrics
from pytest_dura.driving import (
    SIGNALS,
    BodyList,
    EgoState,
    HighwaySimulator,
    Maneuver,
    account_measures,
)
from pytest_dura.driving.explanations import NAMES
from pytest_dura.evidence import FailureModes
from pytest_dura.reports import percent_text

lawful = settings(derandomize=True, deadline=None, max_examples=60)

DT = 0.1
DECISIONS = 6
PERSON = walker("P1", 2.0, 40.0)

words = st.sampled_from([
    "answered", "timeout", "refused", "pending", "slow_down", "hold", "speed_up", "P1", "V9", "",
    *(one.value for one in Maneuver),
])  # fmt: skip
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | words | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=6,
)  # fmt: skip
KEYS = ("decided", "at", "age", "outcome", "fallback", "perceived", "cited", "intent", "maneuver",
        "beside", "seconds", "null", "acceleration")  # fmt: skip
anything = st.dictionaries(st.sampled_from(KEYS), plain, max_size=8)

maneuvers = st.sampled_from([one.value for one in Maneuver])
answers = st.fixed_dictionaries(
    {"outcome": st.sampled_from(["answered", "timeout"]), "maneuver": maneuvers}
)
sensible = st.fixed_dictionaries(
    {
        "decided": st.booleans(),
        "at": st.integers(0, 1),
        "outcome": st.sampled_from(["answered", "timeout", "empty"]),
        "perceived": st.just(["P1"]),
        "cited": st.lists(st.sampled_from(["P1", "V9"]), unique=True),
        "intent": st.sampled_from(["slow_down", "hold", "speed_up"]),
        "maneuver": maneuvers,
        "beside": st.dictionaries(
            st.sampled_from(["again", "again_2", "reordered", "blind", "injected", "conflict"]),
            answers,
        ),
        "seconds": st.floats(0.0, 9.0),
        "age": st.floats(0.0, 0.9),
    },
    optional={"fallback": st.booleans()},
)
episodes = st.lists(sensible | anything, min_size=DECISIONS, max_size=DECISIONS)


def world() -> tuple[HighwaySimulator, list[Tick], list[Percept]]:
    simulator = HighwaySimulator()
    simulator.reset({"world": {}, "duration": 3.0}, 1)
    ego = EgoState(2.0, 50.0, -math.pi / 2, 8.0, 0.0, 0.0, 0.0, 20.0, 0.0)
    truth = {"ego": ego, "bodies": BodyList.of([PERSON]), "contact": 0}
    ticks = [Tick(index, index * DT, truth, {}) for index in range(DECISIONS + 1)]
    return simulator, ticks, [Percept(channels_of(PERSON))] * (DECISIONS + 1)


WORLD = world()


@lawful
@given(episodes)
def test_whatever_accounts_hold_measures_are_shown_or_not_or_unknown(told: Any) -> None:
    _, ticks, percepts = WORLD
    assert all(account_problem(one) is None for one in told)
    columns = account_measures(ticks, percepts, told, DT)
    assert tuple(columns) == NAMES
    for column in columns.values():
        assert column.shape == (DECISIONS,)
        assert set(column[~np.isnan(column)].tolist()) <= {0.0, 1.0}
    classes = np.nansum([columns[name] for name in NAMES[-8:]], axis=0)
    assert (classes <= 1).all()


@lawful
@given(episodes)
def test_signals_have_a_number_at_each_tick_and_tallies_count_decisions(told: Any) -> None:
    simulator, ticks, percepts = WORLD
    found = account_columns(simulator, ticks, percepts, told)
    if found is None:
        assert not any(told)
        return
    assert set(found.signals) == set(SIGNALS)
    assert all(one.shape == (len(ticks),) for one in found.signals.values())
    assert all(np.isfinite(one).all() and (one >= 0).all() for one in found.signals.values())
    fresh = sum(one.get("decided") is True for one in told)
    for tally in found.tallies.values():
        assert 0 <= tally.hits <= tally.of <= fresh
        assert 0 <= tally.null_hits <= tally.null_of <= fresh
    assert len(found.seconds) <= fresh
    assert all(0 <= one < math.inf for one in found.seconds)
    assert len(found.ages) <= fresh
    assert all(0 <= one <= ticks[DECISIONS].time for one in found.ages)


@lawful
@given(episodes)
def test_who_is_the_null_component_fails_exactly_as_it_does(told: Any) -> None:
    simulator, ticks, percepts = WORLD
    own = [{key: value for key, value in one.items() if key != "null"} for one in told]
    found = account_columns(simulator, ticks, percepts, [{**one, "null": dict(one)} for one in own])
    assert found is not None
    for tally in found.tallies.values():
        assert (tally.null_hits, tally.null_of) == (tally.hits, tally.of)


@lawful
@given(episodes)
def test_a_copy_is_equal_and_says_the_same(told: Any) -> None:
    _, ticks, percepts = WORLD
    copies = [copied_account(one) for one in told]
    assert copies == told
    one, other = (account_measures(ticks, percepts, these, DT) for these in (told, copies))
    assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in NAMES)


tallies = st.dictionaries(
    st.sampled_from("abc"),
    st.tuples(*[st.integers(0, 9)] * 4).map(
        lambda n: {
            "hits": min(n[0], n[1]), "of": n[1], "null_hits": min(n[2], n[3]), "null_of": n[3],
            "kind": "failure",
        }
    ),
)  # fmt: skip
durations = st.lists(st.floats(0.0, 99.0), max_size=5)
metrics = st.fixed_dictionaries(
    {"tallies": tallies, "answer_seconds": durations, "answer_ages": durations}
)


@lawful
@given(st.lists(metrics, max_size=12))
def test_sums_over_episodes_add_up_whatever_their_order(found: Any) -> None:
    one, other = FailureModes(), FailureModes()
    for episode in found:
        one.add(make(EpisodeMetrics, **episode))
    for episode in reversed(found):
        other.add(make(EpisodeMetrics, **episode))
    assert sorted(one.entries(), key=str) == sorted(other.entries(), key=str)
    assert one.answer_times() == other.answer_times()
    assert one.answer_ages() == other.answer_ages()
    for mode in map(encode, one.entries()):
        of = [episode["tallies"].get(mode["name"], {"hits": 0, "of": 0}) for episode in found]
        assert mode["hits"] == sum(tally["hits"] for tally in of)
        shown, could = sum(t["hits"] > 0 for t in of), sum(t["of"] > 0 for t in of)
        assert (mode["episodes"], mode["of_episodes"]) == (shown, could)
        if shown < could:
            exact = beta.ppf(0.95, shown + 1, could - shown)
            assert math.isclose(mode["upper"], exact, rel_tol=1e-9)
        else:
            assert mode["upper"] == (1.0 if could else None)
    for key, spread in (("answer_seconds", one.answer_times()), ("answer_ages", one.answer_ages())):
        seconds = [second for episode in found for second in episode[key]]
        assert (spread is None) == (not seconds)
        for name, rank in (("p50", 0.5), ("p95", 0.95)) if spread else ():
            assert getattr(spread, name) in seconds
            assert sum(second <= getattr(spread, name) for second in seconds) >= rank * len(seconds)
            assert sum(second < getattr(spread, name) for second in seconds) < rank * len(seconds)


@lawful
@given(st.integers(0, 10**6), st.integers(1, 10**6))
def test_only_never_and_always_read_so(part: int, whole: int) -> None:
    part = min(part, whole)
    text = percent_text(part / whole)
    assert (text == "0.0") == (part == 0)
    assert (text == "100.0") == (part == whole)
