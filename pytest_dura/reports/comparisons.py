"""Comparisons: verdicts beside those of a baseline, or of another component."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from pytest_dura.core.percepts import NOTHING
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.columns import Cell, Column, Shown, rounded
from pytest_dura.reports.document import Level, Part, Table, Text
from pytest_dura.requirements.comparison import BaselineComparison, ComparedBaseline

_NO_CHANGE = "no evidence of a change"
_VIEW = "provenance"
_MOST_CASES = 3
"""Cases that the terminal names of comparisons that have no row."""


def _status(row: BaselineComparison) -> Cell:
    short: str = row.status
    if row.status == _NO_CHANGE:
        short = "-" if row.uncorrected == _NO_CHANGE else f"({row.uncorrected})"
    return Cell(short, short, row.status if short == "-" else short)


def _violated_of(violations: int | None, episodes: int | None) -> str | None:
    return None if episodes is None else f"{violations}/{episodes}"


def _nearer(row: BaselineComparison) -> tuple[float | None, float | None]:
    """The p-values in the direction of the change."""
    worse, better = row.p_worse or 0.0, row.p_better or 0.0
    return (worse, row.p_worse_holm) if worse <= better else (better, row.p_better_holm)


COMPARISON_COLUMNS: Sequence[Column[BaselineComparison]] = (
    Column("status", _status, short=" "),
    Column(
        "now", lambda row: _violated_of(row.violations, row.episodes),
        meaning="violations of valid runs in this session",
    ),
    Column(
        "then", lambda row: _violated_of(row.baseline_violations, row.baseline_episodes),
        meaning="those of the baseline",
    ),
    Column(
        "p", lambda row: rounded(_nearer(row)[0], ".2g"), heading="p",
        meaning="exact one-sided p-value in the direction of the change",
    ),
    Column(
        "Holm", lambda row: rounded(_nearer(row)[1], ".2g"),
        meaning="p corrected for the number of comparisons, on which the word rests (p alone, at "
        "a confidence of 0.95, calls an unchanged rate worse in up to 5 % of all comparisons)",
    ),
    Column("test", lambda row: row.test, meaning="McNemar's on equal seeds, or Fisher's", kind=""),
)  # fmt: skip
_NOTE = (
    "(worse), (better): without the correction only; -: no evidence of a change, which is no "
    "evidence that nothing changed"
)


def comparison_parts(
    comparisons: Sequence[BaselineComparison],
    letters: Mapping[str, str] = NOTHING,
    reasons: Mapping[str, str] = NOTHING,
) -> Iterator[Part]:
    """Lay out comparisons: those with violations as a table, what is worse first, others by name.

    Args:
        comparisons: The comparisons.
        letters: Of components, by the columns of which they are the headings.
        reasons: What stands in the place of a status without a test.
    """
    rows = [
        (f"{name(each.requirement)} on {name(each.case)}", each)
        for status in ("worse", "better", _NO_CHANGE)
        for each in comparisons
        if each.status == status and (each.test is None or has_violations(each))
    ]
    if rows:
        columns = [
            replace(own, short=letters[own.name], meaning="") if own.name in letters else own
            for own in COMPARISON_COLUMNS
        ]
        if letters:  # the first component stands first
            columns[1:3] = columns[2:0:-1]
        yield Table(
            "requirement and case", columns, rows, notes=(_NOTE,), weight=Level.TERMINAL,
            statuses=[each.status for _, each in rows], shown=Shown.TERMINAL | Shown.PAGE,
            caption="Rates of violations against the baseline", view=_VIEW,
        )  # fmt: skip
    groups: dict[str, dict[str, list[str]]] = {}
    for each in comparisons:
        if each.test is None or not has_violations(each):
            cases = groups.setdefault(_reason(each, reasons), {})
            cases.setdefault(each.case, []).append(name(each.requirement))
    short, every = list[str](), list[str]()
    for reason, cases in groups.items():
        places = [f"{', '.join(ids)} on {name(case)}" for case, ids in cases.items()]
        rest = counted(len(places) - _MOST_CASES, "more case", "more cases")
        more = f"; and on {rest}, in the report" if len(places) > _MOST_CASES else ""
        short.append(f"{reason}: {'; '.join(places[:_MOST_CASES])}{more}")
        every.append(f"{reason}: {'; '.join(places)}")
    if short:
        yield Text(tuple(short), shown=Shown.TERMINAL)
        yield Text(tuple(every), shown=Shown.PAGE, view=_VIEW)


def _reason(each: BaselineComparison, reasons: Mapping[str, str]) -> str:
    """What comparisons without a row have in common: no violation, or no test."""
    if each.test is None:
        status = reasons.get(each.status, each.status)
        return one_line(f"{status}: {each.reason}" if each.reason else status)
    runs = f"0/{each.episodes} now, 0/{each.baseline_episodes} then"
    return f"{each.status}, violated in {runs}"


def has_violations(comparison: BaselineComparison) -> bool:
    """Whether anything violated the requirement, now or in the baseline."""
    return bool(comparison.violations or comparison.baseline_violations)


def baseline_parts(baseline: ComparedBaseline | None) -> Iterator[Part]:
    """Lay out what the comparison with a baseline came to; nothing without one.

    Args:
        baseline: With which the session was compared.
    """
    if baseline is None:
        return
    statuses = [comparison.status for comparison in baseline.comparisons]
    compared = sum(comparison.test is not None for comparison in baseline.comparisons)
    counts = [counted(compared, "comparison")]
    counts += [f"{statuses.count(status)} {status}" for status in ("worse", "better")]
    if baseline.tests != compared:
        counts.append(f"corrected for {baseline.tests}")
    both = Shown.TERMINAL | Shown.PAGE
    yield Text((f"baseline {baseline.path}: {', '.join(counts)}",), shown=both, view=_VIEW)
    yield from comparison_parts(baseline.comparisons)
    made = (
        f"The baseline was made {one_line(baseline.created)}: component "
        f"{name(baseline.component.get('name') or 'unknown')}, base seed {baseline.base_seed}, "
        f"SHA-256 {name(baseline.sha256)}; corrected by {baseline.correction}"
    )
    yield Text((made,), Level.PAGE, Shown.PAGE, view=_VIEW)
