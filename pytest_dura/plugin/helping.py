"""What a worker of pytest-xdist does once it has no item left: it helps the others to simulate.

The last items look at a campaign each, and one worker judges each of them. Whoever is left without
looks at the same campaigns, as the items do, and nobody hears of it: it simulates what nobody has
claimed, and stops where the requirement is decided. The others find what it simulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.items import ScenarioItem

if TYPE_CHECKING:
    import pytest

    from pytest_dura.campaign.campaigns import Campaign
    from pytest_dura.campaign.runner import Bench
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.requirements.model import Requirement


def help_others(session: DuraSession, last: pytest.Item) -> None:
    """Help at the campaigns that other workers may still be at.

    Args:
        session: The session of this worker.
        last: Its last item, which has come to its end.
    """
    if not isinstance(last, ScenarioItem) or not _is_free(session, last.session):
        return
    bench, known = _unheard(session.bench), session.library().requirements
    workers = int(vars(session.config)["workerinput"]["workercount"])
    for item in _last_campaigns(last.session.items, known, workers):
        requirement = known[item.name]
        campaign = bench.campaign(item.planned.case, requirement=requirement)
        try:
            # A component that asks a language model is asked where that is counted, and no more.
            if not bench.task(campaign.case).portable:
                return
            if not _is_simulated(campaign, requirement):
                campaign.judge(requirement)
        except Exception:  # whatever it is, the worker that has the item tells it
            return


def _is_free(session: DuraSession, run: pytest.Session) -> bool:
    """Whether nothing else is to be done, and all items are to be run to their end."""
    patient = not session.config.getoption("maxfail", 0)
    stopped = bool(run.shouldstop or run.shouldfail)
    return patient and not stopped and session.bench.store.execution.inside


def _unheard(bench: Bench) -> Bench:
    """The same bench, which tells nobody anything."""
    silent: dict[str, Any] = {
        one.name: one.default for one in fields(bench) if one.name.startswith("on_")
    }
    return replace(bench, **silent, keep=None)


def _last_campaigns(
    items: Sequence[pytest.Item], known: dict[str, Requirement], cases: int
) -> Iterator[ScenarioItem]:
    """One item for each campaign of so many last cases, the last one first."""
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


def _is_simulated(campaign: Campaign, requirement: Requirement) -> bool:
    """Whether all planned runs are there, those of pairs included."""
    cases, bench = [campaign.case], campaign.bench
    if requirement.paired is not None:
        cases.append(campaign.paired(requirement.paired.without).case)
    runs = range(campaign.planned)
    return all(bench.store.holds(bench.task(case, run)) for run in reversed(runs) for case in cases)
