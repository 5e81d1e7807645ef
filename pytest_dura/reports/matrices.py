"""Matrices: requirements against scenarios and faults, and what was drawn of ranges."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from pytest_dura.evidence.case_model import CaseEntry, CellEntry, ParameterEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.columns import (
    EMPTY,
    NO_VALUE,
    Cell,
    Column,
    Mark,
    Shown,
    Value,
    name_cell,
    number_text,
    share_text,
)
from pytest_dura.reports.contents import (
    case_anchor,
    case_key,
    folded_cases,
    requirement_anchor,
    row_anchors,
    split_folded,
    verdict_anchor,
    verdict_key,
)
from pytest_dura.reports.document import Entry, Facts, Level, Section, Table, Text
from pytest_dura.reports.svg import joined, tag
from pytest_dura.reports.wording import coverage_sentence, names_text

_LEGEND = (
    ("is-supported", "✓ supported"), ("is-violated", "✗ violated"),
    ("is-undecided", "? undecided"), ("untested", "○ untested"), ("", f"{NO_VALUE} does not apply"),
)  # fmt: skip
_HEAT_LEGEND = (
    ("step-0", "0"), ("step-1", "to 5 %"), ("step-2", "to 25 %"), ("step-3", "to 50 %"),
    ("step-4", "above"), ("untested", "○ untested"),
    ("hollow", "? undecided, or no valid episode"),
)  # fmt: skip
_HEAT_STEPS = (0.0, 0.05, 0.25, 0.5)
"""Shares of violating episodes above which a cell of the map is a step darker."""
_HEAT_NOTE = (
    "In each cell: episodes that violated the requirement, of the valid ones with that fault, over "
    "all cases that have it. Runs in which the fault had no effect are in no cell: what they "
    "violate fails the gate, and is not the fault's. For a requirement on pairs, it is pairs that "
    "are counted. An untested cell says nothing, and so does one without a valid episode."
)
_NOTE = (
    "A dash means that the requirement does not apply. A mark leads to its verdict, with test item "
    "and counterexamples; the number beside it counts violating episodes."
)
_UNTESTED = Cell("", "", "", marks=(Mark("untested"),), style="untested")
_NO_FAULT = "no fault"
_MOST_LINKS = 50
_MOST_NAMES = 20


def matrix_sections(record: SessionRecord) -> Iterator[Section]:
    """Yield the map of faults, and what the page's view on coverage shows."""
    if any(case.faults for case in record.head.cases):
        table = replace(_heat_map(record), caption="Violations by requirement and fault")
        yield _section("Faults", "faults", (_HEAT_NOTE,), table)
    caption = "Requirements by scenario and faults"
    table, not_run = _coverage_matrix(record)
    sentence = coverage_sentence(record)
    if not_run:
        sentence += f" {not_run} have one without any run that was judged."
    about: tuple[str, ...] = (f"{sentence} {_NOTE}",)
    if left_out := record.head.coverage.left_out:
        about += (f"{left_out} untested cells are too many to be listed.",)
    yield _section("Matrix", "matrix", about, replace(table, caption=caption))
    if orphans := tuple(_orphans(record)):
        yield Section("Orphans", (Facts(orphans, Level.PAGE, Shown.PAGE, view="matrix"),))
    listed = {requirement.id for requirement in record.head.requirements}
    if unlisted := sorted({each.requirement for each in record.head.verdicts} - listed):
        names = names_text(unlisted, _MOST_NAMES)
        text = f"Verdicts name requirements that the record does not list: {names}."
        yield _section("Requirements", "matrix", (text,))
    if ranges := record.head.coverage.parameters:
        rows = [(each.scenario, each) for each in ranges]
        caption = "Variation ranges, and how much of each was drawn"
        table = Table("scenario", PARAMETER_COLUMNS, rows, caption=caption)
        yield _section(caption, "matrix", (), table)
    else:
        yield _section("Ranges", "matrix", ("No scenario varies a parameter.",))


def _section(title: str, view: str, lines: tuple[str, ...], *tables: Table) -> Section:
    """A section of the page alone: sentences, and tables below them."""
    texts = [Text(lines, Level.PAGE, Shown.PAGE, view=view)] if lines else []
    shown = (replace(each, weight=Level.PAGE, shown=Shown.PAGE, view=view) for each in tables)
    return Section(title, (*texts, *shown))


def crossed(
    requirements: Sequence[Cell],
    places: Sequence[Cell],
    cell: Callable[[int, int], Value],
    corner: str,
) -> Table:
    """Make a table with a column for each of whatever there is less of.

    Args:
        requirements: Their headings.
        places: Headings of what they are held against.
        cell: What stands at the numbers of a requirement and a place.
        corner: What the places are, above their column.
    """
    turned = len(places) > len(requirements)
    across, down = (requirements, places) if turned else (places, requirements)

    def column(number: int, head: Cell) -> Column[int]:
        return Column(
            head.page,
            lambda row: cell(number, row) if turned else cell(row, number),
            heading=head.page,
            small=" ".join(head.notes),
            kind="",
            anchor=head.anchor,
        )

    title = corner if turned else "Requirement"
    columns = [
        Column(title, lambda row: down[row], kind=""),
        *map(column, range(len(across)), across),
    ]
    return Table(title, columns, [(head.page, row) for row, head in enumerate(down)])


# Coverage.


def _coverage_matrix(record: SessionRecord) -> tuple[Table, int]:
    """The matrix of requirements by scenario and faults; how many verdicts rest on no run."""
    head, cells = record.head, record.head.coverage.cells
    folded = folded_cases(head)
    anchors = row_anchors(head, folded)
    violations = Counter[tuple[str, str, str]]()
    for verdict in head.verdicts:
        violations[_cell_key(verdict)] += verdict.violations
    places = sorted({_place(each) for each in cells if verdict_key(each) not in folded})
    at: dict[tuple[str, tuple[str, str]], list[CellEntry]] = defaultdict(list)
    for each in cells:
        at[each.requirement, _place(each)].append(each)
    shown = set(places)
    named = [requirement.id for requirement in head.requirements]
    named += [each.requirement for each in cells if _place(each) in shown]
    requirements = list(dict.fromkeys(named))

    def mark(each: CellEntry) -> Mark:
        if each.verdict is None:
            return Mark("untested")
        link = verdict_anchor(each.requirement, each.case)
        number = violations[_cell_key(each)]
        return Mark(each.verdict, str(number or ""), link if link in anchors else None)

    def cell(requirement: int, place: int) -> Cell:
        own = at.get((requirements[requirement], places[place]))
        if not own:  # the requirement does not apply to the scenario
            return EMPTY
        if len(own) == 1 and own[0].verdict is None:
            return _UNTESTED
        return Cell("", "", "", marks=tuple(map(mark, own)))

    def heading(requirement: str) -> Cell:
        own = requirement_anchor(requirement)
        return name_cell(requirement, anchor=own if own in anchors else None)

    table = crossed(
        [*map(heading, requirements)],
        [
            name_cell(scenario, f"+ {name(faults)}" if faults else _NO_FAULT, below=True)
            for scenario, faults in places
        ],
        cell,
        "Scenario and faults",
    )
    left_out = len(set(map(_place, cells)) - shown)
    notes = (f"and {left_out} more cases that passed are not shown",) if left_out else ()
    judged = {_cell_key(verdict) for verdict in head.verdicts if verdict.run}
    not_run = sum(each.verdict is not None and _cell_key(each) not in judged for each in cells)
    return replace(table, notes=notes, legend=_LEGEND), not_run


def _place(cell: CellEntry) -> tuple[str, str]:
    return cell.scenario, cell.faults


def _cell_key(verdict: ItemVerdict | CellEntry) -> tuple[str, str, str]:
    """Key that a cell and the verdicts on it have in common."""
    return verdict.requirement, verdict.case, verdict.component


def _orphans(record: SessionRecord) -> Iterator[Entry]:
    """Requirements without a case, and cases without a requirement."""
    tested = {verdict.requirement for verdict in record.head.verdicts}
    judged = {verdict_key(verdict) for verdict in record.head.verdicts}
    requirements = [each.id for each in record.head.requirements if each.id not in tested]
    cases = [
        case.id for case in record.head.cases if case_key(case) not in judged and not case.without
    ]
    for label, text, named, anchor in (
        ("requirements", "no case tests", requirements, requirement_anchor),
        ("cases", "no requirement is judged on", cases, case_anchor),
    ):
        if named:
            links = tuple((name(each), anchor(each)) for each in named[:_MOST_LINKS])
            yield Entry(label, text, links=links)
        if len(named) > _MOST_LINKS:
            yield Entry("", f"and {len(named) - _MOST_LINKS} more")


_BAR_WIDTH, _BAR_HEIGHT = 12.0, 22.0
_MOST_BARS = 20
"""Bars of a parameter; a list of choices may be long."""


def _counts(row: ParameterEntry) -> list[int]:
    return row.bins if row.choices is None else [choice.count for choice in row.choices]


def _range(row: ParameterEntry) -> str:
    if row.choices is not None:
        return f"{len(row.choices)} choices"
    return f"{number_text(row.low)} to {number_text(row.high)}"


def _drawn_from(row: ParameterEntry) -> Value:
    if row.choices is not None:
        values = [one_line(str(choice.value)) for choice in row.choices[:_MOST_BARS]]
        return ", ".join(values) + (" ..." if len(row.choices) > _MOST_BARS else "")
    if row.least is None:
        return None
    return f"{number_text(row.least)} to {number_text(row.greatest)}"


def _bars(row: ParameterEntry) -> Value:
    counts = _counts(row)
    shown, highest = counts[:_MOST_BARS], max([*counts, 1])
    if not shown:
        return ""
    bars = []
    for place, count in enumerate(shown):
        x, height = place * _BAR_WIDTH, round(_BAR_HEIGHT * count / highest, 1)
        back = {"x": x, "y": 0, "width": 10, "height": 22}
        bars.append(tag("rect", class_="back", **back))
        bars.append(
            tag("rect", class_="bar", **{**back, "y": _BAR_HEIGHT - height, "height": height})
        )
    width = _BAR_WIDTH * len(shown)
    picture = tag(
        "svg", joined(bars), class_="bins", width=width, height=24, viewBox=f"0 0 {width} 24",
        aria_hidden="true",
    )  # fmt: skip
    return Cell("", "", picture, (" ".join(map(str, shown)),))


def _hit(row: ParameterEntry) -> Cell:
    counts = _counts(row)
    text = f"{sum(count > 0 for count in counts)}/{len(counts)}"
    return Cell(text, text, text, (f"({share_text(row.covered)})",))


PARAMETER_COLUMNS: Sequence[Column[ParameterEntry]] = (
    Column("scenario", lambda row: name_cell(row.scenario), kind=""),
    Column("parameter", lambda row: name_cell(row.parameter), kind=""),
    Column("range", _range, kind=""),
    Column("draws", lambda row: row.drawn),
    Column("drawn from", _drawn_from, kind=""),
    Column("draws by tenth of the range, or by choice", _bars, kind="draws"),
    Column("parts hit", _hit),
)


# Faults.


def _heat_map(record: SessionRecord) -> Table:
    """Violating among valid episodes, by fault and requirement, over all cases with that fault.

    Runs in which a fault had no effect are no sample of runs with it, and stand in no cell.
    """
    head = record.head
    shown, rest = split_folded(head.cases, folded_cases(head), case_key)
    named = {fault for case in shown for fault in _fault_names(case)}
    left_out = {fault for case in rest for fault in _fault_names(case)} - named
    faults_of = {case_key(case): _fault_names(case) for case in head.cases}
    at: dict[tuple[str, str], list[ItemVerdict]] = defaultdict(list)
    for verdict in head.verdicts:
        for fault in faults_of.get(verdict_key(verdict), [_NO_FAULT]):
            at[fault, verdict.requirement].append(verdict)
    every = {fault for faults in faults_of.values() for fault in faults} | {own for own, _ in at}
    faults = sorted(every - left_out, key=lambda fault: (fault != _NO_FAULT, fault))
    requirements = [requirement.id for requirement in head.requirements]
    table = crossed(
        [name_cell(each, anchor=requirement_anchor(each)) for each in requirements],
        [*map(name_cell, faults)],
        lambda i, j: _heat_cell(at.get((faults[j], requirements[i]))),
        "Fault",
    )
    more = "more faults, of cases that passed and are not shown: no violation"
    notes = (f"and {len(left_out)} {more}",) if left_out else ()
    return replace(table, notes=notes, legend=_HEAT_LEGEND)


def _fault_names(case: CaseEntry) -> list[str]:
    return [fault.id for fault in case.faults] or [_NO_FAULT]


def _heat_cell(verdicts: list[ItemVerdict] | None) -> Cell:
    if not verdicts:
        return _UNTESTED
    n = sum(verdict.episodes for verdict in verdicts)
    violations = sum(verdict.violations for verdict in verdicts)
    if not n:
        return Cell("", "", "", marks=(Mark("0 valid"),), style="hollow")
    text = f"{violations}/{n}{' ✗' if violations else ''}"
    if not violations and any(verdict.verdict == "undecided" for verdict in verdicts):
        return Cell("", "", text, marks=(Mark("undecided"),), style="hollow")
    also = sum(verdict.also_without or 0 for verdict in verdicts)
    notes = (f"{also} also without it",) if also else ()
    return Cell(
        "", "", text, notes, style=f"step-{sum(violations / n > own for own in _HEAT_STEPS)}"
    )
