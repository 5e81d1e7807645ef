"""Causes: what happened in a session that did not pass, one card for each.

Verdicts that are not supported are many where one thing went wrong: a collision violates four
requirements in a dozen episodes. Violations of one episode are one cause; episodes of a case in
which the same event stands before the same violation share it, and so do runs of one seed.
Undecided verdicts are put together by their reason. Report, summary, terminal, Allure and JUnit
begin with the causes, the worst first.

Texts are bounded and printable; each format still has to escape them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.incidents import (
    KINDS,
    EpisodeKey,
    Episodes,
    Incident,
    TwinOutcome,
    Violation,
    event_clause,
    headline,
    twin_outcomes,
)
from pytest_dura.reports.next_steps import next_step
from pytest_dura.reports.undecided import Obstacle, obstacle_of
from pytest_dura.reports.verdicts import as_sentence
from pytest_dura.reports.wording import (
    evidence_option,
    is_incomplete,
    model_options,
    names_text,
    replay_command,
)
from pytest_dura.requirements.campaign_verdicts import violation_text
from pytest_dura.requirements.model import Requirement

_STATUSES = ("violated", "incomplete", "undecided")


@dataclass(frozen=True)
class Cause:
    """One thing that went wrong, and all verdicts that it explains.

    Args:
        status: ``violated``, ``undecided`` or ``incomplete``.
        kind: The gravest kind of its requirements; empty without any.
        headline: One sentence of what happened.
        requirements: The gravest first.
        case: Id of the case; empty for a session that is incomplete.
        component: Name of the component under test.
        episode: The worst counterexample, or else a run that spoils the verdict.
        more: Other episodes of the same cause.
        time: When its worst requirement was violated first, in s.
        margin: By how much, negative, in the unit of its check.
        check: What was judged.
        twins: What the runs of the same seed did that lack the faults or a role.
        replay: A command to type; empty where there is nothing to replay.
        next_step: What to look at next.
        verdicts: Those that it explains.
    """

    status: str
    kind: str
    headline: str
    requirements: tuple[Requirement, ...]
    case: str
    component: str
    episode: str | None
    more: tuple[str, ...]
    time: float | None
    margin: float | None
    check: str
    twins: tuple[TwinOutcome, ...]
    replay: str
    next_step: str
    verdicts: tuple[ItemVerdict, ...]

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
    requirements = {each.id: each for each in record.head.requirements}
    causes = [*_incomplete(record)]
    failures = [each for each in record.head.verdicts if each.verdict != "supported"]
    if failures:
        episodes = Episodes.read(record, failures)
        causes += _violated(record, episodes, requirements)
        causes += _undecided(record, episodes, requirements)
    return sorted(causes, key=_badness)


def card_heading(cause: Cause) -> str:
    """Heading of a cause's card: its status, kind, case and component, and what excuses it."""
    parts = [f"{cause.status}: {cause.kind or 'the session'}"]
    if cause.case:
        rest = len(cause.cases) - 1
        more = f" and {counted(rest, 'more case', 'more cases')}" if rest > 0 else ""
        parts.append(f"on {name(cause.case)}{more} ({name(cause.component)})")
    if cause.waived:
        kinds = dict.fromkeys(each.waiver.kind for each in cause.verdicts if each.waiver)
        parts.append(f"[{', '.join(kinds)}]")
    return " ".join(parts)


def card_entries(cause: Cause) -> Iterator[tuple[str, str]]:
    """Labels and texts of a cause's card, below its heading and its headline, for every format."""
    if cause.requirements:
        first, *rest = cause.requirements
        also = f" Also {names_text([each.id for each in rest])}." if rest else ""
        yield "required", f"{name(first.id)}: {as_sentence(first.text)}{also}"
    assertion = cause.verdicts[0].assertion if cause.verdicts else None
    failed = assertion.failed if assertion is not None else ()
    for failure in failed[:1]:
        yield "failed", one_line(f"{failure.message}, in {failure.episode}")
    # Where the check held, what failed is an assertion of the test.
    judged = not failed or (assertion is not None and assertion.by_check)
    if judged and cause.check and cause.check != cause.verdicts[0].requirement:
        yield "check", one_line(cause.check)
    if cause.episode is not None:
        when = ""
        if cause.status == "violated":
            when = violation_text(cause.time, cause.margin, valid=cause.valid)
        runs = [f"#{each.rpartition('#')[2]}" for each in cause.more]
        more = f"; also {names_text(runs)}" if runs else ""
        yield "episode", f"{name(cause.episode)}{when}{more}"
    for twin in cause.twins:
        yield "twin", twin.sentence
    if cause.replay:
        yield "replay", cause.replay
    yield "next", cause.next_step


def _badness(cause: Cause) -> tuple[bool, int, int, int]:
    kind = KINDS.index(cause.kind) if cause.kind else 0
    return cause.waived, _STATUSES.index(cause.status), kind, -len(cause.requirements)


def _violated(
    record: SessionRecord, episodes: Episodes, requirements: Mapping[str, Requirement]
) -> Iterator[Cause]:
    """Causes of violated verdicts."""
    incidents: dict[EpisodeKey, Incident] = {}
    without_episode: list[ItemVerdict] = []
    for verdict in record.head.verdicts:
        if verdict.verdict != "violated":
            continue
        if not verdict.counterexamples:
            without_episode.append(verdict)
        for counterexample in verdict.counterexamples:
            key = counterexample.episode, verdict.component
            incident = incidents.setdefault(key, Incident(*key, episodes.get(*key)))
            violation = Violation(requirements[verdict.requirement], verdict, counterexample)
            incident.violations.append(violation)
    for group in _clusters(incidents.values()):
        yield _violated_cause(record, episodes, group)
    for verdict in without_episode:
        yield _cause(
            record,
            "violated",
            one_line(f"{name(verdict.requirement)}: {verdict.reason}."),
            [verdict],
            requirements,
            next_step="Look at the test that judges it: no episode of the record shows it.",
        )


def _clusters(incidents: Iterable[Incident]) -> list[list[Incident]]:
    """Groups of incidents with one cause, each with its worst incident first."""
    groups: list[list[Incident]] = []
    by_explained: dict[tuple[str, str, str, str], list[Incident]] = {}
    by_seed: dict[tuple[str, int, str], list[Incident]] = {}
    for incident in sorted(incidents, key=lambda incident: incident.rank):
        component, signature = incident.component, incident.signature
        group = None
        if incident.brief is not None:
            group = by_seed.get((component, incident.brief.seed, signature))
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
        for key in incident.verdict_keys:
            by_explained.setdefault((component, signature, *key), group)
        if incident.brief is not None:
            by_seed.setdefault((component, incident.brief.seed, signature), group)
    return groups


def _violated_cause(record: SessionRecord, episodes: Episodes, group: Sequence[Incident]) -> Cause:
    """The cause of a group of incidents, the worst of them first."""
    incident = group[0]
    worst = incident.worst
    violations = sorted(
        (each for member in group for each in member.violations),
        key=lambda violation: violation.badness[:2],
    )
    verdicts = {(each.verdict.requirement, each.verdict.case): each.verdict for each in violations}
    twins = tuple(twin_outcomes(episodes, incident))
    command = record.head.command
    return Cause(
        status="violated",
        kind=worst.requirement.kind,
        headline=headline(incident),
        requirements=tuple({each.requirement.id: each.requirement for each in violations}.values()),
        case=worst.verdict.case,
        component=incident.component,
        episode=incident.episode,
        more=tuple(member.episode for member in group[1:]),
        time=worst.counterexample.time,
        margin=worst.counterexample.margin,
        check=worst.verdict.check or worst.requirement.check,
        twins=twins,
        replay=replay_command(incident.episode, evidence_option(command), model_options(command)),
        next_step=next_step(incident, twins),
        verdicts=tuple(verdicts.values()),
    )


def _undecided(
    record: SessionRecord, episodes: Episodes, requirements: Mapping[str, Requirement]
) -> Iterator[Cause]:
    """Causes of undecided verdicts, one for each reason."""
    groups: dict[tuple[str, str], tuple[Obstacle, list[ItemVerdict]]] = {}
    undecided = [each for each in record.head.verdicts if each.verdict == "undecided"]
    # The first of a group speaks for it.
    for verdict in sorted(undecided, key=lambda each: -each.violations / max(1, each.episodes)):
        obstacle = obstacle_of(verdict, requirements[verdict.requirement])
        key = verdict.component, obstacle.key
        groups.setdefault(key, (obstacle, []))[1].append(verdict)
    for obstacle, verdicts in groups.values():
        text = obstacle.headline
        brief = episodes.get(obstacle.episode or "", verdicts[0].component)
        if brief is not None and brief.grave is not None and obstacle.shows_event:
            text += f": {event_clause(brief.grave, brief)}"
        elif len(verdicts) > 1:
            names = names_text(list(dict.fromkeys(each.requirement for each in verdicts)))
            text += f" (the worst of {len(verdicts)} verdicts: {names})"
        yield _cause(
            record,
            "undecided",
            f"{text}.",
            verdicts,
            requirements,
            next_step=obstacle.next_step,
            episode=obstacle.episode,
        )


def _cause(
    record: SessionRecord,
    status: str,
    headline: str,
    verdicts: Sequence[ItemVerdict],
    requirements: Mapping[str, Requirement],
    *,
    next_step: str,
    episode: str | None = None,
) -> Cause:
    """A cause that rests on verdicts and no event."""
    ordered = sorted(
        verdicts,
        key=lambda each: (
            each.waiver is not None,
            KINDS.index(requirements[each.requirement].kind),
        ),
    )
    first, command = ordered[0], record.head.command
    options = evidence_option(command), model_options(command)
    return Cause(
        status=status,
        kind=requirements[first.requirement].kind,
        headline=headline,
        requirements=tuple(
            {each.requirement: requirements[each.requirement] for each in ordered}.values()
        ),
        case=first.case,
        component=first.component,
        episode=episode,
        more=(),
        time=None,
        margin=first.margin,
        check=first.check or requirements[first.requirement].check,
        twins=(),
        replay="" if episode is None else replay_command(episode, *options),
        next_step=next_step,
        verdicts=tuple(ordered),
    )


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
    for objection in other_objections(head):
        yield _session_cause(f"{one_line(objection)}.", _objection_step(objection))


def _objection_step(objection: str) -> str:
    if objection.startswith("not repeatable"):
        return (
            "Look for what is not drawn from the episode's seed: clocks, global generators, order "
            "of sets, threads."
        )
    return "Mend it, and run the session again."


def _session_cause(headline: str, next_step: str) -> Cause:
    return Cause(
        "incomplete", "", headline, (), "", "", None, (), None, None, "", (), "", next_step, ()
    )
