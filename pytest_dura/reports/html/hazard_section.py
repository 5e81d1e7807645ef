"""The page's matrix from hazards over requirements and cases to verdicts and episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.hazards import HazardEvidence
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.contents import EpisodeLinks, ReportContents, split_folded, verdict_key
from pytest_dura.reports.hazards import (
    bound_sentence,
    condition_lines,
    hazards_by_need,
    status_sentence,
)

_MAX_STEPS = 12
"""Verdicts of a requirement that are shown under a hazard; the table of requirements has more."""

Data = Mapping[str, Any]


def hazard_section(record: SessionRecord, contents: ReportContents, _links: EpisodeLinks) -> Data:
    """The hazards, those without evidence first, each with its requirements and their verdicts."""
    rows = [
        {
            "hazard": evidence.hazard,
            "sentence": f"{status_sentence(evidence)} {bound_sentence(evidence)}",
            "lacking": not evidence.has_evidence,
            "stated": [line for line in condition_lines(evidence.hazard) if line[1] != "none"],
            "requirements": list(_requirements(evidence, contents)),
        }
        for evidence in hazards_by_need(record)
    ]
    several = len({case.component for case in record.head.cases}) > 1
    return {"several": several, "rows": rows} if rows else {}


def _requirements(evidence: HazardEvidence, contents: ReportContents) -> Iterator[Data]:
    for requirement in evidence.requirements:
        verdicts = evidence.verdicts_on(requirement)
        # Rows that the page does not have cannot be linked; they are counted.
        shown, _ = split_folded(verdicts, contents.folded, verdict_key)
        shown.sort(key=lambda verdict: WORST_FIRST.index(verdict.verdict))
        counts = Counter[str](verdict.verdict for verdict in verdicts)
        yield {
            "requirement": requirement,
            "counts": [(status, counts[status]) for status in WORST_FIRST if counts[status]],
            "verdicts": shown[:_MAX_STEPS],
            "more": len(verdicts) - len(shown[:_MAX_STEPS]),
        }
