"""Consistency of a simulator: whether what it reports of the ego agrees with itself.

A check of requirements, ``SIM-1`` of the built-in scenarios. Verdicts rest on these signals: one in
another unit, with the wrong sign or of another clock makes an unsafe run look safe.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.driving.domain import DRIVING
from pytest_dura.requirements import CheckResult

Floats = NDArray[np.float64]

WINDOW = 1.0
"""Seconds over which changes are compared with rates."""
CHANGES = (
    ("progress", "speed", 0.1),
    ("speed", "acceleration", 0.1),
    ("acceleration", "jerk", 0.5),
    ("lateral_acceleration", "lateral_jerk", 0.5),
)
"""A signal, its rate, and by how much, in the signal's unit, its change may lie outside of what the
rate allows."""
REPORTED = (("gap", 0.1), ("leader_gap", 0.1), ("speed", 0.1))
"""Signals that are computed from percepts as well, and by how much the two may differ."""
_ROUNDING = 1e-3
"""By how much, in the signal's unit, a value may lie outside of the range of its signal."""


def consistent_signals(episode: Episode) -> CheckResult:
    """Whether signals keep to their ranges and rates, and percepts show what the ground truth says.

    The ranges are those that the domain declares; what is 0 or 1 has no value between them.
    Over each second a signal changes by something between the sums of the lesser and of the greater
    rate of each two ticks that follow each other, so that any way to integrate is right. Percepts
    are compared until a fault first acts, which may change them. Where sensors have noise, or
    hide a road user, they differ from the truth.

    The margin is the least share of an allowed difference that is left, and -1 where one is twice
    as great or more; the time is that of the first difference that is greater.
    """
    found = [*_ranges(episode), *_changes(episode), *_reports(episode)]
    if not found:
        return CheckResult(True, vacuous=True, detail="no signal that could be compared")
    worst = min(found)
    if worst[0] >= 0.0:
        return CheckResult(True, worst[0], worst[1], worst[2])
    beyond = [each for each in found if each[0] < 0.0]
    details = "; ".join(detail for _, _, detail in beyond)
    return CheckResult(False, worst[0], min(time for _, time, _ in beyond), details)


def _ranges(episode: Episode) -> Iterator[tuple[float, float, str]]:
    for signal in DRIVING.signals or ():
        if signal.name in episode.signals and len(episode.time):
            value, (least, greatest) = episode.signal(signal.name), signal.range
            beyond = np.maximum(least - value, value - greatest).clip(min=0.0)
            if signal.unit == TRUTH:
                beyond = np.maximum(beyond, np.abs(value - value.round()))
            yield _worst(episode, beyond, _ROUNDING, f"{signal.name} leaves its range")


def _changes(episode: Episode) -> Iterator[tuple[float, float, str]]:
    step = np.diff(episode.time)
    if not len(step) or not np.median(step) > 0.0:
        return
    width = min(max(1, round(WINDOW / float(np.median(step)))), len(step))
    for name, rate, allowed in CHANGES:
        if name in episode.signals and rate in episode.signals:
            value, rates = episode.signal(name), episode.signal(rate)
            least = _over(np.minimum(rates[1:], rates[:-1]) * step, width)
            most = _over(np.maximum(rates[1:], rates[:-1]) * step, width)
            change = value[width:] - value[:-width]
            beyond = np.maximum(least - change, change - most)
            yield _worst(episode, beyond, allowed, f"{name} does not change by {rate}", width)


def _reports(episode: Episode) -> Iterator[tuple[float, float, str]]:
    began = [fault.activated_at for fault in episode.faults if fault.activated_at is not None]
    until = int(np.searchsorted(episode.time, min(began, default=np.inf)))
    for name, allowed in REPORTED:
        reported = f"percept.{name}"
        if name in episode.signals and reported in episode.signals:
            shown, true = episode.signal(reported)[:until], episode.signal(name)[:until]
            both = min(len(shown), len(true))
            shown, true = shown[:both], true[:both]
            if both:
                # What a sensor does not know is no difference.
                apart = np.where(np.isfinite(shown), np.abs(shown - true), 0.0)
                yield _worst(episode, apart, allowed, f"{name} is not what percepts show")


def _over(steps: Floats, width: int) -> Floats:
    """Sum as many steps as a window has, at each of its places."""
    total: Floats = np.concatenate([[0.0], np.cumsum(steps)])
    return total[width:] - total[:-width]


def _worst(
    episode: Episode, differences: Floats, allowed: float, what: str, ahead: int = 0
) -> tuple[float, float, str]:
    """Return the share of what is allowed that is left, since when, and the difference in words."""
    differences = np.nan_to_num(differences, nan=np.inf, posinf=np.inf)
    apart = float(differences.max())
    at = int(np.argmax(differences > allowed if apart > allowed else differences))
    time = float(episode.time[at + ahead])
    left = max(1.0 - apart / allowed, -1.0)
    return left, time, f"{what}: off by {max(apart, 0.0):.3g}, {allowed:g} allowed"
