"""Life: one fault of an episode, from its plan through its activations, tick by tick."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from pytest_dura.core.seeding import stream
from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.duration import Lifetime
from pytest_dura.faults.model import Fault, Moment
from pytest_dura.faults.targets import resolved


class Life:
    """Decides when its fault is active and lets it act. It looks at no other fault's effects.

    All its random numbers come from streams of its own, so that adding or removing another fault
    shifts none of them.
    """

    def __init__(self, fault: Fault, seed: int, dt: float) -> None:
        self.fault = fault
        self.target = fault.place
        self.lifetime: Lifetime | None = None
        self._seed, self._dt = seed, dt
        self._count = 0
        self._last = -1.0
        self._held = False
        self._pending: list[float] = []
        self._memory: Any = None
        self._began = 0.0
        activation = fault.activation
        self._condition = parse_condition(activation.when) if activation.when else None
        self._chance = activation.probability
        if activation.rate is not None:
            self._chance = -math.expm1(-activation.rate * dt)
        self._draws = stream(seed, f"fault:{fault.id}:activation")
        self._keeps = fault.memory > 0.0
        self._history: deque[tuple[float, Any]] = deque(
            maxlen=math.ceil(fault.memory / dt - TOLERANCE) + 1 if self._keeps else 1
        )

    @property
    def watchful(self) -> bool:
        """Whether it must look at every tick, active or not."""
        return self._condition is not None or self._chance is not None or self._keeps

    @property
    def active(self) -> bool:
        """Whether it has been activated and has not ended."""
        return self.lifetime is not None

    def next_by_plan(self) -> float:
        """The time before which it cannot become active without an event or a directive, in s."""
        if self.watchful or self._pending:
            return -math.inf
        activation = self.fault.activation
        if activation.at is None or activation.by != "fault_injector" or self._spent:
            return math.inf
        if activation.every is None or self._last < activation.at:
            return activation.at if self._last < activation.at - TOLERANCE else math.inf
        passed = math.floor((self._last - activation.at + TOLERANCE) / activation.every)
        return activation.at + (passed + 1) * activation.every

    def follow(self, time: float) -> None:
        """An event that it waits for has happened at this time."""
        after = self.fault.activation.after
        delay = after.delay if after is not None else 0.0
        self._pending.append(time + max(delay, self._dt))

    def ends(self, time: float, channels: Mapping[str, Any]) -> bool:
        """End it if it is over; whether it was."""
        if self.lifetime is None or not self.lifetime.over(time, channels):
            return False
        self.lifetime, self._memory = None, None
        return True

    def begins(self, time: float, channels: Mapping[str, Any]) -> bool:
        """Activate it if its plan says so; whether it was. To be asked once per tick."""
        due = self._due(time, channels)
        self._last = time
        return due and self.activate(time)

    def activate(self, time: float) -> bool:
        """Activate it from this time on; whether it was, being inactive and not spent."""
        if self.active or self._spent:
            return False
        drawn = stream(self._seed, f"fault:{self.fault.id}:duration:{self._count}")
        self.lifetime = Lifetime(self.fault.duration, time, self._dt, drawn)
        self._count += 1
        return True

    def act(self, value: Any, time: float, channels: Mapping[str, Any]) -> Any:
        """What stands at the target after the fault; the very value if nothing was changed."""
        given = value
        if self._keeps:
            value = resolved(value)
            self._history.append((time, value))
        if self.lifetime is None or not self.lifetime.acts(time):
            return given
        if self._memory is None:
            self._memory = self.fault.begin(value, self._moment(time, time, channels))
            self._began = time
            if self._memory is None:
                return given
        after = self.fault.apply(self._memory, value, self._moment(time, self._began, channels))
        return given if same(value, after) else after

    @property
    def acts_now(self) -> bool:
        """Whether it must be asked at this tick: it is active, or keeps a history."""
        return self.lifetime is not None or self._keeps

    @property
    def _spent(self) -> bool:
        limit = self.fault.activation.limit
        return limit is not None and self._count >= limit

    def _due(self, time: float, channels: Mapping[str, Any]) -> bool:
        activation = self.fault.activation
        if self._chance is not None:
            # Drawn at every tick, so that how long it was active shifts nothing.
            return self._draws.random() < self._chance and self._in_window(time)
        if self._condition is not None:
            held, self._held = self._held, self._condition.holds(channels, time)
            return self._held and not held and self._in_window(time)
        if self._pending:
            reached = [one for one in self._pending if one <= time + TOLERANCE]
            self._pending = [one for one in self._pending if one > time + TOLERANCE]
            return bool(reached)
        return activation.by == "fault_injector" and activation.due(time, self._last)

    def _in_window(self, time: float) -> bool:
        activation = self.fault.activation
        if time < activation.not_before - TOLERANCE:
            return False
        return activation.not_after is None or time <= activation.not_after + TOLERANCE

    def _moment(self, time: float, began: float, channels: Mapping[str, Any]) -> Moment:
        index = round(time / self._dt)
        draws = partial(stream, self._seed, f"fault:{self.fault.id}:{index}")
        return Moment(time, self._dt, time - began, channels, self._history, draws)


def same(before: Any, after: Any) -> bool:
    """Whether a fault left a value as it was, by identity or by equality."""
    if before is after:
        return True
    if type(before) is not type(after) and not (
        isinstance(before, (int, float, np.number)) and isinstance(after, (int, float, np.number))
    ):
        return False
    if isinstance(before, np.ndarray):
        return before.dtype == after.dtype and np.array_equal(before, after)
    try:
        return bool(before == after)
    except (TypeError, ValueError):  # values that hold arrays do not compare
        return False
