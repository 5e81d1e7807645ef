"""Life: one fault of an episode, from its plan through its activations, tick by tick."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import stream
from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.chance import Chance
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.duration import Lifetime, Until
from pytest_dura.faults.model import Fault, Moment
from pytest_dura.faults.sameness import same
from pytest_dura.faults.targets import AbsentRowError, resolved

NEVER, NOW = math.inf, -math.inf


class Life:
    """Decides when its fault is active and lets it act. It looks at no other fault's effects.

    All its random numbers come from streams of its own, so that adding or removing another fault
    shifts none of them.

    ``wake`` is the time in s before which :meth:`ends` and :meth:`begins` need not be called,
    unless an event that it follows happens; to call them is no mistake.
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
        when = None if activation.directed else activation.when
        self._condition = parse_condition(when) if when else None
        probability = activation.probability
        if activation.rate is not None:
            probability = -math.expm1(-activation.rate * dt)
        self._chance: Chance | None = None
        if probability is not None:
            self._chance = Chance(probability, stream(seed, f"fault:activation:{fault.id}"))
        self._limit = activation.limit
        self._first = activation.not_before - TOLERANCE
        self._final = NEVER if activation.not_after is None else activation.not_after + TOLERANCE
        self.keeps = fault.memory > 0.0
        self._history: deque[tuple[float, Any]] = deque(
            maxlen=math.ceil(fault.memory / dt - TOLERANCE) + 1 if self.keeps else 1
        )
        self.wake = self._next()

    def check(self, channels: Mapping[str, Any]) -> None:
        """Refuse a target or a condition that these channels do not have.

        Raises:
            ConfigurationError: With the fault's id.
        """
        place = "target"
        try:
            if not (self.target.is_command or self.target.is_message):
                with suppress(AbsentRowError):
                    self.target.read(channels)
            place = "activation.when"
            if self._condition is not None:
                self._condition.check(channels)
            place = "duration.until"
            if isinstance(self.fault.duration, Until):
                parse_condition(self.fault.duration.until).check(channels)
        except ConfigurationError as error:
            raise ConfigurationError(
                f"the fault {self.fault.id!r} cannot be used: {error.problem}",
                key=place,
                found=error.found,
                expected=error.expected,
                remedy=error.remedy,
            ) from None

    @property
    def active(self) -> bool:
        """Whether it has been activated and has not ended."""
        return self.lifetime is not None

    @property
    def acts_now(self) -> bool:
        """Whether it must be asked at this tick: it is active, or keeps a history."""
        return self.lifetime is not None or self.keeps

    def follow(self, time: float) -> None:
        """An event that it waits for has happened at this time."""
        after = self.fault.activation.after
        delay = after.delay if after is not None else 0.0
        self._pending.append(time + max(delay, self._dt))
        self.wake = self._next()

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
        began = due and self.activate(time)
        # A condition in its window is looked at in each tick; that it was last time says so.
        if self._condition is None or began or self._spent or time > self._final:
            self.wake = self._next()
        return began

    def activate(self, time: float) -> bool:
        """Activate it from this time on; whether it was, being inactive and not spent."""
        if self.active or self._spent:
            return False
        drawn = stream(self._seed, f"fault:duration:{self._count}:{self.fault.id}")
        self.lifetime = Lifetime(self.fault.duration, time, self._dt, drawn)
        self._count += 1
        self.wake = NOW
        return True

    def act(self, whole: Any, time: float, channels: Mapping[str, Any]) -> Any:
        """The channel, or the command, after the fault; the very same if nothing was changed.

        A row that an array or list does not have at this tick is left alone.
        """
        try:
            value = self.target.of(whole)
        except AbsentRowError:
            return whole
        if self.keeps:
            value = resolved(value)
            self._history.append((time, value))
        if self.lifetime is None or not self.lifetime.acts(time):
            return whole
        moment = self._moment(time, self._began, channels)
        if self._memory is None:
            # One stream serves both, lest `apply` draw the numbers of `begin` again.
            moment = self._moment(time, time, channels)
            self._memory = self.fault.begin(value, moment)
            self._began = time
            if self._memory is None:
                return whole
        after = self.fault.apply(self._memory, value, moment)
        return whole if same(value, after) else self.target.written(whole, after)

    @property
    def _spent(self) -> bool:
        return self._limit is not None and self._count >= self._limit

    def _due(self, time: float, channels: Mapping[str, Any]) -> bool:
        if self._chance is not None:
            return self._in_window(time) and self._chance.happens(self._index(time))
        if self._condition is not None:
            held = self._held
            self._held = self._in_window(time) and self._condition.holds(channels, time)
            return self._held and not held
        if self._pending:
            waiting = [one for one in self._pending if one > time + TOLERANCE]
            reached = len(waiting) < len(self._pending)
            self._pending = waiting
            return reached
        activation = self.fault.activation
        return not activation.directed and activation.due(time, self._last)

    def _in_window(self, time: float) -> bool:
        return self._first <= time <= self._final

    def _next(self) -> float:
        """The time before which it neither ends nor begins by itself."""
        if self.lifetime is not None:
            return NOW
        if self._spent:
            return NEVER
        if self._pending:
            return min(self._pending)
        if self._chance is not None or self._condition is not None:
            following = max(self._first, self._last + self._dt / 2)
            if self._chance is not None:
                index = math.ceil(following / self._dt - TOLERANCE)
                following = self._chance.next(max(index, 0)) * self._dt
            return following if following <= self._final else NEVER
        activation = self.fault.activation
        if activation.directed:
            return NEVER
        return activation.next_planned(self._last)

    def _index(self, time: float) -> int:
        return round(time / self._dt)

    def _moment(self, time: float, began: float, channels: Mapping[str, Any]) -> Moment:
        draws = partial(stream, self._seed, f"fault:tick:{self._index(time)}:{self.fault.id}")
        return Moment(time, self._dt, time - began, channels, self._history, draws)
