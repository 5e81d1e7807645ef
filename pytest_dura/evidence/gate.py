"""The gate: whether a session passed, and every reason why it did not.

Reasons are verdicts, outcomes of searches, and cases that could not be repeated.
Every pytest run loads this module: it imports the standard library alone.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Data = Mapping[str, Any]
REPEAT_KEYS = ("episode", "digest", "repeated_digest", "result", "detail")
"""The keys of a case's repetition."""
_REPEAT_RESULTS = ("different", "failed", "equal", "skipped")
"""What a repetition comes to. Of several the first in this order counts."""


def worse_repeat(item: Data | None, other: Data | None) -> Data | None:
    """Of two repetitions of a case, by two processes or shards, the one that says more."""
    if item is None or other is None:
        return item or other
    return min(item, other, key=lambda repeat: _REPEAT_RESULTS.index(repeat["result"]))


def not_repeatable_lines(cases: Iterable[Data]) -> Iterator[str]:
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
        yield from not_repeatable_lines([case])
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


VerdictKey = tuple[str, str, str]
"""Node id, requirement and case."""

VIOLATED_OUTCOMES = ("falsified", "not repeatable")
"""Words of an outcome with a violation; no option lets them through."""
NOTHING_FOUND = "nothing found"
OBJECTIONABLE_OUTCOMES = {
    "falsified": "falsified by a search",
    "not repeatable": "violated in a search, and not again each time it was repeated",
    "baseline": "violated by a baseline of a search, and not confirmed",
    "undecided": "undecided by a search",
}
"""What the gate says of an outcome that it does not accept; the worst first."""
_SORT_KEYS = ("case", "component", "item", "seed")


@dataclass
class SearchRecords:
    """The searches of a session while it grows. The same one may be told twice.

    A search is a function of its case, its seed and its budget: told twice it is told once. One
    that came out differently when it was tried again stands beside the first: neither is dropped.
    """

    _told: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, item: str, searches: Iterable[Data]) -> None:
        """Those that an item told."""
        for search in searches:
            self.adopt({**search, "item": item, "waiver": None})

    def adopt(self, entry: Data) -> None:
        """A search as another session has it, with its item and its waiver."""
        question = {key: value for key, value in entry.items() if key != "waiver"}
        self._told.setdefault(json.dumps(question, sort_keys=True), dict(entry))

    @property
    def answered(self) -> set[VerdictKey]:
        """What items were to decide and searched instead: no verdict is to be expected of it."""
        return {
            (item["item"], outcome["requirement"], item["case"])
            for item in self._told.values()
            for outcome in item["outcomes"]
        }

    def to_json(self, waivers: Mapping[str, Data]) -> list[dict[str, Any]]:
        """The record's key ``searches``, sorted.

        Args:
            waivers: By node id, what excuses an item.
        """
        ordered = sorted(
            self._told.items(), key=lambda told: (*(told[1][name] for name in _SORT_KEYS), told[0])
        )
        return [
            {**item, "waiver": waivers.get(item["item"], item["waiver"])} for _, item in ordered
        ]


def _search_objections(searches: Sequence[Data], *, warn_undecided: bool) -> list[str]:
    """A sentence for every outcome of a search that the gate does not accept; the worst first."""
    words = [
        objectionable_outcome
        for objectionable_outcome in OBJECTIONABLE_OUTCOMES
        if objectionable_outcome in VIOLATED_OUTCOMES or not warn_undecided
    ]
    return [
        outcome_objection(outcome["requirement"], search["case"], word)
        for word in words
        for search in searches
        if search["waiver"] is None
        for outcome in search["outcomes"]
        if outcome_status(search, outcome) == word
    ]


def outcome_status(search: Data, outcome: Data) -> str:
    """The word of an outcome; ``baseline`` where a baseline alone met a violation."""
    name = outcome["requirement"]
    if outcome["word"] in VIOLATED_OUTCOMES:
        return str(outcome["word"])
    met = any(baseline["first"].get(name) is not None for baseline in search["baselines"])
    return "baseline" if met else str(outcome["word"])


def outcome_objection(requirement: str, case: str, word: str) -> str:
    """What the gate says of an outcome that it does not accept."""
    return f"{requirement} on {case} is {OBJECTIONABLE_OUTCOMES[word]}"


GateResult = Literal["passed", "failed", "incomplete"]

# Exit codes of pytest, which records carry and which are judged here without pytest.
OK = 0
TESTS_FAILED = 1
INTERRUPTED = 2
INTERNAL_ERROR = 3
NO_TESTS = 5


@dataclass(frozen=True)
class Gate:
    """Whether the session passed. It fails closed.

    Args:
        result: ``incomplete`` where the session did not come to its end.
        exit_code: Of the session.
        warn_undecided: Whether undecided verdicts were accepted (``--dura-undecided=warn``).
        failed: Test items that failed.
        reasons: Why it did not pass; empty if it did.
    """

    result: GateResult
    exit_code: int
    warn_undecided: bool
    failed: int
    reasons: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "reasons": list(self.reasons)}

    @classmethod
    def running(cls, *, warn_undecided: bool) -> Gate:
        """That of a session which has not come to its end."""
        why = "the session has not come to its end: it is running, or it was killed"
        return cls("incomplete", INTERNAL_ERROR, warn_undecided, 0, (why,))

    @classmethod
    def of(
        cls,
        verdicts: Sequence[Data],
        objections: Sequence[str],
        *,
        searches: Sequence[Data],
        interrupted: bool,
        exit_code: int,
        failed: int,
        warn_undecided: bool,
    ) -> Gate:
        """That of a session at its end.

        Args:
            verdicts: Of the record.
            objections: What else stands against it, whatever the tests say.
            searches: Of the record.
            interrupted: Whether it ended before its time.
            exit_code: Of pytest.
            failed: Test items that failed.
            warn_undecided: Whether undecided verdicts are accepted.
        """
        reasons = verdict_objections(verdicts, searches, warn_undecided=warn_undecided)
        if failed:
            reasons.append(f"{failed} test {'item' if failed == 1 else 'items'} failed")
        if exit_code == NO_TESTS:
            reasons.append("no test was run")
        reasons += objections
        if interrupted:
            reasons.insert(0, f"the session was interrupted (exit code {exit_code})")
            code = exit_code or INTERRUPTED
            return cls("incomplete", code, warn_undecided, failed, tuple(reasons))
        if exit_code == OK and reasons:
            exit_code = TESTS_FAILED
        if exit_code != OK:
            reasons = reasons or [f"pytest ended with exit code {exit_code}"]
            return cls("failed", exit_code, warn_undecided, failed, tuple(reasons))
        return cls("passed", exit_code, warn_undecided, failed, ())


def verdict_objections(
    verdicts: Sequence[Data], searches: Sequence[Data], *, warn_undecided: bool
) -> list[str]:
    """A sentence for every verdict and search that the gate does not accept; worst verdicts first.

    Args:
        verdicts: Of the record.
        searches: Of the record.
        warn_undecided: Whether what is undecided is accepted.
    """
    accepted = {"supported"} | ({"undecided"} if warn_undecided else set())
    found = [
        verdict
        for verdict in verdicts
        if verdict["verdict"] not in accepted and verdict["waiver"] is None
    ]
    found.sort(key=lambda verdict: verdict["verdict"] != "violated")
    told = [
        f"{verdict['requirement']} on {verdict['case']} is {verdict['verdict']}"
        for verdict in found
    ]
    return [*told, *_search_objections(searches, warn_undecided=warn_undecided)]
