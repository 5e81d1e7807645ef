"""What a domain's channels hold, and which faults can act on them."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.model import Fault, Kind
from pytest_dura.faults.targets import COMMAND, Target


@dataclass(frozen=True)
class Channel:
    """What a channel holds.

    Args:
        kind: ``numbers`` and ``pose`` have named fields, ``array`` has rows; lists of objects,
            pictures and signs are taken as a whole.
        fields: Names of the fields that hold numbers.
    """

    kind: Literal["numbers", "array", "objects", "image", "pose", "signs", "other"]
    fields: tuple[str, ...] = ()


_HOLDS: Mapping[Kind, tuple[str, ...]] = {
    "objects": ("objects",),
    "image": ("image",),
    "pose": ("pose",),
    "signs": ("signs",),
}


def check_target(fault: Fault, channels: Mapping[str, Channel]) -> None:
    """Refuse a target that is not there, or that the fault's type cannot act on.

    Raises:
        ConfigurationError: With the targets that it can act on.
    """
    target, possible = fault.place, possible_targets(fault.acts_on, channels)
    if fault.acts_on in ("number", "command") and target.channel in channels:
        rows = channels[target.channel].kind == "array" and target.field
        if rows and fault.acts_on == "number":
            return
    if str(target) in possible:
        return
    near = difflib.get_close_matches(str(target), possible, n=1)
    exists = target.channel in channels
    raise ConfigurationError(
        f"{fault.type!r} cannot act on {str(target)!r}" + ("" if exists else ": no such channel"),
        key="target",
        found=str(target),
        expected="one of " + ", ".join(possible),
        remedy=f"did you mean {near[0]!r}?" if near else "choose a target that it can act on",
    )


def check_condition_targets(
    targets: tuple[Target, ...], channels: Mapping[str, Channel], key: str
) -> None:
    """Refuse a condition on what is not there.

    Raises:
        ConfigurationError: With the fields that hold numbers.
    """
    for target in targets:
        channel = channels.get(target.channel)
        counted = target.field == "count" and channel is not None
        indexed = channel is not None and channel.kind == "array"
        if target.is_command or not (
            counted or indexed or (channel is not None and target.field in channel.fields)
        ):
            known = [name for name in possible_targets("number", channels) if COMMAND not in name]
            raise ConfigurationError(
                f"a condition cannot read {str(target)!r}",
                key=key,
                found=str(target),
                expected="one of " + ", ".join([*known, "<channel>.count", "time"]),
            )


def possible_targets(acts_on: Kind, channels: Mapping[str, Channel]) -> list[str]:
    """All targets on which faults of a kind can act, in the order of the channels."""
    numbers = [f"{name}.{field}" for name, one in channels.items() for field in one.fields]
    if acts_on == "number":
        return numbers
    if acts_on == "command":
        return [name for name in numbers if Target.parse(name).is_command]
    if acts_on == "any":
        return [*channels, *numbers]
    return [name for name, one in channels.items() if one.kind in _HOLDS[acts_on]]
