"""Values that come late, seldom, or not at all, and what a receiver shows meanwhile.

A channel delivers one message per tick, and a receiver that gets nothing keeps showing the last
message that it got. :class:`Receiver` says so for all types of faults.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from pydantic import Field

from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart, NotNegative, Positive, Share, Span, resolved
from pytest_dura.faults.types.base import NoParameters

_ONE_TICK = 1e-6
"""s; a memory shorter than any tick, which keeps the value of the tick before."""


def value_at(moment: Moment, time: float) -> Any:
    """Value of the target at that time; the oldest one kept if none is that old."""
    latest = moment.history[0][1]
    for when, value in moment.history:
        if when > time + TOLERANCE:
            break
        latest = value
    return latest


class Receiver:
    """Receiver of the messages that a fault changes.

    Attributes:
        shown: The last message that it received.
        queue: Messages on their way to it, as ``(time, message)``.
        since: Time since which the fault acts at every tick, in s.
    """

    __slots__ = ("_at", "queue", "shown", "since")

    def __init__(self) -> None:
        self.shown: Any = None
        self.queue: list[tuple[float, Any]] = []
        self.since = self._at = -math.inf

    def starts(self, moment: Moment) -> bool:
        """Whether the fault did not act at the previous tick. Call it once per tick.

        Messages arrived undisturbed until then, so that the queue is empty.
        """
        rested = moment.time > self._at + 1.5 * moment.dt
        self._at = moment.time
        if rested:
            self.since = moment.time
            self.queue.clear()
        return rested


class ReceiverFault(FaultEffect):
    """Base of the types that decide which message a receiver gets at a tick."""

    acts_on: ClassVar[Kind] = "any"

    @property
    def memory(self) -> float:
        """One tick: the previous message stays if none arrives."""
        return _ONE_TICK

    def begin(self, value: Any, moment: Moment) -> Receiver:  # noqa: ARG002 - as FaultEffect has it
        """Return a new receiver."""
        return Receiver()

    def apply(self, memory: Receiver, value: Any, moment: Moment) -> Any:
        """Return the message that the receiver shows."""
        if memory.starts(moment):
            # The value one tick earlier; at the first tick, the present one.
            memory.shown = moment.history[max(len(moment.history) - 2, 0)][1]
        memory.shown = self.received(memory, value, moment)
        return memory.shown

    @abstractmethod
    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the last message that arrives at this tick, or ``receiver.shown`` if none does."""


class DropParameters(FaultPart):
    """Probability of a loss."""

    p: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.5, description="Probability, at each tick, that nothing arrives; 0 to 1."
    )


class Dropping(ReceiverFault):
    """Base of the types that lose single messages by chance."""

    parameters: DropParameters = DropParameters()

    @property
    def hits_by_chance(self) -> bool:
        """Whether some messages are lost, and some are not."""
        return 0.0 < self.parameters.p < 1.0

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the message, unless it is lost."""
        return receiver.shown if moment.rng.random() < self.parameters.p else value


class Held(FaultEffect):
    """Base of the types that repeat what stood at the target when they began to act."""

    parameters: NoParameters = NoParameters()

    def begin(self, value: Any, moment: Moment) -> tuple[Any]:  # noqa: ARG002 - as FaultEffect has it
        """Return the value that stays, as it is now."""
        return (resolved(value),)

    def apply(self, memory: tuple[Any], value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the remembered value."""
        return memory[0]


class Freeze(Held):
    """The value of the activation stays; it shows from the next tick on."""

    acts_on: ClassVar[Kind] = "any"


class Omission(Dropping):
    """Single values are not delivered, each with probability ``p``; the last one delivered stays.

    With ``p`` 0 it is the identity.
    """


class DelayParameters(FaultPart):
    """Delay of the value."""

    s: Annotated[NotNegative, Span(0.0, 3.0)] = Field(
        0.5, description="In s; counts to the next whole tick. 0 is the identity."
    )


class Delay(FaultEffect):
    """The value is that of ``s`` seconds ago: a delay of k ticks shifts it by k ticks.

    It looks back before the activation. Early in the episode, where nothing is that old yet, the
    oldest value stands.
    """

    parameters: DelayParameters = DelayParameters()

    acts_on: ClassVar[Kind] = "any"

    @property
    def memory(self) -> float:
        """Delay, in s."""
        return self.parameters.s

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the remembered value."""
        # The number of ticks after which at least so many seconds have passed.
        late = math.ceil(self.parameters.s / moment.dt - TOLERANCE)
        return value_at(moment, moment.time - late * moment.dt) if late else value


class SlowParameters(FaultPart):
    """Rate of refreshes."""

    # Ticks come at 10 Hz, unless a scenario says otherwise.
    hz: Annotated[Positive, Span(0.2, 10.0, neutral=10.0)] = Field(
        2.0, description="Refreshes per second, in Hz; at the rate of the ticks, the identity."
    )


class Slow(ReceiverFault):
    """The value is refreshed ``hz`` times per second only, first at the activation."""

    parameters: SlowParameters = SlowParameters()

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the value, if a refresh fell due since the tick before."""
        now = moment.time - receiver.since
        before = now - moment.dt
        hz = self.parameters.hz
        due = math.floor(now * hz + TOLERANCE) > math.floor(before * hz + TOLERANCE)
        return value if due else receiver.shown


class IntermittentParameters(FaultPart):
    """For how long values come and stay away."""

    on: Annotated[Positive, Span(0.1, 2.0, neutral=2.0)] = Field(
        0.5, description="Seconds for which values are delivered."
    )
    off: Annotated[NotNegative, Span(0.0, 2.0)] = Field(
        0.5, description="Seconds for which none is, at first; 0 is the identity."
    )


class Intermittent(ReceiverFault):
    """A loose contact: nothing is delivered for ``off`` s, then all is for ``on`` s, and so on.

    While it is off, the last value delivered stays.
    """

    parameters: IntermittentParameters = IntermittentParameters()

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the value, while it is on."""
        period = self.parameters.off + self.parameters.on
        within = moment.elapsed - math.floor(moment.elapsed / period + TOLERANCE) * period
        return receiver.shown if within < self.parameters.off - TOLERANCE else value
