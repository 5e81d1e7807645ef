"""Which episodes a session took over from earlier ones, and why it simulated others again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Data = Mapping[str, Any]

OWN: Data = {"session": None, "changed": None}
"""The origin of an episode that was simulated by the session itself, for the first time."""
ALONE: Data = {"mode": "none", "session": None, "searched": None}
"""Of a session that nobody told of others."""
MODES = ("none", "resume", "reuse")


class Reuse:
    """What items tell of earlier sessions, beside the episodes of the record."""

    def __init__(self) -> None:
        self._notes: set[str] = set()
        self._searched: dict[str, Data] = {}

    def add(self, report: Data) -> None:
        """What an item told: its ``notes``, and the origins of what it ``searched``."""
        self._notes.update(report["notes"])
        for one in report["searched"]:
            self._searched.setdefault(one["run"], one)

    def to_json(self, header: Data) -> dict[str, Any]:
        """What the record says of reuse, what follows from its episodes apart.

        Args:
            header: What the session says of itself.
        """
        searched = None if header["mode"] == "none" else searched_counts(self._searched.values())
        return {"searched": searched, **header, "problems": sorted(self._notes)}


def searched_counts(runs: Iterable[Data]) -> dict[str, Any]:
    """What the origins of the simulations of searches come to.

    Args:
        runs: ``{origin}`` of each.
    """
    known = list(runs)
    return {"simulations": len(known), **reuse_counts(known)}


def reuse_counts(episodes: Iterable[Data]) -> dict[str, Any]:
    """What the origins of episodes come to, fault-free twins apart.

    Args:
        episodes: Of the record, or others with an ``origin``.

    Returns:
        ``taken_over``, ``sessions`` with their ``episodes``, and ``outdated``: what ``changed``
        since an earlier session simulated so many ``episodes``.
    """
    sessions: Counter[str] = Counter()
    changes: Counter[tuple[str, ...]] = Counter()
    for one in episodes:
        session, changed = one["origin"]["session"], one["origin"]["changed"]
        if session is not None:
            sessions[session] += 1
        elif changed is not None:
            changes[tuple(changed)] += 1
    return _told(sessions, changes)


def _told(sessions: Counter[str], changes: Counter[tuple[str, ...]]) -> dict[str, Any]:
    return {
        "taken_over": sessions.total(),
        "sessions": [{"session": one, "episodes": sessions[one]} for one in sorted(sessions)],
        "outdated": [{"changed": list(one), "episodes": changes[one]} for one in sorted(changes)],
    }


def joined_reuse(parts: Iterable[Data]) -> dict[str, Any]:
    """What the record of merged shards begins with: each of them was a session of its own."""
    told = list(parts)
    searched = [one["searched"] for one in told if one["searched"] is not None]
    return {
        "mode": max((one["mode"] for one in told), key=MODES.index),
        "session": None,
        "searched": _summed(searched) if searched else None,
    }


def _summed(counts: Sequence[Data]) -> dict[str, Any]:
    """The sum of several :func:`searched_counts`; no two shards make the same search."""
    sessions: Counter[str] = Counter()
    changes: Counter[tuple[str, ...]] = Counter()
    for one in counts:
        sessions.update({each["session"]: each["episodes"] for each in one["sessions"]})
        changes.update({tuple(each["changed"]): each["episodes"] for each in one["outdated"]})
    return {"simulations": sum(one["simulations"] for one in counts), **_told(sessions, changes)}


def why_again(changed: Iterable[str]) -> str:
    """In words, why episodes of an earlier session do not count in this one."""
    names = ", ".join(changed)
    return f"{names} changed" if names else "missing or damaged in the earlier session"
