"""The gate: whether a session passed, and every reason why it did not.

Reasons are verdicts, outcomes of searches, and cases that could not be repeated.
Every pytest run loads this module: it imports the standard library alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.codec import Count

if TYPE_CHECKING:
    from pytest_dura.evidence.case_model import CaseEntry, RepeatEntry
    from pytest_dura.evidence.item_verdicts import ItemVerdict
    from pytest_dura.evidence.searches import RecordedSearch
    from pytest_dura.requirements.campaign_verdicts import CampaignStatus
    from pytest_dura.requirements.searches import Falsification, SearchOutcome

_REPEAT_RESULTS = ("different", "failed", "within tolerances", "equal", "skipped")
"""Results of a repetition. Of several the first in this order counts."""


def worse_repeat(repeat: RepeatEntry | None, other: RepeatEntry | None) -> RepeatEntry | None:
    """Choose, of two repetitions of a case by two processes or shards, the worse result."""
    if repeat is None or other is None:
        return repeat or other
    return min(repeat, other, key=lambda repeat: _REPEAT_RESULTS.index(repeat.result))


NOT_REPEATABLE = "not repeatable: "
"""Beginning of the reason why verdicts on a case whose repeated episode differs are undecided."""
_DRAWS = "the runs count as draws"


def repeat_difference(repeat: RepeatEntry | None, component: str) -> str:
    """Describe how a repeated episode differs from the first one; empty if it does not.

    Args:
        repeat: Of a case.
        component: Name of the component under test.
    """
    if repeat is None or repeat.result not in ("different", "failed"):
        return ""
    name = f"{NOT_REPEATABLE}{repeat.episode} ({component})"
    if repeat.result == "failed":
        return f"{name}: the repetition failed: {repeat.detail}"
    digests = f"digests {repeat.digest[:12]} and {(repeat.repeated_digest or '')[:12]}"
    return f"{name}: run again in this session it came out differently, {repeat.detail or digests}"


def _is_declared(repeat: RepeatEntry) -> bool:
    """Whether a repetition that differs is declared; a failed one is not excused by that."""
    return bool(repeat.declared) and repeat.result != "failed"


def not_repeatable_lines(cases: Iterable[CaseEntry]) -> Iterator[str]:
    """Yield a line for each case whose repeated episode differs, though nothing declares that."""
    for case in cases:
        if case.repeat is not None and not _is_declared(case.repeat):
            difference = repeat_difference(case.repeat, case.component)
            yield from [difference] if difference else []


def draws_lines(cases: Iterable[CaseEntry]) -> Iterator[str]:
    """Yield a line for each case of which it is declared that its episodes may not repeat."""
    for case in cases:
        if case.repeat is not None and case.repeat.declared:
            yield f"{_DRAWS} on {case.id} ({case.component}): {case.repeat.declared}"


def with_repeats(
    status: CampaignStatus, reason: str, repeats: Iterable[RepeatEntry | None], component: str
) -> dict[str, Any]:
    """Fields of a verdict that change since the cases that it rests on are not repeatable.

    Args:
        status: Of the verdict.
        reason: Of the verdict.
        repeats: Of the case, and of that of the second runs of pairs.
        component: Name of the component under test.
    """
    from pytest_dura.requirements.campaign_verdicts import doubted

    fields: dict[str, Any] = {"verdict": status, "reason": reason}
    for repeat in repeats:
        if repeat is None:
            continue
        difference = repeat_difference(repeat, component)
        if difference and not _is_declared(repeat):
            fields |= doubted(fields["verdict"], fields["reason"], difference)
        if repeat.declared and _DRAWS not in fields["reason"]:
            fields["reason"] += f"; {_DRAWS}: {repeat.declared}"
    return fields


def repeat_objections(cases: Iterable[CaseEntry]) -> Iterator[str]:
    """Yield what fails a session that requires its cases to be repeatable.

    A case is exempt whose episodes differ for a reason outside of the session.
    """
    for case in cases:
        difference = repeat_difference(case.repeat, case.component)
        yield from [difference] if difference else []
        if case.repeat is None and case.planned and case.metrics.run:
            yield f"not repeatable: no episode of {case.id} ({case.component}) was repeated"


def repeat_problems(case: CaseEntry, digests: Iterable[str]) -> Iterator[str]:
    """Yield the contradictions in a case's repetition.

    Args:
        case: Of the record.
        digests: Of the recorded episodes that have the id of the repeated one.
    """
    repeat = case.repeat
    if repeat is None:
        return
    if repeat.digest not in set(digests):
        yield f"{repeat.episode} was repeated, and is not recorded with that digest"
    if repeat.result == "skipped" and not repeat.declared:
        yield f"{repeat.episode} was not repeated, and nothing declares that it may differ"
    equal = repeat.digest == repeat.repeated_digest
    compared = ("equal", "within tolerances", "different")
    if repeat.result in compared and equal != (repeat.result == "equal"):
        yield f"the digests of its repetition are {'' if equal else 'not '}equal"


VIOLATED_OUTCOMES = ("falsified", "not repeatable")
"""Statuses of an outcome with a violation."""
NOTHING_FOUND = "nothing found"
OBJECTIONABLE_OUTCOMES = {
    "falsified": "falsified by a search",
    "not repeatable": "violated in a search, and not again each time it was repeated",
    "baseline": "violated by a baseline of a search, and not confirmed",
    "undecided": "undecided by a search",
}
"""Wording of the outcomes that the gate does not accept; the worst first."""


def outcome_status(search: Falsification, outcome: SearchOutcome) -> str:
    """Status of an outcome; ``baseline`` where a baseline alone met a violation."""
    name = outcome.requirement
    if outcome.status in VIOLATED_OUTCOMES:
        return outcome.status
    baseline_violates = any(baseline.first.get(name) is not None for baseline in search.baselines)
    return "baseline" if baseline_violates else outcome.status


def outcome_objection(requirement: str, case: str, status: str) -> str:
    """Word what the gate does not accept about an outcome."""
    return f"{requirement} on {case} is {OBJECTIONABLE_OUTCOMES[status]}"


GateResult = Literal["passed", "failed", "incomplete"]

# Exit codes of pytest, which is not imported here.
OK = 0
TESTS_FAILED = 1
INTERRUPTED = 2
INTERNAL_ERROR = 3
NO_TESTS = 5


def failed_items_text(failed: int) -> str:
    """Say that so many test items failed."""
    return f"{failed} test {'item' if failed == 1 else 'items'} failed"


@dataclass(frozen=True)
class Gate:
    """Whether the session passed. It fails closed.

    Args:
        result: ``incomplete`` where the session did not come to its end.
        exit_code: Of the session.
        warn_undecided: Whether verdicts on too few runs were accepted
            (``--dura-undecided=warn``).
        failed: Test items that failed.
        reasons: Why it did not pass; empty if it did.
    """

    result: GateResult
    exit_code: Count
    warn_undecided: bool
    failed: Count
    reasons: tuple[str, ...]

    @classmethod
    def running(cls, *, warn_undecided: bool) -> Gate:
        """Make the gate of a session that has not come to its end."""
        why = "the session has not come to its end: it is running, or it was killed"
        return cls("incomplete", INTERNAL_ERROR, warn_undecided, 0, (why,))

    @classmethod
    def of(
        cls,
        verdicts: Sequence[ItemVerdict],
        objections: Sequence[str],
        *,
        searches: Sequence[RecordedSearch],
        interrupted: bool,
        exit_code: int,
        failed: int,
        warn_undecided: bool,
    ) -> Gate:
        """Judge a session at its end.

        Args:
            verdicts: Of the record.
            objections: Further reasons against it, whatever the tests say.
            searches: Of the record.
            interrupted: Whether it ended early.
            exit_code: Of pytest.
            failed: Test items that failed.
            warn_undecided: Whether verdicts on too few runs are accepted.
        """
        reasons = verdict_objections(verdicts, searches, warn_undecided=warn_undecided)
        if failed:
            reasons.append(failed_items_text(failed))
        if exit_code == NO_TESTS:
            reasons.append("no test was run")
        reasons += objections
        if interrupted:
            code = exit_code or INTERRUPTED
            reasons.insert(0, f"the session was interrupted (exit code {code})")
            return cls("incomplete", code, warn_undecided, failed, tuple(reasons))
        if exit_code == OK and reasons:
            exit_code = TESTS_FAILED
        if exit_code != OK:
            reasons = reasons or [f"pytest ended with exit code {exit_code}"]
            return cls("failed", exit_code, warn_undecided, failed, tuple(reasons))
        return cls("passed", exit_code, warn_undecided, failed, ())


def verdict_objections(
    verdicts: Sequence[ItemVerdict], searches: Sequence[RecordedSearch], *, warn_undecided: bool
) -> list[str]:
    """Write a sentence for every verdict and search that the gate does not accept, worst first.

    Args:
        verdicts: Of the record.
        searches: Of the record.
        warn_undecided: Whether undecided verdicts are accepted whose valid runs are too few.
    """
    objectionable = [
        verdict
        for verdict in verdicts
        if verdict.verdict != "supported"
        and verdict.waiver is None
        and not (warn_undecided and verdict.too_few)
    ]
    objectionable.sort(key=lambda verdict: verdict.verdict != "violated")
    sentences = [
        f"{verdict.requirement} on {verdict.case} is {verdict.verdict}" for verdict in objectionable
    ]
    # A search is undecided since too many of its simulations are missing, invalid or open, and not
    # since there are too few: no option accepts that.
    searched = [
        outcome_objection(outcome.requirement, search.case, status)
        for status in OBJECTIONABLE_OUTCOMES
        for search in searches
        if search.waiver is None
        for outcome in search.outcomes
        if outcome_status(search, outcome) == status
    ]
    return [*sentences, *searched]
