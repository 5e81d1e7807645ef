"""The page's matrix from hazards over requirements and cases to verdicts and episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.evidence.hazards import HazardEvidence
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    anchor,
    case_anchor,
    requirement_anchor,
    split_folded,
    verdict_anchor,
    verdict_key,
)
from pytest_dura.reports.hazards import (
    bound_sentence,
    condition_lines,
    hazards_by_need,
    status_sentence,
)
from pytest_dura.requirements.model import Requirement

_MAX_STEPS = 12
"""Verdicts of a requirement that are shown under a hazard; the table of requirements has more."""
_MAX_EPISODES = 3
_WORST_FIRST = ("violated", "undecided", "supported")

Data = Mapping[str, Any]


def hazard_section(record: SessionRecord, contents: ReportContents, links: EpisodeLinks) -> Data:
    """The hazards, those without evidence first, each with its requirements and their verdicts."""
    rows = [_hazard_row(evidence, contents, links) for evidence in hazards_by_need(record)]
    several = len({case.component for case in record.head.cases}) > 1
    return {"several": several, "rows": rows} if rows else {}


def _hazard_row(evidence: HazardEvidence, contents: ReportContents, links: EpisodeLinks) -> Data:
    hazard = evidence.hazard
    return {
        "id": hazard.id,
        "anchor": anchor("hazard", hazard.id),
        "text": hazard.text,
        "severity": hazard.severity,
        "status": evidence.status,
        "sentence": f"{status_sentence(evidence)} {bound_sentence(evidence)}",
        "lacking": not evidence.has_evidence,
        "stated": [line for line in condition_lines(hazard) if line[1] != "none"],
        "requirements": [
            _requirement_row(requirement, evidence.verdicts_on(requirement), contents, links)
            for requirement in evidence.requirements
        ],
    }


def _requirement_row(
    requirement: Requirement,
    verdicts: Sequence[ItemVerdict],
    contents: ReportContents,
    links: EpisodeLinks,
) -> Data:
    # Rows that the page does not have cannot be linked; they are counted.
    shown, _ = split_folded(verdicts, contents.folded, verdict_key)
    shown.sort(key=lambda verdict: _WORST_FIRST.index(verdict.verdict))
    counts: Counter[str] = Counter(verdict.verdict for verdict in verdicts)
    return {
        "id": requirement.id,
        "anchor": requirement_anchor(requirement.id),
        "text": requirement.text,
        "counts": [(status, counts[status]) for status in _WORST_FIRST if counts[status]],
        "steps": [_step(verdict, links) for verdict in shown[:_MAX_STEPS]],
        "more": len(verdicts) - len(shown[:_MAX_STEPS]),
    }


def _step(verdict: ItemVerdict, links: EpisodeLinks) -> Data:
    episodes = verdict.counterexamples[:_MAX_EPISODES]
    return {
        "case": verdict.case,
        "component": verdict.component,
        "case_anchor": case_anchor(verdict.case),
        "verdict": verdict.verdict,
        "verdict_anchor": verdict_anchor(verdict.requirement, verdict.case),
        "waived": verdict.waiver is not None,
        "episodes": [
            {"id": each.episode, "link": links.of_episode(each.episode, verdict.component)}
            for each in episodes
        ],
        "more": len(verdict.counterexamples) - len(episodes),
    }
