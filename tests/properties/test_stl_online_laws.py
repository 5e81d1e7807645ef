"""A formula judged sample by sample is what the whole trace gives, and what the textbook says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import stl_oracle
from formulas import FINITE, formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import Formula, OnlineFormula, robustness, robustness_batch

NAMES = ("a", "b")
STEP = 0.1
Trace = Mapping[str, Sequence[float]]


def samples(trace: Trace) -> list[dict[str, float]]:
    columns = [trace[name] for name in NAMES]
    return [dict(zip(NAMES, now, strict=True)) for now in zip(*columns, strict=True)]


def several(seed: int) -> list[dict[str, list[float]]]:
    """Traces of few distinct values, so that samples often lie on the bound."""
    draws = np.random.default_rng(seed)
    return [
        {name: draws.integers(-3, 4, size).astype(float).tolist() for name in NAMES}
        for size in draws.integers(1, 17, 8)
    ]


@settings(max_examples=250, derandomize=True, deadline=None)
@given(
    formulas(NAMES, time_step=STEP, future=False, max_leaves=6), st.integers(0, 9999).map(several)
)
def test_each_sample_is_judged_as_the_trace_so_far(
    formula: Formula, found: list[dict[str, list[float]]]
) -> None:
    monitor = OnlineFormula(formula, STEP)
    for trace, margins in zip(found, robustness_batch(formula, found, STEP), strict=True):
        monitor.reset()
        judged = [monitor.update(now) for now in samples(trace)]
        assert [one.robustness for one in judged] == margins.tolist()
        assert [one.holds for one in judged] == stl_oracle.satisfaction(formula.root, trace, STEP)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(
    formulas(NAMES, time_step=STEP, future=False, max_leaves=3, numbers=FINITE),
    traces(NAMES, min_size=1, max_size=6, values=FINITE),
)
def test_a_sample_is_refused_where_the_trace_is_and_then_it_never_was(
    formula: Formula, trace: Trace
) -> None:
    monitor, judged, taken = OnlineFormula(formula, STEP), [], []
    for now in samples(trace):
        with_it = {name: [one[name] for one in [*taken, now]] for name in NAMES}
        told = refused = None
        try:
            margins = robustness(formula, with_it, STEP).tolist()
        except ConfigurationError as error:
            refused = error.problem
        try:
            judged.append(monitor.update(now).robustness)
        except ConfigurationError as error:
            told = error.problem
        assert told == refused
        if refused is None:
            taken.append(now)
            assert judged == margins
