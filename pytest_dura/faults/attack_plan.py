"""AttackPlan: when a SecurityAssessor directs each of its planned attacks."""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Injection
from pytest_dura.core.state import RoleView
from pytest_dura.faults.activation import TOLERANCE, Activation, Condition, parse_condition
from pytest_dura.faults.targets import PROPOSAL, Target


class AttackPlan:
    """Plan of the faults of an episode with ``by: security_assessor``.

    An assessor calls :meth:`due` once per tick and returns the ids as its directives. Faults on
    sensors take effect at the next percept, those on the command at once. The plan depends on the
    assessor's own view: simulated time (``at``, ``every``), the percept and the component's
    proposal (``when``), and the FaultInjector's outputs so far (``after``).

    Args:
        faults: All faults of the episode, as in ``RoleContext.faults``.
        role: Name of the assessor's role.
    """

    def __init__(self, faults: Sequence[Mapping[str, Any]], role: str) -> None:
        self._attacks = [_Attack(fault) for fault in faults if fault["activation"]["by"] == role]
        self._unchecked = True

    def due(self, view: RoleView, proposal: Callable[[], Mapping[str, float]]) -> tuple[str, ...]:
        """Ids of the faults to activate, in planned order.

        Args:
            view: The assessor's view of this tick.
            proposal: Returns the numbers of the component's proposal by name, which conditions
                read as ``proposal.<name>``; called if one does and there is a valid proposal.

        Raises:
            ConfigurationError: At the first tick, if a condition reads what no channel has.
        """
        if not self._attacks:
            return ()
        if self._unchecked:
            for attack in self._attacks:
                attack.check(view.percept)
            self._unchecked = False
        channels: Mapping[str, Any] = view.percept
        if view.proposal is not None and any(attack.reads_proposal for attack in self._attacks):
            # A chain, since a copy would read every channel of the percept.
            channels = ChainMap({PROPOSAL: proposal()}, view.percept)  # type: ignore[arg-type]
        return tuple(attack.id for attack in self._attacks if attack.due(view, channels))


class _Attack:
    def __init__(self, fault: Mapping[str, Any]) -> None:
        self.id: str = fault["id"]
        self.activation = Activation.model_validate(fault["activation"])
        when = self.activation.when
        self.condition: Condition | None = parse_condition(when) if when else None
        targets = self.condition.targets if self.condition else ()
        self.reads_proposal = any(target.channel == PROPOSAL for target in targets)
        self._on_command = Target.parse(fault["target"]).is_command
        self._last = -1.0
        self._held = False
        self._pending: list[float] = []
        self._reports = 0

    def check(self, percept: Mapping[str, Any]) -> None:
        """Refuse a condition before anything has moved, also one whose window comes later."""
        if self.condition is None or self.reads_proposal:
            return
        try:
            self.condition.check(percept)
        except ConfigurationError as error:
            raise ConfigurationError(
                f"the fault {self.id!r} cannot be used: {error.problem}",
                key="activation.when",
                found=self.activation.when,
                expected=error.expected,
                remedy=error.remedy,
            ) from None

    def due(self, view: RoleView, channels: Mapping[str, Any]) -> bool:
        effect = view.time if self._on_command else view.time + view.dt
        since, self._last = self._last, effect
        activation = self.activation
        if activation.after is not None:
            self._follow(view)
            waiting = [time for time in self._pending if time > effect + TOLERANCE]
            is_due, self._pending = len(waiting) < len(self._pending), waiting
            return is_due
        if self.condition is not None:
            last = math.inf if activation.not_after is None else activation.not_after
            held = self._held
            self._held = (
                (view.proposal is not None or not self.reads_proposal)
                and activation.not_before - TOLERANCE <= view.time <= last + TOLERANCE
                and self.condition.holds(channels, view.time)
            )
            return self._held and not held
        return activation.due(effect, since)

    def _follow(self, view: RoleView) -> None:
        """Schedule activations after the events that the injector reported since the last tick."""
        after = self.activation.after
        reports = view.history.get("fault_injector", ())
        for time, report in reports[self._reports :]:
            if after is not None and isinstance(report, Injection):
                names = report.activated if after.event == "activated" else report.deactivated
                if after.fault in names:
                    self._pending.append(time + after.delay)
        self._reports = len(reports)
