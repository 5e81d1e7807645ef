"""One pass over the episodes: counts by case, and the few episodes that the report shows."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pytest_dura.evidence.formats.report.folding import Key, folded_cases
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]
MAX_LISTED = 1000
"""Episodes in the list."""
MAX_DOTS = 200
"""Runs of a case that are drawn one by one."""
UNREMARKABLE = 4
"""Rank of an episode of which there is nothing to tell."""
MAX_CANDIDATES = 36
"""Episodes among which those with a player are chosen; the traces of some may be damaged."""


@dataclass
class CaseTally:
    """What the episodes of a case with one component come to.

    Args:
        words: Of all episodes, those chosen by hand included, how many are valid, invalid, missing.
        times: Clearance times in s of the first valid planned runs that cleared.
        cleared: How many there are of these.
        outcomes: Of each fault, how many planned episodes came to which outcome.
    """

    words: Counter[str] = field(default_factory=Counter)
    times: list[float] = field(default_factory=list)
    cleared: int = 0
    outcomes: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def add(self, episode: Data) -> None:
        """Count one more episode."""
        self.words[episode["validity"]] += 1
        if not episode["planned"]:
            return
        for fault in episode["faults"]:
            self.outcomes[fault["id"]][fault["outcome"] or "not followed"] += 1
        time = episode["outcome"]["clearance_time"]
        if episode["validity"] == "valid" and time is not None:
            self.cleared += 1
            if len(self.times) < MAX_DOTS:
                self.times.append(time)


@dataclass(frozen=True)
class Listed:
    """An episode that the report shows.

    Args:
        rank: 0 for violating ones, then missing, invalid, remarkable, and unremarkable ones.
        index: Its place in the record.
        episode: Its record without specification, metrics and all events but the critical one.
        violates: Ids of the requirements that it violated.
    """

    rank: int
    index: int
    episode: Data
    violates: tuple[str, ...]

    @property
    def key(self) -> Key:
        """Id and component."""
        return self.episode["id"], self.episode["component"]


@dataclass
class Gathered:
    """All that the report says of single episodes, bounded whatever their number.

    Args:
        cases: By case id and component, in the order in which they were met.
        listed: The first by rank, then in the record's order.
        total: Episodes in the record.
        candidates: Episodes with a trace, those that show most first.
        folded: Cases that passed and have no rows of their own; see :func:`folded_cases`.
    """

    cases: dict[Key, CaseTally]
    listed: list[Listed]
    total: int
    candidates: list[Listed]
    folded: frozenset[Key]

    @classmethod
    def of(cls, record: SessionRecord) -> Gathered:
        """Read the record's episodes once."""
        violating = violations_by_episode(record)
        wanted = {key: place for place, key in enumerate(_worst_in_turn(record))}
        cases: dict[Key, CaseTally] = {}
        listed: list[tuple[int, int, Listed]] = []
        candidates: list[tuple[int, int, Listed]] = []
        sampled: Counter[Key] = Counter()
        total = 0
        for index, episode in enumerate(record.episodes()):
            total += 1
            cases.setdefault((episode["case"], episode["component"]), CaseTally()).add(episode)
            # A verdict rests on planned episodes; one run by hand may bear the same id.
            key = episode["id"], episode["component"]
            violates = tuple(violating.get(key, ())) if episode["planned"] else ()
            shown = Listed(_rank(episode, violates), index, _brief(episode), violates)
            _keep(listed, shown.rank, shown, MAX_LISTED)
            if episode["trace"] is not None:
                turn = wanted.get(key)
                if turn is None:
                    # One of each case after all that violate something, then a second one...
                    of_case = episode["case"], episode["component"]
                    turn = len(wanted) + sampled[of_case]
                    sampled[of_case] += 1
                _keep(candidates, turn, shown, MAX_CANDIDATES)
        return cls(cases, _in_order(listed), total, _in_order(candidates), folded_cases(record))


def violations_by_episode(record: SessionRecord) -> dict[Key, list[str]]:
    """Requirements that each episode violated, by its id and component."""
    found: dict[Key, list[str]] = {}
    for verdict in record["verdicts"]:
        for one in verdict["counterexamples"]:
            told = found.setdefault((one["episode"], verdict["component"]), [])
            if verdict["requirement"] not in told:
                told.append(verdict["requirement"])
    return found


def _worst_in_turn(record: SessionRecord) -> Iterator[Key]:
    """The worst counterexample of each verdict, then each one's second, and so on."""
    seen: set[Key] = set()
    for place in range(MAX_CANDIDATES):
        for verdict in record["verdicts"]:
            if place < len(verdict["counterexamples"]):
                key = verdict["counterexamples"][place]["episode"], verdict["component"]
                if key not in seen:
                    seen.add(key)
                    yield key


def _rank(episode: Data, violates: tuple[str, ...]) -> int:
    if violates:
        return 0
    if episode["validity"] != "valid":
        return 1 if episode["validity"] == "missing" else 2
    outcome = episode["outcome"]
    marked = outcome["flagged"] or outcome["collided"] or outcome["gridlock"]
    return UNREMARKABLE - 1 if marked else UNREMARKABLE


_KEPT = (
    "id", "case", "component", "seed", "planned", "validity", "invalid_reason", "failure",
    "termination", "digest", "trace", "outcome",
)  # fmt: skip


def _brief(episode: Data) -> Data:
    """What is shown of an episode: a thousand whole records would take much memory."""
    critical = [one["detail"] for one in episode["events"] if one["kind"] == "critical"]
    kept = {key: episode[key] for key in _KEPT}
    return {**kept, "run": episode["spec"]["run"], "critical": critical[0] if critical else ""}


def _keep(heap: list[tuple[int, int, Listed]], rank: int, shown: Listed, most: int) -> None:
    """Keep the ``most`` lowest ranks, the earlier of equals."""
    entry = -rank, -shown.index, shown
    if len(heap) < most:
        heapq.heappush(heap, entry)
    elif entry[:2] > heap[0][:2]:
        heapq.heapreplace(heap, entry)


def _in_order(heap: list[tuple[int, int, Listed]]) -> list[Listed]:
    return [shown for _, _, shown in sorted(heap, key=lambda entry: (-entry[0], -entry[1]))]
