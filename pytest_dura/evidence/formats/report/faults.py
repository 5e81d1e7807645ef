"""Section: which requirement held under which fault, and how far each fault got."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import requirement_anchor
from pytest_dura.evidence.formats.report.folding import apart
from pytest_dura.evidence.formats.report.gathering import CaseTally, Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.report.matrix import heading, matrix
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]

NO_FAULT = "no fault"
STEPS = (0.0, 0.05, 0.25, 0.5)
"""Shares of violating episodes above which a cell of the map is a step darker."""


def section(record: SessionRecord, gathered: Gathered, _links: Links) -> Data:
    """The map of faults and requirements, and one row for each fault of each case."""
    chains = []
    shown, rest = apart(record["cases"], gathered.folded, "id")
    for case in shown:
        tally = gathered.cases.get((case["id"], case["component"]), CaseTally())
        for fault in case["metrics"]["faults"]:
            outcomes = sorted(tally.outcomes.get(fault["id"], Counter()).items())
            chains.append({**fault, "case": case, "outcomes": outcomes})
    named = {name for case in shown for name in _faults(case)}
    left = {name for case in rest for name in _faults(case)} - named
    return {
        "heat": _heat(record, left),
        "left_out": len(left),
        "chains": chains,
        "folded": sum(len(case["metrics"]["faults"]) for case in rest),
    }


def _faults(case: Data) -> list[str]:
    return [fault["id"] for fault in case["faults"]] or [NO_FAULT]


def _heat(record: SessionRecord, left_out: Collection[str]) -> Data:
    """Violating among valid episodes, by fault and requirement, over all cases with that fault.

    Runs in which a fault had no effect are no sample of runs with it, and stand in no cell.

    Args:
        record: The record.
        left_out: Names of faults without a row; only folded cases have them.
    """
    faults_of = {
        (case["id"], case["component"]): [fault["id"] for fault in case["faults"]]
        for case in record["cases"]
    }
    cells: dict[tuple[str, str], list[Data]] = defaultdict(list)
    names: dict[str, None] = {}
    for ids in faults_of.values():
        names.update(dict.fromkeys(ids or [NO_FAULT]))
    for verdict in record["verdicts"]:
        ids = faults_of.get((verdict["case"], verdict["component"])) or [NO_FAULT]
        for one in ids:
            names.setdefault(one)
            cells[one, verdict["requirement"]].append(verdict)
    order = sorted(names.keys() - left_out, key=lambda one: (one != NO_FAULT, one))
    requirements = [one["id"] for one in record["requirements"]]
    return matrix(
        [heading(name, anchor=requirement_anchor(name)) for name in requirements],
        [heading(name) for name in order],
        lambda i, j: _cell(cells.get((order[j], requirements[i]))),
        "Fault",
    )


def _cell(verdicts: list[Data] | None) -> Data:
    if not verdicts:
        return {"word": "untested"}
    n = sum(one["episodes"] for one in verdicts)
    violations = sum(one["violations"] for one in verdicts)
    if not n:
        return {"word": "no valid episode"}
    step = sum(violations / n > bound for bound in STEPS)
    doubt = not violations and any(one["verdict"] == "undecided" for one in verdicts)
    also = sum(one["also_without"] or 0 for one in verdicts)
    counts = {"n": n, "violations": violations, "also_without": also}
    return {"word": "", "step": step, "doubt": doubt, **counts}
