"""Selection: which of the planned verdicts a session was asked for, and with how many runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    import pytest

    from pytest_dura.plugin.session import DuraSession

LISTED = 20
"""Verdicts that are named of those that were left out."""
_TOLD = "dura_selection"
"""Key of what a worker of pytest-xdist tells the controller, which collects nothing."""


class Selection:
    """What ``-k``, ``--deselect``, a conftest and ``--dura-runs`` left of the plan.

    The plan is what the arguments name: every verdict that the collected tests and scenario items
    would come to.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self._planned: dict[str, int] = {}
        """Runs that are declared for each verdict."""
        self._told: dict[str, Any] = {
            "planned": 0, "asked": 0, "left_out": [], "runs": None, "declared_runs": [],
        }  # fmt: skip

    def plan(self, items: Sequence[pytest.Item]) -> None:
        """Note the verdicts of all items that were collected."""
        self._planned = dict(self._verdicts(items))

    def ask(self, items: Sequence[pytest.Item]) -> None:
        """Note what is left of them."""
        asked = dict(self._verdicts(items))
        left_out = [name for name in self._planned if name not in asked]
        runs = self.session.options.runs
        fewer = {one for one in asked.values() if runs is not None and runs < one}
        self._told = {
            "planned": len(self._planned | asked),
            "asked": len(asked),
            "left_out": sorted(left_out)[:LISTED],
            "runs": runs if fewer else None,
            "declared_runs": [min(fewer), max(fewer)] if fewer else [],
        }

    def to_json(self) -> dict[str, Any]:
        """The record's key ``selection``."""
        return self._told

    def tell_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Tell the controller what this worker collected."""
        workeroutput[_TOLD] = json.dumps(self._told)

    def hear_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Take over from a worker what it collected; each collects the same."""
        if _TOLD in workeroutput:
            self._told = json.loads(workeroutput[_TOLD])

    def _verdicts(self, items: Sequence[pytest.Item]) -> Iterator[tuple[str, int]]:
        """The verdicts that items would come to, each with the runs that are declared for it."""
        from pytest_dura.plugin.item_results import target_of

        known: dict[tuple[str, str], list[str]] = {}
        for item in items:
            target = target_of(item)
            if hasattr(item, "planned"):
                yield item.nodeid, target.case.scenario.planned
            elif target is not None:
                key = item.nodeid.partition("[")[0], target.case.id
                if key not in known:
                    known[key] = self._decided_by(item, *key)
                for name in known[key]:
                    yield name, target.declared

    def _decided_by(self, item: pytest.Item, test: str, case: str) -> list[str]:
        """The verdicts of a test on a case: one for each requirement, or the one it asks for."""
        from pytest_dura.plugin.parametrize import decides_nothing
        from pytest_dura.plugin.requirement_markers import marked_requirements

        if decides_nothing(item):
            return []
        try:
            names = [one.id for one in marked_requirements(self.session, item)]
        except ConfigurationError:  # the test's own error says so
            names = []
        return [f"{name} on {case} by {test}" for name in dict.fromkeys(names)] or [
            f"{test} on {case}"
        ]
