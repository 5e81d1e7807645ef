"""Section: each requirement with its verdicts, their bounds and their counterexamples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import requirement_anchor, verdict_anchor
from pytest_dura.evidence.formats.report.folding import apart
from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.stated import by_assertion
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.requirements.verdicts.situations import SITUATIONS

WORST_FIRST = ("violated", "undecided", "supported")
MAX_COUNTEREXAMPLES = 5
"""Counterexamples of a verdict that are named; the list of episodes has more."""
SEQUENTIAL = ("sprt", "e-process")
"""Methods for which McNemar's p does not hold: their number of pairs depends on what they show."""

Data = Mapping[str, Any]


def section(record: SessionRecord, gathered: Gathered, links: Links) -> Data:
    """The requirements with their verdicts, the worst first, or else in the record's order."""
    several = len({one["component"] for one in record["cases"]}) > 1
    rows: dict[str, list[Data]] = {}
    anchors: set[str] = set()
    methods: dict[tuple[str, str], int] = {}
    shown, rest = apart(record["verdicts"], gathered.folded)
    folded: dict[str, list[Data]] = {}
    for verdict in rest:
        folded.setdefault(verdict["requirement"], []).append(verdict)
    for verdict in sorted(shown, key=_badness):
        found = verdict_anchor(verdict["requirement"], verdict["case"])
        own = None if found in anchors else found
        anchors.add(found)
        note = methods.setdefault((verdict["bound"]["method"], verdict["method"]), len(methods) + 1)
        row = {**_row(verdict, links), "anchor": own, "note": note}
        rows.setdefault(verdict["requirement"], []).append(row)
    groups = [
        {
            "declared": True,
            **_described(one),
            "rows": rows.pop(one["id"], []),
            "folded": _folded(folded.pop(one["id"], [])),
        }
        for one in record["requirements"]
    ]
    others = [
        {
            "declared": False,
            **_described({"id": name}),
            "rows": rows.get(name, []),
            "folded": _folded(folded.get(name, [])),
        }
        for name in dict.fromkeys([*rows, *folded])
    ]
    groups.sort(key=lambda group: min(map(_badness, group["rows"]), default=len(WORST_FIRST)))
    return {"groups": groups + others, "several": several, "methods": list(methods)}


def _badness(verdict: Data) -> int:
    return WORST_FIRST.index(verdict["verdict"])


def _folded(verdicts: list[Data]) -> Data:
    """What is told of verdicts without rows: all of them are supported, by valid episodes."""
    margins = [one["margin"] for one in verdicts if one["margin"] is not None]
    bounds = [one["bound"]["upper"] for one in verdicts if one["bound"]["upper"] is not None]
    return {
        "number": len(verdicts),
        "episodes": sum(one["episodes"] for one in verdicts),
        "vacuous": sum(one["vacuous"] for one in verdicts),
        "margin": min(margins, default=None),
        "upper": max(bounds, default=None),
    }


def _described(requirement: Data) -> Data:
    keys = ("text", "kind", "source", "check", "reason")
    return {
        "id": requirement["id"],
        "anchor": requirement_anchor(requirement["id"]),
        **{key: requirement.get(key, "") for key in keys},
    }


def _row(verdict: Data, links: Links) -> Data:
    shown = verdict["counterexamples"][:MAX_COUNTEREXAMPLES]
    pairs = verdict["pairs"]
    return {
        **verdict,
        "worst": [
            {**one, "link": links.of_episode(one["episode"], verdict["component"])} for one in shown
        ],
        "by_assertion": by_assertion(verdict),
        "more": len(verdict["counterexamples"]) - len(shown),
        "pairs": pairs if pairs and "only_with" in pairs else None,
        "no_rate": SITUATIONS.get(verdict.get("situation") or "", ""),
        "fixed_n": verdict["method"] not in SEQUENTIAL,
    }
