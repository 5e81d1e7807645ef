"""Conclusions of a record: whatever follows from its cases, episodes and verdicts.

Coverage of requirements and parameters, effectiveness of recovery and monitors, missing
runs, timings, redactions and totals. All of it is computed in passes over the episodes,
by the session that writes the record and again to verify it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any, TypeAlias

from pytest_dura.evidence.case_model import CaseEntry, CasePlan
from pytest_dura.evidence.conclusions.verdicts import Runs, VerdictLines, conclude_verdicts
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import Gate
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.metrics import (
    CaseMetrics,
    PooledMetrics,
    SharedViolations,
    case_order,
    missing_runs,
    verdicts_on_cases,
)
from pytest_dura.evidence.model import SessionRecord, Totals
from pytest_dura.evidence.operating_domain import CombinationCoverage, ParameterCoverage
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.search_model import searched_claims
from pytest_dura.evidence.session_model import InputEntry
from pytest_dura.evidence.sessions import origin_counts
from pytest_dura.evidence.verdict_model import MonitorEntry
from pytest_dura.requirements.pairs import PairTable

Place: TypeAlias = "tuple[str, str, str, str]"
"""Scenario, faults, requirement and component."""

MAX_CELLS = 20_000
"""Number of untested cells up to which all are listed."""
NO_FAULTS = "none"
WORST_FIRST = ("violated", "undecided", "supported")


def coverage(
    cases: Sequence[CasePlan],
    verdicts: Sequence[ItemVerdict],
    episodes: Iterable[EpisodeEntry],
) -> dict[str, Any]:
    """Compute the record's key ``coverage``.

    ``cells`` are requirement x scenario x faults, for each component: each scenario of the session
    with each set of faults that occurs anywhere in the session, and with none. A requirement has a
    cell where it applies: where the scenario lists it, or a test claims it there. ``verdict`` is
    the worst on that cell and ``None`` where there is none: untested. ``case`` is the id of the
    case that tests it. Cases without a role, the second runs of pairs, are no cells, as nothing is
    claimed of them. Of more than :data:`MAX_CELLS` untested cells one is listed for each
    requirement and scenario, so that none of these reads as tested throughout; ``left_out`` counts
    the others.

    Args:
        cases: The record's cases.
        verdicts: The record's verdicts.
        episodes: The record's episodes.
    """
    grid = _Grid(cases, verdicts)
    untested = grid.untested_count()
    shown = list(grid.untested() if untested <= MAX_CELLS else grid.first_untested())
    parameters, combinations = ParameterCoverage(cases), CombinationCoverage(cases)
    for episode in episodes:
        for counted in (parameters, combinations):
            counted.add(episode)
    cells = map(grid.cell, (*grid.statuses, *shown))
    return {
        "cells": sorted(cells, key=itemgetter("scenario", "faults", "requirement", "component")),
        "left_out": untested - len(shown),
        "parameters": parameters.to_json(),
        **combinations.to_json(),
    }


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
        self.applies: dict[tuple[str, str], str] = {}
        """Where each requirement is declared, by scenario and requirement."""
        by_id: dict[str, CasePlan] = {}
        for case in whole:
            scenario, by_id[case.id] = case.scenario, case
            self.ids[scenario, faults_of(case)] = case.id
            for requirement in case.requirements:
                self.applies[scenario, requirement] = "scenario"
        self.statuses: dict[Place, str] = {}
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

    def untested(self) -> Iterator[Place]:
        """Yield the places where a requirement applies and has no verdict."""
        for scenario, requirement in self.applies:
            for faults in self.faults:
                for component in self.components:
                    place = scenario, faults, requirement, component
                    if place not in self.statuses:
                        yield place

    def first_untested(self) -> Iterator[Place]:
        """Yield the first untested place of each scenario and requirement that has any."""
        for scenario, requirement in self.applies:
            places = (
                (scenario, faults, requirement, component)
                for faults in self.faults
                for component in self.components
            )
            untested = next((place for place in places if place not in self.statuses), None)
            if untested is not None:
                yield untested

    def cell(self, place: Place) -> dict[str, Any]:
        """Build the cell of a place."""
        scenario, faults, requirement, component = place
        return {
            "requirement": requirement,
            "scenario": scenario,
            "faults": faults,
            "component": component,
            "case": self._case(scenario, faults),
            "applies": self.applies[scenario, requirement],
            "verdict": self.statuses.get(place),
        }

    def _case(self, scenario: str, faults: str) -> str:
        """Id of the case, also of one that was not run."""
        return self.ids.get((scenario, faults), f"{scenario}+{faults or NO_FAULTS}")


def faults_of(case: CasePlan) -> str:
    """Join the ids of a case's faults as in case ids; empty without any."""
    return "+".join(str(fault.id) for fault in case.faults)


Key = tuple[str, str, int]
"""Case, component and run."""

RECOVERY_ROLE = "recovery_planner"
_SUMS = ("only_with", "only_without", "both", "neither", "acted_only_with", "acted_only_without",
         "acted_both", "acted_neither")  # fmt: skip


class PairedCourses:
    """Compares the runs in which recovery acted with their twins without it.

    Runs are equal if their performance values have the same least, greatest and last value, and
    they took the same time. Decisions are left out: they differ wherever recovery acts.
    """

    def __init__(self, verdicts: Iterable[ItemVerdict]) -> None:
        pairs = (
            (verdict.pairs.case, verdict.case, verdict.component)
            for verdict in verdicts
            if verdict.pairs and verdict.pairs.without == RECOVERY_ROLE
        )
        self._twins = {(twin, who): (own, who) for twin, own, who in pairs}
        self._own = set(self._twins.values())
        self._acted: dict[Key, int] = {}
        self._without: dict[Key, int] = {}

    def add(self, episode: EpisodeEntry) -> None:
        """Add a planned episode of the record."""
        key = episode.case, episode.component
        if episode.validity != "valid" or not episode.metrics.performance:
            return
        run = episode.spec.run
        if key in self._own and episode.outcome.switching.takeovers:
            self._acted[key[0], key[1], run] = _course(episode)
        elif (own := self._twins.get(key)) is not None:
            self._without[own[0], own[1], run] = _course(episode)

    def compared(self, component: str, cases: set[str]) -> tuple[int, int]:
        """Count the runs in which recovery acted and that have a twin, and those equal to it."""
        pairs = [
            (course, self._without[key])
            for key, course in self._acted.items()
            if key[0] in cases and key[1] == component and key in self._without
        ]
        return len(pairs), sum(
            with_recovery == without_recovery for with_recovery, without_recovery in pairs
        )


def _course(episode: EpisodeEntry) -> int:
    """Hash the course of a run."""
    values = {
        name: (spread.last, spread.min, spread.max)
        for name, spread in episode.metrics.performance.items()
        if name != "response_time"
    }
    return hash((episode.timings.simulated_seconds, tuple(sorted(values.items()))))


def effectiveness(
    verdicts: Sequence[ItemVerdict], monitors: Sequence[MonitorEntry], courses: PairedCourses
) -> list[dict[str, Any]]:
    """Compute the record's key ``effectiveness``: recovery first, then each monitor, by name."""
    return [*_recovery_effects(verdicts, courses), *_monitor_effects(monitors)]


def _recovery_effects(
    verdicts: Sequence[ItemVerdict], courses: PairedCourses
) -> Iterator[dict[str, Any]]:
    sums: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    cases: dict[tuple[str, str], set[str]] = defaultdict(set)
    for verdict in verdicts:
        pairs = verdict.pairs
        if isinstance(pairs, PairTable) and pairs.without == RECOVERY_ROLE:
            key = verdict.component, verdict.requirement
            if verdict.case not in cases[key]:  # several tests may ask the same of a case
                cases[key].add(verdict.case)
                sums[key].update({name: getattr(pairs, name) for name in _SUMS})
    for (component, requirement), counts in sorted(sums.items()):
        runs = courses.compared(component, cases[component, requirement])
        finding, detail = _recovery_finding(requirement, counts, runs)
        yield _entry(RECOVERY_ROLE, component, requirement, finding, detail)


def _recovery_finding(
    requirement: str, counts: Mapping[str, int], courses: tuple[int, int]
) -> tuple[str, str]:
    acted_runs, unchanged = courses
    pairs = sum(counts[name] for name in ("only_with", "only_without", "both", "neither"))
    violated = counts["only_without"] + counts["both"]
    prevented, introduced = counts["only_without"], counts["only_with"]
    what = f"of {violated} violations of {requirement} without it in {pairs} pairs"
    if acted_runs and unchanged == acted_runs:
        also = "" if violated else f"; nothing violated {requirement} without it either"
        text = f"changed nothing: the runs in which it acted ({acted_runs}) went as their twins"
        return "changed nothing", text + also
    if introduced and not prevented:
        return "introduced", f"introduced {introduced} violations and prevented none {what}"
    if not violated:
        detail = (
            f"cannot be told here: none of {pairs} runs without it violated {requirement}, so that "
            "there was nothing to prevent"
        )
        return "cannot be told", detail
    if prevented:
        more = f", introduced {introduced}" if introduced else ", introduced none"
        return "prevented", f"prevented {prevented} {what}{more}"
    if counts["acted_both"]:
        return "prevented none", f"prevented none {what}, and acted in {counts['acted_both']}"
    return "never acted", f"acted in none {what}"


def _monitor_effects(monitors: Sequence[MonitorEntry]) -> Iterator[dict[str, Any]]:
    by_target: dict[tuple[str, str], dict[str, Counter[str]]] = defaultdict(dict)
    for quality in monitors:
        targets = by_target[quality.component, quality.monitor]
        sums = targets.setdefault(quality.target, Counter())
        names = ("true_positives", "false_negatives", "false_positives", "true_negatives")
        sums.update({name: getattr(quality, name) for name in names})
    for (component, monitor), targets in sorted(by_target.items()):
        finding, detail = _monitor_finding(targets)
        # An assessor speaks by alerts, which are judged as a monitor of their own.
        if monitor == "security_assessor" and finding in ("silent", "cannot be told"):
            continue
        yield _entry(monitor, component, None, finding, detail)


def _monitor_finding(targets: Mapping[str, Counter[str]]) -> tuple[str, str]:
    warnings = {
        name: (counted["true_positives"], counted["true_positives"] + counted["false_negatives"])
        for name, counted in sorted(targets.items())
    }
    happened = {name: counts for name, counts in warnings.items() if counts[1]}
    if not happened:
        detail = (
            "cannot be told here: nothing that it is to warn of happened in runs without recovery "
            f"({', '.join(warnings)})"
        )
        return "cannot be told", detail
    in_words = ", ".join(f"{name} {hits} of {of}" for name, (hits, of) in happened.items())
    if any(hits for hits, _ in happened.values()):
        return "warned", f"warned in time of {in_words}"
    if any(target["false_positives"] for target in targets.values()):
        return "warned of none", f"flagged other runs, and warned of none: {in_words}"
    return "silent", f"was silent in time: {in_words}"


def _entry(
    role: str, component: str, requirement: str | None, finding: str, detail: str
) -> dict[str, Any]:
    return {
        "role": role, "component": component, "requirement": requirement, "finding": finding,
        "detail": detail,
    }  # fmt: skip


def with_verdicts(record: SessionRecord) -> SessionRecord:
    """Add the verdicts that follow from a record's judgements and episodes.

    Args:
        record: With its cases, requirements, judgements, waivers, doubts and searches.
    """
    head = record.head
    cases = {(case.id, case.component): case for case in head.cases}
    requirements = {requirement.id: requirement for requirement in head.requirements}
    lines = VerdictLines(
        head.judgements,
        cases,
        requirements,
        head.waivers,
        {key: case.repeat for key, case in cases.items()},
        {(doubt.case, doubt.component): doubt.reason for doubt in head.doubts},
        searched_claims(head.searches),
    )
    runs = Runs(cases, requirements)
    for episode in record.episodes():
        runs.add(episode)
    return record.changed(verdicts=conclude_verdicts(lines, runs))


def measure_cases(record: SessionRecord) -> SessionRecord:
    """Add what follows from the planned episodes to a record.

    These are metrics and missing runs of cases, ``also_without`` of verdicts, ``overall`` and
    ``effectiveness``.

    Args:
        record: With its verdicts, its monitors, and its cases in any order.
    """
    verdicts = record.head.verdicts
    cases: Sequence[CaseEntry] = sorted(record.head.cases, key=case_order)
    shared, courses = SharedViolations(verdicts), PairedCourses(verdicts)
    pooled = PooledMetrics(cases, verdicts)
    metrics = {(case.id, case.component): CaseMetrics() for case in cases}
    reported: dict[tuple[str, str], set[int]] = {key: set() for key in metrics}
    for episode in record.episodes():
        key = episode.case, episode.component
        if episode.planned and key in metrics:
            metrics[key].add(episode)
            reported[key].add(episode.spec.run)
            for summary in (pooled, shared, courses):
                summary.add(episode)
    judged = verdicts_on_cases(verdicts)
    measured = [
        case.replace(
            metrics=metrics[key].to_json(case.planned),
            **missing_runs(case, judged.get(key, []), reported[key]),
        )
        for key, case in zip(metrics, cases, strict=True)
    ]
    counts = zip(verdicts, shared.to_json(), strict=True)
    return record.changed(
        cases=measured,
        verdicts=[replace(verdict, also_without=count) for verdict, count in counts],
        overall=pooled.to_json(),
        effectiveness=effectiveness(verdicts, record.head.monitors, courses),
    )


def timings(
    episodes: Iterable[EpisodeEntry], *, wall_seconds: float, evidence_seconds: float
) -> dict[str, Any]:
    """Sum up the times of the recorded episodes.

    Args:
        episodes: Of the record.
        wall_seconds: From the start of the session until the record was complete.
        evidence_seconds: Part of them that the controller spent on gathering the evidence; traces
            are written where the episodes run, and rendering follows.
    """
    simulated, processing = 0.0, Counter[str]()
    for episode in episodes:
        simulated += episode.timings.simulated_seconds
        processing.update(episode.timings.processing_seconds)
    return {
        "wall_seconds": wall_seconds,
        "evidence_seconds": evidence_seconds,
        "simulated_seconds": simulated,
        "processing_seconds": {role: processing[role] for role in sorted(processing)},
    }


def verdict_counts(verdicts: Iterable[ItemVerdict]) -> dict[str, int]:
    """Count verdicts by status; ``waived`` ones also count under their own status."""
    known = list(verdicts)
    statuses = Counter(verdict.verdict for verdict in known)
    return {
        **{status: statuses[status] for status in ("supported", "violated", "undecided")},
        "waived": sum(verdict.waiver is not None for verdict in known),
    }


def totals(record: SessionRecord) -> Totals:
    """Compute the record's key ``totals``, which every format states."""
    head = record.head
    validity = Counter(episode.validity for episode in record.episodes())
    return Totals(
        gate=head.gate.result,
        requirements=len(head.requirements),
        cases=len(head.cases),
        episodes=validity.total(),
        valid=validity["valid"],
        invalid=validity["invalid"],
        missing=validity["missing"],
        **verdict_counts(head.verdicts),
    )


_AFTERWARDS = ("redacted", "totals")
"""Keys that are added after redactions are counted."""


def conclude_record(
    record: SessionRecord,
    *,
    finished: str | None,
    gate: Gate,
    inputs: Sequence[InputEntry | JsonObject],
    wall_seconds: float,
    evidence_seconds: float,
    redact: Callable[[Any], Any],
) -> SessionRecord:
    """Complete a record with gate, inputs, reuse, coverage, timings, redactions and totals.

    Args:
        record: Of :meth:`RecordBuilder.record`.
        finished: When the session ended, in ISO 8601; ``None`` as long as it runs.
        gate: Whether the session passed.
        inputs: Every input file, with its digest.
        wall_seconds: From the session's start until now.
        evidence_seconds: Part of them that was spent on gathering the evidence.
        redact: Removes secrets from plain data; episodes lost theirs where they were run.
    """
    origins = origin_counts(episode.origin for episode in record.episodes())
    whole = record.changed(
        finished=finished,
        gate=gate,
        inputs=inputs,
        reuse=record.head.reuse.replace(**origins._asdict()),
        coverage=coverage(record.head.cases, record.head.verdicts, record.episodes()),
        timings=timings(
            record.episodes(), wall_seconds=wall_seconds, evidence_seconds=evidence_seconds
        ),
    )
    head = redact(whole.head.to_json())
    redactions = count_redactions({key: head[key] for key in head if key not in _AFTERWARDS})
    for episode in record.episodes():
        redactions += count_redactions(episode.to_json())
    concluded = record.changed(**{**head, "redacted": dict(sorted(redactions.items()))})
    return concluded.changed(totals=totals(concluded))
