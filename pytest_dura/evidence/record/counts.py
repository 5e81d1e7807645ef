"""Counts: what a format states of a session, so that formats can be compared with the record."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.evidence.record.session_record import SessionRecord


@dataclass(frozen=True)
class Counts:
    """Counts that every format states. ``waived`` verdicts are counted by their word as well.

    Args:
        gate: ``passed``, ``failed`` or ``incomplete``.
        requirements: Requirements of the session.
        cases: Cases with one component each.
        episodes: Episodes that were run.
        valid: Those that are valid.
        invalid: Those whose planned fault never manifested.
        missing: Those that an infrastructure error ended.
        supported: Verdicts.
        violated: Verdicts.
        undecided: Verdicts.
        waived: Verdicts that a waiver excuses.
    """

    gate: str
    requirements: int
    cases: int
    episodes: int
    valid: int
    invalid: int
    missing: int
    supported: int
    violated: int
    undecided: int
    waived: int

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return dict(vars(self))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Counts:
        """The inverse of :meth:`to_json`.

        Raises:
            TypeError: If a count is missing, or there are others.
        """
        return cls(**data)

    @classmethod
    def of(cls, record: SessionRecord) -> Counts:
        """Counted in the record itself, and not taken from its ``totals``."""
        validity = Counter(one["validity"] for one in record.episodes())
        words = Counter(one["verdict"] for one in record["verdicts"])
        return cls(
            gate=record["gate"]["result"],
            requirements=len(record["requirements"]),
            cases=len(record["cases"]),
            episodes=validity.total(),
            valid=validity["valid"],
            invalid=validity["invalid"],
            missing=validity["missing"],
            supported=words["supported"],
            violated=words["violated"],
            undecided=words["undecided"],
            waived=sum(one["waiver"] is not None for one in record["verdicts"]),
        )
