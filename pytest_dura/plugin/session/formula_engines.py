"""The second engine for formulas, and how often it was compared with the own one."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

    from pytest_dura.requirements.second_engine import SecondEngine

_COMPARED_KEY = "dura_formulas_compared"
"""Key in the output of a worker of pytest-xdist."""


class FormulaEngines:
    """The second engine for formulas, if the session has one, and what it was compared on.

    Args:
        both: Whether it has one.
    """

    def __init__(self, *, both: bool) -> None:
        self._both = both
        self._of_workers: list[dict[str, str]] = []

    @cached_property
    def second_engine(self) -> SecondEngine | None:
        """Engine that evaluates the formulas of this process as well.

        Raises:
            ConfigurationError: If it cannot be imported.
        """
        if not self._both:
            return None
        from pytest_dura.requirements.second_engine import SecondEngine

        return SecondEngine()

    def check(self) -> None:
        """Check that the second engine can be imported, before anything is collected or written.

        Raises:
            ConfigurationError: If it cannot.
        """
        _ = self.second_engine

    def take_differences(self) -> list[str]:
        """Return where the two engines differed since the last call."""
        engine = self.second_engine
        if engine is None:
            return []
        differences, engine.differences = engine.differences, []
        return differences

    def to_json(self) -> dict[str, Any]:
        """The record's key ``second_engine``, which is absent without one."""
        engine = self.second_engine
        return {} if engine is None else {"second_engine": engine.counts(*self._of_workers)}

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output what it has compared."""
        engine = self.second_engine
        workeroutput[_COMPARED_KEY] = {} if engine is None else engine.results

    def receive_from_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Add the counts of a worker that has ended."""
        self._of_workers.append(workeroutput.get(_COMPARED_KEY, {}))
