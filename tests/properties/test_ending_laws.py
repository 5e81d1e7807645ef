"""What ends an episode early: a verdict that no continuation changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
from columns import Columns
from formulas import formulas, nodes, traces, windows
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.requirements import (
    Boolean,
    Ending,
    Evaluation,
    Formula,
    Requirement,
    RequirementJudge,
    Temporal,
    evaluate,
    node_text,
)
from pytest_dura.requirements import checks as judging
from pytest_dura.requirements.stl.formula import reach

NAMES = ("a", "b")
STEP = 0.1
Trace = dict[str, list[float]]
small = nodes(NAMES, time_step=STEP, max_leaves=2, max_window=3)
implied = st.builds(lambda one, other: Boolean("implies", one, other), small, small)
throughout = st.builds(
    lambda one, window: Temporal("always", one, window), implied, windows(STEP, 4)
)
asked_for = formulas(NAMES, time_step=STEP) | st.one_of(implied, throughout).map(
    lambda root: Formula(root, node_text(root))
)
several = st.lists(asked_for, min_size=1, max_size=2)
continuations = st.lists(traces(NAMES, min_size=1), min_size=1, max_size=3)


def laws(examples: int) -> Any:
    return settings(max_examples=examples, derandomize=True, deadline=None)


def decided_at(
    asked: Sequence[Formula], trace: Trace, *, violated: bool = False, every: int = 1
) -> int | None:
    """Ticks after which the judge lets the episode end, if it does before the trace ends."""
    simulator = Columns(trace)
    simulator.set_time_step(STEP)
    judge = RequirementJudge([Requirement(f"R{i}", check=str(x)) for i, x in enumerate(asked)])
    ticks = []
    with patch.object(judging, "FIRST_LOOK", every), patch.object(judging, "GROWTH", 1000):
        for index in range(len(trace["a"])):
            ticks.append(simulator.tick(index))
            if judge.decided(simulator, ticks, violated=violated):
                return len(ticks)
    return None


def judged(formula: Formula, trace: Trace, *, ending: Ending) -> Evaluation:
    time = [tick * STEP for tick in range(len(trace["a"]))]
    return evaluate(formula, time, trace, ending=ending, time_step=STEP)


def cut(trace: Trace, size: int) -> Trace:
    return {name: column[:size] for name, column in trace.items()}


def test_a_verdict_that_ends_an_episode_is_that_of_every_continuation() -> None:
    ends: Counter[str] = Counter()

    @laws(200)
    @given(several, traces(NAMES, min_size=1), continuations, st.booleans(), st.integers(1, 3))
    def law(
        asked: list[Formula], trace: Trace, others: list[Trace], violated: bool, every: int
    ) -> None:
        size = decided_at(asked, trace, violated=violated, every=every)
        if size is None:
            return
        start = cut(trace, size)
        wholes = [{name: start[name] + more[name] for name in NAMES} for more in others]
        for formula in asked:
            known = judged(formula, start, ending="open")
            ends[known.status if not known.vacuous else "vacuous"] += 1
            assert known.status in (("violated",) if violated else ("violated", "satisfied"))
            for whole in (start, trace, *wholes):
                found = judged(formula, whole, ending="time")
                assert found.status == known.status
                assert found.vacuous == known.vacuous
                assert found.time == known.time
                if known.status == "satisfied":
                    assert known.lower <= found.margin

    law()
    # The law says something only if many examples end, and in each of these ways.
    assert min(ends[word] for word in ("satisfied", "violated", "vacuous")) > 15


@laws(100)
@given(several, traces(NAMES, min_size=2))
def test_an_episode_ends_as_soon_as_that_is_known_at_a_look(
    asked: list[Formula], trace: Trace
) -> None:
    size = decided_at(asked, trace) or len(trace["a"]) + 1
    ends = {reach(formula.root, STEP) for formula in asked} - {None}
    for shorter in range(2, size):
        found = [judged(formula, cut(trace, shorter), ending="open") for formula in asked]
        beyond = all(
            one.status != "undecided"
            and (not one.vacuous or (reach(formula.root, STEP) or 10**6) < shorter)
            for one, formula in zip(found, asked, strict=True)
        )
        assert not beyond, (shorter, ends)


@laws(100)
@given(asked_for, traces(NAMES, min_size=1), continuations)
def test_nothing_behind_its_reach_changes_a_formula(
    formula: Formula, trace: Trace, others: list[Trace]
) -> None:
    far = reach(formula.root, STEP)
    if far is None or far >= len(trace["a"]):
        return
    known = judged(formula, cut(trace, far + 1), ending="open")
    assert known.status != "undecided"
    for more in others:
        whole = {name: trace[name][: far + 1] + more[name] for name in NAMES}
        found = judged(formula, whole, ending="time")
        assert (found.status, found.margin, found.vacuous) == (
            known.status, known.margin, known.vacuous,
        )  # fmt: skip


@laws(60)
@given(st.integers(1, 3000))
def test_all_looks_together_cost_a_few_looks_at_the_whole(ticks: int) -> None:
    simulator = Columns({"a": [1.0]})
    judge = RequirementJudge([Requirement("R", check="always (a > 0)")])
    so_far = [simulator.tick(index) for index in range(ticks)]
    for size in range(1, ticks + 1):
        assert not judge.decided(simulator, so_far[:size], violated=False)
    assert np.sum(simulator.looks) <= (judging.GROWTH + 1) * ticks + 500
    gaps = np.diff([*simulator.looks, ticks + 1]) if simulator.looks else np.zeros(0)
    assert (
        gaps <= np.maximum(judging.FIRST_LOOK, np.array(simulator.looks) / judging.GROWTH)
    ).all()
