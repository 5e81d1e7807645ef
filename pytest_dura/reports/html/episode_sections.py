"""Sections of the report on runs: cases, episodes, matrix, faults, failure modes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.case_model import (
    CaseEntry,
    CellEntry,
    ParameterEntry,
)
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
    requirement_anchor,
    split_folded,
    verdict_anchor,
    verdict_key,
)
from pytest_dura.reports.tables import case_columns
from pytest_dura.reports.wording import coverage_sentence

Data = Mapping[str, Any]
Heading = Mapping[str, Any]
"""``label``, ``below`` (a second line, or empty) and ``anchor`` (or ``None``)."""


def heading(label: str, below: str = "", anchor: str | None = None) -> Heading:
    """Heading of a row or column."""
    return {"label": label, "below": below, "anchor": anchor}


def matrix(
    requirements: Sequence[Heading],
    places: Sequence[Heading],
    cell: Callable[[int, int], Any],
    corner: str,
) -> Mapping[str, Any]:
    """``corner``, ``columns`` and ``rows``; whichever there is less of stands in the columns.

    Args:
        requirements: Their headings.
        places: Headings of what they are held against.
        cell: What stands at the numbers of a requirement and a place.
        corner: What the places are, above their column.
    """
    if len(places) <= len(requirements):
        rows = [
            {**requirement, "cells": [cell(i, j) for j in range(len(places))]}
            for i, requirement in enumerate(requirements)
        ]
        return {"corner": "Requirement", "columns": places, "rows": rows}
    rows = [
        {**place, "cells": [cell(i, j) for i in range(len(requirements))]}
        for j, place in enumerate(places)
    ]
    return {"corner": corner, "columns": requirements, "rows": rows}


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


BIN_WIDTH, BIN_HEIGHT = 12.0, 22.0
_MAX_BARS = 20
"""Bars of a parameter; a list of choices may be long."""


def matrix_section(record: SessionRecord, contents: ReportContents, links: EpisodeLinks) -> Data:
    """The matrix of requirements by scenario and faults, orphans, and what of ranges was drawn."""
    coverage = record.head.coverage
    violations: Counter[tuple[str, str, str]] = Counter()
    for verdict in record.head.verdicts:
        violations[_cell_key(verdict)] += verdict.violations
    requirements = [requirement.id for requirement in record.head.requirements]
    listed = set(requirements)
    places: dict[tuple[str, str], dict[str, list[Data]]] = {}
    shown, rest = _split_folded_cells(coverage.cells, contents.folded)
    for cell in shown:
        row = places.setdefault((cell.scenario, cell.faults), {})
        row.setdefault(cell.requirement, []).append(
            {
                "verdict": cell.verdict,
                "anchor": links.known(verdict_anchor(cell.requirement, cell.case)),
                "violations": violations[_cell_key(cell)],
            }
        )
        if cell.requirement not in listed:
            requirements.append(cell.requirement)
            listed.add(cell.requirement)
    columns = sorted(places)
    judged = {_cell_key(verdict) for verdict in record.head.verdicts if verdict.run}
    return {
        "table": matrix(
            [heading(name, anchor=links.known(requirement_anchor(name))) for name in requirements],
            [
                heading(scenario, f"+ {faults}" if faults else "no fault")
                for scenario, faults in columns
            ],
            # No cell at all: the requirement does not apply to the scenario.
            lambda i, j: places[columns[j]].get(requirements[i]),
            "Scenario and faults",
        ),
        # Cells are small: a row of a wide matrix is as long as some of other tables.
        "rows": len(columns) * max(1, len(requirements) // 5),
        "sentence": coverage_sentence(record),
        "not_run": sum(
            cell.verdict is not None and _cell_key(cell) not in judged for cell in coverage.cells
        ),
        "left_out": coverage.left_out,
        "folded": len(set(map(_scenario_key, rest))),
        "parameters": [_parameter_bars(parameter) for parameter in coverage.parameters],
        **_orphans(record),
    }


def _orphans(record: SessionRecord) -> Data:
    """Requirements without a case, cases without one, and what verdicts alone name."""
    tested = {verdict.requirement for verdict in record.head.verdicts}
    judged = {verdict_key(verdict) for verdict in record.head.verdicts}
    named = [requirement.id for requirement in record.head.requirements]
    return {
        "untested": [
            (name, requirement_anchor(name)) for name in named if name not in tested
        ],
        "unjudged": [
            (case.id, case_anchor(case.id))
            for case in record.head.cases
            if case_key(case) not in judged and not case.without
        ],
        "unlisted": sorted(tested.difference(named)),
    }  # fmt: skip


def _split_folded_cells(
    cells: list[CellEntry], folded: frozenset[CaseKey]
) -> tuple[list[CellEntry], list[CellEntry]]:
    """The cells of places that are shown, and of those of which all cells are of folded cases."""
    places = {_scenario_key(cell) for cell in cells if verdict_key(cell) not in folded}
    shown = [cell for cell in cells if _scenario_key(cell) in places]
    return shown, [cell for cell in cells if _scenario_key(cell) not in places]


def _scenario_key(cell: CellEntry) -> tuple[str, str]:
    return cell.scenario, cell.faults


def _cell_key(verdict: ItemVerdict | CellEntry) -> tuple[str, str, str]:
    """Key that a cell and the verdicts on it have in common."""
    return verdict.requirement, verdict.case, verdict.component


def _parameter_bars(parameter: ParameterEntry) -> Data:
    choices = parameter.choices
    counts = parameter.bins if choices is None else [choice.count for choice in choices]
    highest = max([*counts, 1])
    bars = []
    for place, count in enumerate(counts[:_MAX_BARS]):
        height = round(BIN_HEIGHT * count / highest, 1)
        bars.append({"x": place * BIN_WIDTH, "y": BIN_HEIGHT - height, "height": height})
    return {
        **vars(parameter),
        "counts": counts,
        "bars": bars,
        "width": BIN_WIDTH * len(bars),
        "hit": sum(count > 0 for count in counts),
    }


_NO_FAULT = "no fault"
_HEAT_STEPS = (0.0, 0.05, 0.25, 0.5)
"""Shares of violating episodes above which a cell of the map is a step darker."""


def fault_section(record: SessionRecord, contents: ReportContents, _links: EpisodeLinks) -> Data:
    """The map of faults and requirements."""
    if not any(case.faults for case in record.head.cases):
        return {}
    shown, rest = split_folded(record.head.cases, contents.folded, case_key)
    named = {name for case in shown for name in _fault_names(case)}
    left_out = {name for case in rest for name in _fault_names(case)} - named
    return {"heat": _heat_map(record, left_out), "left_out": len(left_out)}


def _fault_names(case: CaseEntry) -> list[str]:
    return [fault.id for fault in case.faults] or [_NO_FAULT]


def _heat_map(record: SessionRecord, left_out: Collection[str]) -> Data:
    """Violating among valid episodes, by fault and requirement, over all cases with that fault.

    Runs in which a fault had no effect are no sample of runs with it, and stand in no cell.

    Args:
        record: The record.
        left_out: Names of faults without a row; only folded cases have them.
    """
    faults_of = {case_key(case): [fault.id for fault in case.faults] for case in record.head.cases}
    cells: dict[tuple[str, str], list[ItemVerdict]] = defaultdict(list)
    names: dict[str, None] = {}
    for ids in faults_of.values():
        names.update(dict.fromkeys(ids or [_NO_FAULT]))
    for verdict in record.head.verdicts:
        ids = faults_of.get(verdict_key(verdict)) or [_NO_FAULT]
        for fault in ids:
            names.setdefault(fault)
            cells[fault, verdict.requirement].append(verdict)
    order = sorted(names.keys() - left_out, key=lambda name: (name != _NO_FAULT, name))
    requirements = [requirement.id for requirement in record.head.requirements]
    return matrix(
        [heading(name, anchor=requirement_anchor(name)) for name in requirements],
        [heading(name) for name in order],
        lambda i, j: _heat_cell(cells.get((order[j], requirements[i]))),
        "Fault",
    )


def _heat_cell(verdicts: list[ItemVerdict] | None) -> Data:
    if not verdicts:
        return {"word": "untested"}
    n = sum(verdict.episodes for verdict in verdicts)
    violations = sum(verdict.violations for verdict in verdicts)
    if not n:
        return {"word": "no valid episode"}
    step = sum(violations / n > bound for bound in _HEAT_STEPS)
    doubt = not violations and any(verdict.verdict == "undecided" for verdict in verdicts)
    also = sum(verdict.also_without or 0 for verdict in verdicts)
    counts = {"n": n, "violations": violations, "also_without": also}
    return {"word": "", "step": step, "doubt": doubt, **counts}


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
