"""Messages of a channel, or the command, that come late, lost, twice, altered, old or forged."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, NoReturn, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.fault import Fault
from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.model import Channel, FaultEffect, Kind, Moment, is_number
from pytest_dura.faults.parts import (
    FaultPart,
    NotNegative,
    Positive,
    Share,
    Span,
    Target,
    part_of,
    resolved,
    with_part,
)
from pytest_dura.faults.types.base import (
    NoParameters,
    change_lazily,
    count_numbers,
    flip_bits,
    with_changed_number,
)
from pytest_dura.faults.types.timing import Dropping, Receiver, ReceiverFault, value_at

_MS = 1e-3


class LatencyParameters(FaultPart):
    """Delay of a message."""

    latency_ms: Annotated[NotNegative, Span(0.0, 3000.0, unit="ms")] = Field(
        300.0, description="Of every message, in ms."
    )
    jitter_ms: Annotated[NotNegative, Span(0.0, 1000.0, unit="ms")] = Field(
        0.0, description="On top, drawn evenly from 0 to this for each message, in ms."
    )


class Latency(ReceiverFault):
    """Every message arrives ``latency_ms`` later, and up to ``jitter_ms`` more, in the order sent.

    It shows at the first tick at or after its arrival. Messages sent before the activation have
    arrived: until the first of the late ones does, the last of those stays. With both at 0 it is
    the identity.
    """

    parameters: LatencyParameters = LatencyParameters()

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the latest message that has arrived."""
        late = self.parameters.latency_ms * _MS
        if self.parameters.jitter_ms:
            late += self.parameters.jitter_ms * _MS * moment.rng.random()
        receiver.queue.append((moment.time + late, value))
        latest = receiver.shown
        # The head of the queue delays the others: no message overtakes another.
        while receiver.queue and receiver.queue[0][0] <= moment.time + TOLERANCE:
            latest = receiver.queue.pop(0)[1]
        return latest


class Loss(Dropping):
    """Messages are lost, each with probability ``p``; the last one that arrived stays.

    With ``p`` 0 it is the identity, with ``p`` 1 it is ``denial``.
    """


class ReorderParameters(FaultPart):
    """Probability of a late message."""

    p: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.5, description="Probability that a message falls behind; 0 to 1."
    )


class Reorder(ReceiverFault):
    """Messages arrive one tick late, each with probability ``p``: after their successor.

    The late message overwrites the newer one. With ``p`` 0 it is the identity, with ``p`` 1 every
    message is one tick late.
    """

    parameters: ReorderParameters = ReorderParameters()

    @property
    def hits_by_chance(self) -> bool:
        """Whether some messages fall behind, and some do not."""
        return 0.0 < self.parameters.p < 1.0

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:
        """Return the message that arrives last at this tick."""
        latest = receiver.shown
        late = moment.rng.random() < self.parameters.p
        if not late:
            latest = value
        if receiver.queue:
            latest = receiver.queue.pop()[1]
        if late:
            receiver.queue.append((moment.time, value))
        return latest


class DuplicateParameters(FaultPart):
    """Number of copies, and length of the queue."""

    n: Annotated[int, Span(0, 9)] = Field(
        1, ge=0, le=1000, description="Extra copies of a message; 0 is the identity."
    )
    queue_s: Annotated[Positive, Span(0.1, 10.0, neutral=0.1)] = Field(
        5.0, description="Seconds of messages that the queue holds; older ones drop out."
    )


class Duplicate(ReceiverFault):
    """Every message is delivered ``n`` more times, and the receiver takes one per tick.

    So a queue builds up: i ticks after the activation the message shown is that of tick
    i // (n + 1), until the queue is full. From then on what is shown is ``queue_s`` old.
    """

    parameters: DuplicateParameters = DuplicateParameters()

    @property
    def memory(self) -> float:
        """Length of the queue, in s."""
        return self.parameters.queue_s

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as ReceiverFault has it
        """Return the message at the head of the queue."""
        passed = round((moment.time - receiver.since) / moment.dt)
        lag = passed - passed // (self.parameters.n + 1)
        return value_at(moment, moment.time - lag * moment.dt)


class CorruptionParameters(FaultPart):
    """Probability and size of an alteration."""

    p: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.5, description="Probability that a message is altered; 0 to 1."
    )
    bits: Annotated[int, Span(0, 8)] = Field(
        1, ge=0, le=32, description="Bits inverted in one number of it; 0 is the identity."
    )


class Corruption(FaultEffect):
    """Messages are altered, each with probability ``p``: bits of one of its numbers are inverted.

    Numbers are found wherever the message keeps them, also in lists of objects and in pictures,
    and each is as likely as another. A finite number stays finite. A message without any number
    stays as it is.
    """

    parameters: CorruptionParameters = CorruptionParameters()

    acts_on: ClassVar[Kind] = "any"

    @property
    def hits_by_chance(self) -> bool:
        """Whether some messages are altered, and some are not."""
        return 0.0 < self.parameters.p < 1.0 and self.parameters.bits > 0

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the message, altered or not."""
        bits, rng = self.parameters.bits, moment.rng
        if rng.random() >= self.parameters.p or not bits:
            return value

        def corrupted(message: Any, rng: np.random.Generator) -> Any:
            count = count_numbers(message)
            if not count:
                return message
            index = int(rng.integers(count))
            return with_changed_number(message, index, lambda number: flip_bits(number, bits, rng))

        return change_lazily(value, rng, corrupted)


class Denial(ReceiverFault):
    """Nothing is delivered; the last message that arrived before the activation stays."""

    parameters: NoParameters = NoParameters()

    def received(self, receiver: Receiver, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as ReceiverFault has it
        """Nothing."""
        return receiver.shown


_COLUMNS = ("numbers", "pose", "array")
"""Kinds of channels of which it is known where they hold numbers."""
_HOLD_MORE = (*_COLUMNS, "objects", "image", "signs")
"""Kinds of channels whose message is more than one plain value."""


def _plain(value: Any) -> Any:
    if not isinstance(value, (bool, int, float, str)):
        raise ValueError(f"a number, a text or a truth value can be forged, not {value!r}")  # noqa: TRY004 - what pydantic takes
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"a forged number is finite, not {value!r}")
    return value


Plain: TypeAlias = Annotated[bool | int | float | str, BeforeValidator(_plain)]


class ReplayParameters(FaultPart):
    """Length of the replayed record."""

    # The shorter the record is, the less old is what it repeats.
    s: Annotated[Positive, Span(0.1, 10.0, neutral=0.1)] = Field(
        2.0, description="Seconds that were recorded before the activation."
    )


class Replay(FaultEffect):
    """What was delivered in the ``s`` seconds before the activation is delivered again, in a loop.

    Early in the episode the record is as long as there were messages; without any, it waits for
    the first.
    """

    parameters: ReplayParameters = ReplayParameters()

    acts_on: ClassVar[Kind] = "any"

    @property
    def memory(self) -> float:
        """Length of the record, in s."""
        return self.parameters.s

    def begin(self, value: Any, moment: Moment) -> list[Any] | None:  # noqa: ARG002 - as FaultEffect has it
        """Return the record; ``None`` while there is none."""
        return [message for _, message in moment.history][:-1] or None

    def apply(self, memory: list[Any], value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the recorded message whose turn it is."""
        return memory[round(moment.elapsed / moment.dt) % len(memory)]


class MasqueradeParameters(FaultPart):
    """Forged content."""

    forged: dict[str, Plain] = Field(
        {}, description="Fields of the message and what they hold, in their own units."
    )
    value: Plain | None = Field(
        None, description="For a target that is one field: what it holds, in its own unit."
    )

    @model_validator(mode="after")
    def _check_exclusive(self) -> MasqueradeParameters:
        if self.forged and self.value is not None:
            raise ValueError("forged names fields of a message, value is a whole one; give one")
        return self


class Masquerade(FaultEffect):
    """A forged sender takes the real one's place and sends the same message over and over.

    It is the message of the activation, which the forger overheard, with the ``forged`` fields in
    it; or ``value``. With neither it is ``freeze``.
    """

    parameters: MasqueradeParameters = MasqueradeParameters()

    acts_on: ClassVar[Kind] = "any"

    def check_parameters(self, fault: Fault, channel: Channel) -> None:
        """Refuse what no message of the channel holds.

        What is in its objects, pictures and signs, and in other values, is not known beforehand.
        """
        given, place = self.parameters, Target.parse(fault.target)
        if given.value is not None:
            if is_number(place, channel):
                _check_number(fault, "value", given.value)
            elif channel.kind in _HOLD_MORE and not place.field:
                remedy = "name one field as the target, or give `forged`"
                _refuse(fault, "value", given.value, "is a whole message", "`forged`", remedy)
        for name, forged in given.forged.items():
            _check_field(fault, place, channel, name, forged)

    def begin(self, value: Any, moment: Moment) -> tuple[Any]:  # noqa: ARG002 - as FaultEffect has it
        """Return the forged message.

        Raises:
            ConfigurationError: If the message has no such field.
        """
        if self.parameters.value is not None:
            return (self.parameters.value,)
        message = resolved(value)
        for field, forged in self.parameters.forged.items():
            part_of(message, field)  # a mapping would take any new key
            message = with_part(message, field, forged)
        return (message,)

    def apply(self, memory: tuple[Any], value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the forged message."""
        return memory[0]


def _check_field(fault: Fault, place: Target, channel: Channel, name: str, forged: object) -> None:
    if is_number(place, channel):
        _refuse(fault, "forged", name, "is a part of a number", "`value`", "give `value`")
    path = f"{place.field}.{name}" if place.field else name
    if channel.kind in _COLUMNS and is_number(Target(place.channel, path), channel):
        _check_number(fault, "forged", forged)
    elif channel.kind in (*_COLUMNS, "objects"):
        known = ", ".join(channel.fields) or ("<row>.<column>" if channel.columns else "")
        remedy = did_you_mean(name, channel.fields, "name a number of the message")
        expected = f"one of {known}" if known else "another target, with fields"
        _refuse(fault, "forged", name, f"is no number in {place.channel!r}", expected, remedy)


def _check_number(fault: Fault, key: str, forged: object) -> None:
    if isinstance(forged, (bool, str)):
        why = "is no number, where one belongs"
        _refuse(fault, key, forged, why, "a number", "give a number")


def _refuse(  # noqa: PLR0917 - the parts of one message
    fault: Fault, key: str, found: object, why: str, expected: str, remedy: str
) -> NoReturn:
    raise ConfigurationError(
        f"the fault {fault.id!r} cannot be used: what is forged {why}",
        key=f"parameters.{key}",
        found=found,
        expected=expected,
        remedy=remedy,
    )
