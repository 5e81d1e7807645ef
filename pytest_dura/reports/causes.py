"""Causes: what happened in a session that did not pass, one card for each.

Verdicts that are not supported are many where one thing went wrong: a collision violates four
requirements in a dozen episodes. Violations of one episode are one cause; episodes of a case in
which the same event stands before the same violation share it, and so do runs of one seed, and all
in which the component failed by itself in the same way. Undecided verdicts are put together by
their reason; those that an event of a violation's episode leaves undecided belong to that cause.
Report, summary and terminal begin with the causes, the worst first.

Texts are bounded and printable; each format still has to escape them.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.baseline import regression_objections
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.incidents import (
    KINDS,
    OWN_FAILURE,
    EpisodeKey,
    Episodes,
    Incident,
    TwinOutcome,
    Violation,
    amount_text,
    event_clause,
    own_failure_key,
    own_failure_step,
    twin_outcomes,
    what_happened,
)
from pytest_dura.reports.next_steps import next_step
from pytest_dura.reports.undecided import Obstacle, obstacle_of, own_failures_text
from pytest_dura.reports.wording import is_incomplete
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.model import Requirement

_STATUSES = ("violated", "incomplete", "undecided")


class Judged(Protocol):
    """Verdicts and what their causes rest on: the head of a record, or an item that has ended."""

    @property
    def verdicts(self) -> Sequence[ItemVerdict]:
        """The verdicts."""

    @property
    def requirements(self) -> Sequence[Requirement]:
        """All that they are on."""

    @property
    def cases(self) -> Sequence[CaseEntry]:
        """The cases, among them those of twins."""

    @property
    def measures(self) -> Sequence[MeasureInfo]:
        """The figures that simulators declare."""

    @property
    def units(self) -> Mapping[str, str] | None:
        """Units of signals, by name."""


@dataclass(frozen=True)
class Finding:
    """A requirement that a cause explains, and by how much it is missed.

    Args:
        requirement: The requirement.
        verdict: The worst of its verdicts that the cause explains.
        check: What judged it.
        amount: By how much it was missed in the worst episode, in units, and when; empty where
            neither is known.
    """

    requirement: Requirement
    verdict: ItemVerdict
    check: str
    amount: str = ""

    @property
    def is_violated(self) -> bool:
        """Whether any run violates it."""
        return bool(self.verdict.violations or self.verdict.without_effect)


@dataclass(frozen=True)
class Cause:
    """One thing that went wrong, and all verdicts that it explains.

    Args:
        status: ``violated``, ``undecided`` or ``incomplete``.
        kind: The gravest kind of its requirements; empty without any.
        happened: One sentence of what happened; by how much it misses which requirement, its
            findings say.
        findings: Its requirements, the gravest first.
        case: Id of the case; empty for a session that is incomplete.
        component: Name of the component under test.
        episode: The worst counterexample, or else a run that spoils the verdict.
        more: Other episodes of the same cause.
        time: When its worst requirement was violated first, in s.
        twins: What the runs of the same seed did that lack the faults or a role.
        next_step: What to look at next.
        verdicts: Those that it explains.
    """

    status: str
    kind: str
    happened: str
    findings: tuple[Finding, ...]
    case: str
    component: str
    episode: str | None
    more: tuple[str, ...]
    time: float | None
    twins: tuple[TwinOutcome, ...]
    next_step: str
    verdicts: tuple[ItemVerdict, ...]

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """Its requirements, the gravest first."""
        return tuple(finding.requirement for finding in self.findings)

    @property
    def waived(self) -> bool:
        """Whether each of its verdicts is excused."""
        return bool(self.verdicts) and all(each.waiver is not None for each in self.verdicts)

    @property
    def valid(self) -> bool:
        """Whether its episode is valid; false where a planned fault was without effect."""
        return not any(
            each.episode == self.episode and not each.valid
            for verdict in self.verdicts
            for each in verdict.counterexamples
        )

    @property
    def cases(self) -> tuple[str, ...]:
        """Ids of all cases that it shows in."""
        return tuple(dict.fromkeys(verdict.case for verdict in self.verdicts))


def causes_of(record: SessionRecord) -> list[Cause]:
    """Put what is not supported together by its causes, the worst first.

    Reads the episodes once, and not at all where every verdict is supported.

    Args:
        record: Of a session.
    """
    causes = [*_incomplete(record), *causes_of_verdicts(record.head, record.episodes)]
    return sorted(causes, key=_badness)


def causes_of_verdicts(
    judged: Judged, episodes: Callable[[], Iterable[EpisodeEntry]]
) -> list[Cause]:
    """Put verdicts that are not supported together by their causes.

    Args:
        judged: The verdicts.
        episodes: Returns the episodes that they may name; called where one is not supported.
    """
    failures = [each for each in judged.verdicts if each.verdict != "supported"]
    if not failures:
        return []
    return _Causes(judged, Episodes.read(judged.cases, judged.measures, episodes(), failures)).all()


def card_heading(cause: Cause) -> str:
    """Heading of a cause's card: its status, kind, case and component, and what excuses it."""
    status = "worse" if cause.status == "incomplete" and cause.case else cause.status
    parts = [f"{status}: {cause.kind or 'the session'}"]
    if cause.case:
        rest = len(cause.cases) - 1
        more = f" and {counted(rest, 'more case', 'more cases')}" if rest > 0 else ""
        parts.append(f"on {name(cause.case)}{more} ({name(cause.component)})")
    if cause.waived:
        kinds = dict.fromkeys(each.waiver.kind for each in cause.verdicts if each.waiver)
        parts.append(f"[{', '.join(kinds)}]")
    return " ".join(parts)


def _badness(cause: Cause) -> tuple[bool, int, int, int]:
    kind = KINDS.index(cause.kind) if cause.kind else 0
    return cause.waived, _STATUSES.index(cause.status), kind, -len(cause.requirements)


class _Causes:
    """Makes the causes of a record's verdicts.

    Args:
        judged: The verdicts.
        episodes: Those that they name.
    """

    def __init__(self, judged: Judged, episodes: Episodes) -> None:
        self._judged, self._episodes = judged, episodes
        self._requirements = {each.id: each for each in judged.requirements}

    def all(self) -> list[Cause]:
        """Causes of violated verdicts, and then of the undecided ones that they do not explain."""
        groups = _clusters(self._incidents().values())
        causes = [self._of_incidents(group) for group in groups]
        places: dict[tuple[str, str], int] = {}
        for place, group in enumerate(groups):
            for incident in group:
                places.setdefault((incident.component, incident.episode), place)
                places.setdefault((incident.component, incident.signature), place)
        for verdict in self._judged.verdicts:
            if verdict.verdict == "violated" and not verdict.counterexamples:
                reason = one_line(f"{name(verdict.requirement)}: {verdict.reason}.")
                step = "Look at the test that judges it: no episode of the record shows it."
                causes.append(self._of_verdicts("violated", reason, [verdict], step))
        for obstacle, verdicts in self._obstacles():
            key = verdicts[0].component, obstacle.cause or obstacle.episode or ""
            if (obstacle.cause or obstacle.shows_event) and key in places:
                place = places[key]
                causes[place] = self._joined(causes[place], verdicts)
            else:
                causes.append(self._of_obstacle(obstacle, verdicts, places))
                failed = self._episodes.raised[verdicts[0].case, verdicts[0].component].event
                if failed is not None:  # one card tells of it
                    own = verdicts[0].component, own_failure_key(failed)
                    places.setdefault(own, len(causes) - 1)
        return causes

    def _incidents(self) -> dict[EpisodeKey, Incident]:
        incidents: dict[EpisodeKey, Incident] = {}
        for verdict in self._judged.verdicts:
            for counterexample in verdict.counterexamples if verdict.verdict == "violated" else ():
                key = counterexample.episode, verdict.component
                incident = incidents.setdefault(key, Incident(*key, self._episodes.get(*key)))
                requirement = self._requirements[verdict.requirement]
                incident.violations.append(Violation(requirement, verdict, counterexample))
        return incidents

    def _obstacles(self) -> Iterator[tuple[Obstacle, list[ItemVerdict]]]:
        """Undecided verdicts by the reason that they share; the first of a group speaks for it."""
        groups: dict[tuple[str, str], tuple[Obstacle, list[ItemVerdict]]] = {}
        undecided = [each for each in self._judged.verdicts if each.verdict == "undecided"]
        for verdict in sorted(undecided, key=lambda each: -each.violations / max(1, each.episodes)):
            failures = self._episodes.raised[verdict.case, verdict.component]
            obstacle = obstacle_of(verdict, self._requirements[verdict.requirement], failures)
            groups.setdefault((verdict.component, obstacle.key), (obstacle, []))[1].append(verdict)
        yield from groups.values()

    def _of_incidents(self, group: Sequence[Incident]) -> Cause:
        """The cause of a group of incidents, the worst of them first."""
        incident = group[0]
        worst, brief = incident.worst, incident.brief
        violations = sorted(
            (each for member in group for each in member.violations),
            key=lambda violation: violation.badness[:2],
        )
        verdicts = {
            (each.verdict.requirement, each.verdict.case): each.verdict for each in violations
        }
        worst_by_id: dict[str, Violation] = {}
        for each in violations:
            worst_by_id.setdefault(each.requirement.id, each)
        # What the worst episode violates is shown by the amount of that episode.
        worst_by_id |= {each.requirement.id: each for each in incident.violations}
        findings = {own: self._violated(each) for own, each in worst_by_id.items()}
        twins = tuple(twin_outcomes(self._episodes, incident))
        time = worst.counterexample.time
        happened = "No record of the episode is held."
        if brief is not None:
            happened = what_happened(brief, incident.event, time=time)
        if often := self._how_often(incident):
            happened = f"{happened.removesuffix('.')}, {often}."
        return Cause(
            status="violated",
            kind=worst.requirement.kind,
            happened=happened,
            findings=tuple(findings.values()),
            case=worst.verdict.case,
            component=incident.component,
            episode=incident.episode,
            more=tuple(member.episode for member in group[1:]),
            time=time,
            twins=twins,
            next_step=next_step(incident, twins),
            verdicts=tuple(verdicts.values()),
        )

    def _how_often(self, incident: Incident) -> str:
        """That the component failed by itself in each run of the case; else empty."""
        event = incident.event
        failures = self._episodes.raised.get((incident.worst.verdict.case, incident.component))
        if event is None or event.kind != OWN_FAILURE or failures is None:
            return ""
        return f"in {failures.failed} of {counted(failures.runs, 'run')}"

    def _violated(self, violation: Violation) -> Finding:
        verdict, example = violation.verdict, violation.counterexample
        requirement, judged_by = violation.requirement, self._judged
        check = verdict.check or requirement.check
        judged = replace(requirement, paired=verdict.paired or requirement.paired)
        units, measures = judged_by.units or {}, judged_by.measures
        amount = amount_text(
            judged, check, example.margin, example.time, units=units, measures=measures
        )
        brief = self._episodes.get(example.episode, verdict.component)
        if brief is not None and is_function_path(check):  # a formula's detail is the amount again
            amount = ": ".join(filter(None, [amount, brief.details.get(requirement.id, "")]))
        return Finding(requirement, verdict, check, amount)

    def _finding(self, verdict: ItemVerdict) -> Finding:
        """What a verdict that is not violated says; by how much its worst run misses it."""
        requirement = self._requirements[verdict.requirement]
        if verdict.counterexamples:
            return self._violated(Violation(requirement, verdict, verdict.counterexamples[0]))
        return Finding(requirement, verdict, verdict.check or requirement.check)

    def _joined(self, cause: Cause, verdicts: Sequence[ItemVerdict]) -> Cause:
        """A cause with verdicts that it leaves undecided."""
        known = {finding.requirement.id for finding in cause.findings}
        added = {
            each.requirement: self._finding(each)
            for each in verdicts
            if each.requirement not in known
        }
        gravest = sorted(added.values(), key=lambda each: KINDS.index(each.requirement.kind))
        return replace(
            cause,
            findings=(*cause.findings, *gravest),
            verdicts=(*cause.verdicts, *verdicts),
        )

    def _of_obstacle(
        self, obstacle: Obstacle, verdicts: Sequence[ItemVerdict], known: Container[tuple[str, str]]
    ) -> Cause:
        """The cause of undecided verdicts that no violation explains.

        Args:
            obstacle: Why they are undecided.
            verdicts: At least one.
            known: Components and their own failures of which a cause tells.
        """
        text, component = obstacle.headline, verdicts[0].component
        brief = self._episodes.get(obstacle.episode or "", component)
        shown = brief.grave if brief is not None and obstacle.shows_event else None
        if brief is not None and shown is not None:
            text += f": {event_clause(shown, brief)}"
        elif len(verdicts) > 1 and not obstacle.cause:
            one = len({each.requirement for each in verdicts}) == 1
            places = {each.case for each in verdicts}
            what = "cases" if one and len(places) == len(verdicts) else "verdicts"
            text += f" (the worst of {len(verdicts)} {what})"
        step, episode = obstacle.next_step, obstacle.episode
        for verdict in verdicts[:1] if not obstacle.cause else ():
            # What a component raised comes before everything that more runs would show.
            failures = self._episodes.raised[verdict.case, component]
            event = failures.event
            if event is not None and (component, own_failure_key(event)) not in known:
                if shown is None or shown.kind != OWN_FAILURE:
                    text += f"; {own_failures_text(verdict, failures)}"
                step = own_failure_step(name(component), event.detail)
                episode = failures.episode
        return self._of_verdicts("undecided", f"{text}.", verdicts, step, episode)

    def _of_verdicts(
        self,
        status: str,
        happened: str,
        verdicts: Sequence[ItemVerdict],
        next_step: str,
        episode: str | None = None,
    ) -> Cause:
        """A cause that rests on verdicts and no event."""
        ordered = sorted(
            verdicts,
            key=lambda each: (
                each.waiver is not None,
                KINDS.index(self._requirements[each.requirement].kind),
            ),
        )
        findings = {each.requirement: self._finding(each) for each in reversed(ordered)}
        first = self._finding(ordered[0])
        return Cause(
            status=status,
            kind=first.requirement.kind,
            happened=happened,
            findings=tuple(dict.fromkeys(findings[each.requirement] for each in ordered)),
            case=first.verdict.case,
            component=first.verdict.component,
            episode=episode,
            more=(),
            time=None,
            twins=(),
            next_step=next_step,
            verdicts=tuple(ordered),
        )


def _clusters(incidents: Iterable[Incident]) -> list[list[Incident]]:
    """Groups of incidents with one cause, each with its worst incident first."""
    groups: list[list[Incident]] = []
    by_explained: dict[tuple[str, str, str, str], list[Incident]] = {}
    by_seed: dict[tuple[str, int, str], list[Incident]] = {}
    own_failures: dict[tuple[str, str], list[Incident]] = {}
    for incident in sorted(incidents, key=lambda incident: incident.rank):
        component, signature = incident.component, incident.signature
        group = None
        if incident.brief is not None:
            group = by_seed.get((component, incident.brief.seed, signature))
        if incident.event is not None and incident.event.kind == OWN_FAILURE:
            group = own_failures.get((component, signature))
        if group is None:
            # One that violates no more than a worse one with the same event has its cause.
            candidates = [
                by_explained.get((component, signature, *key)) for key in incident.verdict_keys
            ]
            group = next(
                (
                    known
                    for known in candidates
                    if known is not None
                    and (
                        incident.worst.requirement is known[0].worst.requirement
                        or incident.verdict_keys <= known[0].verdict_keys
                    )
                ),
                None,
            )
        if group is None:
            group = []
            groups.append(group)
        group.append(incident)
        own_failures.setdefault((component, signature), group)
        for key in incident.verdict_keys:
            by_explained.setdefault((component, signature, *key), group)
        if incident.brief is not None:
            by_seed.setdefault((component, incident.brief.seed, signature), group)
    return groups


def _incomplete(record: SessionRecord) -> Iterator[Cause]:
    """What stands against the session beside its verdicts."""
    head = record.head
    if is_incomplete(record):
        planned = sum(case.planned for case in head.cases if not case.without)
        run = sum(case.metrics.run for case in head.cases if not case.without)
        how = {"running": "was killed", "interrupted": "was interrupted"}.get(
            head.status, "did not come to its end"
        )
        yield _session_cause(
            f"The session {how} after {run} of {planned} planned episodes.",
            "Run it again with --dura-resume: the episodes that it has simulated are taken over.",
        )
    losses = _losses(record)
    for objection in other_objections(head):
        yield losses.get(objection) or _session_cause(
            f"{one_line(objection)}.", _objection_step(objection)
        )


def _losses(record: SessionRecord) -> dict[str, Cause]:
    """Causes of what got worse than in the baseline, by the objection that it makes."""
    baseline = record.head.baseline
    if baseline is None:
        return {}
    kinds = {each.id: each.kind for each in record.head.requirements}
    worse = [each for each in baseline.comparisons if each.status == "worse"]
    causes = {}
    for each, objection in zip(worse, regression_objections(baseline), strict=False):
        now = f"{each.violations} of {counted(each.episodes or 0, 'run')}"
        then = f"{each.baseline_violations} of {each.baseline_episodes} of the baseline"
        p_value = each.p_worse if each.p_worse_holm is None else each.p_worse_holm
        headline = (
            f"{name(each.requirement)} is violated in {now}, and in {then}: p = {p_value or 0:.2g} "
            f"by the exact test of {each.test}, corrected for "
            f"{counted(baseline.tests, 'comparison')}."
        )
        step = (
            f"Compare a run that violates it now with that of its seed in {name(baseline.path)}"
            "; where the loss is meant, make this session the baseline."
        )
        cause = _session_cause(headline, step)
        causes[objection] = replace(
            cause, kind=kinds.get(each.requirement, "safety"), case=each.case,
            component=each.component or "",
        )  # fmt: skip
    return causes


def _objection_step(objection: str) -> str:
    if objection.startswith("not repeatable"):
        return (
            "Look for what is not drawn from the episode's seed: clocks, global generators, order "
            "of sets, threads."
        )
    return "Mend it, and run the session again."


def _session_cause(happened: str, next_step: str) -> Cause:
    return Cause(
        status="incomplete", kind="", happened=happened, findings=(), case="", component="",
        episode=None, more=(), time=None, twins=(), next_step=next_step, verdicts=(),
    )  # fmt: skip
