"""Section: the gate's result, and what the session shows and does not show, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.in_words import not_shown, shown
from pytest_dura.evidence.formats.report.anchors import verdict_anchor
from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.stated import merged, part, selected
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]


def section(record: SessionRecord, _gathered: Gathered, _links: Links) -> Data:
    """Sentences, and the verdicts that the gate's reasons speak of, by the words of the reason."""
    anchors = {}
    for one in record["verdicts"]:
        requirement, case = one["requirement"], one["case"]
        reason = f"{requirement} on {case} is {one['verdict']}"
        anchors[reason] = verdict_anchor(requirement, case)
    return {
        "anchors": anchors,
        "shown": list(shown(record)),
        "not_shown": list(not_shown(record)),
        "part": part(record),
        "merged": merged(record),
        "selected": selected(record),
    }
