"""Scenario items, one per case and requirement, such as ``intersection/nominal::SAF-1``.

With them the units of a session: items that share episodes, and so run in one shard.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.sessions import ShardUnit
from pytest_dura.plugin.markers import Target
from pytest_dura.plugin.messages import replay_command, rerun_command
from pytest_dura.plugin.session import session_of

if TYPE_CHECKING:
    import os

    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.session import DuraSession, Planned
    from pytest_dura.runner import Runner


COLLECTOR = "::scenarios"
"""The node that collects all cases; no path is called so, whose conftest would apply."""


class ScenarioCases(pytest.Collector):
    """Collects the items of all planned cases at once: a report for each would take its time.

    It is no file: ``--lf`` would pass over it.
    """

    def collect(self) -> Iterator[pytest.Item]:
        """The items of each case in the order of the plan."""
        session = session_of(self.config)
        for planned in session.plan:
            name = planned.case.id
            # The root's path lets the root conftest apply, wherever the scenario file lies.
            case: ScenarioCase = ScenarioCase.from_parent(
                self.session, name=name, nodeid=name, path=session.config.rootpath
            )
            case.planned, case.cases = planned, self
            yield from case.collect()

    @cached_property
    def fixtures(self) -> Any:
        """The fixtures of all items, which are the same: those of plugins and the root conftest."""
        first = pytest.Function.from_parent(self, name="fixtures", callobj=_judge)
        return first._fixtureinfo  # noqa: SLF001 - it is what `Function` takes as `fixtureinfo`

    @cached_property
    def markers(self) -> dict[str, pytest.MarkDecorator]:
        """The markers of the items, by their requirement."""
        known = session_of(self.config).library().requirements
        names = {name for planned in session_of(self.config).plan for name in planned.requirements}
        return {name: pytest.mark.requirement(name, text=known[name].text) for name in names}


class ScenarioCase(pytest.Collector):
    """The parent of the items of one case."""

    planned: Planned
    cases: ScenarioCases

    def collect(self) -> Iterator[pytest.Item]:
        """One item per requirement."""
        for name in self.planned.requirements:
            item = ScenarioItem.from_parent(
                self, name=name, callobj=_judge, fixtureinfo=self.cases.fixtures
            )
            item.planned = self.planned
            item.add_marker(self.cases.markers[name])
            yield item


class ScenarioItem(pytest.Function):
    """Judges one requirement on all episodes of a case."""

    planned: Planned

    def reportinfo(self) -> tuple[os.PathLike[str] | str, int | None, str]:
        """Where the scenario stands."""
        scenario = self.planned.case.scenario
        line = scenario.line_of("requirements") or 1
        return scenario.file, line - 1, self.nodeid


def scenario_items(session: DuraSession, root: pytest.Session) -> list[pytest.Item]:
    """The items of all planned cases."""
    cases = ScenarioCases.from_parent(
        root, name=COLLECTOR, nodeid=COLLECTOR, path=session.config.rootpath
    )
    return list(root.genitems(cases))


def _judge(request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner) -> None:
    """What each item runs, whose case and requirement it is that it asks for."""
    from pytest_dura.campaign.reporting import explain_verdict
    from pytest_dura.plugin.junit import ending_events
    from pytest_dura.plugin.outcomes import ItemResult

    session, planned = session_of(request.config), request.node.planned
    requirement = session.library().requirements[request.node.name]
    campaign = orchestrator.campaign(planned.case, requirement=requirement)
    try:
        verdict = campaign.judge(requirement)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    session.reporter.verdict_reached(verdict, requirement)
    if verdict.verdict == "supported":
        return
    lines = explain_verdict(verdict, requirement, campaign.failures)
    if verdict.counterexamples:
        found = ItemResult(requirement, planned.case, verdict=verdict.to_json())
        lines += [f"event:    {line}" for line in ending_events(session, found)]
        lines.append("replay:   " + replay_command(session, verdict.counterexamples[0].episode))
    lines.append("rerun:    " + rerun_command(session, f"{planned.case.id}::{requirement.id}"))
    message = "\n".join(lines)
    if verdict.verdict == "undecided" and session.options.warn_undecided:
        pytest.skip(message)
    pytest.fail(message, pytrace=False)


def units_of(
    session: DuraSession, items: Sequence[pytest.Item]
) -> dict[ShardUnit, list[pytest.Item]]:
    """The items in units, all of one case in one, and so those of cases that share episodes.

    A campaign that is compared with runs without faults runs those of another case, so that both
    are one unit. What a test asks of a bench itself is not known before it runs: an episode that
    two shards ran that way is told by both, and has to be the same one.

    Args:
        session: The session of this process.
        items: Those that the whole session would run.
    """
    groups = _Groups()
    tests: dict[str, list[pytest.Item]] = defaultdict(list)
    of_cases: list[tuple[str, pytest.Item]] = []
    for item in items:
        found = _planned_case_of(session, item)
        if found is None:
            tests[item.nodeid].append(item)
            continue
        case, planned, faults_left_out = found
        groups.add(case.id, planned)
        if faults_left_out:
            twin = case.without_faults().id
            groups.add(twin, planned)
            groups.join(case.id, twin)
        of_cases.append((case.id, item))
    members: dict[str, list[pytest.Item]] = defaultdict(list)
    names: dict[str, str] = {}
    for name, item in of_cases:
        root = groups.root(name)
        members[root].append(item)
        names[root] = min(names.get(root, name), name)
    episodes = groups.episodes()
    units: dict[ShardUnit, list[pytest.Item]] = {}
    for root, own in members.items():
        ids = [item.nodeid for item in own]
        units[ShardUnit.of("case", names[root], ids, episodes[root])] = own
    for name, own in tests.items():
        # One that chooses its episodes itself has at least one, for all that is known.
        runs = any("dura_metrics" in getattr(item, "fixturenames", ()) for item in own)
        units[ShardUnit.of("test", name, [name] * len(own), int(runs))] = own
    return units


def _planned_case_of(session: DuraSession, item: pytest.Item) -> tuple[Case, int, bool] | None:
    """An item's case, its planned runs, and whether it compares them with runs without faults."""
    if isinstance(item, ScenarioItem):
        case, names = item.planned.case, item.planned.requirements
        runs = session.options.runs or case.scenario.planned
        return case, runs, _pairs(session, case, names)
    parameters = getattr(getattr(item, "callspec", None), "params", {})
    for fixture in ("episode", "campaign"):
        target = parameters.get(fixture)
        if isinstance(target, Target):
            asked = () if target.requirement is None else (target.requirement.id,)
            return target.case, target.planned, _pairs(session, target.case, asked)
    return None


def _pairs(session: DuraSession, case: Case, names: Iterable[str]) -> bool:
    """Whether one of these requirements compares runs with their twins without faults."""
    from pytest_dura.requirements.model import FAULTS

    known = session.library().requirements
    paired = [known[name].paired for name in names if name in known]
    return bool(case.faults) and any(one is not None and one.without == FAULTS for one in paired)


class _Groups:
    """Cases that hang together, and how many episodes they come to."""

    def __init__(self) -> None:
        self._above: dict[str, str] = {}
        self._planned: dict[str, int] = {}

    def add(self, case: str, planned: int) -> None:
        self._above.setdefault(case, case)
        self._planned[case] = max(planned, self._planned.get(case, 0))

    def root(self, case: str) -> str:
        while self._above[case] != case:
            self._above[case] = self._above[self._above[case]]
            case = self._above[case]
        return case

    def join(self, one: str, other: str) -> None:
        first, second = sorted((self.root(one), self.root(other)))
        self._above[second] = first

    def episodes(self) -> Counter[str]:
        """Of each group, by its root."""
        found: Counter[str] = Counter()
        for case, planned in self._planned.items():
            found[self.root(case)] += planned
        return found
