"""SeededDefects: one item for each seeded defect, on which the gate of the session is run.

Every pytest run loads this module. What runs mutants is imported where a session asks for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from pytest_dura.guests import Guest, JudgedCase
from pytest_dura.options import unusable
from pytest_dura.qualification.options import QualificationOptions

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.evidence.model import Fact, RecordHead
    from pytest_dura.qualification.qualifying import AnyMutant, Gate, Qualification
    from pytest_dura.qualification.results import Qualified


@dataclass
class _SharedRuns:
    """Runs without a mutant, which the items of a process share."""

    gates: Sequence[Gate]
    runner: Runner | None = None
    qualification: Qualification | None = None

    def on(self, runner: Runner) -> Qualification:
        """Return the qualification, made at the first call with a runner."""
        from pytest_dura.qualification.qualifying import Qualification

        if self.qualification is None or self.runner is not runner:
            self.runner, self.qualification = runner, Qualification(runner, self.gates)
        return self.qualification


@dataclass(frozen=True)
class DefectItem:
    """Item that runs the gate on one mutant."""

    mutant: AnyMutant
    place: int
    shared: _SharedRuns

    @property
    def name(self) -> str:
        """Name of the mutant."""
        return self.mutant.name

    def waiting(self, problem: str) -> Fact:
        """Return the line of a mutant that was not run."""
        from pytest_dura.qualification.results import Qualified

        mutant = self.mutant
        return self._fact(
            Qualified(mutant.name, mutant.role, mutant.described, "not run", problem=problem)
        )

    def run(self, runner: Runner, later: Sequence[DefectItem]) -> str:
        """Run the gate on the mutant; it fails where no run came to an end."""
        from pytest_dura.campaign.events import FactEstablished

        qualification = self.shared.on(runner)
        if later:
            qualification.plan(each.mutant for each in later)
        result = qualification.qualify(self.mutant)
        fact = self._fact(result)
        runner.events.emit(FactEstablished(fact.table, fact.about, fact.order, fact.data))
        if result.status == "not run":
            return f"no run with {result.name} came to an end: {result.problem}"
        return ""

    def _fact(self, result: Qualified) -> Fact:
        from pytest_dura.core.codec import encode
        from pytest_dura.evidence.model import Fact
        from pytest_dura.qualification.results import NAME

        return Fact(NAME, result.name, self.place, encode(result))


class SeededDefects(Guest):
    """Qualification of the suite that a session runs."""

    options = QualificationOptions
    marker_arguments: ClassVar[Mapping[str, Any]] = MappingProxyType({"qualify": False})

    def items(
        self, planned: Iterable[JudgedCase], marked: Iterable[JudgedCase]
    ) -> Sequence[DefectItem]:
        """Return an item for each mutant that fits the plan, or the tests that ask for it."""
        asked = [case for case in marked if case.marker["qualify"]]
        gates = _gates([*(planned if self.given.qualifies else ()), *asked])
        if not gates and self.given.qualifies:
            row = QualificationOptions.switched_on
            raise unusable(
                f"{row.key} qualifies scenario cases, and the arguments name none",
                key=row.key,
                remedy="add --dura-scenarios, or mark a test on a campaign with dura(qualify=True)",
            )
        return _items(gates)

    def expected(self, planned: Iterable[JudgedCase]) -> Sequence[DefectItem]:
        """Return an item for each mutant that fits the plan."""
        return _items(_gates(planned)) if self.given.qualifies else ()

    def objections(self, head: RecordHead) -> Iterable[str]:
        """Yield what the demanded share does not let pass."""
        if self.given.at_least is None:
            return ()
        from pytest_dura.qualification.table import qualification_objections

        return qualification_objections(head, self.given.at_least)


def _items(gates: Sequence[Gate]) -> list[DefectItem]:
    """List an item for each mutant that fits these gates."""
    if not gates:
        return []
    from pytest_dura.qualification.qualifying import planned_mutants

    shared = _SharedRuns(gates)
    return [
        DefectItem(mutant, place, shared) for place, mutant in enumerate(planned_mutants(gates))
    ]


def _gates(cases: Iterable[JudgedCase]) -> list[Gate]:
    """List each case once, with what judges it by a check: test code cannot be run anew."""
    by_id: dict[str, tuple[Any, dict[str, Any]]] = {}
    for case, requirements, _ in cases:
        _, judges = by_id.setdefault(case.id, (case, {}))
        judges.update({each.id: each for each in requirements if each.check or each.paired})
    if not by_id:
        return []
    from pytest_dura.qualification.qualifying import Gate

    return [Gate(case, tuple(judges.values())) for case, judges in by_id.values() if judges]
