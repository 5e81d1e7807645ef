"""Figures as every format words them: a rate never stands without its n and its confidence."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.requirements.verdicts.situations import SITUATIONS

Data = Mapping[str, Any]
UNREVIEWED = "generated, unreviewed"
NAMED = 8
"""Names of what a test looked at, in a sentence."""
_SHA256 = re.compile(r"[0-9a-f]{64}")


def sample(verdict: Data) -> str:
    """What a verdict rests on: ``12 valid of 15 run, 15 planned; 0 violations``."""
    told = (
        f"{verdict['episodes']} valid of {verdict['run']} run, {verdict['planned']} planned; "
        f"{verdict['violations']} violation{'' if verdict['violations'] == 1 else 's'}"
        f"{also_without(verdict)}"
    )
    return ", ".join([told, *besides(verdict)])


def besides(verdict: Data) -> list[str]:
    """What else there is to say of a verdict's runs: ``2 ended before it was decided``."""
    counts = {
        "ended before it was decided": len(verdict["open"]),
        "violated without effect of the fault": verdict["without_effect"],
        **{word: verdict[word] for word in ("invalid", "missing", "vacuous")},
    }
    return [f"{count} {what}" for what, count in counts.items() if count]


def also_without(verdict: Data) -> str:
    """How many of a verdict's violations are not the faults' doing; empty if none is known."""
    count = verdict["also_without"]
    return f" ({count} of them also without the faults)" if count else ""


def bound(verdict: Data) -> str:
    """The bound on the rate of violations with its confidence, or that there is none."""
    told = verdict["bound"]
    if told["upper"] is None:
        return f"no bound{why_no_rate(verdict)}"
    return f"rate <= {told['upper']:.3g} at {told['confidence']:g} confidence"


def why_no_rate(verdict: Data) -> str:
    """That its runs are all equal, after a colon; empty where they differ, or there is one."""
    situation = verdict.get("situation")
    return "" if situation is None else f": {SITUATIONS[situation]}"


def by_assertion(verdict: Data) -> list[str]:
    """What a verdict rests on that assertions of a test decided, sentence by sentence.

    There is none for a verdict by checks alone. Names in it are a user's, and have to be escaped.
    """
    found = verdict["assertion"]
    if found is None:
        return []
    seen = ", ".join(found["observed"][:NAMED]) or "nothing"
    if len(found["observed"]) > NAMED:
        seen += f" and {len(found['observed']) - NAMED} more"
    told = [f"failed: {one['message']}, in {one['episode']}" for one in found["failed"][:1]]
    if found["alone"]:
        told.append(f"by assertion: the test looked at {seen}")
    elif found["observed"]:
        told.append(f"by its check, and by assertion: the test looked at {seen}")
    for one in found["false"]:
        count = f"{one['episodes']} episode{'' if one['episodes'] == 1 else 's'}"
        told.append(f"false in {count} with which the test passed: {one['check']}")
    return told


def event_line(event: Data) -> str:
    """What ended an episode: ``at t = 6.50 s the ego ran into VICTIM``."""
    return f"at t = {event['time']:.2f} s {event['detail']}"


def selected(record: SessionRecord) -> str:
    """What the session was asked for of its plan; empty where it was the whole plan.

    Such as ``1 of 2 planned verdicts asked for, 5 runs instead of 15``.
    """
    told = record["selection"]
    parts = []
    if told["asked"] < told["planned"]:
        parts.append(f"{told['asked']} of {told['planned']} planned verdicts asked for")
    if told["runs"] is not None:
        declared = " to ".join(map(str, dict.fromkeys(told["declared_runs"])))
        runs = f"{told['runs']} run{'' if told['runs'] == 1 else 's'}"
        parts.append(f"{runs} instead of {declared}")
    return ", ".join(parts)


def roles_off(record: SessionRecord) -> list[str]:
    """Which roles are switched off, and in how many of the cases."""
    cases = [one for one in record["cases"] if not one["without"]]
    counts = Counter(role for one in cases for role in one["off"])
    several = "s" if len(cases) > 1 else ""
    return [
        f"{role} is OFF in {counts[role]} of {len(cases)} case{several}" for role in sorted(counts)
    ]


def part(record: SessionRecord) -> str:
    """Which part of a session the record is, such as ``shard 2 of 5``; empty for a whole one."""
    shard = record["shard"]
    return "" if shard is None else f"shard {shard['index']} of {shard['count']}"


def merged(record: SessionRecord) -> str:
    """How many shards the record was merged from, and where they ran; empty for a session's own."""
    shards = record["merged_from"]
    if shards is None:
        return ""
    # Which shards have property tests says nothing of where they ran.
    places = [{**one["environment"], "hypothesis": None} for one in shards]
    several = len({json.dumps(one, sort_keys=True) for one in places}) > 1
    count = f"{len(shards)} shard{'' if len(shards) == 1 else 's'}"
    return f"{count}, in environments that differ" if several else f"{count}, in one environment"


def sha256(text: object) -> str | None:
    """The digest, if it is a SHA-256 in hexadecimal."""
    return text if isinstance(text, str) and _SHA256.fullmatch(text) else None
