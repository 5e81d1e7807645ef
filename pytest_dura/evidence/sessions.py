"""Work shared between sessions: episodes taken over from earlier ones, and shards of a whole."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from typing import Any, NamedTuple

from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episode_model import OriginEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.session_model import (
    EarlierSession,
    OutdatedEpisodes,
    ResumeEntry,
)
from pytest_dura.evidence.shard_units import plan_digest

OWN_ORIGIN: JsonObject = {"session": None, "changed": None}
"""The origin of an episode that was simulated by the session itself, for the first time."""


def resume_json(
    header: JsonObject, searched: Collection[JsonObject], notes: Iterable[str]
) -> JsonObject:
    """Build the record's key ``resume``, apart from what follows from its episodes.

    Args:
        header: ``resumed``, ``session`` and ``sources`` of the session itself.
        searched: Origins of the simulations of its searches.
        notes: What items report beside.
    """
    counts = None
    if header["resumed"]:
        origins = origin_counts(map(OriginEntry.from_data, searched))
        counts = {"simulations": len(searched), **origins._asdict()}
    return {"searched": counts, **header, "problems": sorted(set(notes))}


class OriginCounts(NamedTuple):
    """Counts of the origins of episodes, for the record's key ``resume``.

    Args:
        taken_over: Episodes that an earlier session simulated.
        sessions: The earlier sessions.
        outdated: Episodes that were simulated again, by the reason.
    """

    taken_over: int
    sessions: list[EarlierSession]
    outdated: list[OutdatedEpisodes]

    @classmethod
    def of(cls, sessions: Counter[str], changes: Counter[tuple[str, ...]]) -> OriginCounts:
        """Sort the counts by session, and by what changed."""
        return cls(
            sessions.total(),
            [EarlierSession(session=name, episodes=sessions[name]) for name in sorted(sessions)],
            [
                OutdatedEpisodes(changed=list(change), episodes=changes[change])
                for change in sorted(changes)
            ],
        )


def origin_counts(origins: Iterable[OriginEntry]) -> OriginCounts:
    """Count the origins of episodes, fault-free twins apart."""
    sessions: Counter[str] = Counter()
    changes: Counter[tuple[str, ...]] = Counter()
    for origin in origins:
        if origin.session is not None:
            sessions[origin.session] += 1
        elif origin.changed is not None:
            changes[tuple(origin.changed)] += 1
    return OriginCounts.of(sessions, changes)


def merged_resume(parts: Iterable[ResumeEntry]) -> dict[str, Any]:
    """Merge what shards, each a session of its own, say of earlier sessions."""
    shards = list(parts)
    searched = [shard.searched for shard in shards if shard.searched is not None]
    # No two shards make the same search.
    sessions: Counter[str] = Counter()
    changes: Counter[tuple[str, ...]] = Counter()
    for count in searched:
        sessions.update({each.session: each.episodes for each in count.sessions})
        changes.update({tuple(each.changed): each.episodes for each in count.outdated})
    summed = {
        "simulations": sum(count.simulations for count in searched),
        **OriginCounts.of(sessions, changes)._asdict(),
    }
    return {
        "resumed": any(shard.resumed for shard in shards),
        "session": None,
        "sources": shards[0].sources if len({shard.sources for shard in shards}) == 1 else None,
        "searched": summed if searched else None,
    }


def outdated_reason(changed: Iterable[str]) -> str:
    """Reason, in words, why episodes of an earlier session do not count in this one."""
    names = ", ".join(changed)
    return f"{names} changed" if names else "missing or damaged in the earlier session"


def resume_problems(head: RecordHead) -> Iterator[str]:
    """Yield the contradictions in what a record says of earlier sessions."""
    resume, searched = head.resume, head.resume.searched
    if not resume.resumed and (resume.taken_over or resume.outdated):
        yield "resume: episodes of earlier sessions, though none was resumed"
    if resume.session in {session.session for session in resume.sessions}:
        yield "resume: the session took over episodes from itself"
    if (resume.session is None) != (head.merged_from is not None):
        yield "resume: a session has an id, and merged shards have none"
    if resume.resumed == (searched is None):
        yield "resume: searches are counted where earlier sessions are asked, and only there"
    if searched is None:
        return
    # The episodes of searches are in no record.
    taken_over = sum(session.episodes for session in searched.sessions)
    outdated = sum(reason.episodes for reason in searched.outdated)
    if searched.taken_over != taken_over:
        runs = f"{searched.taken_over} runs of searches"
        yield f"resume: {runs}, and their sessions say {taken_over}"
    if taken_over + outdated > searched.simulations:
        runs = f"{searched.simulations} runs of searches"
        yield f"resume: {runs}, and {taken_over + outdated} origins"
    if resume.session in {session.session for session in searched.sessions}:
        yield "resume: the session took over runs of searches from itself"


def shard_problems(head: RecordHead) -> Iterator[str]:
    """Yield the contradictions in what a record says of shards."""
    yield from _shard_part_problems(head)
    yield from _merged_problems(head)


def _shard_part_problems(head: RecordHead) -> Iterator[str]:
    shard = head.shard
    if shard is None:
        return
    if head.merged_from is not None:
        yield "shard: it is a shard, and merged from shards"
    if shard.index > shard.count:
        yield f"shard: {shard.index} of {shard.count}"
    units = shard.holds
    keys = [unit.key for unit in units]
    if keys != sorted(set(keys)):
        yield "shard: its units are not sorted, or one is listed twice"
    if shard.plan is None:
        if units or shard.units is not None:
            yield "shard: it holds units of no plan"
        return
    if shard.units is None or len(units) > shard.units:
        yield f"shard: it holds {len(units)} units, and the whole session {shard.units}"
    elif len(units) == shard.units and plan_digest(units) != shard.plan:
        yield "shard: it holds all units of the session, and they are not its plan"
    elif shard.count == 1 and len(units) != shard.units:
        yield f"shard: the only one holds {len(units)} of {shard.units} units"


def _merged_problems(head: RecordHead) -> Iterator[str]:
    parts = head.merged_from
    if parts is None:
        return
    known = [(part.index or 0, part.created, part.record) for part in parts]
    if not known or known != sorted(known) or len({part.record for part in parts}) < len(parts):
        yield "merged_from: not in their order, or one is there twice"
        return
    shards: dict[tuple[int, str], set[int]] = defaultdict(set)
    for part in parts:
        if part.index and part.count and part.plan and part.units is not None:
            shards[part.count, part.plan].add(part.index)
        elif any((part.index, part.count, part.plan, part.units)):
            yield "merged_from: a shard without a plan"
    for (count, _), indices in shards.items():
        if len(indices) != count or max(indices) != count:
            yield "merged_from: not every shard of a session"
    if head.created != min(part.created for part in parts):
        yield "created: not when the first of its sessions began"
    if head.status == "complete" and head.finished != max(part.finished for part in parts):
        yield "finished: not when the last of its sessions ended"
    failed = any(part.gate != "passed" or part.exit_code for part in parts)
    if failed and head.gate.result == "passed":
        yield "gate: passed, although one of its sessions did not pass"
