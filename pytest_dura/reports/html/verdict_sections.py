"""Sections of the report on verdicts, and on models that components asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.columns import Shown, shown_in
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    fault_names,
    faults_by_case,
    requirement_anchor,
    split_folded,
    verdict_anchor,
    verdict_key,
)
from pytest_dura.reports.incidents import KINDS
from pytest_dura.reports.tables import (
    VERDICT_COLUMNS,
)
from pytest_dura.requirements.model import Requirement

Data = Mapping[str, Any]


def requirement_section(
    record: SessionRecord, contents: ReportContents, _links: EpisodeLinks
) -> Data:
    """The requirements with their verdicts, the worst first, or else in the record's order."""
    several = len({case.component for case in record.head.cases}) > 1
    rows: dict[str, list[Data]] = {}
    anchors: set[str] = set()
    methods: dict[tuple[str, str], int] = {}
    shown, rest = split_folded(record.head.verdicts, contents.folded, verdict_key)
    faults_of = faults_by_case(record)
    folded: dict[str, list[ItemVerdict]] = {}
    for verdict in rest:
        folded.setdefault(verdict.requirement, []).append(verdict)
    shown.sort(key=_verdict_rank)
    for verdict in shown:
        anchor = verdict_anchor(verdict.requirement, verdict.case)
        own = None if anchor in anchors else anchor
        anchors.add(anchor)
        note = methods.setdefault((verdict.bound.method, verdict.method), len(methods) + 1)
        faults = faults_of.get(verdict_key(verdict), ())
        row = {"v": verdict, "anchor": own, "note": note, "faults": faults}
        rows.setdefault(verdict.requirement, []).append(row)
    ranks = {verdict.requirement: _verdict_rank(verdict) for verdict in reversed(shown)}
    groups = [
        {
            **encode(requirement),
            "declared": True,
            "anchor": requirement_anchor(requirement.id),
            "rows": rows.pop(requirement.id, []),
            "folded": _folded_verdicts(folded.pop(requirement.id, [])),
        }
        for requirement in sorted(
            record.head.requirements,
            key=lambda own: (ranks.get(own.id, len(WORST_FIRST)), KINDS.index(own.kind)),
        )
    ]
    others = [
        {
            **dict.fromkeys((field.name for field in fields(Requirement)), ""),
            "declared": False,
            "id": name,
            "rows": rows.get(name, []),
            "folded": _folded_verdicts(folded.get(name, [])),
        }
        for name in dict.fromkeys([*rows, *folded])
    ]
    for group in groups + others:
        counts = Counter(row["v"].verdict for row in group["rows"])
        counts["supported"] += group["folded"]["number"]
        group["counts"] = {status: counts[status] for status in WORST_FIRST if counts[status]}
    return {
        "groups": groups + others,
        "rows": len(shown),
        "kinds": sorted({requirement.kind for requirement in record.head.requirements}),
        "faults": fault_names(record, contents.folded),
        "several": several,
        "methods": list(methods),
        "columns": shown_in(VERDICT_COLUMNS, Shown.PAGE),
    }


def _verdict_rank(verdict: ItemVerdict) -> int:
    return WORST_FIRST.index(verdict.verdict)


def _folded_verdicts(verdicts: list[ItemVerdict]) -> Data:
    """Sums of the verdicts without rows; all of them are supported, by valid episodes."""
    margins = [verdict.margin for verdict in verdicts if verdict.margin is not None]
    bounds = [verdict.bound.upper for verdict in verdicts if verdict.bound.upper is not None]
    return {
        "number": len(verdicts),
        "episodes": sum(verdict.episodes for verdict in verdicts),
        "vacuous": sum(verdict.vacuous for verdict in verdicts),
        "margin": min(margins, default=None),
        "upper": max(bounds, default=None),
    }
