"""The FaultInjector: activates what is planned or directed and applies it to the channels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pytest_dura.core.roles import FaultInjector, Injection, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import NOTHING, RoleView
from pytest_dura.faults.catalogue import load_fault
from pytest_dura.faults.model import Fault


class _Active:
    """A fault while it lasts."""

    def __init__(self, since: float) -> None:
        self.since = since
        self.memory: Any = None
        self.began: float | None = None


class CampaignInjector(FaultInjector):
    """Applies the faults of the episode in declared order, each with a random stream of its own.

    An activation decided at one tick takes effect at the next update. The faults that the
    SecurityAssessor directs wait for its directive.
    """

    def reset(self, context: RoleContext) -> None:
        """Load the faults of the episode."""
        self._faults: dict[str, Fault] = {f["id"]: load_fault(f) for f in context.faults}
        self._random: dict[str, np.random.Generator] = {
            name: stream(context.seed, f"fault:{name}") for name in self._faults
        }
        self._last = 0.0
        # A fault that is planned for the beginning is in the first percept.
        self._active: dict[str, _Active] = {
            name: _Active(0.0)
            for name, fault in self._faults.items()
            if fault.activation.by == self.name and fault.activation.due(0.0, -1.0)
        }
        self._unreported = tuple(self._active)

    def run(self, view: RoleView) -> Injection:
        """Activate and end faults. One that is due at time t is in the percept at t."""
        if not self._faults:
            return _IDLE
        ahead = view.time + view.dt
        ended = [
            name
            for name, active in self._active.items()
            if (limit := self._faults[name].duration) is not None
            and ahead >= active.since + limit - 1e-9
        ]
        for name in ended:
            del self._active[name]
        started = list(self._unreported)
        self._unreported = ()
        directed = getattr(view.outputs.get("security_assessor"), "directives", ())
        for name, fault in self._faults.items():
            by_plan = fault.activation.by == self.name
            due = fault.activation.due(ahead, self._last) if by_plan else name in directed
            if due and name not in self._active:
                self._active[name] = _Active(ahead)
                started.append(name)
        self._last = ahead
        ended = [name for name in ended if name not in self._active]  # it begins anew at once
        return Injection(tuple(started), tuple(ended)) if started or ended else _IDLE

    def corrupt(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """Apply the active sensor faults, in declared order."""
        if not self._active:
            return channels, NOTHING
        changed: dict[str, Any] = dict(channels)
        tampered: dict[str, tuple[str, ...]] = {}
        for name, fault in self._faults.items():
            active = self._active.get(name)
            if active is None:
                continue
            if active.memory is None:
                active.memory = fault.begin(changed, self._random[name])
                active.began = time
            if active.memory is None or active.began is None:
                continue
            before = changed[fault.target]
            after = fault.apply(active.memory, changed, time - active.began)
            if after is not before:
                changed[fault.target] = after
                tampered[fault.target] = (*tampered.get(fault.target, ()), name)
        return changed, tampered


_IDLE = Injection()
