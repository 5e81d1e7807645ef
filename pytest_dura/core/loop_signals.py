"""Signals that the loop itself has, whatever the simulator: who was in control, and for how long.

A decision is made at every tick but the last, so the last sample repeats the one before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode

PREFIX = "loop."
LOOP_SIGNALS = (
    "loop.recovering", "loop.recovering_for", "loop.recovered_time", "loop.fallback", "loop.unsafe"
)  # fmt: skip
"""0 or 1 for: recovery's action, or the simulator's fallback, was carried out; the proposal was
unsafe. ``recovering_for`` is the time since recovery took over, in s, 0 while it does not act;
``recovered_time`` that for which it has been in control so far, in s, which never falls."""

_DECIMALS = 9
"""Of seconds, to which a difference of two ticks' times is given."""


def loop_signals(episode: Episode) -> dict[str, NDArray[np.float64]]:
    """The columns by name, each of shape ``(ticks,)``."""
    return loop_columns(episode.time, episode.decisions)


def loop_columns(
    time: NDArray[np.float64], decisions: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[np.float64]]:
    """The same of an episode's columns.

    Args:
        time: Simulated seconds, shape ``(ticks,)``.
        decisions: ``source`` and ``verdict``, as those of an episode.
    """
    source = _to_the_end(decisions["source"], len(time), "")
    verdict = _to_the_end(decisions["verdict"], len(time), 0)
    recovering = source == "recovery"
    started = np.where(recovering & ~np.roll(recovering, 1), time, -np.inf)
    if len(recovering) and recovering[0]:
        started[0] = time[0]
    with np.errstate(invalid="ignore"):
        lasting = time - np.maximum.accumulate(started)
    # A decision holds from its tick until the next one.
    spent = np.where(recovering[:-1], np.diff(time), 0.0)
    return {
        "loop.recovering": recovering.astype(float),
        # 12.3 s after 2.3 s is 10 s, whatever the float rounds to: a bound of 10 s holds there.
        "loop.recovering_for": np.where(recovering, np.round(lasting, _DECIMALS), 0.0),
        "loop.recovered_time": np.round(np.cumsum(np.append(0.0, spent))[: len(time)], _DECIMALS),
        "loop.fallback": (source == "fallback").astype(float),
        "loop.unsafe": (verdict == 2).astype(float),
    }


def _to_the_end(column: NDArray[np.generic], ticks: int, nothing: object) -> NDArray[np.generic]:
    """The column of decisions with its last value repeated up to the episode's last tick."""
    last = column[-1:] if len(column) else np.array([nothing])
    return np.concatenate([column[:ticks], np.repeat(last, max(ticks - len(column), 0))])
