"""Whether a record took over from earlier sessions what its episodes say, and was asked to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.record.reuse import reuse_counts
from pytest_dura.evidence.record.session_record import SessionRecord


def reuse_problems(record: SessionRecord) -> Iterator[str]:
    """Everything in which a record contradicts what it says of earlier sessions."""
    told, again = record["reuse"], reuse_counts(record.episodes())
    for key, value in again.items():
        if told[key] != value:
            yield f"reuse: {key} is {told[key]}, and its episodes say {value}"
    if told["mode"] == "none" and (again["taken_over"] or again["outdated"]):
        yield "reuse: episodes of earlier sessions, though none was asked for"
    if told["session"] in {one["session"] for one in again["sessions"]}:
        yield "reuse: the session took over episodes from itself"
    if (told["session"] is None) != (record["merged_from"] is not None):
        yield "reuse: a session has an id, and merged shards have none"
    yield from _searched_problems(told["mode"], told["session"], told["searched"])
    for one in record.episodes():
        if one["origin"]["session"] is not None and one["validity"] == "missing":
            yield f"episode {one['id']}: it was taken over, and it is missing"


def _searched_problems(
    mode: str, session: str | None, searched: Mapping[str, Any] | None
) -> Iterator[str]:
    """What contradicts itself in the counts of searches, whose episodes are in no record."""
    if (mode == "none") != (searched is None):
        yield "reuse: searches are counted where earlier sessions are asked, and only there"
    if searched is None:
        return
    taken, again = (
        sum(one["episodes"] for one in searched[key]) for key in ("sessions", "outdated")
    )
    if searched["taken_over"] != taken:
        yield f"reuse: {searched['taken_over']} runs of searches, and their sessions say {taken}"
    if taken + again > searched["simulations"]:
        yield f"reuse: {searched['simulations']} runs of searches, and {taken + again} origins"
    if session in {one["session"] for one in searched["sessions"]}:
        yield "reuse: the session took over runs of searches from itself"
