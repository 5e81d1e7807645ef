"""Scheduling of our items over the workers of pytest-xdist, and work stealing.

Items of a case are split over all workers, which share its episodes. A worker that has no item
left simulates episodes of the last campaigns that no other worker has claimed, and stops where
the requirement is decided; the worker that has the item judges it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from xdist.scheduler import LoadScopeScheduling

from pytest_dura.campaign.events import EventStream
from pytest_dura.plugin.items import ScenarioItem

if TYPE_CHECKING:
    import pytest
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController

    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.requirements.model import Requirement


def steal_work(runner: Runner, last: pytest.Item) -> None:
    """Simulate episodes of campaigns that other workers may still run.

    Args:
        runner: The runner of this worker.
        last: Its last item, which has come to its end.
    """
    if not isinstance(last, ScenarioItem) or not _may_steal(runner, last.session):
        return
    known = runner.library().requirements
    # What is simulated for another worker is no event here: that worker's items use it.
    runner = replace(runner, events=EventStream())
    workers = int(vars(last.config)["workerinput"]["workercount"])
    for item in _last_items(last.session.items, known, workers):
        requirement = known[item.name]
        campaign = runner.campaign(item.planned.case, requirement=requirement)
        try:
            # A component that asks a language model runs only where its requests are counted.
            if not runner.task(campaign.case).portable:
                return
            if not _is_simulated(runner, campaign, requirement):
                campaign.judge(requirement)
        except Exception:  # whatever it is, the worker that has the item reports it
            return


def _may_steal(runner: Runner, run: pytest.Session) -> bool:
    """Whether all items are to be run to their end, and nothing else is due here."""
    runs_all = not run.config.getoption("maxfail", 0)
    stopped = bool(run.shouldstop or run.shouldfail)
    return runs_all and not stopped and runner.store.execution.inside


def _last_items(
    items: Sequence[pytest.Item], known: dict[str, Requirement], cases: int
) -> Iterator[ScenarioItem]:
    """Yield an item for each campaign of so many last cases, the last one first."""
    seen: dict[str, set[str | None]] = {}
    for item in reversed(items):
        if not isinstance(item, ScenarioItem):
            return
        case, paired = item.planned.case.id, known[item.name].paired
        if case not in seen and len(seen) == cases:
            return
        without = None if paired is None else paired.without
        if without not in seen.setdefault(case, set()):
            seen[case].add(without)
            yield item


def _is_simulated(runner: Runner, campaign: Campaign, requirement: Requirement) -> bool:
    """Whether all planned runs are stored, those of pairs included."""
    cases = [campaign.case]
    if requirement.paired is not None:
        cases.append(campaign.paired(requirement.paired.without).case)
    runs = range(campaign.planned)
    return all(
        runner.store.holds(runner.task(case, run)) for run in reversed(runs) for case in cases
    )


SHARES = 4
"""Shares per worker into which the runs of a test are split, if they are long enough."""
LEAST = 8
"""Runs in a share at least, unless every worker is to have one."""
MOST = 500
"""Runs in a share at most: the base class looks through a whole share at each item that ends."""


class CaseScheduling(LoadScopeScheduling):  # type: ignore[misc, unused-ignore]
    """Load scheduling that keeps all workers at the same case, whose episodes they share.

    The items of a case that look at its campaign are split into a share for each worker: all of
    them simulate it together, and none is left with the last case alone. The items of a test that
    looks at one run each are split into shares of neighbouring runs. Any other item is on its own.
    """

    def __init__(self, config: pytest.Config, log: Producer | None = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False  # the order of the cases is that of the shares
        self._scopes: dict[str, str] = {}
        self._places: dict[str, int] = {}

    def _split_scope(self, nodeid: str) -> str:
        if not self._scopes:
            self._scopes = shares(self.collection or [], self.numnodes)
        return self._scopes[nodeid]

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Assign a unit as the base class does, without its search for each item."""
        if not self._places:
            collection = self.registered_collections[node]
            self._places = {name: place for place, name in enumerate(collection)}
        scope, unit = self.workqueue.popitem(last=False)
        self.assigned_work.setdefault(node, {})[scope] = unit
        node.send_runtest_some([self._places[name] for name, done in unit.items() if not done])

    def mark_test_complete(
        self, node: WorkerController, item_index: int, duration: float = 0
    ) -> None:
        """Do as the base class, and forget a finished unit, which it would count for ever."""
        scope = self._split_scope(self.registered_collections[node][item_index])
        units = self.assigned_work[node]
        super().mark_test_complete(node, item_index, duration)
        if scope in units and all(units[scope].values()):
            del units[scope]

    def remove_node(self, node: WorkerController) -> str | None:
        """Return the item during which the worker died; it is not tried again.

        The base class hands out all units of a dead worker again. An item that kills its worker
        would kill every one that follows, and a worker that is given a finished unit is never
        given another: the session would not end.
        """
        units = self.assigned_work[node]
        crashed: str | None = None
        for name, unit in list(units.items()):
            unfinished = [item for item, is_done in unit.items() if not is_done]
            if unfinished and crashed is None:
                crashed = unfinished.pop(0)
                unit[crashed] = True
            if not unfinished:
                del units[name]
        super().remove_node(node)
        return crashed

    def _reschedule(self, node: WorkerController) -> None:
        """Give the worker more work, and never a single item.

        A worker runs an item when it knows the next one, or that there is none. The base class
        gives one unit to a worker that takes the place of a dead one, which would wait for ever.
        """
        super()._reschedule(node)
        if not node.shutting_down and self._pending_of(self.assigned_work[node]) == 1:
            super()._reschedule(node)


def shares(collection: Sequence[str], workers: int) -> dict[str, str]:
    """Return the unit of each item: units are handed out whole, in the order of the collection.

    Args:
        collection: Node ids of all items.
        workers: How many workers there are.
    """
    together: dict[str, list[str]] = {}
    for name in collection:
        together.setdefault(_group(name), []).append(name)
    scopes = {}
    for group, names in together.items():
        count = workers
        if ".py::" in group:
            count = max(workers, min(SHARES * workers, len(names) // LEAST), -(-len(names) // MOST))
        for place, name in enumerate(names):
            scopes[name] = f"{group} {place * count // len(names)}"
    return scopes


def _group(nodeid: str) -> str:
    """Return what belongs together: items of a case, or the runs of a case in a test."""
    name, bracket, parameters = nodeid.partition("[")
    if bracket:
        # A test on runs or cases: `name[intersection/nominal#3]`, maybe among other parameters.
        return f"{name}[{parameters.partition('#')[0].rstrip(']')}]"
    return name if ".py::" in name else name.rpartition("::")[0]
