"""Objections: reasons against a recorded session, which is judged again.

Every pytest run loads this module: it imports the standard library alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pytest_dura.evidence.gate import Gate, repeat_objections

if TYPE_CHECKING:
    from pytest_dura.evidence.model import RecordHead


def judge_again(head: RecordHead) -> Gate:
    """Judge a recorded session again.

    Reasons besides its verdicts, its searches and its tests are taken as recorded.
    """
    others = other_objections(head)
    if head.gate.result == "passed" and head.require_repeatable:
        others += repeat_objections(head.cases)
    return _gate_of(head, others)


def other_objections(head: RecordHead) -> list[str]:
    """List reasons against a recorded session besides its verdicts, its searches and its tests."""
    by_rule = _gate_of(head, ()).reasons
    return [reason for reason in head.gate.reasons if reason not in by_rule]


def _gate_of(head: RecordHead, objections: Sequence[str]) -> Gate:
    if head.status == "running":
        return Gate.running(warn_undecided=head.gate.warn_undecided)
    return Gate.of(
        head.verdicts,
        objections,
        searches=head.searches,
        interrupted=head.status != "complete",
        exit_code=head.gate.exit_code,
        failed=len(head.failed_items or ()),
        warn_undecided=head.gate.warn_undecided,
    )
