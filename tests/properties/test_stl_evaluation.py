"""Laws of evaluated formulas: the textbook, prefixes and extensions, batches, verdicts."""

from __future__ import annotations

from collections import Counter
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import stl_oracle
from formulas import formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st
from stl_intervals import robustness_interval

from pytest_dura.requirements import (
    Boolean,
    Comparison,
    Constant,
    Ending,
    Formula,
    Node,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    Window,
    evaluate,
    node_text,
    robustness,
    robustness_batch,
)
from pytest_dura.requirements.stl.formula import children, walk

NAMES = ("a", "b")
STEP = 0.1
AHEAD = ("always", "eventually", "until", "next", "strong_next")
any_formula = formulas(NAMES, time_step=STEP)
COMPARISON = Comparison(">", Signal("a"), Constant(0.0))


def laws(examples: int) -> Any:
    return settings(max_examples=examples, derandomize=True, deadline=None)


def seconds(trace: dict[str, list[float]]) -> list[float]:
    return [round(tick * STEP, 9) for tick in range(len(trace["a"]))]


def extended(trace: dict[str, list[float]], more: dict[str, list[float]]) -> dict[str, Any]:
    return {name: trace[name] + more[name] for name in NAMES}


@laws(350)
@given(any_formula, st.lists(traces(NAMES, min_size=1), min_size=3, max_size=3))
def test_robustness_is_the_textbooks_for_one_trace_and_for_many(
    formula: Formula, several: list[dict[str, list[float]]]
) -> None:
    many = robustness_batch(formula, several, STEP)
    for trace, in_batch in zip(several, many, strict=True):
        found = robustness(formula, trace, STEP)
        assert found.tolist() == stl_oracle.robustness(formula.root, trace, STEP)
        assert in_batch.tolist() == found.tolist()


@laws(100)
@given(any_formula, traces(NAMES, min_size=1), st.booleans())
def test_a_margin_that_is_not_zero_tells_the_truth(
    formula: Formula, trace: dict[str, list[float]], complete: bool
) -> None:
    for margin, holds in zip(
        robustness(formula, trace, STEP),
        stl_oracle.satisfaction(formula.root, trace, STEP),
        strict=True,
    ):
        assert margin <= 0 or holds
        assert margin >= 0 or not holds
    margins = robustness_interval(formula, trace, STEP, complete=complete)
    truths = robustness_interval(formula, trace, STEP, complete=complete, truth=True)
    for margin, truth in zip(margins, truths, strict=True):
        assert (np.sign(truth) == np.sign(margin))[margin != 0].all()
        assert (truth != 0).all()


@laws(130)
@given(any_formula, traces(NAMES, min_size=1), st.lists(traces(NAMES), min_size=1, max_size=1))
def test_the_interval_of_a_prefix_contains_what_any_longer_trace_gives(
    formula: Formula, trace: dict[str, list[float]], futures: list[dict[str, list[float]]]
) -> None:
    size = len(trace["a"])
    lower, upper = robustness_interval(formula, trace, STEP, complete=False)
    false, true = robustness_interval(formula, trace, STEP, complete=False, truth=True)
    for longer in (trace, *(extended(trace, more) for more in futures)):
        for complete in (True, False):
            low, high = robustness_interval(formula, longer, STEP, complete=complete)
            assert (lower <= low[:size]).all()
            assert (high[:size] <= upper).all()
            margins = stl_oracle.robustness(formula.root, longer, STEP)
            assert (low <= margins).all()
            assert (margins <= high).all()
        holds = np.array(stl_oracle.satisfaction(formula.root, longer, STEP)[:size])
        assert holds[false > 0].all()
        assert not holds[true < 0].any()


@laws(100)
@given(any_formula, traces(NAMES, min_size=1), st.lists(traces(NAMES), min_size=1, max_size=1))
def test_the_interval_of_an_episode_contains_what_bounded_windows_would_see_after_it(
    formula: Formula, trace: dict[str, list[float]], futures: list[dict[str, list[float]]]
) -> None:
    size = len(trace["a"])
    lower, upper = robustness_interval(formula, trace, STEP)
    textbook = stl_oracle.samples

    def of_the_episode(node: Any, at: int, longer: int, step: float) -> list[int]:
        found = textbook(node, at, longer, step)
        if node.window is None and at < size:
            return [one for one in found if one < size]
        return found

    for more in futures:
        with patch.object(stl_oracle, "samples", of_the_episode):
            margins = stl_oracle.robustness(formula.root, extended(trace, more), STEP)[:size]
        assert (lower <= margins).all()
        assert (margins <= upper).all()


def reach(node: Any) -> float:
    """Samples that a formula looks ahead."""
    own = 0.0
    if isinstance(node, (Temporal, TemporalPair)) and node.operator in AHEAD:
        own = np.inf if node.window is None else round(node.window.end / STEP)
    elif isinstance(node, Step) and node.operator in AHEAD:
        own = 1.0
    return own + max((reach(child) for child in children(node)), default=0.0)


@laws(100)
@given(any_formula, traces(NAMES, min_size=1))
def test_where_nothing_is_unknown_the_interval_is_the_robustness(
    formula: Formula, trace: dict[str, list[float]]
) -> None:
    size = len(trace["a"])
    margins = robustness(formula, trace, STEP)
    looks_behind_the_end = any(
        (isinstance(node, (Temporal, TemporalPair)) and node.window and node.operator in AHEAD)
        or (isinstance(node, Step) and node.operator in AHEAD)
        for node in walk(formula.root)
    )
    ahead = reach(formula.root)
    for complete in (True, False):
        known = np.arange(size) + ahead < size
        if complete and not looks_behind_the_end:
            known[:] = True
        for side in robustness_interval(formula, trace, STEP, complete=complete):
            assert side[known].tolist() == margins[known].tolist()


@laws(150)
@given(any_formula, traces(NAMES, min_size=1))
def test_a_verdict_is_that_of_the_truth_interval_and_its_time_that_of_the_first_prefix(
    formula: Formula, trace: dict[str, list[float]]
) -> None:
    time = seconds(trace)
    found = evaluate(formula, time, trace, time_step=STEP)
    false, true = robustness_interval(formula, trace, STEP, truth=True)
    status = "satisfied" if false[0] > 0 else "violated" if true[0] < 0 else "undecided"
    assert found.status == status
    lower, upper = robustness_interval(formula, trace, STEP)
    assert (found.lower, found.upper) == (lower[0], upper[0])
    assert found.worst_time in time
    if status == "violated":
        prefixes = [
            {name: column[:size] for name, column in trace.items()}
            for size in range(1, len(time) + 1)
        ]
        decided = [
            robustness_interval(formula, one, STEP, complete=False, truth=True)[1][0] < 0
            for one in prefixes
        ]
        assert found.time == (time[decided.index(True)] if True in decided else time[-1])
        assert lower[0] <= found.margin <= upper[0]
    else:
        assert found.time is None
        assert found.margin == robustness(formula, trace, STEP)[0]


@laws(100)
@given(any_formula, traces(NAMES, min_size=1), traces(NAMES))
def test_what_a_prefix_decides_the_whole_trace_confirms(
    formula: Formula, trace: dict[str, list[float]], more: dict[str, list[float]]
) -> None:
    early = evaluate(formula, seconds(trace), trace, ending="open", time_step=STEP)
    longer = extended(trace, more)
    late = evaluate(formula, seconds(longer), longer, time_step=STEP)
    if early.status != "undecided":
        assert late.status == early.status
        assert late.time == early.time
    assert early.lower <= late.lower
    assert late.upper <= early.upper


def textbook_vacuous(
    node: Node, trace: dict[str, list[float]], at: set[int], *, complete: bool
) -> bool:
    """Whether what is asked at these samples rests on conditions that held at none of them."""

    def held(part: Node) -> set[int]:
        formula = Formula(part, node_text(part))
        least, _ = robustness_interval(formula, trace, STEP, complete=complete, truth=True)
        return {sample for sample in at if least[sample] > 0}

    def of(part: Node, asked: set[int] = at) -> bool:
        return textbook_vacuous(part, trace, asked, complete=complete)

    if isinstance(node, Temporal):
        size = len(trace["a"])
        return of(
            node.operand,
            {other for now in at for other in stl_oracle.samples(node, now, size, STEP)},
        )
    if not isinstance(node, Boolean):
        return False
    if node.operator == "implies":
        return not held(node.left) or of(node.right, held(node.left))
    if node.operator == "and":
        return of(node.left) and of(node.right)
    if node.operator == "or":
        sides = [(node.left, node.right), (node.right, node.left)]
        return any(of(side) and (of(other) or not held(other)) for side, other in sides)
    return False


def conditional() -> st.SearchStrategy[Formula]:
    """Formulas with an implication in them, ranged over or joined with another."""
    small = formulas(NAMES, time_step=STEP, max_leaves=2, max_window=3).map(
        lambda formula: formula.root
    )
    implied = st.builds(Boolean, st.just("implies"), small, small)
    windows = st.none() | st.just(Window(0.1, 0.3))
    kinds = st.sampled_from(["always", "eventually", "once", "historically"])
    ranged = st.builds(Temporal, kinds, implied, windows)
    joined = st.builds(Boolean, st.sampled_from(["and", "or", "implies"]), ranged | small, ranged)
    return st.one_of(ranged, joined, st.builds(Temporal, kinds, joined, windows)).map(
        lambda root: Formula(root, node_text(root))
    )


def test_a_satisfied_formula_is_vacuous_where_its_conditions_held_nowhere_that_it_was_asked() -> (
    None
):
    counts: Counter[bool] = Counter()

    @laws(300)
    @given(conditional(), traces(NAMES, min_size=1), st.booleans())
    def law(formula: Formula, trace: dict[str, list[float]], complete: bool) -> None:
        ending: Ending = "time" if complete else "open"
        found = evaluate(formula, seconds(trace), trace, ending=ending, time_step=STEP)
        if found.status != "satisfied":
            assert not found.vacuous
            return
        expected = textbook_vacuous(formula.root, trace, {0}, complete=complete)
        assert found.vacuous == expected
        counts[expected] += 1

    law()
    assert min(counts[True], counts[False]) > 30, counts


@pytest.mark.parametrize("size", [1, 2, 5])
@pytest.mark.parametrize("window", [(0, 0), (0, 1), (1, 1), (1, 3), (2, 5)], ids=str)
@pytest.mark.parametrize("operator", ["always", "eventually"])
def test_a_window_is_open_from_the_first_sample_that_it_misses_on(
    operator: str, window: tuple[int, int], size: int
) -> None:
    first, last = window
    node = Temporal(operator, COMPARISON, Window(first * STEP, last * STEP))
    trace = {"a": [3.0, -1.0, 2.0, 5.0, 4.0][:size], "b": [0.0] * size}
    lower, upper = robustness_interval(Formula(node, node_text(node)), trace, STEP)
    seen = stl_oracle.robustness(node, trace, STEP)
    for sample in range(size):
        is_open = sample + last >= size
        least = -np.inf if is_open and operator == "always" else seen[sample]
        most = np.inf if is_open and operator == "eventually" else seen[sample]
        assert (lower[sample], upper[sample]) == (least, most)
