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

_ATTACKS = "pytest_dura.driving.faults.attacks"
_OBJECTS = "pytest_dura.driving.faults.objects"
_GNSS = "pytest_dura.driving.faults.gnss"
_PROMPT = "pytest_dura.llm.faults.prompt"
_TYPES = "pytest_dura.faults.types"

FAULT_TYPES: dict[str, str] = {
    "bias": f"{_TYPES}.scalar:Bias",
    "drift": f"{_TYPES}.scalar:Drift",
    "noise": f"{_TYPES}.scalar:Noise",
    "gain": f"{_TYPES}.scalar:Gain",
    "stuck-at": f"{_TYPES}.scalar:StuckAt",
    "bit-flip": f"{_TYPES}.scalar:BitFlip",
    "out-of-range": f"{_TYPES}.scalar:OutOfRange",
    "freeze": f"{_TYPES}.timing:Freeze",
    "omission": f"{_TYPES}.timing:Omission",
    "delay": f"{_TYPES}.timing:Delay",
    "slow": f"{_TYPES}.timing:Slow",
    "intermittent": f"{_TYPES}.timing:Intermittent",
    "latency": f"{_TYPES}.communication:Latency",
    "loss": f"{_TYPES}.communication:Loss",
    "reorder": f"{_TYPES}.communication:Reorder",
    "duplicate": f"{_TYPES}.communication:Duplicate",
    "corruption": f"{_TYPES}.communication:Corruption",
    "denial": f"{_TYPES}.communication:Denial",
    "replay": f"{_TYPES}.impersonation:Replay",
    "masquerade": f"{_TYPES}.impersonation:Masquerade",
    "loss-of-effectiveness": f"{_TYPES}.command:LossOfEffectiveness",
    "lag": f"{_TYPES}.command:Lag",
    "stuck-command": f"{_TYPES}.command:StuckCommand",
    "inversion": f"{_TYPES}.command:Inversion",
    "brightness": f"{_TYPES}.image:Brightness",
    "salt-and-pepper": f"{_TYPES}.image:SaltAndPepper",
    "patch": f"{_TYPES}.image:Patch",
    "perturbation": f"{_TYPES}.perturbation:Perturbation",
    "ghost-obstacle": f"{_ATTACKS}:GhostObstacle",
    "trajectory-spoof": f"{_ATTACKS}:TrajectorySpoof",
    "object-miss": f"{_OBJECTS}:ObjectMiss",
    "position-noise": f"{_OBJECTS}:PositionNoise",
    "range-cut": f"{_OBJECTS}:RangeCut",
    "class-change": f"{_OBJECTS}:ClassChange",
    "id-switch": f"{_OBJECTS}:IdSwitch",
    "moved-obstacle": f"{_OBJECTS}:MovedObstacle",
    "gnss-jump": f"{_GNSS}:GnssJump",
    "gnss-drag-off": f"{_GNSS}:GnssDragOff",
    "gnss-jam": f"{_GNSS}:GnssJam",
    "prompt-text": "pytest_dura.driving.faults.signs:PromptText",
    "prompt-drop": f"{_PROMPT}:PromptDrop",
    "prompt-reorder": f"{_PROMPT}:PromptReorder",
    "prompt-paraphrase": f"{_PROMPT}:PromptParaphrase",
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
