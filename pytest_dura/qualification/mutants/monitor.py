"""Mutations of the safety monitor, the recovery planner and the security assessor."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import ClassVar

from pytest_dura.core.roles import (
    Assessed,
    Assessment,
    PerformanceAssessment,
    PerformanceOracle,
    Recovery,
    RecoveryPlanner,
    RoleContext,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.core.state import RoleView
from pytest_dura.qualification.altered import with_numbers
from pytest_dura.qualification.mutant import Mutation, Parameter


class MonitorMutation(Mutation[SafetyMonitor], SafetyMonitor):
    """A safety monitor with a defect."""

    def run(self, view: RoleView) -> Assessment:
        """Assess as the monitor does."""
        return self.part.run(view)


class AlwaysSafe(MonitorMutation):
    """Is content with everything."""

    about = "finds every proposal safe"

    def run(self, view: RoleView) -> Assessment:
        """Call it safe; the score stays."""
        return replace(self.part.run(view), verdict=Assessed.SAFE, critical=False, reasons=())


class AlwaysUnsafe(MonitorMutation):
    """Is content with nothing."""

    about = "finds every proposal unsafe"

    def run(self, view: RoleView) -> Assessment:
        """Call it unsafe; the score stays."""
        return replace(self.part.run(view), verdict=Assessed.UNSAFE, reasons=("always",))


class LateMonitor(MonitorMutation):
    """Warns too late."""

    about = "reports what it saw some ticks ago"
    parameters: ClassVar = (Parameter("ticks", (5, 15), "ticks"),)
    ticks: int

    def reset(self, context: RoleContext) -> None:
        """Forget the earlier assessments."""
        super().reset(context)
        self._earlier: deque[Assessment] = deque(maxlen=self.ticks + 1)

    def run(self, view: RoleView) -> Assessment:
        """Call it safe until there is an assessment that old."""
        self._earlier.append(self.part.run(view))
        return self._earlier[0] if len(self._earlier) > self.ticks else Assessment()


class RecoveryMutation(Mutation[RecoveryPlanner], RecoveryPlanner):
    """A recovery planner with a defect."""

    def run(self, view: RoleView) -> Recovery:
        """Recover as the planner does."""
        return self.part.run(view)


class Nothing(RecoveryMutation):
    """Lets the proposal stand."""

    about = "lets the refused proposal stand"

    def run(self, view: RoleView) -> Recovery:
        """Return the proposal's action; without a valid one, the planner's."""
        recovery = self.part.run(view)
        proposed = view.proposal and view.proposal.action
        return recovery if proposed is None else replace(recovery, action=proposed)


class LateRecovery(RecoveryMutation):
    """Acts too late."""

    about = "lets the refused proposal stand for some ticks before it acts"
    parameters: ClassVar = (Parameter("ticks", (5, 15), "ticks"),)
    ticks: int

    def reset(self, context: RoleContext) -> None:
        """Forget when it was called."""
        super().reset(context)
        self._last, self._calls = -2, 0

    def run(self, view: RoleView) -> Recovery:
        """Count the ticks of one takeover, and act after so many."""
        self._calls = self._calls + 1 if view.index - self._last <= 1 else 1
        self._last = view.index
        recovery = self.part.run(view)
        proposed = view.proposal and view.proposal.action
        waits = self._calls <= self.ticks and proposed is not None
        return replace(recovery, action=proposed) if waits else recovery


class WrongWay(RecoveryMutation):
    """Goes the wrong way."""

    about = "takes over with the opposite sign"

    def run(self, view: RoleView) -> Recovery:
        """Mirror each number of the action."""
        recovery = self.part.run(view)
        return replace(recovery, action=with_numbers(recovery.action, lambda number: -number))


class Deaf(Mutation[SecurityAssessor], SecurityAssessor):
    """Raises no alarm."""

    about = "raises no alert, and finds every proposal safe"

    def run(self, view: RoleView) -> SecurityAssessment:
        """Say nothing; directives to the injector, which plans need, stay."""
        assessed = self.part.run(view)
        return replace(assessed, verdict=Assessed.SAFE, critical=False, reasons=(), alerts=())


class Blank(Mutation[PerformanceOracle], PerformanceOracle):
    """Measures nothing."""

    about = "reports 0 of everything, and no threshold that was passed"

    def run(self, view: RoleView) -> PerformanceAssessment:
        """Return zeros."""
        assessed = self.part.run(view)
        return PerformanceAssessment(dict.fromkeys(assessed.values, 0.0), assessed.wall_clock)
