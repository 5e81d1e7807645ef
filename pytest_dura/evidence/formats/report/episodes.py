"""Section: the counts of episodes by case, and a bounded list of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import case_anchor, requirement_anchor
from pytest_dura.evidence.formats.report.folding import Key
from pytest_dura.evidence.formats.report.gathering import (
    UNREMARKABLE,
    CaseTally,
    Gathered,
    Listed,
)
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]


def section(record: SessionRecord, gathered: Gathered, links: Links) -> Data:
    """Rows of counts, which together count each episode once, and rows of single episodes."""
    left = dict(gathered.cases)
    counts = []
    folded: list[tuple[Data, int]] = []
    for case in record["cases"]:
        key = case["id"], case["component"]
        tally = left.pop(key, CaseTally())
        if key in gathered.folded and tally.words["valid"] == tally.words.total():
            folded.append((case, tally.words.total()))
        else:
            counts.append(_counts(key, tally, case))
    # Episodes of a case that the record does not list are counted all the same.
    counts += [_counts(key, tally, None) for key, tally in left.items()]
    anchors: set[str] = set()
    return {
        "counts": counts,
        "folded": {
            "number": len(folded),
            "planned": sum(case["planned"] for case, _ in folded),
            "run": sum(run for _, run in folded),
        },
        "several": len({key[1] for key in gathered.cases}) > 1,
        "total": gathered.total,
        "shown": len(gathered.listed),
        "rows": [_row(one, links, anchors) for one in gathered.listed if one.rank < UNREMARKABLE],
        "others": [
            _row(one, links, anchors) for one in gathered.listed if one.rank == UNREMARKABLE
        ],
        "left_out": gathered.total - len(gathered.listed),
    }


def _counts(key: Key, tally: CaseTally, case: Data | None) -> Data:
    return {
        "case": key[0],
        "component": key[1],
        "listed": case is not None,
        "anchor": case_anchor(key[0]),
        "planned": None if case is None else case["planned"],
        "never": [] if case is None else case["missing_runs"],
        "never_total": 0 if case is None else case["missing_runs_total"],
        "run": tally.words.total(),
        **{word: tally.words[word] for word in ("valid", "invalid", "missing")},
    }


def _row(one: Listed, links: Links, anchors: set[str]) -> Data:
    own = links.listed[one.key]
    anchor = None if own in anchors else own
    anchors.add(own)
    return {
        **one.episode,
        "anchor": anchor,
        "violates": [{"id": name, "anchor": requirement_anchor(name)} for name in one.violates],
        "player": links.players.get(one.key),
        "why": one.episode["failure"] or one.episode["invalid_reason"] or one.episode["critical"],
    }
