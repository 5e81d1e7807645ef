"""Coverage: what was tried of the requirements, scenarios and faults that there are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from typing import Any, Literal, TypeAlias

from pytest_dura.evidence.case_model import CasePlan, CellEntry, CoverageEntry
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.conclusions.operating_domain import CombinationCoverage, ParameterCoverage
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead
from pytest_dura.requirements.campaign_verdicts import CampaignStatus

Place: TypeAlias = "tuple[str, str, str, str]"
"""Scenario, faults, requirement and component."""

MAX_CELLS = 20_000
"""Number of untested cells up to which all are listed."""
NO_FAULTS = "none"
WORST_FIRST = ("violated", "undecided", "supported")


class Coverage(Conclusion):
    """Concludes the key ``coverage``.

    ``cells`` are requirement x scenario x faults, for each component: each scenario of the session
    with each set of faults that occurs anywhere in the session, and with none. A requirement has a
    cell where it applies: where the scenario lists it, or a test claims it there. ``verdict`` is
    the worst on that cell and ``None`` where there is none: untested. ``case`` is the id of the
    case that tests it. Cases without a role, the second runs of pairs, are no cells, as nothing is
    claimed of them. Of more than :data:`MAX_CELLS` untested cells one is listed for each
    requirement and scenario, so that none of these reads as tested throughout; ``left_out`` counts
    the others.

    Args:
        head: With its cases.
    """

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._parameters = ParameterCoverage(head.cases)
        self._combinations = CombinationCoverage(head.cases)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        self._parameters.add(episode)
        self._combinations.add(episode)

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude it from the cases and verdicts."""
        return {"coverage": self.entry(head.cases, head.verdicts)}

    def entry(self, cases: Sequence[CasePlan], verdicts: Iterable[ItemVerdict]) -> CoverageEntry:
        """Conclude it from some cases and verdicts."""
        grid = _Grid(cases, verdicts)
        untested = grid.untested_count()
        shown = list(grid.untested(None if untested <= MAX_CELLS else 1))
        cells = map(grid.cell, (*grid.statuses, *shown))
        return CoverageEntry(
            cells=sorted(cells, key=attrgetter("scenario", "faults", "requirement", "component")),
            left_out=untested - len(shown),
            parameters=self._parameters.entries(),
            combinations=self._combinations.entry(),
        )


class _Grid:
    """Requirements, scenarios and sets of faults of a session, and the verdicts on them.

    Args:
        cases: The record's cases.
        verdicts: The record's verdicts.
    """

    def __init__(self, cases: Sequence[CasePlan], verdicts: Iterable[ItemVerdict]) -> None:
        whole = [case for case in cases if not case.without]
        self.components = sorted({case.component for case in whole})
        self.faults = sorted({"", *map(faults_of, whole)})
        self.ids: dict[tuple[str, str], str] = {}
        """Ids of cases, by scenario and faults."""
        self.applies: dict[tuple[str, str], Literal["scenario", "test"]] = {}
        """Where each requirement is declared, by scenario and requirement."""
        by_id: dict[str, CasePlan] = {}
        for case in whole:
            scenario, by_id[case.id] = case.scenario, case
            self.ids[scenario, faults_of(case)] = case.id
            for requirement in case.requirements:
                self.applies[scenario, requirement] = "scenario"
        self.statuses: dict[Place, CampaignStatus] = {}
        """The worst verdict at each place."""
        for verdict in verdicts:
            if verdict.case not in by_id:
                continue
            case = by_id[verdict.case]
            place = case.scenario, faults_of(case)
            self.applies.setdefault((place[0], verdict.requirement), "test")
            key = *place, verdict.requirement, verdict.component
            candidates = self.statuses.get(key, verdict.verdict), verdict.verdict
            self.statuses[key] = min(candidates, key=WORST_FIRST.index)

    def untested_count(self) -> int:
        """Count what :meth:`untested` yields, which may be millions, without iterating."""
        known = set(self.components)
        judged = sum(component in known for *_, component in self.statuses)
        return len(self.applies) * len(self.faults) * len(known) - judged

    def untested(self, most: int | None = None) -> Iterator[Place]:
        """Yield the places where a requirement applies and has no verdict.

        Args:
            most: How many of each scenario and requirement; default: all.
        """
        for scenario, requirement in self.applies:
            places = (
                (scenario, faults, requirement, component)
                for faults in self.faults
                for component in self.components
            )
            yield from islice((place for place in places if place not in self.statuses), most)

    def cell(self, place: Place) -> CellEntry:
        """Build the cell of a place, with the id of the case, also of one that was not run."""
        scenario, faults, requirement, component = place
        return CellEntry(
            requirement=requirement,
            scenario=scenario,
            faults=faults,
            component=component,
            case=self.ids.get((scenario, faults), f"{scenario}+{faults or NO_FAULTS}"),
            applies=self.applies[scenario, requirement],
            verdict=self.statuses.get(place),
        )


def faults_of(case: CasePlan) -> str:
    """Join the ids of a case's faults as in case ids; empty without any."""
    return "+".join(str(fault.id) for fault in case.faults)
