"""The gate: whether a session passed, and every reason why it did not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import pytest

GateWord = Literal["passed", "failed", "incomplete"]
Data = Mapping[str, Any]

REGULAR = (
    pytest.ExitCode.OK,
    pytest.ExitCode.TESTS_FAILED,
    pytest.ExitCode.NO_TESTS_COLLECTED,
)
"""Exit codes of sessions that ran to their end."""


@dataclass(frozen=True)
class Gate:
    """Whether the session passed. It fails closed.

    Args:
        result: ``incomplete`` where the session did not come to its end.
        exit_code: Of the session.
        warn_undecided: Whether undecided verdicts were accepted (``--dura-undecided=warn``).
        reasons: Why it did not pass; empty if it did.
    """

    result: GateWord
    exit_code: int
    warn_undecided: bool
    reasons: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "reasons": list(self.reasons)}

    @classmethod
    def running(cls, *, warn_undecided: bool) -> Gate:
        """That of a session which has not come to its end."""
        why = "the session has not come to its end: it is running, or it was killed"
        return cls("incomplete", int(pytest.ExitCode.INTERNAL_ERROR), warn_undecided, (why,))

    @classmethod
    def of(
        cls,
        verdicts: Sequence[Data],
        objections: Sequence[str],
        *,
        interrupted: bool,
        exit_code: int,
        failed: int,
        warn_undecided: bool,
    ) -> Gate:
        """That of a session at its end.

        Args:
            verdicts: Of the record.
            objections: What else stands against it, whatever the tests say.
            interrupted: Whether it ended before its time.
            exit_code: Of pytest.
            failed: Test items that failed.
            warn_undecided: Whether undecided verdicts are accepted.
        """
        unsupported = unsupported_verdicts(verdicts, warn_undecided=warn_undecided)
        reasons = [f"{name} on {case} is {word}" for name, case, word in unsupported]
        if failed:
            reasons.append(f"{failed} test {'item' if failed == 1 else 'items'} failed")
        if exit_code == pytest.ExitCode.NO_TESTS_COLLECTED:
            reasons.append("no test was run")
        reasons += objections
        if interrupted:
            reasons.insert(0, f"the session was interrupted (exit code {exit_code})")
            code = exit_code or int(pytest.ExitCode.INTERRUPTED)
            return cls("incomplete", code, warn_undecided, tuple(reasons))
        if exit_code == pytest.ExitCode.OK and reasons:
            exit_code = int(pytest.ExitCode.TESTS_FAILED)
        if exit_code != pytest.ExitCode.OK:
            reasons = reasons or [f"pytest ended with exit code {exit_code}"]
            return cls("failed", int(exit_code), warn_undecided, tuple(reasons))
        return cls("passed", int(exit_code), warn_undecided, ())


def unsupported_verdicts(
    verdicts: Sequence[Data], *, warn_undecided: bool
) -> list[tuple[str, str, str]]:
    """Requirement, case and word of every verdict that the gate does not accept; worst first."""
    accepted = {"supported"} | ({"undecided"} if warn_undecided else set())
    found = [
        (one["requirement"], one["case"], one["verdict"])
        for one in verdicts
        if one["verdict"] not in accepted and one["waiver"] is None
    ]
    return sorted(found, key=lambda one: one[2] != "violated")
