"""Section: how good the monitors were, and what recovery did."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import verdict_anchor
from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.report.requirements import SEQUENTIAL
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.requirements.model import FAULTS

Data = Mapping[str, Any]


def section(record: SessionRecord, _gathered: Gathered, _links: Links) -> Data:
    """Monitors that had anything to see or to say, how many had not, and the pairs of recovery."""
    told = [
        one
        for one in record["monitors"]
        if one["true_positives"] + one["false_negatives"] + one["false_positives"]
    ]
    switching = {
        (case["id"], case["component"]): case["metrics"]["switching"] for case in record["cases"]
    }
    paired = [
        {
            **one,
            "anchor": verdict_anchor(one["requirement"], one["case"]),
            "switching": switching.get((one["case"], one["component"])),
            "fixed_n": one["method"] not in SEQUENTIAL,
        }
        for one in record["verdicts"]
        if one["pairs"] and ("only_with" in one["pairs"] or "change" in one["pairs"])
    ]
    attacks = [one for one in paired if one["pairs"]["without"] == FAULTS]
    pairs = [one for one in paired if one not in attacks and "only_with" in one["pairs"]]
    horizons = sorted({one["horizon"] for one in told if one["horizon"] is not None})
    return {
        "rows": _together(told),
        "horizons": horizons,
        "silent": len(record["monitors"]) - len(told),
        "pairs": pairs,
        "attacks": attacks,
        "effectiveness": record["effectiveness"],
        "several": len({one["component"] for one in record["effectiveness"]}) > 1,
    }


def _together(found: list[Data]) -> list[Data]:
    """Rows that differ in nothing but their target as one."""
    same: dict[str, dict[str, Any]] = {}
    for one in found:
        figures = json.dumps({key: value for key, value in one.items() if key != "target"})
        row = same.setdefault(figures, {**one, "targets": []})
        row["targets"].append(one["target"])
    return list(same.values())
