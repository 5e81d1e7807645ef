"""RequirementJudge: tells the loop when an episode may end at a violation."""

from __future__ import annotations

from collections.abc import Sequence

from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.language.parsing import parse
from pytest_dura.requirements.stl.offline.evaluation import evaluate

LATER = ("percept.", "proposal.", "loop.")
"""Beginnings of the names of signals that are there only once the episode is complete."""


class RequirementJudge:
    """Ends an episode once every requirement is decided and at least one is violated.

    A requirement that ranges over the episode and holds so far is not decided, and one on a
    signal of the percept, of the proposals or of the loop, on pairs of episodes, by a function or
    without a check never is before the end: each of these keeps the episode going.

    Raises:
        ConfigurationError: If a check cannot be read.
    """

    def __init__(self, requirements: Sequence[Requirement]) -> None:
        checks = [
            one.check
            for one in requirements
            if one.check and not one.paired and not is_function_path(one.check)
        ]
        self._formulas = [parse(check) for check in checks]
        self._open = len(checks) < len(requirements) or any(
            name.startswith(LATER) for formula in self._formulas for name in formula.signals
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
