"""Components side by side, as lines of text."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence

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
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.columns import number_text, rounded
from pytest_dura.reports.failure_modes import (
    FAILURE_MODE_HEADINGS,
    failure_mode_text,
    percent_text,
)
from pytest_dura.requirements.comparison import BaselineComparison

_WIDTH = 100
_LEVEL = 0.05
"""Corrected p-values up to this one are shown by case."""
_VERDICTS = ("supported", "violated", "undecided")
_UNTESTED = "~"
"""Before a figure over all cases, which has no test: their pairs are not independent."""


def side_by_side_lines(result: SideBySide, *, everything: bool = False) -> Iterator[str]:
    """Write the comparison as lines of printable text.

    Args:
        result: The comparison.
        everything: Whether each verdict, and the pairs of each case, are shown: not only those
            that call for attention.
    """
    yield from _aligned(
        ["", "component", "bundle", "begun", "gate"],
        [_about(side) for side in result.sides],
        left=5,
    )
    yield from _wrapped(
        "the hashes of each bundle hold; what follows from its episodes was not concluded again: "
        "`python -m pytest_dura verify` does"
    )
    yield ""
    yield from _verdicts(result.sides, everything=everything)
    yield ""
    yield from _figures(result)
    for contrast in result.contrasts:
        yield ""
        yield from _contrast_lines(contrast, result, everything=everything)
    if any(contrast.measures or contrast.failure_modes for contrast in result.contrasts):
        yield from _wrapped(
            "in pairs: means over the pairs; in how many the component has more or less than "
            f"{result.sides[0].letter}; p: exact sign test (of truth values: McNemar's) on the "
            f"pairs of one case; {_UNTESTED}: pairs of several cases, which have no test"
            + ("" if everything else f"; cases are shown where p by Holm is at most {_LEVEL:g}")
        )
    if result.left_out:
        yield ""
        for text in result.left_out:
            yield from _wrapped(f"left out: {one_line(text, 2000)}")


def _about(side: Side) -> list[str]:
    gate = side.gate if side.status == "complete" else f"{side.gate} ({side.status})"
    return [
        side.letter, name(side.component), one_line(side.directory),
        one_line(side.created)[:19].replace("T", " "), gate,
    ]  # fmt: skip


def _verdicts(sides: Sequence[Side], *, everything: bool) -> Iterator[str]:
    """Write how many verdicts there are, then those that are not alike and not all supported."""
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
        [_on(*key[:2]), *(_verdict_cell(own.get(side.letter)) for side in sides)]
        for key, own in rows.items()
    ]
    shown = [row for row in cells if everything or not all(map(_is_clean, row[1:]))]
    yield from _aligned(
        ["verdicts", *(side.letter for side in sides)], [*totals, *shown], left=1 + len(sides)
    )
    if len(shown) < len(cells):
        rest = counted(len(cells) - len(shown), "further verdict is", "further verdicts are")
        yield f"{rest} supported for each, without a violation"
    if shown:
        yield "violated 3/15: in 3 of 15 valid runs"


def _is_clean(cell: str) -> bool:
    return cell.startswith("supported 0/")


def _verdict_cell(verdict: VerdictShown | None) -> str:
    if verdict is None:
        return "-"
    return f"{verdict.verdict} {verdict.violations}/{verdict.episodes}"


def _on(requirement: str, case: str) -> str:
    return f"{name(requirement)} on {name(case)}"


def _figures(result: SideBySide) -> Iterator[str]:
    """Write what the runs of the shared cases come to, for each component."""
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
    about = counted(len(result.cases), "shared case")
    yield from _aligned([about, *(side.letter for side in sides)], rows)
    if any(own.failure_modes for own in figures):
        yield from _wrapped(
            "failure modes: share of decisions, and of a null component on the same decisions "
            "(null 12.0): what it also reaches says nothing about the model"
        )


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
        [
            f"{label}, {text}",
            *(
                rounded(None if spread is None else getattr(spread, key), ".2f")
                for spread in spreads
            ),
        ]
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


def _contrast_lines(contrast: Contrast, result: SideBySide, *, everything: bool) -> Iterator[str]:
    """Write one component against the first one."""
    own, reference = contrast.letter, contrast.reference
    yield (
        f"{own} against {reference}: {counted(contrast.pairs, 'pair')} of valid runs with equal "
        "seeds and conditions"
    )
    for case, paths in contrast.unlike.items():
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        what = ", ".join(name(path) for path in paths[:3])
        yield from _wrapped(f"not paired: the runs of {name(case)} differ in {what}{more}")
    yield from _verdict_changes(contrast)
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
    if rows:
        titles = ["in pairs", "pairs", reference, own, "more", "less", "p", "Holm"]
        yield from _aligned(titles, rows)


def _verdict_changes(contrast: Contrast) -> Iterator[str]:
    rows = []
    reasons: dict[str, list[str]] = {}
    for each in contrast.verdicts:
        where = _on(each.requirement, each.case)
        if each.test is not None:
            rows.append([where, each.status, *_change_cells(each)])
        elif each.status in ("new", "gone"):
            which = contrast.letter if each.status == "new" else contrast.reference
            reasons.setdefault(f"judged of {which} alone", []).append(where)
        else:
            reasons.setdefault(f"not compared, {one_line(each.reason)}", []).append(where)
    changed = [row for row in rows if row[1] != "no evidence of a change"]
    if changed:
        titles = [contrast.reference, contrast.letter, "p", "Holm", "test"]
        yield from _aligned(["verdict", "rate", *titles], changed, left=2)
    if len(rows) > len(changed):
        same = counted(len(rows) - len(changed), "rate of violations", "rates of violations")
        yield f"no evidence of a change in {same}"
    for reason, places in reasons.items():
        yield from _wrapped(f"{reason}: {'; '.join(places)}")


def _change_cells(each: BaselineComparison) -> list[str]:
    better = each.status == "better"
    p, corrected = (
        (each.p_better, each.p_better_holm) if better else (each.p_worse, each.p_worse_holm)
    )
    return [
        f"{each.baseline_violations}/{each.baseline_episodes}",
        f"{each.violations}/{each.episodes}",
        rounded(p, ".2g"), rounded(corrected, ".2g"), each.test or "-",
    ]  # fmt: skip


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


def _aligned(
    titles: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1
) -> Iterator[str]:
    """Align a table: the first columns at the left, the others, which are figures, at the right."""
    table = [list(titles), *rows]
    widths = [max(len(row[place]) for row in table) for place in range(len(titles))]
    for row in table:
        cells = [
            f"{cell:<{width}}" if place < left else f"{cell:>{width}}"
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, subsequent_indent="  ", break_on_hyphens=False)
