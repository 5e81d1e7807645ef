"""Section: the cases as the paper's table has them, and the plot of their clearance times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import case_anchor
from pytest_dura.evidence.formats.report.charts import ClearanceRow, clearance_chart
from pytest_dura.evidence.formats.report.folding import apart
from pytest_dura.evidence.formats.report.gathering import CaseTally, Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]


def section(record: SessionRecord, gathered: Gathered, _links: Links) -> Data:
    """One row for each case and component, and the chart where anything was cleared.

    Arms that lack a role come last: they are there to be compared with.
    """
    cases = record["cases"]
    rows = []
    chart = []
    anchors: set[str] = set()
    shown, rest = apart(cases, gathered.folded, "id")
    for case in shown:
        anchor = case_anchor(case["id"])
        tally = gathered.cases.get((case["id"], case["component"]), CaseTally())
        rows.append({**case, "anchor": None if anchor in anchors else anchor})
        anchors.add(anchor)
        if tally.times and not case["without"]:
            time = case["metrics"]["clearance_time"] or {"mean": None, "sd": None}
            chart.append(
                ClearanceRow(case["id"], tally.times, tally.cleared, time["mean"], time["sd"])
            )
    return {
        "groups": [
            {"arms": arms, "rows": found, "folded": _folded(folded)}
            for arms in (False, True)
            if (found := [row for row in rows if bool(row["without"]) is arms])
            + (folded := [row for row in rest if bool(row["without"]) is arms])
        ],
        "overall": [one for one in record["overall"] if one["cases"] > 1],
        "several": len({case["component"] for case in cases}) > 1,
        "users": sorted({name for case in cases for name in case["metrics"]["user"]}),
        "chart": clearance_chart(chart) if chart else None,
    }


def _folded(cases: list[Data]) -> Data:
    """The sums of cases without rows."""
    metrics = [case["metrics"] for case in cases]
    shares = {
        word: sum(one[word]["valid"] for one in metrics if one[word])
        for word in ("flagged", "gridlock", "rescued", "comfort_failed")
    }
    sums = {
        word: sum(one[word] for one in metrics)
        for word in ("valid", "planned", "recoveries", "alerts")
    }
    return {"number": len(cases), **shares, **sums}
