"""Laws of pairs: swapping the runs swaps the table, and nothing is lost in counting."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from typing import Any

import pytest
from handmade import SPEC, handmade
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from pytest_dura import EpisodeVerdict, FaultRecord, Paired, Requirement
from pytest_dura.core.codec import decode, encode
from pytest_dura.requirements import (
    Change,
    Pair,
    PairCounts,
    change_verdict,
    judge_campaign,
    judge_episode,
    judge_pairs,
    pair_verdict,
)
from pytest_dura.requirements.pairs import prevention_verdict
from pytest_dura.requirements.runs import Run

lawful = settings(derandomize=True, deadline=None, max_examples=100)

WITHOUT_EFFECT = "violated without effect"
"""In a run that is invalid, since a planned fault never manifested."""
words = st.sampled_from(["satisfied", "violated", WITHOUT_EFFECT, "invalid", "missing"])
tables = st.lists(st.tuples(words, words, st.booleans()), max_size=30)
values = st.none() | st.just(math.nan) | st.floats(-1e6, 1e6)
measured = st.dictionaries(st.text("abc", max_size=3), st.tuples(values, values), max_size=12)


def verdict(word: Any, episode: str) -> EpisodeVerdict:
    spoilt = word == WITHOUT_EFFECT
    status = "violated" if spoilt else word
    return EpisodeVerdict("R", episode, "P", status, None, None, "", 10, 10, without_effect=spoilt)


def pairs(table: list[tuple[str, str, bool]], *, swapped: bool = False) -> list[Pair]:
    found = []
    for run, (own, twin, acted) in enumerate(table):
        sides = (verdict(own, f"case#{run}"), verdict(twin, f"twin#{run}"))
        found.append(Pair(*(reversed(sides) if swapped else sides), acted=acted))
    return found


@lawful
@given(tables)
def test_swapping_the_runs_swaps_the_table_and_nothing_else(table: Any) -> None:
    found, swapped = judge_pairs(pairs(table)), judge_pairs(pairs(table, swapped=True))
    assert (found.only_with, found.only_without) == (swapped.only_without, swapped.only_with)
    assert found.acted_only_with == swapped.acted_only_without
    assert found.violated_with == swapped.violated_without
    same = ("pairs", "both", "neither", "incomplete", "acted_both", "acted_neither", "p_value")
    assert all(getattr(found, name) == getattr(swapped, name) for name in same)


@lawful
@given(tables)
def test_every_pair_is_counted_in_one_cell(table: Any) -> None:
    found = judge_pairs(pairs(table))
    cells = (found.only_with, found.only_without, found.both, found.neither)
    assert sum(cells) + found.incomplete == found.pairs == len(table)
    named = (
        found.prevented + found.introduced + found.futile + found.unheeded
        + found.unnecessary + found.unneeded
    )  # fmt: skip
    assert named == found.complete
    assert 0 <= found.unexplained <= found.only_with + found.only_without
    assert found.violated_with == sum(own.startswith("violated") for own, _, _ in table)
    assert decode(PairCounts, json.loads(json.dumps(encode(found)))) == found


@lawful
@given(tables)
def test_a_pair_of_which_a_run_does_not_count_enters_neither_the_table_nor_the_test(
    table: Any,
) -> None:
    """Also where it violates the requirement, without effect of the fault."""
    judged = [row for row in table if {"satisfied", "violated"}.issuperset(row[:2])]
    found, expected = judge_pairs(pairs(table)), judge_pairs(pairs(judged))
    cells = ("only_with", "only_without", "both", "neither")
    for name in (*cells, *(f"acted_{cell}" for cell in cells), "p_value", "success_rate"):
        assert getattr(found, name) == getattr(expected, name), name
    assert found.incomplete == len(table) - len(judged)


@lawful
@given(words, words, words)
def test_recovery_is_held_to_what_the_reference_avoids_alone(
    own: Any, twin: Any, third: Any
) -> None:
    """Whatever the run with recovery came to: only then is there something to prevent."""
    sides = [verdict(own, "case#0"), verdict(twin, "twin#0"), verdict(third, "reference#0")]
    found = prevention_verdict(*sides)
    known = {"satisfied", "violated"}
    if not known.issuperset((own, twin, third)):
        assert found.verdict == ("missing" if "missing" in (own, twin, third) else "invalid")
        assert not found.vacuous
        return
    to_prevent = twin == "violated" and third == "satisfied"
    assert (found.verdict, found.vacuous) == ((own, False) if to_prevent else ("satisfied", True))


@lawful
@given(st.lists(st.tuples(words, words, words), max_size=30))
def test_of_violations_without_recovery_each_is_the_references_as_well_or_to_be_prevented(
    table: Any,
) -> None:
    triples = [
        Pair(*(verdict(word, f"{side}#{run}") for word, side in zip(row[:2], "ab", strict=True)),
             reference=verdict(row[2], f"c#{run}"))
        for run, row in enumerate(table)
    ]  # fmt: skip
    counts = judge_pairs(triples)
    judged = [row for row in table if {"satisfied", "violated"}.issuperset(row)]
    assert counts.complete == len(judged)
    assert counts.to_prevent == judged.count(("satisfied", "violated", "satisfied")) + judged.count(
        ("violated", "violated", "satisfied")
    )
    assert counts.prevented_of_these == judged.count(("satisfied", "violated", "satisfied"))
    assert counts.reference_both == judged.count(("violated", "violated", "violated"))
    assert counts.only_without + counts.both == counts.to_prevent + counts.reference_without


@lawful
@given(tables)
def test_the_order_of_the_pairs_does_not_matter(table: Any) -> None:
    assert judge_pairs(pairs(table)) == judge_pairs(reversed(pairs(table)))


@lawful
@given(st.integers(0, 40), st.integers(0, 40))
def test_the_p_value_is_that_of_the_exact_test_on_discordant_pairs(k: int, m: int) -> None:
    table = [("violated", "satisfied", True)] * k + [("satisfied", "violated", True)] * m
    found = judge_pairs(pairs([*table, ("violated", "violated", True)]))
    expected = binomtest(k, k + m).pvalue if k + m else 1.0
    assert math.isclose(found.p_value, expected, rel_tol=1e-9)


@lawful
@given(measured)
def test_every_pair_has_a_change_or_a_reason(sides: Any) -> None:
    found = Change.between("m", sides)
    reasons = (*found.lost, *found.gained, *found.valueless, *found.incomplete)
    assert len(set(reasons)) == len(reasons) == found.values.count(None)
    assert found.n + len(reasons) == len(sides)
    assert decode(Change, json.loads(json.dumps(encode(found), allow_nan=False))) == found


@lawful
@given(measured)
def test_swapping_the_runs_turns_the_change_around(sides: Any) -> None:
    found = Change.between("m", sides)
    turned = Change.between("m", {pair: (twin, own) for pair, (own, twin) in sides.items()})
    assert turned.values == tuple(None if one is None else -one for one in found.values)
    assert (turned.lost, turned.gained) == (found.gained, found.lost)
    assert turned.p_value == found.p_value


@lawful
@given(measured.filter(bool))
def test_the_summary_lies_within_the_extremes(sides: Any) -> None:
    found = Change.between("m", sides)
    if found.n:
        low, high = found.min, found.max
        assert low is not None
        assert high is not None
        slack = 1e-9 * max(abs(low), abs(high))
        assert low - slack <= found.mean <= high + slack
        assert low <= found.median <= high


KINDS = ("satisfied", "violated", WITHOUT_EFFECT, "open", "invalid", "missing")


def outcome(with_it: str, without: str) -> str:
    """What a pair of runs comes to: an open run may yet come to either.

    A violation without effect of the fault counts, and supports nothing.
    """
    for spoilt in ("missing", "invalid"):
        if spoilt in (with_it, without):
            return spoilt
    if WITHOUT_EFFECT in (with_it, without):
        seen = ["violated" if kind == WITHOUT_EFFECT else kind for kind in (with_it, without)]
        compared = outcome(*seen)
        return "invalid" if compared == "satisfied" else compared
    sides = [
        ("satisfied", "violated") if kind == "open" else (kind,) for kind in (with_it, without)
    ]
    outcomes = {
        "violated" if pair == ("violated", "satisfied") else "satisfied"
        for pair in itertools.product(*sides)
    }
    return outcomes.pop() if len(outcomes) == 1 else "open"


@pytest.mark.parametrize("without", KINDS)
@pytest.mark.parametrize("with_it", KINDS)
def test_a_pair_comes_to_what_its_runs_come_to_and_is_vacuous_if_both_are(
    with_it: str, without: str
) -> None:
    expected = outcome(with_it, without)
    for own, other in itertools.product((False, True), repeat=2):
        result = pair_verdict(
            replace(verdict(with_it, "case#0"), vacuous=own),
            replace(verdict(without, "twin#0"), vacuous=other),
        )
        assert (result.verdict, result.episode) == (expected, "case#0")
        assert result.without_effect == (expected == "violated" and with_it == WITHOUT_EFFECT)
        if expected == "satisfied":
            assert result.vacuous == (own and other)


@lawful
@given(st.integers(-99, 999), st.integers(-99, 999), st.integers(0, 99), st.sampled_from([10, 30]))
def test_a_change_is_held_against_its_bound_as_the_numbers_are_written(
    own: int, other: int, bound: int, per_unit: int
) -> None:
    """Tenths and thirtieths have no exact float, and a change may equal its bound."""
    run = Run.of(handmade(3, gap=[1, 1, 1]))
    for more in (own, other + bound):
        paired = Paired("recovery_planner", measure="a:b", change_at_most=bound / per_unit)
        values = (more / per_unit, other / per_unit)
        result = change_verdict(Requirement("R", paired=paired), run, run, values)
        growth = more - other
        assert result.verdict == ("violated" if growth > bound else "satisfied")
        assert (result.margin == 0) == (growth == bound)
        assert math.isclose(result.margin, (bound - growth) / per_unit, rel_tol=1e-6)


CHECK = Requirement("R", check="always (gap > 0)", paired=Paired("recovery_planner"))
MEASURE = Requirement("R", paired=Paired("recovery_planner", measure="a:b", change_at_most=1.0))


@lawful
@given(st.lists(st.booleans(), min_size=1, max_size=8), st.sampled_from([CHECK, MEASURE]))
def test_pairs_in_none_of_which_a_fault_manifested_support_nothing(
    manifested: list[bool], requirement: Requirement
) -> None:
    """Whether they are compared by a check or by a measure; a fault by chance may draw no hit."""
    verdicts = []
    for number, hit in enumerate(manifested):
        record = FaultRecord("fog", "lidar", by_chance=True, manifested_at=0.1 if hit else None)
        spec = replace(SPEC, run=number)
        run = handmade(3, gap=[1, 1, 1], spec=spec, faults=(record,))
        if requirement is MEASURE:
            verdicts.append(change_verdict(requirement, Run.of(run), Run.of(run), (1.0, 1.0)))
        else:
            alone = judge_episode(requirement, run)
            verdicts.append(pair_verdict(alone, alone))
    result = judge_campaign(requirement, "case", verdicts, planned=len(manifested))
    assert result.verdict == ("supported" if any(manifested) else "undecided")
    assert ("fog manifested in none" in result.reason) == (not any(manifested))
