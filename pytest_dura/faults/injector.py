"""FaultInjector: activates what is planned or directed and applies it to the channels."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.fault import Fault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import FaultInjector, Injection, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import RoleView
from pytest_dura.faults.activation import NEVER, NOW, TOLERANCE, Lifetime, Trigger, Until, refusing
from pytest_dura.faults.catalogue import fault_form
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.model import Moment
from pytest_dura.faults.parts import AbsentRowError, Target, resolved


def is_same_value(before: Any, after: Any) -> bool:
    """Whether two values are the same, by identity or by value.

    NaN is the same as NaN. Types must be the same, but for numbers. Lazy values, which would have
    to be made to be compared, are the same only if they are one object.
    """
    if before is after:
        return True
    if isinstance(before, _NUMBER) and isinstance(after, _NUMBER):
        return bool(before == after) or bool(np.isnan(before) and np.isnan(after))
    return type(before) is type(after) and _same_of_type(before, after)


_NUMBER = (int, float, np.number)


def _same_of_type(before: Any, after: Any) -> bool:
    if isinstance(before, np.ndarray):
        return before.dtype == after.dtype and _same_arrays(before, after)
    if isinstance(before, (list, tuple)):
        return len(before) == len(after) and all(map(is_same_value, before, after))
    if isinstance(before, Mapping):
        return before.keys() == after.keys() and all(
            is_same_value(before[k], after[k]) for k in before
        )
    if is_dataclass(before) and "__eq__" in vars(type(before)):
        names = (field.name for field in fields(before) if field.compare)
        return all(is_same_value(getattr(before, name), getattr(after, name)) for name in names)
    try:
        return bool(before == after)
    except (TypeError, ValueError):  # of a foreign type that holds arrays: taken as changed
        return False


def _same_arrays(before: NDArray[Any], after: NDArray[Any]) -> bool:
    if before.dtype.kind == "O":
        return before.shape == after.shape and all(map(is_same_value, before.flat, after.flat))
    return np.array_equal(before, after, equal_nan=before.dtype.kind in "fc")


class FaultLife:
    """Activations of one fault in an episode, independent of the effects of other faults.

    All random numbers come from streams of its own, so that adding or removing another fault
    shifts none of them.

    ``wake`` is the time in s before which :meth:`ends` and :meth:`begins` need not be called,
    unless an event that it follows happens.
    """

    def __init__(self, fault: Fault, seed: int, dt: float) -> None:
        form = fault_form(fault)
        self.id, self.activation, self.effect = fault.id, form.activation, form.effect
        self.target = Target.parse(fault.target)
        self.lifetime: Lifetime | None = None
        self._duration, self._seed, self._dt = form.duration, seed, dt
        self._trigger: Trigger | None = None
        if not self.activation.directed:
            self._trigger = Trigger(self.activation, fault.id, dt, seed)
        self._count, self._limit = 0, self.activation.limit
        self._memory: Any = None
        self._began = 0.0
        reach = self.effect.memory
        self.keeps_history = reach > 0.0
        self._history: deque[tuple[float, Any]] = deque(
            maxlen=math.ceil(reach / dt - TOLERANCE) + 1 if self.keeps_history else 1
        )
        self.wake = self._next()

    def check(self, channels: Mapping[str, Any]) -> None:
        """Refuse a target or a condition on channels that do not exist.

        Raises:
            ConfigurationError: With the fault's id.
        """
        if not (self.target.is_command or self.target.is_message):
            with refusing(self.id, "target"), suppress(AbsentRowError):
                self.target.read(channels)
        if self._trigger is not None and self._trigger.condition is not None:
            with refusing(self.id, "activation.when"):
                self._trigger.condition.check(channels)
        if isinstance(self._duration, Until):
            with refusing(self.id, "duration.until"):
                parse_condition(self._duration.until).check(channels)

    @property
    def active(self) -> bool:
        """Whether it has been activated and has not ended."""
        return self.lifetime is not None

    @property
    def acts_now(self) -> bool:
        """Whether :meth:`act` must be called at this tick: it is active, or keeps a history."""
        return self.lifetime is not None or self.keeps_history

    def follow(self, time: float) -> None:
        """Schedule the activation after an event that the fault follows."""
        after = self.activation.after
        if self._trigger is not None and after is not None:
            self._trigger.follow(time + max(after.delay, self._dt))
            self.wake = self._next()

    def ends(self, time: float, channels: Mapping[str, Any]) -> bool:
        """End the activation if its duration is over; returns whether it was."""
        if self.lifetime is None or not self.lifetime.over(time, channels):
            return False
        self.lifetime, self._memory = None, None
        return True

    def begins(self, time: float, channels: Mapping[str, Any]) -> bool:
        """Activate it if it is due; returns whether it was. Call it once per tick."""
        trigger = self._trigger
        if trigger is None:
            self.wake = self._next()
            return False
        began = trigger.due(time, channels) and self.activate(time)
        # Within its window, a condition is checked at each tick, so that `wake` stays.
        if trigger.condition is None or began or self._spent or time > trigger.final:
            self.wake = self._next()
        return began

    def activate(self, time: float) -> bool:
        """Activate it from this time on, unless it is active or spent; returns whether it was."""
        if self.active or self._spent:
            return False
        drawn = stream(self._seed, f"fault:duration:{self._count}:{self.id}")
        self.lifetime = Lifetime(self._duration, time, self._dt, drawn)
        self._count += 1
        self.wake = NOW
        return True

    def act(self, whole: Any, time: float, channels: Mapping[str, Any]) -> Any:
        """Return the channel, or the command, after the fault; the same object if unchanged.

        A row that an array or list does not have at this tick is left alone.
        """
        try:
            value = self.target.of(whole)
        except AbsentRowError:
            return whole
        if self.keeps_history:
            value = resolved(value)
            self._history.append((time, value))
        if self.lifetime is None or not self.lifetime.acts(time):
            return whole
        moment = self._moment(time, self._began, channels)
        if self._memory is None:
            # One moment, and so one stream, lest `apply` draw the numbers of `begin` again.
            moment = self._moment(time, time, channels)
            self._memory = self.effect.begin(value, moment)
            self._began = time
            if self._memory is None:
                return whole
        after = self.effect.apply(self._memory, value, moment)
        return whole if is_same_value(value, after) else self.target.written(whole, after)

    @property
    def _spent(self) -> bool:
        return self._limit is not None and self._count >= self._limit

    def _next(self) -> float:
        """Time before which it neither ends nor begins by itself."""
        if self.lifetime is not None:
            return NOW
        return NEVER if self._spent or self._trigger is None else self._trigger.next_due()

    def _moment(self, time: float, began: float, channels: Mapping[str, Any]) -> Moment:
        draws = partial(stream, self._seed, f"fault:tick:{round(time / self._dt)}:{self.id}")
        return Moment(time, self._dt, time - began, channels, self._history, draws)


class CampaignInjector(FaultInjector):
    """Injector of the faults of the episode, in declared order, with separate random streams.

    A fault that is due at time t changes the percept and the command at t. One that the
    SecurityAssessor directs takes effect at the next percept, or in the command at once; that
    counts towards its greatest number of activations. A directive to a fault that is active or
    spent has no effect.
    """

    def reset(self, context: RoleContext) -> None:
        """Load the faults of the episode.

        Raises:
            ConfigurationError: For two faults of one id.
        """
        self._lives: dict[str, FaultLife] = {}
        for fault in context.faults:
            if fault.id in self._lives:
                raise ConfigurationError(
                    f"two faults have the id {fault.id!r}",
                    key="faults",
                    found=fault.id,
                    expected="an id of its own for each fault",
                    remedy="give one of them another `id`",
                )
            self._lives[fault.id] = FaultLife(fault, context.seed, context.dt)
        self._sensors: list[FaultLife] = []
        self._commands: list[FaultLife] = []
        self._messages: list[FaultLife] = []
        self._followers: dict[tuple[str, str], list[FaultLife]] = {}
        for life in self._lives.values():
            is_command, is_message = life.target.is_command, life.target.is_message
            alike = self._messages if is_message else self._sensors
            (self._commands if is_command else alike).append(life)
            after = life.activation.after
            if after is not None and not life.activation.directed:
                self._followers.setdefault((after.fault, after.event), []).append(life)
        self._directed: set[str] = set()
        self._started: list[str] = []
        self._ended: list[str] = []
        self._channels: Mapping[str, Any] = NOTHING
        self._unchecked = True
        self._keeps_history = any(life.keeps_history for life in self._sensors)
        self._wake = self._next()

    def may_act(self) -> bool:
        """Whether the episode has faults; an own subclass may do more than that."""
        return bool(self._lives) or type(self) is not CampaignInjector

    def run(self, view: RoleView) -> Injection:
        """Take the SecurityAssessor's directives; report what began and ended at this tick.

        Raises:
            ValueError: For a directive that names no fault of an episode that has faults.
        """
        if not self._lives:
            return _NO_CHANGE
        directed = getattr(view.outputs.get("security_assessor"), "directives", ())
        if directed:
            self._direct(directed, view.time)
        if not self._started and not self._ended:
            return _NO_CHANGE
        injection = Injection(tuple(self._started), tuple(self._ended))
        self._started.clear()
        self._ended.clear()
        return injection

    def corrupt(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """Begin and end what is due, then apply the active sensor faults, in declared order."""
        if self._unchecked:  # a misspelt target is refused before anything has moved
            for life in self._lives.values():
                life.check(channels)
            self._unchecked = False
        self._channels = channels
        if time < self._wake - TOLERANCE:
            return channels, NOTHING
        self._advance(channels, time)
        return self._apply(channels, time)

    def corrupt_command(self, action: Any, time: float) -> tuple[Any, tuple[str, ...]]:
        """Apply the active command faults, in declared order."""
        return self._changed(self._commands, action, time)

    def corrupt_message(
        self, channel: str, message: Any, time: float
    ) -> tuple[Any, tuple[str, ...]]:
        """Apply the active faults of a channel of messages, in declared order."""
        lives = [life for life in self._messages if life.target.channel == channel]
        return self._changed(lives, message, time)

    def _changed(
        self, lives: Sequence[FaultLife], value: Any, time: float
    ) -> tuple[Any, tuple[str, ...]]:
        """Value after the faults that act on it, and the ids of those that changed it."""
        if not lives:
            return value, ()
        sent, tampered = value, list[str]()
        for life in lives:
            if not life.acts_now:
                continue
            before = value
            value = life.act(before, time, self._channels)
            if value is not before:
                tampered.append(life.id)
        if len(tampered) > 1 and is_same_value(sent, value):
            return sent, ()
        return value, tuple(tampered)

    def manifested(self, faults: Sequence[str], time: float) -> None:
        """Schedule the faults that follow a manifestation."""
        for name in faults:
            self._chain("manifested", name, time)

    def _advance(self, channels: Mapping[str, Any], time: float) -> None:
        """Begin and end what is due."""
        for name, life in self._lives.items():
            directed = name in self._directed
            if time < life.wake - TOLERANCE and not directed:
                continue
            ended = life.ends(time, channels)
            begins = life.begins(time, channels)
            if begins or (directed and life.activate(time)):
                self._report("activated", name, time)  # also at its end, which is no end then
            elif ended:
                self._report("deactivated", name, time)
        self._directed.clear()
        self._wake = self._next()

    def _apply(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """Channels after the active sensor faults, and by channel the ids that changed it."""
        acting = [life for life in self._sensors if life.acts_now]
        if not acting:
            return channels, NOTHING
        changed = dict(channels)
        tampered: dict[str, tuple[str, ...]] = {}
        for life in acting:
            channel = life.target.channel
            before = life.target.channel_of(changed)
            changed[channel] = life.act(before, time, changed)
            if changed[channel] is not before:
                tampered[channel] = (*tampered.get(channel, ()), life.id)
        for channel in [name for name, faults in tampered.items() if len(faults) > 1]:
            if is_same_value(channels[channel], changed[channel]):  # they cancel each other
                changed[channel] = channels[channel]
                del tampered[channel]
        if not tampered:
            return channels, NOTHING
        self._channels = changed
        return changed, tampered

    def _direct(self, names: Sequence[str], time: float) -> None:
        for name in names:
            life = self._lives.get(name)
            if life is None:
                known = ", ".join(self._lives)
                raise ValueError(
                    f"the security_assessor directs {name!r}, which is no fault of this episode;"
                    f" there are: {known}"
                )
            if not life.target.is_command:
                self._directed.add(name)
            elif life.activate(time):
                if name in self._ended:  # activated at its end, which is no end then
                    self._ended.remove(name)
                self._report("activated", name, time)
        self._wake = self._next()

    def _report(self, event: str, name: str, time: float) -> None:
        (self._started if event == "activated" else self._ended).append(name)
        self._chain(event, name, time)

    def _chain(self, event: str, name: str, time: float) -> None:
        for follower in self._followers.get((name, event), ()):
            follower.follow(time)

    def _next(self) -> float:
        """Time before which there is nothing to do, in s."""
        if self._directed or self._keeps_history:
            return NOW
        return min((life.wake for life in self._lives.values()), default=NEVER)


_NO_CHANGE = Injection()
