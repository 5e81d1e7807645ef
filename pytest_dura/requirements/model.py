"""Requirement: what the component must do, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

Kind = Literal["safety", "security", "performance", "recovery"]
KINDS: tuple[str, ...] = get_args(Kind)


@dataclass(frozen=True, slots=True)
class Requirement:
    """One requirement.

    Args:
        id: Unique name, such as ``SAF-1``.
        text: What is required, in words.
        kind: The kind of dependability it belongs to.
        source: Where it comes from: a standard, a hazard analysis, a contract.
        check: Formula over signals that each episode must satisfy; empty where test code checks.
        reason: Why the bound is what it is.
    """

    id: str
    text: str = ""
    kind: Kind = "safety"
    source: str = ""
    check: str = ""
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain data for files and the evidence record."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Requirement:
        """The inverse of :meth:`to_json`."""
        return cls(**data)
