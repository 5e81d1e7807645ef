"""What a domain's channels hold, and which faults can act on them."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import COMMAND
from pytest_dura.faults.model import Fault, Kind
from pytest_dura.faults.targets import MESSAGES, PROPOSAL, Target


@dataclass(frozen=True)
class Channel:
    """What a channel holds.

    Args:
        kind: ``numbers`` and ``pose`` have named fields, ``array`` has rows; lists of objects,
            pictures, signs and messages are taken as a whole.
        fields: Names of the fields that hold numbers.
        columns: Numbers in each row of an array; 0 where the rows are numbers themselves.
    """

    kind: Literal[
        "numbers", "array", "objects", "image", "pose", "signs", "prompt", "model", "other"
    ]
    fields: tuple[str, ...] = ()
    columns: int = 0


_HOLDS: Mapping[Kind, tuple[str, ...]] = {
    "objects": ("objects",),
    "image": ("image",),
    "pose": ("pose",),
    "signs": ("signs",),
    "prompt": ("prompt",),
    "model": ("model",),
}
_OWN: Mapping[str, Channel] = {"prompt": Channel("prompt"), "model": Channel("model")}
"""The channels of messages, which every domain has: it is the component that sends them."""
_COUNTED = ("objects", "array", "signs")


def check_target(fault: Fault, channels: Mapping[str, Channel]) -> Channel:
    """Refuse a target that is not there, or that the fault's type or parameters do not suit.

    Returns:
        The target's channel.

    Raises:
        ConfigurationError: With the targets that it can act on, or what the parameters may be.
    """
    channels = {**channels, **_OWN}
    target, possible = fault.place, possible_targets(fault.acts_on, channels)
    channel = channels.get(target.channel)
    if channel is not None and (
        _acts_on_rows(fault.acts_on, target, channel) or str(target) in possible
    ):
        fault.check_parameters(channel)
        return channel
    if fault.acts_on in ("number", "any"):
        possible = [*possible, *_rows(channels)]
    near = difflib.get_close_matches(str(target), possible, n=1)
    if channel is None:
        why = f"there is no channel {target.channel!r}"
    elif target.field and target.field not in channel.fields and channel.kind != "array":
        why = f"{target.channel!r} has no part {target.field!r} that holds a number"
    else:
        why = f"it acts on {WHAT[fault.acts_on]}"
    raise ConfigurationError(
        f"the fault {fault.id!r} cannot act on {str(target)!r}: {why}",
        key="target",
        found=str(target),
        expected="one of " + ", ".join(possible) if possible else "another type of fault",
        remedy=f"did you mean {near[0]!r}?" if near else "choose a target that it can act on",
    )


WHAT: Mapping[Kind, str] = {
    "number": "a number",
    "any": "any value",
    "command": "a number of the command",
    "objects": "a list of objects",
    "image": "a picture",
    "pose": "a pose",
    "signs": "the texts of signs",
    "prompt": "what is put before a model",
    "model": "how a model is reached",
}
"""What the kinds mean, for messages."""


def check_condition_targets(
    targets: tuple[Target, ...], channels: Mapping[str, Channel], key: str
) -> None:
    """Refuse a condition on what is not there.

    Raises:
        ConfigurationError: With the fields that hold numbers.
    """
    for target in targets:
        channel = channels.get(target.channel)
        if channel is None or target.is_command or not _is_readable(target, channel):
            known = [name for name in possible_targets("number", channels) if COMMAND not in name]
            known += _rows(channels)
            counts = [f"{name}.count" for name, one in channels.items() if one.kind in _COUNTED]
            near = difflib.get_close_matches(str(target), [*known, *counts], n=1)
            raise ConfigurationError(
                f"a condition cannot read {str(target)!r}",
                key=key,
                found=str(target),
                expected="one of " + ", ".join([*known, *counts, "time"]),
                remedy=f"did you mean {near[0]!r}?" if near else "compare a number",
            )


def with_proposal(channels: Mapping[str, Channel]) -> Mapping[str, Channel]:
    """The channels, and the numbers of the component's proposal, which are those of the command."""
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
    if channel.kind != "array" or not all(one.isdecimal() for one in indices):
        return False
    depth = 2 if channel.columns else 1
    if len(indices) == 2 and int(indices[1]) >= channel.columns:
        return False
    if acts_on == "any":
        return len(indices) <= depth
    return acts_on == "number" and len(indices) == depth


def _rows(channels: Mapping[str, Channel]) -> list[str]:
    """The numbers in arrays, as messages show them."""
    return [
        f"{name}.<row>" + (f".<0 to {one.columns - 1}>" if one.columns else "")
        for name, one in channels.items()
        if one.kind == "array"
    ]


def possible_targets(acts_on: Kind, channels: Mapping[str, Channel]) -> list[str]:
    """All targets on which faults of a kind can act, in the order of the channels."""
    numbers = [f"{name}.{field}" for name, one in channels.items() for field in one.fields]
    if acts_on == "number":
        return numbers
    if acts_on == "command":
        return [name for name in numbers if Target.parse(name).is_command]
    if acts_on == "any":
        return [*(name for name in channels if name not in MESSAGES), *numbers]
    return [name for name, one in channels.items() if one.kind in _HOLDS[acts_on]]
