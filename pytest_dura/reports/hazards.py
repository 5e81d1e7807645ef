"""How hazards and what the session has on them are worded, in every format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.hazards import (
    WITHOUT_EVIDENCE,
    HazardEvidence,
    HazardStatus,
    hazard_evidence,
)
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import counted, first_few, name, one_line
from pytest_dura.reports.columns import Cell, Column, name_cell, prose_cell
from pytest_dura.reports.contents import requirement_anchor
from pytest_dura.reports.verdicts import part_text
from pytest_dura.requirements.hazards import SEVERITIES, Hazard

NO_ASIL = "no ASIL follows without classes of exposure and controllability"
"""What a severity alone does not say, in the terms of ISO 26262-3."""
_WITHOUT = {
    "no requirement": "no requirement of the session names",
    "no verdict": "nothing was judged that is to mitigate",
    "none supported": "no verdict supports the mitigation of",
}


def condition_lines(hazard: Hazard) -> Iterator[tuple[str, str]]:
    """Yield label and text of what is stated of a hazard beside its own text."""
    yield "Loss", hazard.loss
    severity = f"{hazard.severity}; {NO_ASIL}" if hazard.severity else "none"
    yield "Severity, as declared", severity
    for label, text in (
        ("Operating condition", hazard.operating_condition),
        ("Triggering condition", hazard.triggering_condition),
        ("Source", hazard.source),
        ("Acceptance criterion, as declared", criterion_text(hazard)),
    ):
        if text:
            yield label, text


def criterion_text(hazard: Hazard) -> str:
    """The residual risk that the hazard's author accepts; empty where none is declared."""
    rate = ""
    if hazard.at_most is not None:
        rate = (
            f"in each case at most {part_text(hazard.at_most)} of the runs violate a requirement "
            "on it"
        )
    return "; ".join(part for part in (hazard.acceptance_criterion.rstrip("."), rate) if part)


def weakest_verdict(evidence: HazardEvidence) -> ItemVerdict | None:
    """The supported verdict on a hazard that shows the least; ``None`` where none supports it."""
    supported = [verdict for verdict in evidence.verdicts if verdict.verdict == "supported"]
    uppers = [1.0 if each.bound.upper is None else each.bound.upper for each in supported]
    return supported[uppers.index(max(uppers))] if supported else None


def bound_sentence(evidence: HazardEvidence) -> str:
    """Say to which extent the mitigation of a hazard was tested: its weakest bound."""
    weakest = weakest_verdict(evidence)
    if weakest is None:
        return "No verdict supports it, so that there is no bound."
    place = f"{name(weakest.requirement)} in {name(weakest.case)}, n = {weakest.episodes}"
    if weakest.bound.upper is None:
        return f"No bound on the rate of violations follows for {place}."
    return (
        f"The weakest bound of its supported verdicts: at most {part_text(weakest.bound.upper)} "
        f"of such runs violate {place}, {part_text(weakest.bound.confidence)} confidence."
    )


def short_bound(evidence: HazardEvidence) -> str:
    """The weakest bound of a hazard's supported verdicts in a few characters."""
    weakest = weakest_verdict(evidence)
    if weakest is None or weakest.bound.upper is None:
        return "none"
    return f"≤ {part_text(weakest.bound.upper)} ({part_text(weakest.bound.confidence)} conf.)"


def criterion_met(evidence: HazardEvidence) -> bool:
    """Whether every verdict on a hazard shows the rate that its author accepts."""
    accepted, weakest = evidence.hazard.at_most, weakest_verdict(evidence)
    if accepted is None or weakest is None or evidence.status != "supported":
        return False
    return weakest.bound.upper is not None and weakest.bound.upper <= accepted


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
        listed = first_few([_with_severity(evidence.hazard) for evidence in group])
        yield (
            f"{len(group)} of {counted(total, 'hazard')} without evidence, since "
            f"{_WITHOUT[status]} {'it' if len(group) == 1 else 'them'}: {listed}."
        )


def _with_severity(hazard: Hazard) -> str:
    return f"{name(hazard.id)} ({hazard.severity})" if hazard.severity else name(hazard.id)


def _accepted_cell(evidence: HazardEvidence) -> Cell | str:
    text = criterion_text(evidence.hazard)
    if not text:
        return "none declared"
    shown = "shown" if criterion_met(evidence) else "not shown"
    return prose_cell(f"{text} ({shown})")


def _bound_cell(evidence: HazardEvidence) -> Cell:
    text, weakest = short_bound(evidence), weakest_verdict(evidence)
    notes: tuple[str, ...] = ()
    if weakest is not None:
        place = f"{name(weakest.requirement)} in {name(weakest.case)}"
        notes = (f"{place}, n = {weakest.episodes}",)
    return Cell(text, text, text, notes, below=True)


def _requirements_cell(evidence: HazardEvidence) -> Cell:
    """The requirements on a hazard; in the page with their verdicts, to which they lead."""
    names = ", ".join(each.id for each in evidence.requirements)
    if not names:
        return prose_cell("none")
    links = []
    for each in evidence.requirements:
        counts = Counter[str](verdict.verdict for verdict in evidence.verdicts_on(each))
        shown = [f"{counts[status]} {status}" for status in WORST_FIRST if counts[status]]
        text = f"{name(each.id)}: {', '.join(shown) or 'nothing was judged'}"
        links.append((text, requirement_anchor(each.id)))
    return replace(prose_cell(names), links=tuple(links))


def _text_cell(evidence: HazardEvidence) -> Cell:
    stated = (
        f"{label}: {one_line(text)}"
        for label, text in condition_lines(evidence.hazard)
        if not label.startswith(("Severity", "Acceptance")) and text != "none"
    )
    return replace(
        prose_cell(evidence.hazard.text),
        notes=tuple(stated),
        below=True,
        folded="Loss and conditions",
    )


def _evidence_cell(evidence: HazardEvidence) -> Cell:
    """What the verdicts come to; the page says why there is no evidence."""
    status = evidence.status
    if evidence.has_evidence:
        return Cell(status, status, status)
    page = f"without evidence: {status_sentence(evidence)}"
    return Cell(status, status, page, style="some")


HAZARD_COLUMNS: Sequence[Column[HazardEvidence]] = (
    Column("hazard", lambda row: name_cell(row.hazard.id), kind=""),
    Column("severity", lambda row: row.hazard.severity, kind="", meaning=NO_ASIL),
    Column("text", _text_cell, kind="prose"),
    Column("requirements", _requirements_cell, kind=""),
    Column("evidence", _evidence_cell, kind="text"),
    Column("weakest bound", _bound_cell, kind=""),
    Column("accepted", _accepted_cell, kind=""),
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
    return f"hazards without evidence: {len(names)} of {total}: {first_few(names)}"
