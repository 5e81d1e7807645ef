"""The tables of reports: for each a list of columns that terminal, summary and page render.

A column is added here and nowhere else; those of pairs, monitors, faults and failure modes in
``role_tables``. A row is an entry of the record, or a small dataclass around it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.core.metrics import REACTIONS
from pytest_dura.evidence.case_model import CaseEntry, MeasuredNumbers, OverallEntry
from pytest_dura.evidence.gate import outcome_status
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.text import code, markdown, name, one_line
from pytest_dura.reports.columns import (
    NO_VALUE,
    Cell,
    Column,
    Shown,
    given,
    measure_label,
    name_cell,
    number_text,
    prose_cell,
    rounded,
    runs_cell,
    share_text,
)
from pytest_dura.reports.contents import requirement_anchor
from pytest_dura.reports.searches import (
    baselines_text,
    kept_text,
    parameter_changes,
    search_coverage_text,
)
from pytest_dura.reports.verdicts import no_rate_reason, rate_bound
from pytest_dura.requirements.campaign_verdicts import weakness
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import SearcherReport, SearchOutcome

# Cases.

CaseRow = CaseEntry | OverallEntry
"""A case, or all cases of a component."""


def case_columns(rows: Sequence[CaseRow], measures: Sequence[MeasureInfo]) -> list[Column[CaseRow]]:
    """The outcomes of cases; how they rely on recovery is a table of its own in the terminal.

    Args:
        rows: All of them: what none of them measures has no column.
        measures: The record's.
    """
    several = len({row.component for row in rows}) > 1
    users = sorted({name for row in rows for name in row.metrics.user})
    known = {name for row in rows for name in row.metrics.reactions}
    kinds = [*REACTIONS, *sorted(known.difference(REACTIONS))] if known else []
    reliance = "reliance"
    return [
        Column("case", lambda row: _case_cell(row, several=several), shown=Shown.FILES, kind=""),
        Column("component", lambda row: name_cell(row.component), shown=Shown.SUMMARY),
        Column("planned", lambda row: row.metrics.planned, shown=Shown.SUMMARY),
        Column("run", lambda row: row.metrics.run, shown=Shown.SUMMARY),
        Column("valid", lambda row: row.metrics.valid, shown=Shown.SUMMARY),
        Column(
            "n", _valid_of_planned, "n / planned", meaning="valid runs, of those planned",
            shown=Shown.TERMINAL | Shown.PAGE,
        ),
        Column("invalid", lambda row: row.metrics.invalid, shown=Shown.FILES),
        Column("missing", lambda row: row.metrics.missing, shown=Shown.FILES),
        Column(
            "flagged", lambda row: runs_cell(row.metrics.flagged, row.metrics.valid),
            short="flag %", meaning="runs with an unsafe proposal",
        ),
        *(_measure_column(measure) for measure in measures if measure.table == "outcomes"),
        Column(
            "rescued", lambda row: runs_cell(row.metrics.rescued, row.metrics.valid),
            short="rescued %", meaning="runs in which recovery took over", group=reliance,
        ),
        Column(
            "time rescued", _time_in_control, short="time %",
            meaning="share of the time for which recovery was in control",
            shown=Shown.TERMINAL | Shown.PAGE, group=reliance,
        ),
        Column(
            "recoveries", lambda row: _if_valid(row, row.metrics.recoveries), short="recov",
            meaning="stretches in which recovery acted, in valid runs",
            shown=Shown.TERMINAL | Shown.PAGE,
        ),
        *(_measure_column(measure) for measure in measures if measure.table == reliance),
        Column(
            "alerts", lambda row: _if_valid(row, row.metrics.alerts), meaning="in valid runs",
            shown=Shown.TERMINAL | Shown.PAGE,
        ),
        Column(
            "reactions", _reactions, kind="", shown=Shown.FILES,
            meaning="how the component reacted to what looked like an attack, each time",
        ),
        *(_reaction_column(kind, first=kind == kinds[0]) for kind in kinds),
        Column(
            "inv", _invalid_and_missing, shown=Shown.TERMINAL,
            meaning="invalid runs, and missing ones behind a plus",
        ),
        *map(_user_column, users),
    ]  # fmt: skip


def _case_cell(row: CaseRow, *, several: bool) -> Cell:
    notes = (name(row.component),) if several else ()
    if isinstance(row, OverallEntry):
        text = f"All {row.cases} cases"
        return Cell(text, text, text, notes)
    return name_cell(row.id, *notes)


def _valid_of_planned(row: CaseRow) -> Cell:
    valid, planned = row.metrics.valid, row.metrics.planned
    return Cell(
        str(valid) if valid == planned else f"{valid} ({planned})",
        f"{valid} of {planned}",
        f"{valid} / {planned}",
        total=(valid, planned),
    )


def _if_valid(row: CaseRow, count: int) -> Cell:
    page = str(count) if row.metrics.valid else NO_VALUE
    return Cell(str(count), str(count), page, total=(count,))


def _time_in_control(row: CaseRow) -> Cell | None:
    switching = row.metrics.switching
    if switching is None or switching.share is None:
        return None
    text = f"{100 * switching.share:.1f}"
    return Cell(text, text, share_text(switching.share))


def _reactions(row: CaseRow) -> Cell | None:
    counts = {name(kind): count for kind, count in row.metrics.reactions.items()}
    text = ", ".join(f"{kind} {count}" for kind, count in counts.items())
    summary = ", ".join(f"{code(kind) or '-'} {count}" for kind, count in counts.items())
    return Cell(text, summary, text) if counts else None


_SHORT_REACTIONS = {"follows the fake": "follows"}


def _reaction_column(kind: str, *, first: bool) -> Column[CaseRow]:
    return Column(
        kind,
        lambda row: row.metrics.reactions.get(kind, 0),
        short=_SHORT_REACTIONS.get(kind, kind),
        meaning="like the columns behind it, reactions to what looked like an attack, each counted"
        if first
        else "",
        shown=Shown.TERMINAL,
        group="reliance",
    )


def _invalid_and_missing(row: CaseRow) -> str:
    missing = f"+{row.metrics.missing} missing" if row.metrics.missing else ""
    return f"{row.metrics.invalid}{missing}"


def _measure_column(measure: MeasureInfo) -> Column[CaseRow]:
    def value(row: CaseRow) -> Cell | None:
        value = row.metrics.measures.get(measure.name)
        if isinstance(value, MeasuredNumbers):
            return _mean(value, measure.unit)
        cell = runs_cell(value, row.metrics.valid, starred=True)
        if cell is None or value is None or measure.shown == "share":
            return cell
        return replace(cell, terminal=str(value.valid))

    unit = {"share": "%", "count": "", "mean": measure.unit}[measure.shown]
    return Column(
        markdown(measure_label(measure), 64),
        value,
        heading=name(measure_label(measure).capitalize()),
        small="mean \N{PLUS-MINUS SIGN} sd (n)" if measure.shown == "mean" else "",
        short=f"{measure.heading} {unit}".rstrip(),
        meaning=measure.meaning,
        group="reliance" if measure.table == "reliance" else "",
    )


def _mean(value: MeasuredNumbers, unit: str) -> Cell | None:
    if value.mean is None:
        return None
    sd = value.sd
    spread = "" if sd is None else f" +- {sd:.1f}"
    page = f"{value.mean:.2f}" + ("" if sd is None else f" \N{PLUS-MINUS SIGN} {sd:.2f}")
    return Cell(
        f"{value.mean:.1f}{spread} ({value.runs})",
        f"{value.mean:.2f} {markdown(unit, 64)} (n = {value.runs})",
        f"{page}\N{NO-BREAK SPACE}{name(unit)}" if unit else page,
        (f"({value.runs})",),
    )


def _user_column(user: str) -> Column[CaseRow]:
    def value(row: CaseRow) -> Cell | None:
        figure = row.metrics.user.get(user)
        if figure is None or figure.mean is None:
            return None
        text = f"{figure.mean:.4g}"
        return Cell(text, text, number_text(figure.mean), (f"({figure.runs})",))

    return Column(
        user, value, heading=name(user), small="mean (n)", shown=Shown.TERMINAL | Shown.PAGE
    )


# Requirements and verdicts.


@dataclass(frozen=True)
class RequirementRow:
    """A requirement, its verdicts by status, and how many cells have none."""

    requirement: Requirement
    counts: dict[str, int]
    untested: str


def _requirement(row: RequirementRow) -> Cell:
    return name_cell(row.requirement.id, anchor=requirement_anchor(row.requirement.id))


REQUIREMENT_COLUMNS: Sequence[Column[RequirementRow]] = (
    Column("requirement", _requirement, kind=""),
    Column("kind", lambda row: prose_cell(row.requirement.kind), kind=""),
    Column("text", lambda row: prose_cell(row.requirement.text), kind=""),
    Column("supported", lambda row: row.counts["supported"]),
    Column("violated", lambda row: row.counts["violated"]),
    Column("undecided", lambda row: row.counts["undecided"]),
    Column("untested", lambda row: row.untested),
)
SPARED = ("violated", "undecided", "untested")
"""Columns of requirements that a session without any such verdict does not show."""


def _valid_n(row: ItemVerdict) -> Cell:
    saved = f", {row.saved} saved" if row.saved else ""
    notes = (f"({row.run} run{saved})",) if row.run != row.planned else ()
    text = str(row.episodes)
    short = text if row.episodes == row.planned else f"{text}/{row.planned}"
    return Cell(short, text, f"{row.episodes} / {row.planned}", notes, below=True)


def _violations(row: ItemVerdict) -> Cell:
    text = str(row.violations)
    notes = (f"{row.without_effect}*",) if row.without_effect else ()
    return Cell(text, text, text, notes, style="some" * bool(row.violations or row.without_effect))


def _bound(row: ItemVerdict) -> Cell:
    bound, text = row.bound, rate_bound(row)
    allowed = f"allowed: {'none' if bound.at_most is None else share_text(bound.at_most)}"
    if bound.upper is None:
        page = f"none{no_rate_reason(row)}"
    else:
        page = f"\N{LESS-THAN OR EQUAL TO} {share_text(bound.upper)}"
        page += f" at {share_text(bound.confidence)}"
    weak = weakness(bound.at_most, bound.confidence)
    short = "-" if bound.upper is None else f"{bound.upper:.2g}"
    return Cell(short, text, page, (allowed, weak) if weak else (allowed,), below=True)


def _margins(row: ItemVerdict) -> str | None:
    if row.margins is not None:
        return f"{number_text(row.margins.min)} / {number_text(row.margins.median)}"
    return None if row.margin is None else number_text(row.margin)


def _reason(row: ItemVerdict) -> Cell | None:
    """Why it is not supported, and what excuses that."""
    waiver = row.waiver
    excuse = f"waived, {waiver.kind}: {waiver.reason or 'no reason'}" if waiver else ""
    reasons = ["" if row.verdict == "supported" else row.reason, excuse]
    text = "; ".join(filter(None, reasons))
    return prose_cell(text, 500) if text else None


VERDICT_COLUMNS: Sequence[Column[ItemVerdict]] = (
    Column("verdict", lambda row: row.verdict, short=" ", shown=Shown.TERMINAL | Shown.SUMMARY),
    Column("waiver", lambda row: "waived" if row.waiver else None, shown=Shown.SUMMARY),
    Column("requirement", lambda row: name_cell(row.requirement), shown=Shown.SUMMARY),
    Column("case", lambda row: name_cell(row.case), shown=Shown.SUMMARY),
    Column("component", lambda row: name_cell(row.component), shown=Shown.SUMMARY),
    Column(
        "valid n", _valid_n, "Valid / planned", short="n",
        meaning="valid episodes of those planned",
    ),
    Column(
        "violations", _violations, "Viol.", short="viol",
        meaning="valid episodes that violated it; with a star, invalid ones that did so without "
        "effect of the fault",
    ),
    Column(
        "open", lambda row: len(row.open), "Open",
        meaning="valid episodes that ended before it was decided; the bound counts them as "
        "violations",
    ),
    Column("without effect", lambda row: row.without_effect, shown=Shown.SUMMARY),
    Column(
        "invalid", lambda row: row.invalid, "Inv.", short="inv",
        meaning="invalid episodes: the planned fault never manifested, or the trace does not "
        "decide it",
    ),
    Column(
        "missing", lambda row: row.missing, "Miss.", short="miss",
        meaning="missing episodes: an infrastructure error ended them",
    ),
    Column(
        "vacuous", lambda row: row.vacuous, "Vac.", short="vac",
        shown=Shown.TERMINAL | Shown.PAGE,
        meaning="satisfied because their condition never held",
    ),
    Column(
        "upper bound", _bound, "Upper bound of the rate,",
        short="rate <=", small="and the rate allowed", kind="bound",
        meaning="upper confidence bound of the rate of violations",
    ),
    Column(
        "margin", _margins, small="min / median", shown=Shown.TERMINAL | Shown.PAGE,
        meaning="least and median margin, in the unit of the check",
    ),
    Column(
        "reason", _reason, shown=Shown.SUMMARY, kind="",
    ),
)  # fmt: skip


# Searches.


@dataclass(frozen=True)
class OutcomeRow:
    """A search, and its outcome for a requirement."""

    search: RecordedSearch
    outcome: SearchOutcome


MOST_CHANGES = 6
"""Changed parameters in a cell; the record has all."""


def _search_status(row: OutcomeRow) -> str:
    status = outcome_status(row.search, row.outcome)
    return "violated by a baseline" if status == "baseline" else status


def _simulations(row: OutcomeRow) -> Cell:
    count = str(row.outcome.simulations)
    return Cell(count, f"{count} of {row.search.budget}", count)


def _best(value: float | None) -> Cell | None:
    text = rounded(value, ".4g")
    return None if value is None else Cell(text, text, number_text(value))


def _counterexample(row: OutcomeRow) -> Cell:
    """Its changes and its file; without a counterexample, how much the search covered."""
    counterexample = row.outcome.counterexample
    if counterexample is None:
        text = f"coverage {search_coverage_text(row.search)}"
        return Cell(text, text, text)
    changes = parameter_changes(counterexample, MOST_CHANGES)
    more, kept = len(counterexample.changes) - len(changes), kept_text(row.outcome)
    rest = f" and {more} more" if more > 0 else ""

    def written(path: Callable[[str], str], how: Callable[[str, int], str]) -> str:
        text = ", ".join(f"{path(own)} {how(change, 100)}" for own, change in changes)
        return (
            (text or "the case as it stands") + rest + (f"; kept in {path(kept)}" if kept else "")
        )

    plain = written(str, one_line)
    return Cell(plain, written(code, markdown), plain)


SEARCH_COLUMNS: Sequence[Column[OutcomeRow]] = (
    Column("search", _search_status, shown=Shown.FILES, kind=""),
    Column("waiver", lambda row: "waived" if row.search.waiver else None, shown=Shown.FILES,
           kind=""),
    Column("requirement", lambda row: name_cell(row.outcome.requirement), shown=Shown.FILES,
           kind=""),
    Column("case", lambda row: name_cell(row.search.case), shown=Shown.FILES, kind=""),
    Column("component", lambda row: name_cell(row.search.component), shown=Shown.FILES,
           kind=""),
    Column("simulations", _simulations),
    Column(
        "robustness", lambda row: _best(row.outcome.best), "Least robustness",
        meaning="least robustness of all simulations",
    ),
    Column(
        "found by",
        lambda row: given(row.outcome.searcher, lambda own: prose_cell(own, 100)),
        shown=Shown.FILES, kind="",
    ),
    Column(
        "trivial baselines alone",
        lambda row: prose_cell(baselines_text(row.search, row.outcome.requirement), 1000),
        shown=Shown.FILES, kind="",
    ),
    Column("counterexample", _counterexample, shown=Shown.FILES, kind=""),
)  # fmt: skip


@dataclass(frozen=True)
class SearcherRow:
    """A searcher, or a trivial baseline, in the search for a violation of a requirement."""

    searcher: SearcherReport
    requirement: str


SEARCHER_COLUMNS: Sequence[Column[SearcherRow]] = (
    Column("simulations", lambda row: row.searcher.simulations),
    Column(
        "violated at", lambda row: row.searcher.first.get(row.requirement) or "none",
        meaning="after so many of its own simulations",
    ),
    Column(
        "robustness", lambda row: rounded(row.searcher.best.get(row.requirement), ".4g"),
        heading="Least robustness", meaning="its least",
    ),
)  # fmt: skip
