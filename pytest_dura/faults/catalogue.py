"""The catalogue: fault types by name, and faults from plain data."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from functools import cache
from typing import Any

from pydantic import ValidationError

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.state import NOTHING
from pytest_dura.faults.model import Fault
from pytest_dura.faults.refusals import refusal

FAULT_TYPES: dict[str, str] = {
    "bias": "pytest_dura.faults.types.scalar:Bias",
    "drift": "pytest_dura.faults.types.scalar:Drift",
    "noise": "pytest_dura.faults.types.scalar:Noise",
    "gain": "pytest_dura.faults.types.scalar:Gain",
    "stuck-at": "pytest_dura.faults.types.scalar:StuckAt",
    "bit-flip": "pytest_dura.faults.types.scalar:BitFlip",
    "out-of-range": "pytest_dura.faults.types.scalar:OutOfRange",
    "freeze": "pytest_dura.faults.types.timing:Freeze",
    "omission": "pytest_dura.faults.types.timing:Omission",
    "delay": "pytest_dura.faults.types.timing:Delay",
    "slow": "pytest_dura.faults.types.timing:Slow",
    "intermittent": "pytest_dura.faults.types.timing:Intermittent",
    "latency": "pytest_dura.faults.types.communication:Latency",
    "loss": "pytest_dura.faults.types.communication:Loss",
    "reorder": "pytest_dura.faults.types.communication:Reorder",
    "duplicate": "pytest_dura.faults.types.communication:Duplicate",
    "corruption": "pytest_dura.faults.types.communication:Corruption",
    "denial": "pytest_dura.faults.types.communication:Denial",
    "replay": "pytest_dura.faults.types.impersonation:Replay",
    "masquerade": "pytest_dura.faults.types.impersonation:Masquerade",
    "loss-of-effectiveness": "pytest_dura.faults.types.command:LossOfEffectiveness",
    "lag": "pytest_dura.faults.types.command:Lag",
    "stuck-command": "pytest_dura.faults.types.command:StuckCommand",
    "inversion": "pytest_dura.faults.types.command:Inversion",
    "brightness": "pytest_dura.faults.types.image:Brightness",
    "salt-and-pepper": "pytest_dura.faults.types.image:SaltAndPepper",
    "patch": "pytest_dura.faults.types.image:Patch",
    "perturbation": "pytest_dura.faults.types.perturbation:Perturbation",
    "ghost-obstacle": "pytest_dura.driving.faults.attacks:GhostObstacle",
    "trajectory-spoof": "pytest_dura.driving.faults.attacks:TrajectorySpoof",
    "object-miss": "pytest_dura.driving.faults.objects:ObjectMiss",
    "position-noise": "pytest_dura.driving.faults.objects:PositionNoise",
    "range-cut": "pytest_dura.driving.faults.objects:RangeCut",
    "class-change": "pytest_dura.driving.faults.objects:ClassChange",
    "id-switch": "pytest_dura.driving.faults.objects:IdSwitch",
    "moved-obstacle": "pytest_dura.driving.faults.objects:MovedObstacle",
    "gnss-jump": "pytest_dura.driving.faults.gnss:GnssJump",
    "gnss-drag-off": "pytest_dura.driving.faults.gnss:GnssDragOff",
    "gnss-jam": "pytest_dura.driving.faults.gnss:GnssJam",
    "prompt-text": "pytest_dura.driving.faults.signs:PromptText",
    "prompt-drop": "pytest_dura.llm.faults.prompt:PromptDrop",
    "prompt-reorder": "pytest_dura.llm.faults.prompt:PromptReorder",
    "prompt-paraphrase": "pytest_dura.llm.faults.prompt:PromptParaphrase",
    "model-failure": "pytest_dura.llm.faults.model:ModelFailure",
    "model-delay": "pytest_dura.llm.faults.model:ModelDelay",
}
"""Type name to import path; a domain's faults are imported when one is used."""

BY_CHANCE = "by_chance"
"""Key of a fault's plain data that says whether its effect is drawn; derived, never given."""


def fault_class(name: str) -> type[Fault]:
    """The class of a fault type: a name of the catalogue, or ``package.module:Class``.

    Raises:
        ConfigurationError: For an unknown type, and for a class that is no fault.
    """
    if isinstance(name, str) and name in FAULT_TYPES:
        return _imported_once(FAULT_TYPES[name])
    if not isinstance(name, str) or ":" not in name:
        near = difflib.get_close_matches(str(name), FAULT_TYPES, n=1)
        raise ConfigurationError(
            f"unknown fault {name!r}",
            key="type",
            found=name,
            expected="package.module:Class, or one of " + ", ".join(sorted(FAULT_TYPES)),
            remedy=f"did you mean {near[0]!r}?" if near else "choose a type of the catalogue",
        )
    return _imported(name)


@cache
def _imported_once(path: str) -> type[Fault]:
    """The class of a type of the catalogue: a grid asks for it in every case."""
    return _imported(path)


def _imported(path: str) -> type[Fault]:
    found = RoleSpec(path).resolve()
    if not (isinstance(found, type) and issubclass(found, Fault)):
        raise ConfigurationError(
            f"{path} is not a fault",
            key="type",
            found=path,
            expected="a subclass of pytest_dura.faults.model.Fault",
        )
    return found


def load_fault(data: Mapping[str, Any], targets: Mapping[str, str] = NOTHING) -> Fault:
    """A fault from plain data, with defaults for ``id`` (the type) and ``target``.

    Args:
        data: As in a scenario file; or what :func:`parse_fault` returned.
        targets: Where a fault acts that names no target, by what its type can act on.

    Raises:
        ConfigurationError: For an unknown type or key, or a value out of range; ``key`` is the
            dotted path within the fault.
    """
    kind = fault_class(data.get("type", ""))
    filled = {"id": data["type"], **data}
    filled.pop(BY_CHANCE, None)
    target = targets.get(kind.acts_on, kind.default_target)
    if target is not None:
        filled.setdefault("target", target)
    try:
        return kind.model_validate(filled)
    except ValidationError as error:
        raise refusal(kind, filled, error) from None


def parse_fault(data: Mapping[str, Any], targets: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """Plain data with every default filled in; see :func:`load_fault`."""
    return plain_fault(load_fault(data, targets))


def plain_fault(fault: Fault) -> dict[str, Any]:
    """A fault as plain data, from which :func:`load_fault` makes an equal one."""
    return {**fault.model_dump(mode="json"), BY_CHANCE: fault.by_chance}


def default_fault(name: str, targets: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """A fault of the catalogue with its default activation and parameters, by its type's name."""
    return parse_fault({"type": name, **fault_class(name).example()}, targets)
