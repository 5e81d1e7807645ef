"""Scenario items, one per case and requirement, such as ``intersection/nominal::SAF-1``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.context import replay_command, rerun_command

if TYPE_CHECKING:
    import os

    from pytest_dura.plugin.context import Planned, SessionContext
    from pytest_dura.runner import Runner


_COLLECTOR = "::scenarios"
"""The node that collects all cases; no path is called so, whose conftest would apply."""


class ScenarioCases(pytest.Collector):
    """Collects the items of all planned cases at once: a report for each would take its time.

    It is no file: ``--lf`` would pass over it.
    """

    context: SessionContext

    def collect(self) -> Iterator[pytest.Item]:
        """The items of each case in the order of the plan."""
        for planned in self.context.plan:
            name = planned.case.id
            # The root's path lets the root conftest apply, wherever the scenario file lies.
            case: ScenarioCase = ScenarioCase.from_parent(
                self.session, name=name, nodeid=name, path=self.config.rootpath
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
        known = self.context.library().requirements
        names = {name for planned in self.context.plan for name in planned.requirements}
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
            item.context, item.planned = self.cases.context, self.planned
            item.add_marker(self.cases.markers[name])
            yield item


class ScenarioItem(pytest.Function):
    """Judges one requirement on all episodes of a case."""

    context: SessionContext
    planned: Planned

    def reportinfo(self) -> tuple[os.PathLike[str] | str, int | None, str]:
        """Where the scenario stands."""
        scenario = self.planned.case.scenario
        line = scenario.line_of("requirements") or 1
        return scenario.file, line - 1, self.nodeid


def scenario_items(context: SessionContext, root: pytest.Session) -> list[pytest.Item]:
    """The items of all planned cases."""
    cases = ScenarioCases.from_parent(
        root, name=_COLLECTOR, nodeid=_COLLECTOR, path=context.config.rootpath
    )
    cases.context = context
    return list(root.genitems(cases))


def _judge(request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner) -> None:
    """What each item runs, whose case and requirement it is that it asks for."""
    from pytest_dura.campaign.reasons import explain_verdict
    from pytest_dura.plugin.junit import ending_events
    from pytest_dura.plugin.outcomes import ItemResult

    context, planned = request.node.context, request.node.planned
    requirement = context.library().requirements[request.node.name]
    campaign = orchestrator.campaign(planned.case, requirement=requirement)
    try:
        verdict = campaign.judge(requirement)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    context.runner.on_verdict(verdict, requirement)
    if verdict.verdict == "supported":
        return
    lines = explain_verdict(verdict, requirement, campaign.failures)
    if verdict.counterexamples:
        item_result = ItemResult(requirement, planned.case, verdict=verdict.to_json())
        lines += [f"event:    {line}" for line in ending_events(context, item_result)]
        lines.append("replay:   " + replay_command(context, verdict.counterexamples[0].episode))
    lines.append("rerun:    " + rerun_command(context, f"{planned.case.id}::{requirement.id}"))
    message = "\n".join(lines)
    if verdict.verdict == "undecided" and context.options.warn_undecided:
        pytest.skip(message)
    pytest.fail(message, pytrace=False)
