"""Section: where the figures come from, and what changed since a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]

UNKNOWN: dict[str, Any] = {
    "name": None, "path": "", "params": {}, "version": None, "digest": None, "opaque": False,
    "file_count": 0,
}  # fmt: skip
"""A component of which nothing was heard."""


def section(record: SessionRecord, _gathered: Gathered, _links: Links) -> Data:
    """Components, packages, inputs and timings, and the comparisons with the baseline."""
    under_test = record["component_under_test"]
    return {
        "components": [UNKNOWN | one for one in (under_test, *under_test.get("others", ()))],
        "models": record["models"],
        "packages": sorted(record["environment"]["packages"].items()),
        "redacted": sorted(record["redacted"].items()),
        "inputs": record["inputs"],
        "argument": record["argument"],
        "timings": record["timings"],
        "processing": sorted(record["timings"]["processing_seconds"].items()),
        "baseline": record["baseline"],
    }
