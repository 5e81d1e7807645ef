"""How hazards and what the session has on them are worded, in every format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from pytest_dura.evidence.hazards import (
    WITHOUT_EVIDENCE,
    HazardEvidence,
    HazardStatus,
    hazard_evidence,
)
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import Column, name_cell, prose_cell
from pytest_dura.requirements.hazards import SEVERITIES, Hazard

_MOST_NAMES = 8
_WITHOUT = {
    "no requirement": "no requirement of the session names",
    "no verdict": "nothing was judged that is to mitigate",
    "none supported": "no verdict supports the mitigation of",
}


def condition_lines(hazard: Hazard) -> Iterator[tuple[str, str]]:
    """Yield label and text of what is stated of a hazard beside its own text."""
    yield "Loss", hazard.loss
    yield "Severity, as declared", hazard.severity or "none"
    for label, text in (
        ("Operating condition", hazard.operating_condition),
        ("Triggering condition", hazard.triggering_condition),
        ("Source", hazard.source),
    ):
        if text:
            yield label, text


def status_sentence(evidence: HazardEvidence) -> str:
    """Say in a sentence what the verdicts on a hazard's requirements come to."""
    if evidence.status == "no requirement":
        return "No requirement of the session names it."
    requirements = counted(len(evidence.requirements), "requirement")
    if not evidence.verdicts:
        return f"Nothing was judged by its {requirements}."
    counts = Counter(verdict.verdict for verdict in evidence.verdicts)
    listed = ", ".join(
        f"{counts[status]} {status}"
        for status in ("supported", "violated", "undecided")
        if counts[status]
    )
    return f"Verdicts on its {requirements}: {listed}."


def hazards_by_need(record: SessionRecord) -> list[HazardEvidence]:
    """List the hazards: those without evidence first, then the violated, the most severe first."""
    return sorted(hazard_evidence(record), key=_need)


def _need(evidence: HazardEvidence) -> tuple[bool, bool, int]:
    held = evidence.has_evidence
    return held, held and evidence.status != "violated", _severity_rank(evidence)


def without_evidence(record: SessionRecord) -> dict[HazardStatus, list[HazardEvidence]]:
    """Group the hazards whose mitigation nothing supports by why, the most severe first."""
    groups: dict[HazardStatus, list[HazardEvidence]] = {}
    for evidence in sorted(hazard_evidence(record), key=_severity_rank):
        if not evidence.has_evidence:
            status = evidence.status
            groups.setdefault("none supported" if status == "violated" else status, []).append(
                evidence
            )
    return {status: groups[status] for status in WITHOUT_EVIDENCE if status in groups}


def _severity_rank(evidence: HazardEvidence) -> int:
    """Sort key: what is declared more severe comes first, what is not declared last."""
    severity = evidence.hazard.severity
    return len(SEVERITIES) - SEVERITIES.index(severity) if severity else len(SEVERITIES) + 1


def without_evidence_sentences(record: SessionRecord) -> Iterator[str]:
    """Sentences on hazards without evidence. Names in them are a user's, and to be escaped."""
    total = len(record.head.hazards or ())
    for status, group in without_evidence(record).items():
        names = [_with_severity(evidence.hazard) for evidence in group]
        listed = ", ".join(names[:_MOST_NAMES])
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        yield (
            f"{len(group)} of {counted(total, 'hazard')} without evidence, since "
            f"{_WITHOUT[status]} {'it' if len(group) == 1 else 'them'}: {listed}{more}."
        )


def _with_severity(hazard: Hazard) -> str:
    return f"{name(hazard.id)} ({hazard.severity})" if hazard.severity else name(hazard.id)


HAZARD_COLUMNS: Sequence[Column[HazardEvidence]] = (
    Column("hazard", lambda row: name_cell(row.hazard.id)),
    Column("severity", lambda row: row.hazard.severity),
    Column("text", lambda row: prose_cell(row.hazard.text)),
    Column(
        "requirements",
        lambda row: prose_cell(", ".join(each.id for each in row.requirements) or "none"),
    ),
    Column("evidence", lambda row: row.status),
)
"""Columns of the table of hazards."""


def hazard_line(record: SessionRecord) -> str:
    """Say in a line which hazards lack evidence; empty where all have some."""
    names = [
        _with_severity(evidence.hazard)
        for group in without_evidence(record).values()
        for evidence in group
    ]
    if not names:
        return ""
    total = len(record.head.hazards or ())
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return (
        f"hazards without evidence: {len(names)} of {total}: {', '.join(names[:_MOST_NAMES])}{more}"
    )
