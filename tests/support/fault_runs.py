"""Faults run tick by tick through the injector, over a channel or commands of one's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pytest_dura.core import Fault, Lazy, RoleContext
from pytest_dura.faults import (
    CampaignInjector,
    Channel,
    check_target,
    fault_effect,
    parse_fault,
)

CHANNEL = "link"


def fault(kind: str, *, at: float = 0.0, **given: Any) -> Fault:
    """A fault on the whole channel ``link``, for good; other keywords are its parameters."""
    data = {key: given.pop(key) for key in ("id", "target", "duration") if key in given}
    data = {"target": CHANNEL, "duration": None, "activation": {"at": at}, **data}
    return parse_fault({"type": kind, **data, **({"parameters": given} if given else {})})


def through(values: Iterable[Any], *faults: Fault, dt: float = 0.1, seed: int = 1) -> list[Any]:
    """What stands at the channel ``link`` at each tick, read at that tick."""
    injector = CampaignInjector()
    injector.reset(RoleContext(seed, dt, {}, faults))
    shown = []
    for index, value in enumerate(values):
        channels, tampered = injector.corrupt({CHANNEL: value}, index * dt)
        found = channels[CHANNEL]
        assert (found is value) == (CHANNEL not in tampered), "tampered says what was changed"
        shown.append(found.get() if type(found) is Lazy else found)
    return shown


def commanded(values: Sequence[Any], *faults: Fault, dt: float = 0.1, seed: int = 1) -> list[Any]:
    """What the actuators get at each tick."""
    injector = CampaignInjector()
    injector.reset(RoleContext(seed, dt, {}, faults))
    got = []
    for index, value in enumerate(values):
        injector.corrupt({CHANNEL: 0.0}, index * dt)
        got.append(injector.corrupt_command(value, index * dt)[0])
    return got


def check_place(planned: Fault, channels: Mapping[str, Channel]) -> None:
    """Refuse a target that does not suit the fault, as a scenario's reader does."""
    check_target(planned, fault_effect(planned), channels)
