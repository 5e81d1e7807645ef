"""Components side by side, as a document."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import Percentiles
from pytest_dura.evidence.conclusions.failure_modes import share
from pytest_dura.evidence.side_by_side import (
    Contrast,
    ModeCount,
    PairedDifference,
    Side,
    SideBySide,
    VerdictShown,
)
from pytest_dura.evidence.text import counted, first_few, name, one_line
from pytest_dura.reports.columns import Column, number_text, rounded
from pytest_dura.reports.comparisons import comparison_parts, has_violations
from pytest_dura.reports.document import Document, Level, Part, Section, Table, Text
from pytest_dura.reports.failure_modes import (
    FAILURE_MODE_HEADINGS,
    failure_mode_text,
    percent_text,
)

_LEVEL = 0.05
"""Corrected p-values up to this one are shown by case."""
_VERDICTS = ("supported", "violated", "undecided")
_UNTESTED = "~"
"""Before a figure over all cases, which has no test: their pairs are not independent."""
_HASHES = (
    "the hashes of each bundle hold; what follows from its episodes was not concluded again: "
    "`python -m pytest_dura verify` does"
)
Row = Sequence[str]


def document_of(result: SideBySide, *, everything: bool = False) -> Document:
    """Lay out a comparison of components.

    Args:
        result: The comparison.
        everything: Whether each verdict, and the pairs of each case, are shown: not only those
            that call for attention.
    """
    about = _table(
        ["", "component", "bundle", "begun", "gate"], map(_about, result.sides), texts=True
    )
    sections = [
        Section("", (about, Text((_HASHES,)))),
        Section("Verdicts", tuple(_verdicts(result.sides, everything=everything))),
        Section("Figures", (_figures(result),)),
        *(
            Section("In pairs", tuple(_contrast_parts(contrast, result, everything=everything)))
            for contrast in result.contrasts
        ),
    ]
    left_out = tuple(f"left out: {one_line(text, 2000)}" for text in result.left_out)
    sections += [Section("Left out", (Text(left_out),))] if left_out else []
    return Document("", tuple(sections))


def _table(
    titles: Sequence[str], rows: Iterable[Row], notes: Sequence[str] = (), *, texts: bool = False
) -> Table:
    """A table of cells that are written; the first of each row names it.

    Args:
        titles: Headings.
        rows: A cell for each heading.
        notes: Below it.
        texts: Whether the cells are no figures.
    """
    columns: list[Column[Row]] = [
        Column(title, itemgetter(place), kind="" if texts else "n")
        for place, title in enumerate(titles)
    ]
    named = [(row[0], row) for row in rows]
    return Table(titles[0], columns[1:], named, notes=tuple(notes), weight=Level.TERMINAL)


def _about(side: Side) -> Row:
    gate = side.gate if side.status == "complete" else f"{side.gate} ({side.status})"
    return [
        side.letter, name(side.component), one_line(side.directory),
        one_line(side.created)[:19].replace("T", " "), gate,
    ]  # fmt: skip


def _verdicts(sides: Sequence[Side], *, everything: bool) -> Iterator[Part]:
    """Lay out how many verdicts there are, then those that are not alike and not all supported."""
    rows: dict[tuple[str, ...], dict[str, VerdictShown]] = {}
    for side in sides:
        seen: dict[tuple[str, str], int] = {}
        for verdict in side.verdicts:
            key = verdict.requirement, verdict.case
            # A second test on the same requirement and case has a row of its own.
            seen[key] = number = seen.get(key, 0) + 1
            rows.setdefault((*key, str(number)), {})[side.letter] = verdict
    totals = [
        [word, *(str([each.verdict for each in side.verdicts].count(word)) for side in sides)]
        for word in _VERDICTS
    ]
    cells = [
        [
            f"{name(key[0])} on {name(key[1])}",
            *(_verdict_cell(own.get(side.letter)) for side in sides),
        ]
        for key, own in rows.items()
    ]
    shown = [
        row
        for row in cells
        if everything or not all(cell.startswith("supported 0/") for cell in row[1:])
    ]
    rest = counted(len(cells) - len(shown), "further verdict is", "further verdicts are")
    notes = []
    if len(shown) < len(cells):
        notes.append(f"{rest} supported for each, without a violation")
    if shown:
        notes.append("violated 3/15: in 3 of 15 valid runs")
    titles = ["verdicts", *(side.letter for side in sides)]
    yield _table(titles, [*totals, *shown], notes, texts=True)


def _verdict_cell(verdict: VerdictShown | None) -> str:
    if verdict is None:
        return "-"
    return f"{verdict.verdict} {verdict.violations}/{verdict.episodes}"


def _figures(result: SideBySide) -> Table:
    """Lay out what the runs of the shared cases come to, for each component."""
    sides = result.sides
    figures = [side.figures for side in sides]
    rows = [["valid runs", *(f"{own.valid}/{own.run}" for own in figures)]]
    for measure in result.measures:
        values = [_measure_text(measure, own.measures[measure.name]) for own in figures]
        rows.append([_measure_name(measure), *values])
    for kind, heading in FAILURE_MODE_HEADINGS.items():
        modes = dict.fromkeys(
            mode for own in figures for mode, count in own.failure_modes.items()
            if count.kind == kind and (count.of or count.null_of)
        )  # fmt: skip
        for mode in modes:
            cells = [_mode_text(own.failure_modes.get(mode)) for own in figures]
            which = "" if kind == "failure" else f" ({heading})"
            rows.append([f"{failure_mode_text(name(mode))} %{which}", *cells])
    rows += _times("answers s", [own.answer_times for own in figures])
    rows += _times("age of decisions s", [own.answer_ages for own in figures])
    rows += _usage_rows(sides)
    notes = []
    if any(own.failure_modes for own in figures):
        notes.append(
            "failure modes: share of decisions, and of a null component on the same decisions "
            "(null 12.0): what it also reaches says nothing about the model"
        )
    about = counted(len(result.cases), "shared case")
    return _table([about, *(side.letter for side in sides)], rows, notes)


def _measure_name(measure: MeasureInfo) -> str:
    label = name(measure.name).replace("_", " ")
    if measure.shown != "mean":
        return f"{label} %"
    return f"{label}, mean" + (f" {name(measure.unit)}" if measure.unit else "")


def _measure_text(measure: MeasureInfo, value: float | None) -> str:
    if value is None:
        return "-"
    return number_text(value) if measure.shown == "mean" else percent_text(value)


def _mode_text(count: ModeCount | None) -> str:
    if count is None or not (count.of or count.null_of):
        return "-"
    null = share(count.null_hits, count.null_of)
    return f"{percent_text(share(count.hits, count.of))} (null {percent_text(null)})"


def _times(label: str, spreads: Sequence[Percentiles | None]) -> list[list[str]]:
    """Rows with the percentiles of times, where any component has them."""
    if not any(spread is not None and spread.max > 0.0 for spread in spreads):
        return []
    named = {"p50": "median", "p95": "95th percentile", "max": "longest"}
    return [
        [f"{label}, {text}", *(rounded(getattr(each, key, None), ".2f") for each in spreads)]
        for key, text in named.items()
    ]


def _usage_rows(sides: Sequence[Side]) -> list[list[str]]:
    """Rows with what components used by their own accounts, where any of its counts is not 0."""
    usages = [side.figures.usage or {} for side in sides]
    names = dict.fromkeys(own for usage in usages for own, count in usage.items() if count)
    return [
        [f"used: {name(own)}", *(str(usage[own]) if own in usage else "-" for usage in usages)]
        for own in names
    ]


def _contrast_parts(contrast: Contrast, result: SideBySide, *, everything: bool) -> Iterator[Part]:
    """Lay out one component against the first one."""
    own, reference = contrast.letter, contrast.reference
    pairs = counted(contrast.pairs, "pair")
    lines = [f"{own} against {reference}: {pairs} of valid runs with equal seeds and conditions"]
    for case, paths in contrast.unlike.items():
        what = first_few([*map(name, paths)], 3)
        lines.append(f"not paired: the runs of {name(case)} differ in {what}")
    yield Text(tuple(lines))
    alone = {"new": f"judged of {own} alone", "gone": f"judged of {reference} alone"}
    clean = [each for each in contrast.verdicts if each.test and not has_violations(each)]
    others = [each for each in contrast.verdicts if each not in clean]
    yield from comparison_parts(others, {"now": own, "then": reference}, alone)
    if clean:
        rates = counted(len(clean), "further rate", "further rates")
        yield Text((f"no violation, and no evidence of a change in {rates} of violations",))
    measures = {measure.name: measure for measure in result.measures}
    rows = _paired_rows(
        contrast.measures,
        lambda each: (_measure_name(measures[each.name]), measures[each.name].shown == "mean"),
        everything=everything,
    )
    rows += _paired_rows(
        contrast.failure_modes,
        lambda each: (f"{failure_mode_text(name(each.name))}, runs with it %", False),
        everything=everything,
    )
    note = (
        "in pairs: means over the pairs; in how many the component has more or less than "
        f"{reference}; p: exact sign test (of truth values: McNemar's) on the pairs of one case; "
        f"{_UNTESTED}: pairs of several cases, which have no test"
        + ("" if everything else f"; cases are shown where p by Holm is at most {_LEVEL:g}")
    )
    titles = ["in pairs", "pairs", reference, own, "more", "less", "p", "Holm"]
    yield _table(titles, rows, [note])


def _paired_rows(
    differences: Iterable[PairedDifference],
    naming: Callable[[PairedDifference], tuple[str, bool]],
    *,
    everything: bool,
) -> list[list[str]]:
    rows = []
    for each in differences:
        if not (everything or each.case is None or (each.p_holm or 0.0) <= _LEVEL):
            continue
        label, is_number = naming(each)
        values = [
            number_text(value) if is_number else percent_text(value)
            for value in (each.reference, each.value)
        ]
        tested = [rounded(each.p_value, ".2g"), rounded(each.p_holm, ".2g")]
        rows.append(
            [
                label if each.case is None else f"  on {name(each.case)}",
                str(each.pairs), *values, str(each.more), str(each.less),
                *([_UNTESTED, _UNTESTED] if each.case is None else tested),
            ]
        )  # fmt: skip
    return rows
