"""What a component tells of its proposals: checked, kept as it was told, and counted."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest
from loops import Says, run_loop
from thermostat import Thermostat

from pytest_dura import Proposal
from pytest_dura.core import Tally, account_columns, copied_account
from pytest_dura.core.loop_signals import DEEPEST, LONGEST


class Told(Thermostat):
    """A room in which an account may admit to guessing, and tell how sure the component is."""

    measure_kinds: ClassVar = {"guessed": "control"}

    def account_measures(self, ticks, percepts, accounts):
        assert len(percepts) == len(ticks)
        column = [one.get("guess", np.nan) for one in accounts]
        return {"guessed": np.array(column, float), "other": np.full(len(accounts), np.nan)}

    def account_signals(self, ticks, percepts, accounts):
        return {"sure": np.array([one.get("sure", np.nan) for one in accounts], float)}


def telling(*accounts, seconds=None):
    """An episode of a component that gives these accounts, one per tick."""

    def propose(view):
        return Proposal(0.5, account=accounts[view.index])

    return run_loop(propose, simulator=Told(), seconds=seconds or len(accounts) / 10)


def test_decisions_are_counted_and_ticks_that_hold_one_are_not():
    fresh = {"decided": True, "guess": 1}
    episode = telling(fresh, {"guess": 1}, {**fresh, "guess": 0}, fresh, {"decided": True}, {})
    assert episode.failure is None
    assert episode.metrics.tallies == {
        "guessed": Tally(2, 3, 0, 0, "control"),
        "other": Tally(0, 0, 0, 0, "failure"),
    }


def test_signals_have_zero_where_nothing_is_known_and_hold_the_last_value():
    episode = telling({"guess": 1, "sure": 0.5}, {}, {"guess": 1, "sure": 0.25})
    assert episode.signals["proposal.guessed"].tolist() == [1, 0, 1, 1]
    assert episode.signals["proposal.sure"].tolist() == [0.5, 0, 0.25, 0.25]
    assert "sure" not in episode.metrics.tallies


def test_the_null_component_is_measured_on_the_same_decisions():
    both = {"decided": True, "guess": 0, "null": {"guess": 1}}
    episode = telling(both, {"guess": 0, "null": {"guess": 1}}, {"decided": True, "guess": 1})
    tally = episode.metrics.tallies["guessed"]
    assert (tally.hits, tally.of, tally.null_hits, tally.null_of) == (1, 2, 1, 1)


@pytest.mark.parametrize("null", [1, "guess", [], None, {}, {"decided": False, "at": 7}])
def test_a_null_component_that_told_nothing_of_use_is_none(null):
    episode = telling({"decided": True, "guess": 1, "null": null})
    assert episode.failure is None
    assert episode.metrics.tallies["guessed"].null_of == 0


def test_the_input_of_the_null_component_is_that_of_the_component():
    seen = []

    class Looking(Told):
        def account_measures(self, ticks, percepts, accounts):
            seen.append([dict(one) for one in accounts])
            return {}

    account = {"decided": True, "at": 0, "perceived": ["a"], "cited": ["a"], "null": {"cited": []}}
    run_loop(lambda _: Proposal(0.5, account=account), simulator=Looking(), seconds=0.1)
    assert seen == [[account], [{"decided": True, "at": 0, "perceived": ["a"], "cited": []}]]


def test_the_time_of_a_decision_is_kept_where_it_is_one():
    decided = [{"decided": True, "seconds": one} for one in (0.5, 2, "long", -1.0, True, None)]
    episode = telling(*decided, {"seconds": 9.0}, {"decided": True, "seconds": 10**400})
    assert episode.failure is None
    assert episode.metrics.answer_seconds == [0.5, 2.0]


def test_the_age_of_a_decision_is_that_at_which_it_came_into_force():
    decided = {"decided": True}
    held = {"decided": False, "age": 0.1}
    episode = telling({**decided, "age": 0.0}, held, {**decided, "age": 0.2}, held, decided)
    assert episode.failure is None
    assert episode.metrics.answer_ages == [0.0, 0.2]
    assert episode.metrics.summary().answer_ages == (0.0, 0.2)


@pytest.mark.parametrize("age", ["old", True, None, -0.1, 10**400, [0.1], {"s": 0.1}, 0.3])
def test_an_age_that_makes_no_sense_is_none(age):
    # At 0.2 s nothing rests on a percept of 0.3 s ago: there was none.
    episode = telling({}, {}, {"decided": True, "age": age})
    assert episode.failure is None
    assert episode.metrics.answer_ages == []


def test_an_age_may_be_all_of_the_time_since_the_start():
    age = 0.2 + 1e-12  # more than the 0.2 s of the tick, by a rounding error
    episode = telling({}, {}, {"decided": True, "age": age})
    assert age > episode.time[2]
    assert episode.metrics.answer_ages == [0.2]


def test_a_fallback_is_no_decision_that_has_an_age():
    told = {"decided": True, "age": 0.0, "seconds": 0.5}
    episode = telling({**told, "fallback": True}, {**told, "fallback": False})
    assert episode.metrics.answer_ages == [0.0]
    assert episode.metrics.answer_seconds == [0.5, 0.5]


def test_the_null_component_has_no_age_of_its_own():
    null = {"age": 0.1, "decided": True}
    assert telling({}, {"decided": True, "null": null}).metrics.answer_ages == []


def nested(levels):
    """Lists within each other in a mapping."""
    value = 1
    for _ in range(levels - 1):
        value = [value]
    return {"deep": value}


BAD = {
    "a list": ([1], "is list, not a mapping"),
    "a set": ({"x": {1}}, "no plain data"),
    "NaN": ({"x": float("nan")}, "no plain data"),
    "itself": ((own := {}, own.update(own=own))[0], "no plain data"),
    "a number for a key": ({1: 2}, "a key that is no text"),
    "too long": ({"x": "x" * LONGEST}, f"{LONGEST} are allowed"),
    "too deep": (nested(DEEPEST + 1), f"more than {DEEPEST} levels"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_account_that_is_none_is_the_components_failure(name):
    account, why = BAD[name]
    episode = run_loop(lambda _: Proposal(0.5, account=account), simulator=Told(), seconds=0.3)
    assert episode.failure is None
    assert episode.metrics.valid_proposals == 0
    assert episode.metrics.tallies == {}
    (told,) = [one.detail for one in episode.events if one.kind == "component_failure"]
    assert why in told


def test_a_mapping_that_cannot_be_read_is_the_components_failure():
    class Broken(dict):
        def keys(self):
            raise RuntimeError("no keys")

        __iter__ = items = keys

    episode = run_loop(lambda _: Proposal(0.5, account=Broken(a=1)), seconds=0.2)
    assert episode.failure is None
    assert episode.metrics.valid_proposals == 0


@pytest.mark.parametrize("levels", [1, 2, DEEPEST])
def test_an_account_of_allowed_depth_is_taken(levels):
    episode = telling(nested(levels), {"decided": True, "guess": 1})
    assert episode.metrics.valid_proposals == 2
    assert episode.metrics.tallies["guessed"].hits == 1


def test_what_a_component_changes_afterwards_changes_nothing():
    account = {}

    def propose(view):
        account.update(decided=True, guess=int(view.index == 1))
        return Proposal(0.5, account=account)

    episode = run_loop(propose, simulator=Told(), seconds=0.4)
    assert episode.signals["proposal.guessed"].tolist() == [0, 1, 0, 0, 0]


def test_a_copy_shares_nothing_with_its_original():
    account = {"a": [1, {"b": (2,)}]}
    found = copied_account(account)
    account["a"][1]["b"] = 3
    assert found == {"a": [1, {"b": [2]}]}


def test_without_any_account_there_is_nothing_to_measure():
    episode = run_loop(Says(lambda _: Proposal(0.5)), simulator=Told(), seconds=0.3)
    assert not [name for name in episode.signals if name.startswith("proposal.")]
    assert episode.metrics.tallies == {}
    assert account_columns(Told(), [], [], [{}, {}]) is None


@pytest.mark.parametrize("hook", ["account_measures", "account_signals"])
def test_a_column_of_another_length_is_the_simulators_error(hook):
    wrong = type("Wrong", (Told,), {hook: lambda *_: {"x": np.zeros(1)}})
    episode = run_loop(lambda _: Proposal(0.5, account={"a": 1}), simulator=wrong(), seconds=0.3)
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: simulator")
    assert f"{hook} returned 'x' of shape (1,), not (3,)" in episode.failure


def test_a_kind_that_there_is_not_is_the_simulators_error():
    wrong = type("Wrong", (Told,), {"measure_kinds": {"guessed": "bad luck"}})
    episode = run_loop(lambda _: Proposal(0.5, account={"a": 1}), simulator=wrong(), seconds=0.3)
    assert "measure_kinds says of 'guessed' 'bad luck'" in str(episode.failure)


def test_tallies_are_part_of_the_digest_and_times_are_not():
    def digest(guess, seconds):
        return telling({"decided": True, "guess": guess, "seconds": seconds}).digest

    assert digest(1, 0.1) == digest(1, 0.9)
    told = telling({"decided": True, "guess": 1})
    before = told.digest
    del told.digest  # it is kept once it is known
    told.metrics.tallies["guessed"] = Tally(1, 2, kind="control")
    assert told.digest != before


def test_ages_are_part_of_the_digest_where_there_are_any():
    def digest(age):
        return telling({}, {"decided": True, "age": age}).digest

    assert digest(0.0) != digest(0.1)
    assert digest(0.1) == digest(0.1)
    assert digest(None) == digest("old")
    assert "answer_ages" not in telling({"decided": True}).metrics.deterministic()


def test_the_summary_has_tallies():
    summary = telling({"decided": True, "guess": 1, "seconds": 0.5}).metrics.summary()
    assert summary.tallies["guessed"] == Tally(1, 1, 0, 0, "control")
    assert summary.answer_seconds == (0.5,)
