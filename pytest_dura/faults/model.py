"""Effects of faults: what each type of the catalogue does to a value, and where it can act."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, did_you_mean, list_names
from pytest_dura.core.fault import Fault
from pytest_dura.core.messages import MESSAGES
from pytest_dura.core.metrics import COMMAND
from pytest_dura.core.percepts import NOTHING
from pytest_dura.faults.parts import (
    PARAMETERS,
    PROPOSAL,
    FaultPart,
    Quantity,
    Suited,
    Target,
)

Kind: TypeAlias = str
"""Kind of value that a type of fault acts on: one of :data:`KIND_MEANINGS`, or a message by its
name in :data:`~pytest_dura.core.messages.MESSAGES`."""


@dataclass(frozen=True)
class Moment:
    """Inputs of a fault at a tick at which it acts.

    Args:
        time: Simulated seconds.
        dt: Seconds per tick.
        elapsed: Seconds since this activation.
        channels: All channels, after the faults that were declared earlier. For a command fault,
            as the component saw them.
        history: The target's values at earlier ticks, as ``(time, value)``, the present tick last;
            as far back as :attr:`FaultEffect.memory` says.
        random: Makes the fault's random numbers of this tick. Each tick has a stream of its own,
            so that draws at one tick do not shift those of another.
    """

    time: float
    dt: float
    elapsed: float
    channels: Mapping[str, Any]
    history: Sequence[tuple[float, Any]]
    random: Callable[[], np.random.Generator]

    __repr__ = short_repr

    @cached_property
    def rng(self) -> np.random.Generator:
        """Random numbers of this fault at this tick."""
        return self.random()


class FaultEffect(FaultPart, ABC):
    """Type of the catalogue: what a fault does while it acts, made of its data once an episode.

    Subclasses implement :meth:`apply`, and may add ``parameters``, a :class:`FaultPart` in which
    each has its default, bounds, and a description with its unit.

    ``acts_on`` is the kind of value that the type acts on, ``default_target`` its target if none is
    given (``None``: the domain has one), and ``reference`` the corresponding entry of a threat or
    failure catalogue, if any. ``lasting`` and ``typical`` are the duration in s and the parameters
    of the fault if only its name is given.
    """

    acts_on: ClassVar[Kind]
    default_target: ClassVar[str | None] = None
    reference: ClassVar[str] = ""
    lasting: ClassVar[float | str] = 4.0
    typical: ClassVar[Mapping[str, Any]] = NOTHING

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse fields other than ``parameters``, which no file could give a value."""
        super().__pydantic_init_subclass__(**kwargs)
        others = [name for name in cls.model_fields if name != PARAMETERS]
        if others:
            raise TypeError(
                f"{cls.__name__} has the field {others[0]!r}; a type of fault has `parameters`"
                " alone: declare it in their class, or as a ClassVar"
            )

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Return activation, two seconds into the episode, duration and parameters by default."""
        plain: dict[str, Any] = {"activation": {"at": 2.0}, "duration": cls.lasting}
        return plain | ({"parameters": dict(cls.typical)} if cls.typical else {})

    @classmethod
    def suited(cls, quantity: Quantity, seconds: float) -> Mapping[str, Suited]:  # noqa: ARG003 - for those who override it
        """Return parameters that follow from what the target's channel declares, by their names.

        They take the place of the defaults, and of the values that a search tries.

        Args:
            quantity: Range and typical error of the number at the target.
            seconds: Simulated seconds that the fault acts at most.
        """
        return NOTHING

    @property
    def hits_by_chance(self) -> bool:
        """Whether an active fault may change no value at all, because its hits are drawn."""
        return False

    @property
    def memory(self) -> float:
        """Seconds of the target's earlier values that it needs; 0 for none."""
        return 0.0

    def check_parameters(self, fault: Fault, channel: Channel) -> None:
        """Refuse parameters that do not suit the fault's target.

        Args:
            fault: The fault as it is planned.
            channel: The channel of its target.

        Raises:
            ConfigurationError: With the values that do.
        """

    def begin(self, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - for those who override it
        """Return what the fault remembers from its activation on, ``None`` if it cannot act yet.

        It is called again at each tick until it can.
        """
        return True

    @abstractmethod
    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:
        """Return the target's new value, or the same object if nothing is changed.

        Do not write into values; ``memory`` may be changed.
        """


@dataclass(frozen=True)
class Channel:
    """Content of a channel.

    Args:
        kind: ``numbers`` and ``pose`` have named fields, ``array`` has rows; lists of objects,
            pictures, signs and messages are taken as a whole.
        fields: Names of the fields that hold numbers.
        columns: Numbers in each row of an array; 0 where the rows are numbers themselves.
        units: Of the fields, or of the columns, one for each.
        frame: The frame of reference, with its axes and the sense of its angles.
        meaning: What the channel reports.
        ranges: Least and greatest value that is reported, of the fields or of the columns, one for
            each; ``None`` for one without.
        errors: Typical error of each, the standard deviation of a healthy sensor in the unit;
            ``None`` for one without. Defaults of faults and what a search tries follow from both.

    Raises:
        ConfigurationError: For units, ranges or errors that are not as many as there are numbers,
            a range that is not in order, and an error that is not above 0.
    """

    kind: Literal["numbers", "array", "objects", "image", "pose", "signs", "message", "other"]
    fields: tuple[str, ...] = ()
    columns: int = 0
    units: tuple[str, ...] = ()
    frame: str = ""
    meaning: str = ""
    ranges: tuple[tuple[float, float] | None, ...] = ()
    errors: tuple[float | None, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        declared = {"units": self.units, "ranges": self.ranges, "errors": self.errors}
        numbers = len(self.fields) or self.columns or max(map(len, declared.values()))
        for key, entries in declared.items():
            if entries and len(entries) != numbers:
                raise ConfigurationError(
                    f"a channel of {numbers} numbers has {len(entries)} {key}",
                    key=key,
                    found=", ".join(map(str, entries)),
                    expected=f"an entry for each of {', '.join(self.fields) or 'the columns'}",
                    remedy=f"give each its own: {key}=(..., ...)",
                )
        for ends in filter(None, self.ranges):
            if len(ends) != 2 or not -math.inf < ends[0] < ends[1] < math.inf:
                raise ConfigurationError(
                    "a channel declares a range that is not in order",
                    key="ranges",
                    found=ends,
                    expected="two finite numbers, the least first",
                    remedy="correct it, or declare None",
                )
        for error in self.errors:
            if error is not None and not 0.0 < error < math.inf:
                raise ConfigurationError(
                    "a channel declares a typical error that is not above 0",
                    key="errors",
                    found=error,
                    expected="a standard deviation in the unit of the number",
                    remedy="correct it, or declare None",
                )

    def quantity(self, field: str) -> Quantity:
        """Return what is declared of the number at a field, or at ``row.column`` of an array."""
        parts = field.split(".")
        if field in self.fields:
            place = self.fields.index(field)
        elif self.kind == "array" and len(parts) == (2 if self.columns else 1):
            place = int(parts[-1]) if self.columns and parts[-1].isdecimal() else 0
        else:
            return Quantity()
        ends = self.ranges[place] if place < len(self.ranges) else None
        error = self.errors[place] if place < len(self.errors) else None
        low, high = ends or (None, None)
        return Quantity(low, high, error)


_COUNTED = ("objects", "array", "signs")


def check_target(fault: Fault, effect: FaultEffect, channels: Mapping[str, Channel]) -> Channel:
    """Refuse a target that does not exist, or that does not suit the fault's type or parameters.

    Args:
        fault: The fault.
        effect: Made of it.
        channels: The channels of its domain.

    Returns:
        The target's channel.

    Raises:
        ConfigurationError: With the targets that it can act on, or the parameters that it takes.
    """
    # The component sends messages, whatever its domain.
    channels = {**channels, **dict.fromkeys(MESSAGES, Channel("message"))}
    target, acts_on = Target.parse(fault.target), effect.acts_on
    possible = possible_targets(acts_on, channels)
    channel = channels.get(target.channel)
    if channel is not None and (_acts_on_rows(acts_on, target, channel) or str(target) in possible):
        effect.check_parameters(fault, channel)
        return channel
    if acts_on in ("number", "any"):
        possible = [*possible, *_rows(channels)]
    if channel is None:
        why = f"there is no channel {target.channel!r}"
    elif target.field and target.field not in channel.fields and channel.kind != "array":
        why = f"{target.channel!r} has no part {target.field!r} that holds a number"
    else:
        why = f"it acts on {kind_meaning(acts_on)}"
    raise ConfigurationError(
        f"the fault {fault.id!r} cannot act on {str(target)!r}: {why}",
        key="target",
        found=str(target),
        expected="one of " + ", ".join(possible) if possible else "another type of fault",
        remedy=did_you_mean(str(target), possible, "choose a target that it can act on")
        if possible
        else f"choose another type: no channel here holds {kind_meaning(acts_on)}",
    )


KIND_MEANINGS: Mapping[Kind, str] = {
    "number": "a number",
    "any": "any value",
    "command": "a number of the command",
    "objects": "a list of objects",
    "image": "a picture",
    "pose": "a pose",
    "signs": "the texts of signs",
}
"""Descriptions of the kinds that every domain may have."""


def kind_meaning(kind: Kind) -> str:
    """Describe a kind of value.

    Raises:
        ConfigurationError: For one that is no message either.
    """
    if kind in KIND_MEANINGS:
        return KIND_MEANINGS[kind]
    if kind in MESSAGES:
        return MESSAGES[kind]
    kinds = [*KIND_MEANINGS, *MESSAGES]
    raise ConfigurationError(
        f"a type of fault acts on {kind!r}, and no value is of that kind",
        key="acts_on",
        found=kind,
        expected=f"one of {list_names(kinds)}",
        remedy=did_you_mean(kind, kinds),
    )


def check_condition_targets(
    targets: tuple[Target, ...], channels: Mapping[str, Channel], key: str
) -> None:
    """Refuse a condition on targets that do not exist.

    Raises:
        ConfigurationError: With the fields that hold numbers.
    """
    for target in targets:
        channel = channels.get(target.channel)
        if channel is None or target.is_command or not _is_readable(target, channel):
            known = [name for name in possible_targets("number", channels) if COMMAND not in name]
            known += _rows(channels)
            counts = [
                f"{name}.count" for name, channel in channels.items() if channel.kind in _COUNTED
            ]
            raise ConfigurationError(
                f"a condition cannot read {str(target)!r}",
                key=key,
                found=str(target),
                expected="one of " + ", ".join([*known, *counts, "time"]),
                remedy=did_you_mean(str(target), [*known, *counts], "compare a number"),
            )


def with_proposal(channels: Mapping[str, Channel]) -> Mapping[str, Channel]:
    """Add the channel of the proposal, which has the numbers of the command."""
    command = channels.get(COMMAND)
    if command is None:
        return channels
    return {**channels, PROPOSAL: Channel("numbers", command.fields)}


def is_number(target: Target, channel: Channel) -> bool:
    """Whether a target is known to be a number in the messages of its channel."""
    return target.field in channel.fields or _acts_on_rows("number", target, channel)


def _is_readable(target: Target, channel: Channel) -> bool:
    if is_number(target, channel):
        return True
    return target.field == "count" and channel.kind in _COUNTED


def _acts_on_rows(acts_on: Kind, target: Target, channel: Channel) -> bool:
    """Whether the target is a row of an array, or a number in a row, that suits a fault."""
    indices = target.field.split(".")
    if channel.kind != "array" or not all(index.isdecimal() for index in indices):
        return False
    depth = 2 if channel.columns else 1
    if len(indices) == 2 and int(indices[1]) >= channel.columns:
        return False
    if acts_on == "any":
        return len(indices) <= depth
    return acts_on == "number" and len(indices) == depth


def _rows(channels: Mapping[str, Channel]) -> list[str]:
    """Targets of numbers in arrays, as messages show them."""
    return [
        f"{name}.<row>" + (f".<0 to {channel.columns - 1}>" if channel.columns else "")
        for name, channel in channels.items()
        if channel.kind == "array"
    ]


def possible_targets(acts_on: Kind, channels: Mapping[str, Channel]) -> list[str]:
    """List all targets on which faults of a kind can act, in the order of the channels."""
    numbers = [f"{name}.{field}" for name, channel in channels.items() for field in channel.fields]
    if acts_on == "number":
        return numbers
    if acts_on == "command":
        return [name for name in numbers if Target.parse(name).is_command]
    if acts_on == "any":
        return [*(name for name in channels if name not in MESSAGES), *numbers]
    return [
        name
        for name, channel in channels.items()
        if acts_on == (name if channel.kind == "message" else channel.kind)
    ]
