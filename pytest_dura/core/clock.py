"""Clock: what the component's thinking costs, in simulated time or by the wall clock.

By default the world waits for the component. With a latency, or in real time, a command that was
computed from the percept of a tick comes into force at the first tick at which it is there, as in
a control loop that reads its inputs and writes its outputs once a period. The episode begins once
the first command is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.codec import Amount, Count, PositiveNumber
from pytest_dura.core.errors import ConfigurationError

LATE, EXPIRED, PERIOD = "loop.late", "loop.expired", "loop.period"
"""Signals: 1 where the component was still computing a command that was due, 1 where none was in
force any more meanwhile, else 0; seconds since the tick before, by the wall clock where the world
runs by it."""


@dataclass(frozen=True)
class Clock:
    """Clock of an episode, and what the component's latency is.

    Raises:
        ConfigurationError: If the parts do not go together.
    """

    kind: Literal["simulated", "wall"] = "simulated"
    """`wall`: a tick begins when its time has come by the clock of the machine."""
    latency: Literal["none", "declared", "measured"] = "none"
    """Simulated clock: the world waits for the component, goes on for the latency in s that a
    proposal declares, or for the wall-clock time that it took."""
    hold: PositiveNumber = 1.0
    """Seconds for which a command stays in force at most, while the next one is late."""

    def __post_init__(self) -> None:
        if not 0 < self.hold < math.inf:
            raise ConfigurationError(
                "hold is a positive, finite number of seconds", key="hold", found=self.hold
            )
        if self.kind == "wall" and self.latency != "none":
            raise ConfigurationError(
                "by the wall clock latencies are what they are",
                key="latency",
                found=self.latency,
                expected="no `latency` with `clock: wall`",
                remedy="leave it out, or take the simulated clock",
            )

    @property
    def is_timed(self) -> bool:
        """Whether thinking takes time in the world."""
        return self.kind == "wall" or self.latency != "none"

    @property
    def not_repeatable(self) -> str:
        """Why equal seeds give other episodes; empty where they do not."""
        if self.kind == "wall":
            return "the clock is that of the wall"
        return "latencies are measured" if self.latency == "measured" else ""


class Pace:
    """Pace of an episode by the wall clock: waits for each tick, and notes the periods.

    Args:
        step: Seconds per tick.
    """

    def __init__(self, step: float) -> None:
        self._step, self._began = step, 0.0
        self._last = 0.0
        self.periods: list[float] = [step]
        """Seconds before each tick; the first one has its nominal period."""

    def begin(self) -> None:
        """Start the clock: the first tick is now."""
        self._began = self._last = monotonic()

    def wait(self, index: int) -> None:
        """Wait until a tick is due, and note its period."""
        left = self._began + index * self._step - monotonic()
        if left > 0:
            sleep(left)
        now = monotonic()
        self.periods.append(now - self._last)
        self._last = now


def clock_columns(
    ticks: int, late: Iterable[int], expired: Iterable[int], periods: Sequence[float] | None
) -> dict[str, NDArray[np.float64]]:
    """Make the loop's signals of an episode whose component takes time.

    Args:
        ticks: Number of ticks; the last one has no decision, and repeats the one before it.
        late: Indices of the ticks at which the component was late.
        expired: Those at which no command was in force any more.
        periods: Seconds before each tick; ``None`` where they are nominal.
    """
    columns = {}
    for name, indices in ((LATE, late), (EXPIRED, expired)):
        column = columns[name] = np.zeros(ticks)
        column[[index for index in indices if index < ticks]] = 1.0
        if ticks > 1:
            column[-1] = column[-2]
    if periods is not None:
        columns[PERIOD] = np.array(periods[:ticks], dtype=np.float64)
    return columns


@dataclass(frozen=True)
class Timeliness:
    """How well an episode kept its time, where thinking took time in its world."""

    clock: Literal["simulated", "wall"]
    """Whose seconds these are."""
    ticks: Count
    """Ticks at which a command was due."""
    late: Count
    """Those at which the component was still computing it."""
    longest: Amount
    """Longest time for which it was late without a break, in s of simulated time."""
    expired: Count
    """Ticks at which no command was in force any more."""
    period: Amount
    """Mean time between ticks, in s."""
    jitter: Amount
    """95 % of the times between ticks differ by no more from the nominal one, in s."""
    worst: Amount
    """Greatest of these differences, in s."""


def timeliness(
    clock: Clock,
    step: float,
    signals: Mapping[str, NDArray[np.float64]],
    decisions: int,
) -> Timeliness | None:
    """Compute it from an episode's signals; ``None`` where thinking takes no time.

    Args:
        clock: The episode's clock.
        step: Nominal seconds per tick.
        signals: With :data:`LATE` and :data:`EXPIRED`, and :data:`PERIOD` by the wall clock.
        decisions: How many there are.
    """
    if not clock.is_timed or LATE not in signals:
        return None
    late = signals[LATE][:decisions] > 0.5
    streak = longest = 0
    for each in late:
        streak = streak + 1 if each else 0
        longest = max(longest, streak)
    periods = signals.get(PERIOD, np.array([]))[1:]
    off = np.abs(periods - step)
    return Timeliness(
        clock=clock.kind,
        ticks=len(late),
        late=int(late.sum()),
        longest=float(longest * step),
        expired=int((signals[EXPIRED][:decisions] > 0.5).sum()),
        period=float(periods.mean()) if len(periods) else step,
        jitter=float(np.quantile(off, 0.95)) if len(off) else 0.0,
        worst=float(off.max()) if len(off) else 0.0,
    )
