"""Measures of a driving episode: one number each, from its ground truth.

They fit wherever a function of an episode is asked for: as a user-defined metric, or as the measure
of a requirement on pairs, such as ``pytest_dura.driving.measures:clearance_time``. An episode that
has no value gives NaN. A further measure of each episode is a module of this folder.
"""

from __future__ import annotations

import math

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.measures import Measure
from pytest_dura.core.registry import objects_below
from pytest_dura.driving.roles.performance import STANDING


def clearance_time(episode: Episode) -> float:
    """Seconds until the ego's rear had left the junction; NaN if it never did.

    Raises:
        ConfigurationError: If the episode has no signal ``cleared``.
    """
    cleared = np.flatnonzero(episode.signal("cleared") > 0.5)
    return float(episode.time[cleared[0]]) if len(cleared) else math.nan


_TIME_UP = ("time", "iterations", "truncated")


def gridlock(episode: Episode) -> bool:
    """Whether the ego had not cleared the junction when the episode's time was up."""
    return not episode.ever("cleared") and episode.termination in _TIME_UP


def collided(episode: Episode) -> bool:
    """Whether the ego was in contact with anything at any time."""
    return episode.ever("collided")


def minimum_gap(episode: Episode) -> float:
    """Least gap to any object in metres: 0 after contact, and at most the signal's cap (50 m).

    Raises:
        ConfigurationError: If the episode has no signal ``gap``.
    """
    return float(np.min(episode.signal("gap"))) if episode.ticks else math.nan


def peak_deceleration(episode: Episode) -> float:
    """Greatest deceleration along the ego in m/s2; 0 if it never slowed down.

    Raises:
        ConfigurationError: If the episode has no signal ``acceleration``.
    """
    if not episode.ticks:
        return math.nan
    return max(0.0, -float(np.min(episode.signal("acceleration"))))


def time_stopped(episode: Episode) -> float:
    """Seconds for which the ego stood: was slower than 0.1 m/s, at whatever place and how often.

    A speed counts until the next tick, so the last tick of an episode adds nothing.

    Raises:
        ConfigurationError: If the episode has no signal ``speed``.
    """
    standing = episode.signal("speed")[:-1] < STANDING
    return float(np.diff(episode.time)[standing].sum()) if episode.ticks else math.nan


MEASURES = (
    Measure(
        "collided",
        heading="coll",
        meaning="runs with a collision",
        function=collided,
        shown="share",
        signals=("collided",),
        severity="grave",
        signal="collided",
        event="collision",
    ),
    Measure(
        "clearance_time",
        heading="clearance",
        meaning="time until the junction was cleared, over the runs that cleared it",
        function=clearance_time,
        shown="mean",
        unit="s",
        signals=("cleared",),
    ),
    Measure(
        "gridlock",
        heading="grid",
        meaning="runs that had not cleared the junction when their time was up",
        function=gridlock,
        shown="count",
        signals=("cleared",),
        severity="notable",
    ),
    *objects_below(__name__, Measure),
)
"""Measures of each driving episode."""
