"""Section: the cases as the paper's table has them, and the plot of their clearance times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import case_anchor
from pytest_dura.evidence.formats.report.charts import ClearanceRow, clearance_chart
from pytest_dura.evidence.formats.report.gathering import CaseTally, Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.session_record import SessionRecord

Data = Mapping[str, Any]


def section(record: SessionRecord, gathered: Gathered, _links: Links) -> Data:
    """One row for each case and component, and the chart where anything was cleared."""
    cases = record["cases"]
    rows = []
    chart = []
    anchors: set[str] = set()
    for case in cases:
        found = case_anchor(case["id"])
        tally = gathered.cases.get((case["id"], case["component"]), CaseTally())
        rows.append({**case, "anchor": None if found in anchors else found, "tally": tally})
        anchors.add(found)
        if tally.times:
            time = case["metrics"]["clearance_time"] or {"mean": None, "sd": None}
            chart.append(
                ClearanceRow(case["id"], tally.times, tally.cleared, time["mean"], time["sd"])
            )
    return {
        "rows": rows,
        "several": len({case["component"] for case in cases}) > 1,
        "users": sorted({name for case in cases for name in case["metrics"]["user"]}),
        "chart": clearance_chart(chart) if chart else None,
    }
