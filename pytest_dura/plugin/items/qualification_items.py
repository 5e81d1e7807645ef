"""Items of ``--dura-qualify``: one for each seeded defect, on which the gate is run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.items.markers import marked_requirements
from pytest_dura.plugin.items.outcomes import marked_target
from pytest_dura.plugin.items.scenario_items import AtRoot

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.evidence.lines import Line
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.qualification import AnyMutant, Gate, Qualification

_COLLECTOR = "qualification"
"""Before ``::`` and the mutant in the node ids of the items."""


class QualificationItems(pytest.Collector):
    """Collector of the items, which share the runs without a mutant."""

    context: SessionContext
    gates: Sequence[Gate]
    mutants: Sequence[AnyMutant]
    _shared: tuple[Runner, Qualification] | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """Yield one item for each mutant."""
        fixtures = None
        for place, mutant in enumerate(self.mutants):
            item = QualificationItem.from_parent(
                self, name=mutant.name, callobj=_qualify, fixtureinfo=fixtures
            )
            fixtures = item._fixtureinfo  # noqa: SLF001 - the same for all of them
            item.items, item.mutant, item.place = self, mutant, place
            yield item

    def qualification(self, runner: Runner) -> Qualification:
        """Return what all items of this process share, made at the first call."""
        from pytest_dura.qualification import Qualification

        if self._shared is None or self._shared[0] is not runner:
            self._shared = runner, Qualification(runner, self.gates)
        return self._shared[1]


class QualificationItem(AtRoot, pytest.Function):
    """Item that runs the gate on one mutant."""

    items: QualificationItems
    mutant: AnyMutant
    place: int

    def reportinfo(self) -> tuple[str, None, str]:
        """Return its name: it is of no file."""
        return _COLLECTOR, None, self.nodeid


def qualification_items(
    context: SessionContext, root: pytest.Session, items: Iterable[pytest.Item]
) -> list[pytest.Item]:
    """Collect the items, if the session qualifies its suite.

    Args:
        context: The session's context, with its plan.
        root: pytest's session.
        items: Tests of the session, whose markers may ask for it.

    Raises:
        pytest.UsageError: If there is nothing to qualify.
    """
    gates = _gates(context, items)
    if not gates:
        if context.options.qualifies:
            raise pytest.UsageError(
                "--dura-qualify qualifies scenario cases, and the arguments name none: add "
                "--dura-scenarios, or mark a test on a campaign with dura(qualify=True)"
            )
        return []
    from pytest_dura.qualification import planned_mutants

    parent = QualificationItems.from_parent(
        root, name=_COLLECTOR, nodeid=_COLLECTOR, path=context.config.rootpath
    )
    parent.context, parent.gates = context, gates
    parent.mutants = planned_mutants(gates)
    return list(root.genitems(parent))


def _gates(context: SessionContext, items: Iterable[pytest.Item]) -> list[Gate]:
    """List the planned cases with their requirements, and those of tests that ask for it."""
    from pytest_dura.qualification import Gate

    known = context.library().requirements if context.plan else {}
    asked = {}
    if context.options.qualifies:
        asked = {
            each.case.id: (each.case, dict.fromkeys(each.requirements)) for each in context.plan
        }
    for item in items:
        marker = item.get_closest_marker("dura")
        target = None if marker is None else marked_target(item, ["campaign"])
        if target is None or marker is None or not marker.kwargs.get("qualify", False):
            continue
        known = known or context.library().requirements
        _, names = asked.setdefault(target.case.id, (target.case, {}))
        names.update(dict.fromkeys(each.id for each in marked_requirements(context, item)))
    return [
        Gate(case, requirements)
        for case, names in asked.values()
        if (requirements := tuple(
            known[name] for name in names if name in known and _is_judged(known[name])
        ))
    ]  # fmt: skip


def _is_judged(requirement: object) -> bool:
    """Whether a requirement has a check of its own: what test code decides cannot be run anew."""
    return bool(getattr(requirement, "check", "") or getattr(requirement, "paired", None))


def expected_lines(context: SessionContext, chosen: Collection[str]) -> list[Line]:
    """Return what the record says of each mutant until its item has reported.

    Args:
        context: The session's context.
        chosen: Node ids of what will run.
    """
    from pytest_dura.core.codec import encode
    from pytest_dura.evidence.model import Fact
    from pytest_dura.qualification import NAME, Qualified, planned_mutants

    lines: list[Line] = []
    for place, mutant in enumerate(planned_mutants(_gates(context, ()))):
        runs = f"{_COLLECTOR}::{mutant.name}" in chosen
        problem = "its item never reported" if runs else "the session left it out"
        waiting = Qualified(mutant.name, mutant.role, mutant.described, "not run", problem=problem)
        lines.append(Fact(NAME, mutant.name, place, encode(waiting)))
    return lines


def _qualify(request: pytest.FixtureRequest, _dura_roles: None, dura_orchestrator: Runner) -> None:
    """Run the gate on the mutant of the item: the function that each item runs."""
    from pytest_dura.campaign.events import FactEstablished
    from pytest_dura.core.codec import encode
    from pytest_dura.qualification import NAME

    item: QualificationItem = request.node
    qualification = item.items.qualification(dura_orchestrator)
    if not item.items.context.is_worker:  # it does not know which items are its own
        items = item.session.items
        later = items[items.index(item) :]
        qualification.plan(each.mutant for each in later if isinstance(each, QualificationItem))
    try:
        result = qualification.qualify(item.mutant)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    fact = FactEstablished(NAME, result.name, item.place, encode(result))
    dura_orchestrator.events.emit(fact)
    if result.status == "not run":
        pytest.fail(f"no run with {result.name} came to an end: {result.problem}", pytrace=False)
