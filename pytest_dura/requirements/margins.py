"""Margins over time: the robustness of a formula at each tick of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.loop_signals import LOOP_PREFIX, loop_columns
from pytest_dura.requirements.stl.evaluation import robustness
from pytest_dura.requirements.stl.formula import Boolean, Formula, Node, Temporal

Column = NDArray[np.float64]


def columns_of(
    formula: Formula,
    time: Column,
    signals: Mapping[str, Column],
    decisions: Mapping[str, NDArray[np.generic]],
) -> dict[str, Column]:
    """Take the columns that a formula reads, those of the loop included, as far as there are any.

    Args:
        formula: The formula.
        time: Seconds, shape ``(ticks,)``.
        signals: Columns of that shape, by name.
        decisions: What the loop decided, from which its own signals follow.
    """
    known = dict(signals)
    if any(name.startswith(LOOP_PREFIX) for name in formula.signals) and decisions:
        known = loop_columns(time, decisions) | known
    return {name: known[name] for name in formula.signals if name in known}


def moment_of(formula: Formula) -> Formula:
    """Leave out an ``always`` over the whole episode at the root.

    The least robustness of the rest, over all ticks, is the margin of the formula.
    """
    return Formula(_without_always(formula.root), formula.text)


def margins_over_time(formula: Formula, columns: Mapping[str, Column], time_step: float) -> Column:
    """Compute the robustness at each tick; NaN where a signal is not finite, and after that.

    Args:
        formula: See :func:`moment_of`.
        columns: See :func:`columns_of`.
        time_step: Seconds from tick to tick.

    Raises:
        ConfigurationError: For an expression that is not finite.
    """
    finite = np.logical_and.reduce([np.isfinite(column) for column in columns.values()])
    samples = len(finite) if finite.all() else int(np.argmin(finite))
    full = np.full(len(finite), np.nan)
    if samples:
        cut = {name: column[:samples] for name, column in columns.items()}
        full[:samples] = robustness(formula, cut, time_step)
    return full


def _without_always(node: Node) -> Node:
    if isinstance(node, Temporal) and node.operator == "always" and node.window is None:
        return _without_always(node.operand)
    if isinstance(node, Boolean) and node.operator == "and":
        return replace(node, left=_without_always(node.left), right=_without_always(node.right))
    return node
