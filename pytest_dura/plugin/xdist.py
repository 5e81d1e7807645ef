"""How pytest-xdist spreads our items over its workers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController


class CaseScheduling(LoadScopeScheduling):  # type: ignore[misc, unused-ignore]
    """Load balancing in units: the items of a case together, any other item on its own."""

    def _split_scope(self, nodeid: str) -> str:
        name, bracket, parameters = nodeid.partition("[")
        if bracket:
            # A test on runs or cases: `name[intersection/nominal#3]`, maybe among other parameters.
            return parameters.partition("#")[0].rstrip("]")
        return name if ".py::" in name else name.rpartition("::")[0]

    def remove_node(self, node: WorkerController) -> str | None:
        """The item during which the worker died, if it had any left; it is not tried again.

        The base class hands out all units of a dead worker again. An item that kills its worker
        would kill every one that follows, and a worker that is given a finished unit is never
        given another: the session would not end.
        """
        units = self.assigned_work[node]
        crashed: str | None = None
        for name, unit in list(units.items()):
            left = [item for item, completed in unit.items() if not completed]
            if left and crashed is None:
                crashed = left.pop(0)
                unit[crashed] = True
            if not left:
                del units[name]
        super().remove_node(node)
        return crashed

    def _reschedule(self, node: WorkerController) -> None:
        """Give the worker more, and never a single item.

        A worker runs an item when it knows the next one, or that there is none. The base class
        gives one unit to a worker that takes the place of a dead one, which would wait for ever.
        """
        super()._reschedule(node)
        if not node.shutting_down and self._pending_of(self.assigned_work[node]) == 1:
            super()._reschedule(node)
