"""What repeating one episode of each case came to, and what that says against a session."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

Data = Mapping[str, Any]
REPEAT = ("episode", "digest", "repeated_digest", "result", "detail")
"""The keys of a case's repetition."""
RESULTS = ("different", "failed", "equal", "skipped")
"""What a repetition comes to. Of several the first in this order counts."""


def worse(one: Data | None, other: Data | None) -> Data | None:
    """Of two repetitions of a case, by two processes or shards, the one that says more."""
    if one is None or other is None:
        return one or other
    return min(one, other, key=lambda repeat: RESULTS.index(repeat["result"]))


def not_repeatable(cases: Iterable[Data]) -> Iterator[str]:
    """A line for each case whose episode did not come out as it did the first time."""
    for case in cases:
        repeat = case["repeat"]
        if repeat is None or repeat["result"] not in ("different", "failed"):
            continue
        name = f"not repeatable: {repeat['episode']} ({case['component']})"
        if repeat["result"] == "failed":
            yield f"{name}: the repetition failed: {repeat['detail']}"
        else:
            yield (
                f"{name}: run again in this session it came out differently, digests "
                f"{repeat['digest'][:12]} and {repeat['repeated_digest'][:12]}"
            )


def repeat_objections(cases: Iterable[Data]) -> Iterator[str]:
    """What stands against a session that requires its cases to be repeatable.

    A case in which a live language model answers is not held to it.
    """
    for case in cases:
        yield from not_repeatable([case])
        if case["repeat"] is None and case["planned"] and case["metrics"]["run"]:
            yield f"not repeatable: no episode of {case['id']} ({case['component']}) was repeated"


def repeat_problems(case: Data, digests: Iterable[str]) -> Iterator[str]:
    """Whether what is said of a case's repetition agrees with itself and its episodes.

    Args:
        case: Of the record.
        digests: Of the recorded episodes of the name that was repeated.
    """
    repeat = case["repeat"]
    if repeat is None:
        return
    if repeat["digest"] not in set(digests):
        yield f"{repeat['episode']} was repeated, and is not recorded with that digest"
    equal = repeat["digest"] == repeat["repeated_digest"]
    if repeat["result"] in ("equal", "different") and equal != (repeat["result"] == "equal"):
        yield f"the digests of its repetition are {'' if equal else 'not '}equal"
