"""What the scenario items of a session are to decide, known before any of them runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.case_records import case_record
from pytest_dura.plugin.overrides import root_conftest_with

if TYPE_CHECKING:
    from pytest_dura.campaign.cases import Case
    from pytest_dura.plugin.session import DuraSession

Expected = tuple[str, dict[str, Any], dict[str, Any]]


def expected_items(session: DuraSession, chosen: Iterable[str]) -> list[Expected]:
    """Node id, requirement and case of each chosen scenario item, as the evidence holds them.

    There may be tens of thousands of cases: what many of them share is looked up once.

    Args:
        session: The session, with its plan.
        chosen: Node ids of what will run, also of other tests.
    """
    if not session.plan:
        return []
    wanted, requirements = set(chosen), session.library().requirements
    names = {name for planned in session.plan for name in planned.requirements}
    told = {name: requirements[name].to_json() for name in sorted(names)}
    component_of = _Components(session)
    found: list[Expected] = []
    for planned in session.plan:
        case = planned.case
        items = [(f"{case.id}::{name}", told[name]) for name in planned.requirements]
        items = [one for one in items if one[0] in wanted]
        if items:
            runs = session.options.runs or case.scenario.planned
            off = case.roles_off(session.roles.chosen())
            record = case_record(case, component_of(case), runs, session.options.runs, off)
            found += [(item, requirement, record) for item, requirement in items]
    return found


class _Components:
    """The names of the components under test, as far as they are known before anything runs."""

    def __init__(self, session: DuraSession) -> None:
        self._overrides = session.roles.chosen()
        self._in_conftest = root_conftest_with(session.config, "generator") is not None
        self._known: dict[tuple[str, tuple[str, ...]], str] = {}

    def __call__(self, case: Case) -> str:
        """That of a case; its faults make no difference."""
        if self._in_conftest:
            from pytest_dura.evidence.record.evidence_record import UNKNOWN

            return UNKNOWN
        key = case.scenario.name, case.without
        if key not in self._known:
            self._known[key] = case.roles(self._overrides)["generator"].label
        return self._known[key]
