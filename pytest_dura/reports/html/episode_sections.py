"""Sections of the report on runs: cases and episodes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.columns import Shown, shown_in
from pytest_dura.reports.contents import (
    CaseKey,
    EpisodeLinks,
    ListedEpisode,
    ReportContents,
    case_anchor,
    case_key,
    fault_names,
    faults_by_case,
    split_folded,
    verdict_key,
)
from pytest_dura.reports.tables import case_columns

Data = Mapping[str, Any]

_MAX_LINKED = 6
"""Episodes that a case links to; the list of episodes has more."""


def case_section(record: SessionRecord, contents: ReportContents, _links: EpisodeLinks) -> Data:
    """One entry for each case and component, which together count each episode once.

    Arms that lack a role come last: they are there to be compared with.
    """
    cases = record.head.cases
    columns = shown_in(case_columns(cases, record.head.measures), Shown.PAGE)
    shown, rest = split_folded(cases, contents.folded, case_key)
    verdicts: dict[CaseKey, list[ItemVerdict]] = defaultdict(list)
    for verdict in record.head.verdicts:
        verdicts[verdict_key(verdict)].append(verdict)
    episodes: dict[CaseKey, list[ListedEpisode]] = defaultdict(list)
    for each in contents.listed:
        episodes[each.episode.case, each.episode.component].append(each)
    tallies = dict(contents.cases)
    anchors: set[str] = set()
    rows: list[dict[str, Any]] = []
    for case in shown:
        anchor = case_anchor(case.id)
        key = case_key(case)
        judged = verdicts.get(key, [])
        named = {verdict.requirement for verdict in judged}
        rows.append(
            {
                "case": case,
                "anchor": None if anchor in anchors else anchor,
                "verdicts": judged,
                # An arm without a role is there for pairs: the verdicts stand on the case itself.
                "unjudged": [] if case.without else sorted(set(case.requirements) - named),
                "episodes": episodes.get(key, [])[:_MAX_LINKED],
                "tally": tallies.pop(key, Counter()),
            }
        )
        anchors.add(anchor)
    return {
        "groups": [
            {
                "arms": arms,
                "rows": group,
                "folded": {
                    "number": len(folded),
                    "sums": [column.summed(folded) for column in columns[1:]],
                    "tally": sum((tallies.pop(case_key(case), Counter()) for case in folded),
                                 Counter[str]()),
                },
            }
            for arms in (False, True)
            if (group := [row for row in rows if bool(row["case"].without) is arms])
            + (folded := [case for case in rest if bool(case.without) is arms])
        ],
        "rows": len(rows),
        "overall": [total for total in record.head.overall if total.cases > 1],
        "columns": columns,
        "several": len({case.component for case in cases}) > 1,
        "faults": fault_names(record, contents.folded),
        # Episodes of a case that the record does not list are counted all the same.
        "unlisted": list(tallies.items()),
    }  # fmt: skip


def episode_section(record: SessionRecord, contents: ReportContents, links: EpisodeLinks) -> Data:
    """Single episodes, those that violated something first."""
    faults = faults_by_case(record)
    anchors: set[str] = set()
    rows = []
    for each in contents.listed:
        own = links.listed[each.key]
        key = each.episode.case, each.episode.component
        # A run by hand may bear the id of a planned one: the first has the anchor.
        anchor = None if own in anchors else own
        anchors.add(own)
        rows.append({"listed": each, "anchor": anchor, "faults": faults.get(key, ())})
    return {
        "several": len({key[1] for key in contents.cases}) > 1,
        "total": record.head.totals.episodes,
        "shown": len(rows),
        "rows": rows,
        "violated": sorted({name for each in contents.listed for name in each.violates}),
        "faults": fault_names(record, contents.folded),
        "left_out": record.head.totals.episodes - len(rows),
    }
