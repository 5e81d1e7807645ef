"""RequirementJudge: tells the loop when an episode may end at a violation."""

from __future__ import annotations

from collections.abc import Sequence

from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.bounds import evaluate, parse
from pytest_dura.requirements.model import Requirement


class RequirementJudge:
    """Ends an episode once every requirement is decided and at least one is violated.

    A requirement that ranges over the episode and holds so far is not decided, and one on a
    ``percept.`` signal or without a check never is before the end: either keeps the episode going.

    Raises:
        ConfigurationError: If a check cannot be read.
    """

    def __init__(self, requirements: Sequence[Requirement]) -> None:
        checks = [requirement.check for requirement in requirements]
        self._open = not all(checks)
        self._formulas = [parse(check) for check in checks if check]
        self._open |= any(
            name.startswith("percept.") for formula in self._formulas for name in formula.signals
        )

    def __call__(self, simulator: Simulator, ticks: list[Tick]) -> bool:
        """Whether the episode may end; see :class:`pytest_dura.core.orchestrator.Judge`."""
        if self._open or not self._formulas:
            return False
        signals = simulator.signals(ticks)
        time = [tick.time for tick in ticks]
        found = [evaluate(formula, time, signals, complete=False) for formula in self._formulas]
        statuses = {one.status for one in found}
        return "violated" in statuses and "undecided" not in statuses
