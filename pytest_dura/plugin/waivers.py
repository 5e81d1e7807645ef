"""Waivers: what excuses an item whose verdict is not "supported"."""

from __future__ import annotations

import pytest


def waiver_of(report: pytest.TestReport) -> tuple[str, str] | None:
    """What excuses the item of a report, and why; ``None`` if nothing does."""
    reason = getattr(report, "wasxfail", None)
    if reason is not None:
        return "xfail", reason
    if str(report.outcome) == "rerun":  # of pytest-rerunfailures
        return "rerun", "the item was run again"
    if report.skipped and report.when == "setup":
        longrepr = report.longrepr
        return "skip", longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return None
