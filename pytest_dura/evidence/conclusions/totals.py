"""Totals: counts that every format states, times of the episodes, their origins and redactions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry, episode_order
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.sessions import OriginCounts, resume_problems, shard_problems


class Totals(Conclusion):
    """Concludes what counts episodes in ``totals``, ``timings``, ``resume`` and ``redacted``.

    What the session's end adds to them, :func:`pytest_dura.evidence.conclude.complete` adds.
    """

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._validity: Counter[str] = Counter()
        self._simulated = 0.0
        self._processing: Counter[str] = Counter()
        self._taken_over: Counter[str] = Counter()
        self._outdated: Counter[tuple[str, ...]] = Counter()
        self._redactions: Counter[str] = Counter()
        self._trajectories: dict[tuple[str, tuple[str, int]], str] = {}
        self._last: Any = None
        self._ordered = True

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        self._validity[episode.validity] += 1
        if episode.origin.same_as is None:
            self._simulated += episode.timings.simulated_seconds
            self._processing.update(episode.timings.processing_seconds)
        if episode.origin.session is not None:
            self._taken_over[episode.origin.session] += 1
        elif episode.origin.changed is not None:
            self._outdated[tuple(episode.origin.changed)] += 1
        self._redactions += count_redactions(episode.to_json())

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield that an episode counts twice, stands in another place or is not that of a twin."""
        order = episode_order(episode)
        if self._last is not None and self._last > order and self._ordered:
            self._ordered = False
            yield "episodes: not in the order of case, component, run and seed"
        if self._last == order:
            yield f"episode {episode.id}: it is listed twice"
        self._last = order
        same, component = episode.origin.same_as, (episode.component, episode.seed)
        self._trajectories[episode.id, component] = episode.trajectory
        if same is not None and self._trajectories.get((same, component)) != episode.trajectory:
            yield f"episode {episode.id}: its trajectory is not that of {same}"

    def check_head(self) -> Iterator[str]:
        """Yield what the head cannot say of earlier sessions and of shards."""
        yield from resume_problems(self.head)
        yield from shard_problems(self.head)

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them."""
        seconds = {role: self._processing[role] for role in sorted(self._processing)}
        origins = OriginCounts.of(self._taken_over, self._outdated)
        validity = {name: self._validity[name] for name in ("valid", "invalid", "missing")}
        return {
            "totals": head.totals.replace(
                gate=head.gate.result,
                requirements=len(head.requirements),
                cases=len(head.cases),
                episodes=self._validity.total(),
                **validity,
                **verdict_counts(head.verdicts),
            ),
            "timings": head.timings.replace(
                simulated_seconds=self._simulated, processing_seconds=seconds
            ),
            "resume": head.resume.replace(**origins._asdict()),
            "redacted": dict(self._redactions),
        }


def verdict_counts(verdicts: Iterable[ItemVerdict]) -> dict[str, int]:
    """Count verdicts by status; ``waived`` ones also count under their own status."""
    known = list(verdicts)
    statuses = Counter(verdict.verdict for verdict in known)
    return {
        **{status: statuses[status] for status in ("supported", "violated", "undecided")},
        "waived": sum(verdict.waiver is not None for verdict in known),
    }
