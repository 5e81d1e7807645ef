"""Section: from requirements to episodes and back, and what hangs loose at either end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import (
    case_anchor,
    requirement_anchor,
    verdict_anchor,
)
from pytest_dura.evidence.formats.report.folding import apart
from pytest_dura.evidence.formats.report.gathering import CaseTally, Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.report.requirements import MAX_COUNTEREXAMPLES
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]


def section(record: SessionRecord, gathered: Gathered, links: Links) -> Data:
    """Rows of both directions."""
    by_requirement: dict[str, list[Data]] = {}
    by_case: dict[tuple[str, str], list[Data]] = {}
    shown, rest = apart(record["verdicts"], gathered.folded)
    folded = Counter(verdict["requirement"] for verdict in rest)
    cases, folded_cases = apart(record["cases"], gathered.folded, "id")
    for verdict in shown:
        told = _step(verdict, links)
        by_requirement.setdefault(verdict["requirement"], []).append(told)
        by_case.setdefault((verdict["case"], verdict["component"]), []).append(told)
    named = {one["id"] for one in record["requirements"]}
    return {
        "several": len({case["component"] for case in record["cases"]}) > 1,
        "forward": [
            {
                **one,
                "anchor": requirement_anchor(one["id"]),
                "steps": by_requirement.get(one["id"], []),
                "folded": folded[one["id"]],
            }
            for one in record["requirements"]
        ],
        "backward": [_case(case, by_case, gathered) for case in cases],
        "folded": len(folded_cases),
        "unlisted": sorted({*by_requirement, *folded} - named),
    }


def _step(verdict: Data, links: Links) -> Data:
    shown = verdict["counterexamples"][:MAX_COUNTEREXAMPLES]
    return {
        "requirement": verdict["requirement"],
        "requirement_anchor": requirement_anchor(verdict["requirement"]),
        "case": verdict["case"],
        "component": verdict["component"],
        "case_anchor": case_anchor(verdict["case"]),
        "verdict": verdict["verdict"],
        "verdict_anchor": verdict_anchor(verdict["requirement"], verdict["case"]),
        "item": verdict["item"],
        "waiver": verdict["waiver"],
        "episodes": [
            {
                "id": one["episode"],
                "link": links.of_episode(one["episode"], verdict["component"]),
            }
            for one in shown
        ],
        "more": len(verdict["counterexamples"]) - len(shown),
    }


def _case(case: Data, by_case: Mapping[tuple[str, str], list[Data]], gathered: Gathered) -> Data:
    key = case["id"], case["component"]
    steps = by_case.get(key, [])
    judged = {one["requirement"] for one in steps}
    return {
        **case,
        "anchor": case_anchor(case["id"]),
        "steps": steps,
        # An arm without a role is there for pairs: the verdicts stand on the case it belongs to.
        "unjudged": [] if case["without"] else sorted(set(case["requirements"]) - judged),
        "run": gathered.cases.get(key, CaseTally()).words.total(),
    }
