"""Verdicts as a file of comma-separated values, which a project registers by itself."""

from __future__ import annotations

import csv
import io

from pytest_dura import FORMATS
from pytest_dura.evidence import SessionRecord


@FORMATS.register("verdicts.csv")
class VerdictsCsv:
    """Writes a row for each verdict."""

    @staticmethod
    def render(record: SessionRecord) -> str:
        """Render the file."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["case", "requirement", "verdict", "violations", "episodes"])
        for each in record.head.verdicts:
            figures = each.violations, each.episodes
            rows.writerow([each.case, each.requirement, each.verdict, *figures])
        return text.getvalue()
