"""Bounds on the robustness of traces that may go on: the two modes that a verdict rests on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pytest_dura.requirements import Formula
from pytest_dura.requirements.stl.program import Mode, Values, plan_of
from pytest_dura.requirements.stl.windows import Array, Frame, arrays


def robustness_interval(
    formula: Formula,
    columns: Mapping[str, ArrayLike],
    time_step: float,
    *,
    complete: bool = True,
    truth: bool = False,
) -> tuple[Array, Array]:
    """Bounds on the robustness at each sample, over all that may follow the trace.

    A bounded window, and ``next``, see unknown samples behind the end. Operators without a window
    do so only if the trace is not complete. What was before the start is known: nothing. A formula
    behind the end is unknown as a whole, even if it looks back into the trace. The interval
    contains the robustness of every longer trace, and is a single value where nothing is unknown.
    Parts of a formula are bounded apart, so that it may be wider than what can come about: at the
    last sample ``(next (p)) or (next (not p))`` stays open, although one of the two must hold.

    Args:
        formula: What to evaluate.
        columns: Samples by signal, shape ``(n,)`` or ``(traces, n)``.
        time_step: Seconds from sample to sample.
        complete: Whether the trace is the whole episode, which operators without a window range
            over; otherwise it is a prefix.
        truth: Whether to give truth instead, +1 or -1 for each comparison: then a lower value
            above zero says "satisfied", and an upper one below zero "violated".

    Returns:
        Lower and upper values, of the columns' shape.

    Raises:
        ConfigurationError: As ``robustness``.
    """
    plan = plan_of(formula, time_step)
    samples = arrays(plan.signals, columns, formula)
    frame = Frame(samples, next(iter(samples.values())).shape, time_step)
    frame.refuse_not_finite()
    with np.errstate(all="ignore"):
        values = Values(plan.program, frame)
        lower, upper = (
            values[plan.program.slot(plan.formula.root, Mode(unknown, not complete, truth))]
            for unknown in (-np.inf, np.inf)
        )
    return lower, upper
