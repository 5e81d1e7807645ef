"""Contents of the report: which cases and episodes it shows, their anchors, links and counts.

Other formats point at the anchors with ``report.html#...``. Of many cases that passed the
report shows some, and counts the rest.
"""

from __future__ import annotations

import hashlib
import heapq
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from pytest_dura.evidence.case_model import (
    CaseEntry,
    CellEntry,
    ShareEntry,
)
from pytest_dura.evidence.episode_model import EpisodeEntry, OutcomeEntry, TraceEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead, SessionRecord

_MAX_READABLE = 80
"""Readable characters of an anchor."""


def requirement_anchor(requirement: str) -> str:
    """Anchor of a requirement and its verdicts; the report has each requirement of the record."""
    return anchor("requirement", requirement)


def verdict_anchor(requirement: str, case: str) -> str:
    """Anchor of the first verdict on a requirement and a case.

    The report has it for each such pair, unless the case is folded; see :func:`folded_cases`.
    """
    return anchor("verdict", requirement, case)


def case_anchor(case: str) -> str:
    """Anchor of a case; the report has each case that is not folded."""
    return anchor("case", case)


def episode_anchor(episode: str, component: str) -> str:
    """Anchor of an episode in the list, which is bounded: of many episodes not all are there."""
    return anchor("episode", episode, component)


def player_anchor(episode: str, component: str) -> str:
    """Anchor of an episode's player; a bounded number of episodes has one."""
    return anchor("player", episode, component)


@lru_cache(maxsize=65_536)
def anchor(kind: str, *parts: str) -> str:
    """An anchor of letters, digits, dots and dashes, whatever the parts hold.

    Two lists of parts that differ never have the same one: a short hash tells them apart, where
    the readable text leaves anything out.
    """
    text = "-".join(part[:_MAX_READABLE] for part in parts)
    readable = re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-")[:_MAX_READABLE]
    if len(parts) == 1 and readable == parts[0]:
        return f"{kind}-{readable}"
    joined = "\0".join(parts).encode("utf-8", "surrogatepass")
    return f"{kind}-{readable}-{hashlib.sha256(joined).hexdigest()[:10]}"


CaseKey = tuple[str, str]
"""Id of a case, and the component's name."""
_Row = TypeVar("_Row")


def case_key(case: CaseEntry) -> CaseKey:
    """Key of a case."""
    return case.id, case.component


def verdict_key(verdict: ItemVerdict | CellEntry) -> CaseKey:
    """Key of the case that a verdict is on."""
    return verdict.case, verdict.component


def faults_by_case(record: SessionRecord) -> Mapping[CaseKey, Sequence[str]]:
    """Ids of the faults of each case."""
    return {case_key(case): [fault.id for fault in case.faults] for case in record.head.cases}


_MAX_CHOICES = 200
"""Faults that a filter offers; its text finds others."""


def fault_names(record: SessionRecord, folded: Collection[CaseKey]) -> list[str]:
    """Ids of the first faults by name, to choose from, but those of folded cases alone."""
    cases = [case for case in record.head.cases if case_key(case) not in folded]
    return sorted({fault.id for case in cases for fault in case.faults})[:_MAX_CHOICES]


MAX_PLAIN_CASES = 1000
"""Cases without anything to report that have rows of their own."""


def folded_cases(head: RecordHead) -> frozenset[CaseKey]:
    """The cases that have no rows of their own, by id and component: the last of too many.

    Only cases without anything to report are folded: each of their requirements is judged, and
    supported at the first attempt without a waiver or any violation; every planned episode was run
    and is valid, and no grave measure is true of it. Whatever else is there is
    shown, however much it is.
    """
    judged: dict[CaseKey, list[ItemVerdict]] = defaultdict(list)
    for verdict in head.verdicts:
        judged[verdict_key(verdict)].append(verdict)
    grave = [measure.name for measure in head.measures if measure.severity == "grave"]
    plain = [
        key for case in head.cases if _is_plain(case, judged.get(key := case_key(case), []), grave)
    ]
    return frozenset(plain[MAX_PLAIN_CASES:])


def split_folded(
    rows: Iterable[_Row], folded: frozenset[CaseKey], key: Callable[[_Row], CaseKey]
) -> tuple[list[_Row], list[_Row]]:
    """Rows that are shown, and those of folded cases.

    Args:
        rows: Of any kind.
        folded: Of :func:`folded_cases`.
        key: Returns the case of a row.
    """
    shown: list[_Row] = []
    rest: list[_Row] = []
    for row in rows:
        (rest if key(row) in folded else shown).append(row)
    return shown, rest


def _is_plain(case: CaseEntry, verdicts: list[ItemVerdict], grave: Iterable[str]) -> bool:
    metrics = case.metrics
    raised = [metrics.measures.get(name) for name in grave]
    missing_runs_total = case.missing_runs_total or metrics.invalid or metrics.missing
    if missing_runs_total or any(isinstance(rate, ShareEntry) and rate.run for rate in raised):
        return False
    if case.without:  # a reference arm, the verdicts stand on the case it belongs to
        return not verdicts
    names = {verdict.requirement for verdict in verdicts}
    return bool(verdicts) and names.issuperset(case.requirements) and all(map(_passed, verdicts))


def _passed(verdict: ItemVerdict) -> bool:
    against = (
        verdict.violations, verdict.open, verdict.without_effect, verdict.invalid, verdict.missing,
        verdict.waiver, verdict.attempts, verdict.counterexamples,
    )  # fmt: skip
    return verdict.verdict == "supported" and not any(against)


MAX_LISTED = 1000
"""Episodes in the list."""
UNREMARKABLE = 4
"""Rank of a valid episode without a violation, a flag or a notable measure."""
_MAX_CANDIDATES = 36
"""Episodes among which those with a player are chosen; the traces of some may be damaged."""


@dataclass(frozen=True)
class BriefEpisode:
    """The part of an episode that is shown: a thousand whole entries would take much memory."""

    id: str
    case: str
    component: str
    seed: int
    run: int
    planned: bool
    validity: str
    invalid_reason: str | None
    failure: str | None
    critical: str
    """What the critical event says; empty without one."""
    termination: str
    digest: str
    trace: TraceEntry | None
    outcome: OutcomeEntry

    @classmethod
    def of(cls, episode: EpisodeEntry) -> BriefEpisode:
        """Take this part of an entry."""
        critical = (event.detail for event in episode.events if event.kind == "critical")
        return cls(
            id=episode.id,
            case=episode.case,
            component=episode.component,
            seed=episode.seed,
            run=episode.spec.run,
            planned=episode.planned,
            validity=episode.validity,
            invalid_reason=episode.invalid_reason,
            failure=episode.failure,
            critical=next(critical, ""),
            termination=episode.termination,
            digest=episode.digest,
            trace=episode.trace,
            outcome=episode.outcome,
        )


@dataclass(frozen=True)
class ListedEpisode:
    """An episode that the report shows.

    Args:
        rank: 0 for violating ones, then missing, invalid, remarkable, and unremarkable ones.
        index: Its place in the record.
        episode: What is shown of it.
        violates: Ids of the requirements that it violated.
    """

    rank: int
    index: int
    episode: BriefEpisode
    violates: tuple[str, ...]

    @property
    def key(self) -> CaseKey:
        """Id and component."""
        return self.episode.id, self.episode.component


@dataclass
class ReportContents:
    """Single episodes that the report shows, bounded whatever their number.

    Args:
        cases: How many episodes of each case and component are valid, invalid and missing, those
            run by hand included; in the order in which they were met.
        listed: The first by rank, then in the record's order.
        candidates: Episodes with a trace, those that show most first.
        folded: Cases that passed and have no rows of their own; see :func:`folded_cases`.
    """

    cases: dict[CaseKey, Counter[str]]
    listed: list[ListedEpisode]
    candidates: list[ListedEpisode]
    folded: frozenset[CaseKey]

    @classmethod
    def of(cls, record: SessionRecord, first: Iterable[CaseKey] = ()) -> ReportContents:
        """Read the record's episodes once.

        Args:
            record: The record.
            first: Episodes that come first among the candidates, by id and component.
        """
        violating = _violations_by_episode(record)
        notable = {each.name for each in record.head.measures if each.severity != "none"}
        wanted = dict.fromkeys([*first, *_worst_in_turn(record)])
        turns = {key: place for place, key in enumerate(wanted)}
        cases: dict[CaseKey, Counter[str]] = {}
        listed: list[tuple[int, int, ListedEpisode]] = []
        candidates: list[tuple[int, int, ListedEpisode]] = []
        sampled: Counter[CaseKey] = Counter()
        for index, episode in enumerate(record.episodes()):
            cases.setdefault((episode.case, episode.component), Counter())[episode.validity] += 1
            # A verdict rests on planned episodes; one run by hand may bear the same id.
            key = episode.id, episode.component
            violates = tuple(violating.get(key, ())) if episode.planned else ()
            shown = ListedEpisode(
                _rank(episode, violates, notable), index, BriefEpisode.of(episode), violates
            )
            _keep_lowest(listed, shown.rank, shown, MAX_LISTED)
            if episode.trace is not None:
                turn = turns.get(key)
                if turn is None:
                    # One of each case after all that violate something, then a second one...
                    of_case = episode.case, episode.component
                    turn = len(turns) + sampled[of_case]
                    sampled[of_case] += 1
                _keep_lowest(candidates, turn, shown, _MAX_CANDIDATES)
        return cls(cases, _in_order(listed), _in_order(candidates), folded_cases(record.head))


def _violations_by_episode(record: SessionRecord) -> dict[CaseKey, list[str]]:
    """Requirements that each episode violated, by its id and component."""
    violations: dict[CaseKey, list[str]] = {}
    for verdict in record.head.verdicts:
        for counterexample in verdict.counterexamples:
            requirements = violations.setdefault((counterexample.episode, verdict.component), [])
            if verdict.requirement not in requirements:
                requirements.append(verdict.requirement)
    return violations


def _worst_in_turn(record: SessionRecord) -> Iterator[CaseKey]:
    """The worst counterexample of each verdict, then each one's second, and so on."""
    seen: set[CaseKey] = set()
    for place in range(_MAX_CANDIDATES):
        for verdict in record.head.verdicts:
            if place < len(verdict.counterexamples):
                key = verdict.counterexamples[place].episode, verdict.component
                if key not in seen:
                    seen.add(key)
                    yield key


def _rank(episode: EpisodeEntry, violates: tuple[str, ...], notable: Collection[str]) -> int:
    if violates:
        return 0
    if episode.validity != "valid":
        return 1 if episode.validity == "missing" else 2
    outcome = episode.outcome
    raised = {name for name, value in outcome.measures.items() if value is True}
    marked = outcome.flagged or not raised.isdisjoint(notable)
    return UNREMARKABLE - 1 if marked else UNREMARKABLE


def _keep_lowest(
    heap: list[tuple[int, int, ListedEpisode]], rank: int, shown: ListedEpisode, most: int
) -> None:
    """Keep the ``most`` lowest ranks, the earlier of equals."""
    entry = -rank, -shown.index, shown
    if len(heap) < most:
        heapq.heappush(heap, entry)
    elif entry[:2] > heap[0][:2]:
        heapq.heapreplace(heap, entry)


def _in_order(heap: list[tuple[int, int, ListedEpisode]]) -> list[ListedEpisode]:
    return [shown for _, _, shown in sorted(heap, key=lambda entry: (-entry[0], -entry[1]))]


def row_anchors(head: RecordHead, folded: Collection[CaseKey]) -> frozenset[str]:
    """List the anchors of requirements, and of cases and verdicts that are not folded."""
    return frozenset(
        [requirement_anchor(requirement.id) for requirement in head.requirements]
        + [case_anchor(case.id) for case in head.cases if case_key(case) not in folded]
        + [
            verdict_anchor(verdict.requirement, verdict.case)
            for verdict in head.verdicts
            if verdict_key(verdict) not in folded
        ]
    )


@dataclass(frozen=True)
class EpisodeLinks:
    """Anchors of what is shown.

    Args:
        players: Of episodes with a player, by id and component.
        listed: Of episodes in the list, by id and component.
        rows: Of requirements, cases and verdicts.
    """

    players: dict[CaseKey, str]
    listed: dict[CaseKey, str]
    rows: frozenset[str]

    @classmethod
    def of(
        cls, record: SessionRecord, contents: ReportContents, players: Collection[CaseKey]
    ) -> EpisodeLinks:
        """List the anchors of the page."""
        return cls(
            {key: player_anchor(*key) for key in players},
            {episode.key: episode_anchor(*episode.key) for episode in contents.listed},
            row_anchors(record.head, contents.folded),
        )

    def known(self, anchor: str) -> str | None:
        """Return the anchor of a requirement, case or verdict if it is there.

        A record may name some that it does not list.
        """
        return anchor if anchor in self.rows else None

    def of_episode(self, episode: str, component: str) -> str | None:
        """The anchor of its player or else of its row; ``None`` where it has neither."""
        key = episode, component
        return self.players.get(key) or self.listed.get(key)
