"""By how much a check held at each tick of an episode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import PREFIX, loop_columns
from pytest_dura.evidence.traces.trace import Trace
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.stl.language.formula import Formula
from pytest_dura.requirements.stl.language.nodes import Boolean, Node, Temporal
from pytest_dura.requirements.stl.language.parsing import parse
from pytest_dura.requirements.stl.offline.robustness import robustness

Column = NDArray[np.float64]
_DECIMALS = 9
"""Of seconds; what more there is comes from adding up time steps."""


def formula_of(check: str) -> Formula | None:
    """The formula that a check is; ``None`` for a function, and where test code decides."""
    if not check or is_function_path(check):
        return None
    try:
        return parse(check)
    except ConfigurationError:  # the name of a function inside a test
        return None


def columns_of(names: tuple[str, ...], episode: Episode | Trace) -> dict[str, Column]:
    """The episode's signals of these names, and those of the loop, as far as it has them."""
    known = dict(episode.signals)
    if any(name.startswith(PREFIX) for name in names) and episode.decisions:
        known |= loop_columns(episode.time, episode.decisions)
    return {name: known[name] for name in names if name in known}


def margin_over_time(check: str, episode: Episode | Trace) -> tuple[str, Column] | None:
    """The robustness at each tick, and the formula that it is of.

    An ``always`` over the whole episode at the root is left out, so that the curve shows the
    moment: its minimum is the margin. NaN where a signal is not finite, and after that.

    Returns:
        ``None`` for a check that is no formula over signals of this episode.
    """
    formula = formula_of(check)
    if formula is None:
        return None
    columns = columns_of(formula.signals, episode)
    if len(columns) < len(formula.signals):
        return None
    finite = np.logical_and.reduce([np.isfinite(one) for one in columns.values()])
    ticks = len(episode.time)
    samples = ticks if finite.all() else int(np.argmin(finite))
    if not samples:
        return None
    moment = Formula(_moment(formula.root), formula.text)
    found = np.full(ticks, np.nan)
    cut = {name: column[:samples] for name, column in columns.items()}
    try:
        found[:samples] = robustness(moment, cut, _time_step(episode))
    except ConfigurationError:  # an expression that is not finite: the verdict tells where
        return None
    return str(moment), found


def _time_step(episode: Episode | Trace) -> float:
    """Seconds from tick to tick; a trace tells them by its times alone."""
    if isinstance(episode, Episode):
        return episode.spec.time_step
    steps = len(episode.time) - 1
    return round(float(episode.time[-1] - episode.time[0]) / steps, _DECIMALS) if steps else 1.0


def _moment(node: Node) -> Node:
    if isinstance(node, Temporal) and node.operator == "always" and node.window is None:
        return _moment(node.operand)
    if isinstance(node, Boolean) and node.operator == "and":
        return replace(node, left=_moment(node.left), right=_moment(node.right))
    return node
