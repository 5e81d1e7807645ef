"""Robustness of a formula at each sample of a trace, as far as the trace goes.

The discrete-time semantics of rtamt: windows are cut at the ends of the trace, an empty window is
-inf for ``eventually`` and +inf for ``always``. See ``evaluation`` for verdicts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import Formula
from pytest_dura.requirements.stl.program import TRUNCATED, Mode, Plan, Values, plan_of
from pytest_dura.requirements.stl.windows import Array, Frame, arrays, empty_trace, other_length

_CHUNK = 64
"""Traces that are computed together: their arrays fit into the processor's cache."""


def robustness(formula: Formula, columns: Mapping[str, ArrayLike], time_step: float) -> Array:
    """Robustness at each sample.

    Args:
        formula: What to evaluate.
        columns: Samples by signal, shape ``(n,)`` for a trace or ``(traces, n)`` for several of
            the same length. Others than the formula's are ignored.
        time_step: Seconds from sample to sample.

    Returns:
        Shape ``(n,)`` or ``(traces, n)``.

    Raises:
        ConfigurationError: For an unknown signal, an empty trace, columns that do not fit each
            other, a sample or an expression that is not finite, or a window that is no multiple of
            the time step.
    """
    plan = plan_of(formula, time_step)
    found = arrays(plan.signals, columns, formula)
    shape = _shape(found, columns)
    if len(shape) == 1 or shape[0] <= _CHUNK:
        return _computed(plan, Frame(found, shape, time_step))
    whole = np.empty(shape)
    for start in range(0, shape[0], _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, shape[0]))
        part = {name: column[start : start + _CHUNK] for name, column in found.items()}
        frame = Frame(part, (len(rows), shape[1]), time_step, rows=rows)
        whole[start : start + _CHUNK] = _computed(plan, frame)
    return whole


def robustness_batch(
    formula: Formula, traces: Sequence[Mapping[str, ArrayLike]], time_step: float
) -> list[Array]:
    """Robustness at each sample of many traces, which may differ in length.

    Args:
        formula: What to evaluate.
        traces: Samples by signal, shape ``(n,)`` with an ``n`` of each trace's own.
        time_step: Seconds from sample to sample, the same for all.

    Returns:
        For each trace what ``robustness`` gives.

    Raises:
        ConfigurationError: As ``robustness``; the message names the trace, counted from zero.
    """
    plan = plan_of(formula, time_step)
    inputs = [arrays(plan.signals, trace, formula) for trace in traces]
    shapes = [_shape(found, trace) for found, trace in zip(inputs, traces, strict=True)]
    for number, shape in enumerate(shapes):
        if len(shape) != 1:
            raise ConfigurationError(
                f"trace {number} is not one trace", found=shape, expected="columns of shape (n,)"
            )
    lengths = np.array([shape[0] for shape in shapes], dtype=np.intp)
    results: list[Array] = [np.empty(0)] * len(traces)
    # Traces of like length together, so that little is computed behind their ends.
    order = np.argsort(lengths, kind="stable")
    for start in range(0, len(order), _CHUNK):
        rows = order[start : start + _CHUNK]
        frame = _padded([inputs[row] for row in rows], lengths[rows], rows, time_step)
        for row, values in zip(rows, _computed(plan, frame), strict=True):
            results[row] = values[: lengths[row]]
    return results


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
    found = arrays(plan.signals, columns, formula)
    frame = Frame(found, _shape(found, columns), time_step)
    frame.refuse_not_finite()
    with np.errstate(all="ignore"):
        values = Values(plan.program, frame)
        lower, upper = (
            values[plan.program.slot(plan.formula.root, Mode(unknown, not complete, truth))]
            for unknown in (-np.inf, np.inf)
        )
    return lower, upper


def _computed(plan: Plan, frame: Frame) -> Array:
    frame.refuse_not_finite()
    with np.errstate(all="ignore"):
        return Values(plan.program, frame)[plan.program.slot(plan.formula.root, TRUNCATED)]


def _shape(found: Mapping[str, Array], columns: Mapping[str, ArrayLike]) -> tuple[int, ...]:
    """The shape that all columns have; a formula of constants has that of any column."""
    if not found:
        found = {name: np.asarray(column) for name, column in columns.items()}
    first = next((column.shape for column in found.values()), (0,))
    for name, column in found.items():
        if column.shape != first:
            raise other_length(name, column.shape, first)
    if len(first) not in (1, 2):
        raise ConfigurationError(
            "columns are traces or rows of traces", found=first, expected="shape (n,) or (m, n)"
        )
    if first[-1] == 0:
        raise empty_trace(f"columns of shape {first}")
    return first


def _padded(
    traces: Sequence[Mapping[str, Array]],
    lengths: np.ndarray[tuple[int], np.dtype[np.intp]],
    rows: np.ndarray[tuple[int], np.dtype[np.intp]],
    time_step: float,
) -> Frame:
    """The traces in rows. The shorter ones go on with their last sample, to stay in range."""
    shape = len(traces), int(lengths[-1])
    columns = {}
    for name in traces[0]:
        columns[name] = np.empty(shape)
        for row, trace, length in zip(columns[name], traces, lengths, strict=True):
            row[:length] = trace[name]
            row[length:] = trace[name][-1]
    beyond = None
    if lengths[0] < lengths[-1]:
        beyond = np.arange(shape[1]) >= lengths[:, np.newaxis]
    return Frame(columns, shape, time_step, beyond=beyond, rows=rows)
