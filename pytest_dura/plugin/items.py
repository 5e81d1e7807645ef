"""Scenario items: one per case and requirement, such as ``intersection/nominal::SAF-1``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.commands import replay_command, rerun_command
from pytest_dura.plugin.session import session_of

if TYPE_CHECKING:
    import os

    from pytest_dura.campaign.runner import Bench
    from pytest_dura.plugin.planning import Planned
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.requirements.model import Requirement


class ScenarioCase(pytest.Collector):
    """Collects the items of one case. It is no file: ``--lf`` would pass over it."""

    planned: Planned

    def collect(self) -> Iterator[pytest.Item]:
        """One item per requirement."""
        session = session_of(self.config)
        for name in self.planned.requirements:
            requirement = session.library().requirements[name]
            item = ScenarioItem.from_parent(
                self, name=name, callobj=_judging(session, self.planned, requirement)
            )
            item.planned = self.planned
            item.add_marker(pytest.mark.requirement(name, text=requirement.text))
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
    items: list[pytest.Item] = []
    for planned in session.plan:
        name = planned.case.id
        # The root's path lets the root conftest apply, wherever the scenario file lies.
        collector: ScenarioCase = ScenarioCase.from_parent(
            root, name=name, nodeid=name, path=session.config.rootpath
        )
        collector.planned = planned
        items += root.genitems(collector)
    return items


def _judging(
    session: DuraSession, planned: Planned, requirement: Requirement
) -> Callable[..., None]:
    def judge(_dura_roles: None, orchestrator: Bench) -> None:
        from pytest_dura.campaign.reasons import reasons

        campaign = orchestrator.campaign(planned.case, requirement=requirement)
        try:
            verdict = campaign.judge(requirement)
        except ConfigurationError as error:
            raise pytest.fail.Exception(str(error), pytrace=False) from None
        session.reporter.verdict_reached(verdict, requirement)
        if verdict.verdict == "supported":
            return
        lines = reasons(verdict, requirement, campaign.failures)
        if verdict.counterexamples:
            lines.append("replay:   " + replay_command(session, verdict.counterexamples[0].episode))
        lines.append("rerun:    " + rerun_command(session, f"{planned.case.id}::{requirement.id}"))
        message = "\n".join(lines)
        if verdict.verdict == "undecided" and session.options.warn_undecided:
            pytest.skip(message)
        pytest.fail(message, pytrace=False)

    return judge
