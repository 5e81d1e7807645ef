"""Lines that items report, of plain data by kind."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pytest_dura.core.codec import decode
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.gather import claim
from pytest_dura.evidence.lines import (
    ClaimedCase,
    EpisodeLine,
    Line,
    Remark,
    UsedComponent,
    asked_by,
)
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.requirements.judgements import Judgement
from pytest_dura.requirements.model import Requirement

_READERS = {
    "components": lambda data: UsedComponent(data, {}),
    "cases": CasePlan.from_data,
    "claimed": ClaimedCase.from_data,
    "requirements": lambda data: decode(Requirement, data),
    "episodes": EpisodeLine,
    "judgements": lambda data: decode(Judgement, data),
    "searches": lambda data: decode(RecordedSearch, data),
}


def report(
    item: str = "a/b::R", recorded_as: str = "", attempt: int = 1, *, retried: bool = False,
    **parts: Any,
) -> list[Line]:  # fmt: skip
    """What an item reports."""
    lines: list[Line] = [Remark("retried", item)] if retried else []
    for kind, entries in parts.items():
        lines += [asked_by(_READERS[kind](each), item, recorded_as, attempt) for each in entries]
    return lines


def expected(item: str, requirement: dict[str, Any], case: dict[str, Any]) -> Iterator[Line]:
    """What is known of an item before it runs."""
    plan, known = ClaimedCase.from_data(case), decode(Requirement, requirement)
    yield from (plan, known, claim(item, known.id, plan))
