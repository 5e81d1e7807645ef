"""The tables in the terminal, from the record alone.

They cover cases, attacks, pairs, monitors, faults and failure modes, with the columns of
``reports``. Of a great many rows the worst are shown.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.plugin.messages import indent_if_reserved
from pytest_dura.reports.columns import Column, Shown, legend, shown_in
from pytest_dura.reports.failure_modes import (
    FAILURE_MODE_HEADINGS,
    cases_with_accounts,
    decision_age_lines,
    decision_time_lines,
    failure_mode_text,
    failure_modes_by_component,
    judge_agreement_lines,
    measured_failure_modes,
    unavailability_text,
    uncovered_lines,
)
from pytest_dura.reports.role_tables import (
    ATTACK_COLUMNS,
    FAULT_COLUMNS,
    MONITOR_COLUMNS,
    PAIR_COLUMNS,
    AttackRow,
    FailureModeRow,
    FaultRow,
    MonitorRow,
    PairRow,
    failure_mode_columns,
    summed_pairs,
)
from pytest_dura.reports.tables import CaseRow, case_columns
from pytest_dura.reports.usage import spending_text, usage_columns, usage_rows
from pytest_dura.requirements.model import FAULTS

if TYPE_CHECKING:
    from pytest_dura.core.measures import MeasureInfo
    from pytest_dura.core.metrics import TracedFault
    from pytest_dura.evidence.case_model import CaseEntry, FailureModeEntry, OverallEntry
    from pytest_dura.evidence.item_verdicts import ItemVerdict
    from pytest_dura.evidence.model import RecordHead, SessionRecord
    from pytest_dura.evidence.session_model import LanguageModelEntry, PriceEntry
    from pytest_dura.evidence.verdict_model import EffectivenessEntry
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.monitoring.quality import MonitorQuality
    from pytest_dura.requirements.pairs import PairTable

Row = TypeVar("Row")
WIDTH = 100
LONGEST = 500
"""Characters of a row's name."""


def table(
    title: str,
    columns: Sequence[Column[Row]],
    rows: Sequence[tuple[str, Row]],
    about: str = "",
    group: str = "",
) -> list[str]:
    """Write a table with its legend; nothing without rows.

    Args:
        title: Heading of the rows' names.
        columns: Of ``reports``; those that the terminal has are shown.
        rows: With their names.
        about: What the legend begins with.
        group: The terminal's table, where a list of columns makes several.
    """
    if not rows:
        return []
    columns = shown_in(columns, Shown.TERMINAL, group)
    cells = [[column.cell(row).terminal for column in columns] for _, row in rows]
    names = [name for name, _ in rows]
    lines = aligned(title, [column.label for column in columns], names, cells)
    return [*lines, *wrapped_legend(columns, about)]


def wrapped_legend(columns: Sequence[Column[Row]], about: str = "") -> list[str]:
    """Write what the columns mean, indented where it goes on: no text of others begins a line."""
    text = "; ".join(filter(None, [about, legend(columns)]))
    lines = textwrap.wrap(text, WIDTH - 2, break_on_hyphens=False)
    return [f"{'  ' if number else ''}{name(line, WIDTH)}" for number, line in enumerate(lines)]


def case_table(
    cases: Sequence[CaseEntry],
    overall: Sequence[OverallEntry] = (),
    measures: Sequence[MeasureInfo] = (),
) -> list[str]:
    """Write the paper's table: a line per case and component, and one per component.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
        measures: The record's.
    """
    rows = _case_rows(cases, overall)
    columns = case_columns([row for _, row in rows], measures)
    lines = table("case", columns, rows)
    if any(measure.shown == "mean" for measure in measures):
        lines.append("9.1 +- 0.4 (3): mean +- standard deviation over so many runs")
    if any("*" in column.cell(row).terminal for column in columns for _, row in rows):
        lines.append(_BEYOND)
    return lines


_BEYOND = "3*: so many more runs that are invalid or missing, which are in no rate"


def reliance_table(cases: Sequence[CaseEntry], overall: Sequence[OverallEntry] = ()) -> list[str]:
    """Write how often recovery acts, what passengers feel, and reactions to attacks.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
    """
    rows = _case_rows(cases, overall)
    if not any(
        row.metrics.comfort_failed
        or row.metrics.reactions
        or (row.metrics.rescued and row.metrics.rescued.run)
        for _, row in rows
    ):
        return []
    return table("reliance", case_columns([row for _, row in rows], ()), rows, group="reliance")


def _case_rows(
    cases: Sequence[CaseEntry], overall: Sequence[OverallEntry]
) -> list[tuple[str, CaseRow]]:
    """Return the rows with their names: the cases, then all together if several."""
    several = len({case.component for case in cases}) > 1
    rows: list[tuple[str, CaseRow]] = [(case.id, case) for case in cases]
    rows += [("overall", entry) for entry in overall if entry.cases > 1]
    return [(f"{name} ({row.component})" if several else name, row) for name, row in rows]


def aligned(
    title: str, columns: Sequence[str], names: Sequence[str], rows: Sequence[Sequence[str]]
) -> list[str]:
    """Align the lines of a table; a name that is too long stands on a line of its own."""
    # The names of cases, faults and metrics may have any length.
    names = [indent_if_reserved(name(text, LONGEST)) for text in names]
    table = [[name(column) for column in columns], *rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(columns))]
    room = max(24, WIDTH - sum(widths) - 2 * len(widths))
    label_width = min(max(map(len, [title, *names])), room)
    lines = []
    for label, row in zip([title, *names], table, strict=True):
        cells = "".join(f"  {cell:>{width}}" for cell, width in zip(row, widths, strict=True))
        if len(label) > label_width:
            lines += [label, " " * label_width + cells]
        else:
            lines.append(f"{label:<{label_width}}{cells}")
    return lines


def attack_table(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> list[str]:
    """Write what faults did: a line per case and requirement on pairs without them."""
    rows = [
        (f"{verdict.requirement} on {verdict.case}", AttackRow(verdict))
        for verdict in _by_case(verdicts, cases)
        if verdict.pairs and verdict.pairs.without == FAULTS
    ]
    return table("attack", ATTACK_COLUMNS, rows)


def pair_table(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> list[str]:
    """Write what recovery did: a line per case, component and requirement on pairs without it."""
    from pytest_dura.requirements.pairs import PairTable

    metrics = {(case.id, case.component): case.metrics for case in cases}
    rows: list[tuple[str, PairRow]] = []
    sums: dict[tuple[str, str], list[PairTable]] = {}
    for verdict in _by_case(verdicts, cases):
        pairs = verdict.pairs
        if not isinstance(pairs, PairTable) or pairs.without != RECOVERY_ROLE:
            continue
        switching = metrics[verdict.case, verdict.component].switching
        row = PairRow(verdict, pairs, switching)
        rows.append((f"{verdict.requirement} on {verdict.case}", row))
        sums.setdefault((verdict.requirement, verdict.component), []).append(pairs)
    for (requirement, component), pairs_of_cases in sums.items():
        if len(pairs_of_cases) > 1:
            whose = f" ({component})" if len({component for _, component in sums}) > 1 else ""
            row = PairRow(None, summed_pairs(pairs_of_cases))
            rows.append((f"{requirement} overall{whose}", row))
    return table("recovery", PAIR_COLUMNS, rows)


def _by_case(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> Iterable[ItemVerdict]:
    order = {case.id: place for place, case in enumerate(cases)}
    return sorted(verdicts, key=lambda verdict: order.get(verdict.case, len(order)))


def effectiveness_lines(
    entries: Sequence[EffectivenessEntry], role: str | None = None
) -> list[str]:
    """Write what the runs show of recovery or of monitors, a sentence each.

    Args:
        entries: The record's ``effectiveness``.
        role: Of this role alone; ``None`` for all but recovery.
    """
    several = len({entry.component for entry in entries}) > 1
    lines = []
    for entry in entries:
        if (entry.role == role) if role else (entry.role != RECOVERY_ROLE):
            whose = f" with {name(entry.component)}" if several else ""
            sentence = indent_if_reserved(name(f"{entry.role}{whose}: {entry.detail}", LONGEST))
            lines += textwrap.wrap(sentence, WIDTH, subsequent_indent="  ", break_long_words=False)
    return lines


def monitor_table(monitors: Sequence[MonitorQuality]) -> list[str]:
    """Write how good each monitor was, a line per case and monitor.

    Requirements on which it did equally well share a line; where nothing was violated and nothing
    flagged there is none.
    """
    same: dict[tuple[str, ...], list[MonitorQuality]] = {}
    for monitor in monitors:
        if monitor.true_positives + monitor.false_negatives + monitor.false_positives:
            columns = shown_in(MONITOR_COLUMNS, Shown.TERMINAL)
            cells = [column.cell(MonitorRow(monitor)).terminal for column in columns]
            key = monitor.case.partition("~")[0], monitor.monitor, *cells
            same.setdefault(key, []).append(monitor)
    rows = [
        (f"{who}, {case}: {', '.join(entry.target for entry in alike)}", MonitorRow(alike[0]))
        for (case, who, *_), alike in same.items()
    ]
    return table("monitor", MONITOR_COLUMNS, rows, "runs without recovery")


T = TypeVar("T")

MOST_ROWS = 100
"""Rows of a table, verdicts, or failures that are shown at most, unless ``-v`` is given."""
VERDICT_RANK = {"violated": 0, "undecided": 1, "supported": 2}
WHERE_ALL_ARE = "-v shows all of them, as do the report and evidence.json"


def most_rows(context: SessionContext) -> int | None:
    """Return how many rows a table shows in this session; ``None`` for all."""
    return None if context.config.option.verbose > 0 else MOST_ROWS


def keep_worst(rows: Sequence[T], ranks: Sequence[int], *, most: int | None = MOST_ROWS) -> list[T]:
    """Return the worst rows, as many as are shown, in their own order.

    Args:
        rows: All there is.
        ranks: How bad each is, 0 the worst; among equals the first ones stay.
        most: How many; ``None`` for all.
    """
    if most is None or len(rows) <= most:
        return list(rows)
    places = sorted(range(len(rows)), key=ranks.__getitem__)[:most]
    return [rows[index] for index in sorted(places)]


def worst_cases(
    cases: Sequence[CaseEntry], verdicts: Iterable[ItemVerdict], *, most: int | None = MOST_ROWS
) -> list[CaseEntry]:
    """Return the cases that tables show: those with the worst verdicts, also on comparisons."""
    rank: dict[tuple[str, str], int] = {}
    for verdict in verdicts:
        for case in (verdict.case, *([verdict.pairs.case] if verdict.pairs else ())):
            key = case, verdict.component
            rank[key] = min(rank.get(key, len(VERDICT_RANK)), VERDICT_RANK[verdict.verdict])
    ranks = [rank.get((case.id, case.component), len(VERDICT_RANK)) for case in cases]
    return keep_worst(cases, ranks, most=most)


def fault_table(cases: Sequence[CaseEntry]) -> list[str]:
    """Write a line per fault, case and component."""
    several = len({case.component for case in cases}) > 1
    rows = []
    for case in cases:
        for fault in case.metrics.faults:
            # Most cases are named after their only fault, which is not repeated. One of several
            # stays: without it the name would be that of another case.
            is_only = len(case.metrics.faults) == 1
            case_name = case.id.removesuffix(f"+{fault.id}") if is_only else case.id
            component = f" ({case.component})" if several else ""
            rows.append((f"{fault.id} on {case_name}{component}", FaultRow(case, fault)))
    return table("fault", FAULT_COLUMNS, rows)


def chain_line(fault: TracedFault) -> str:
    """Write the causal chain of one fault, with times in s."""
    steps = [
        ("planned", fault.planned_at, ""),
        ("activated", fault.activated_at, ""),
        ("manifested", fault.manifested_at, _read_by(fault)),
        ("propagated", fault.propagated_at, ""),
        ("detected", fault.detected_at, _by(fault.detected_by, fault.pattern)),
        ("recovery", fault.recovery_at, _by(fault.recovery)),
        ("recovered", fault.recovered_at, ""),
    ]
    parts = [f"{step} {time:.2f}{by}" for step, time, by in steps if time is not None]
    if fault.outcome is not None:
        parts.append(fault.outcome)
    return f"{fault.id}: {', '.join(parts) or 'never active'}"


def _read_by(fault: TracedFault) -> str:
    return f" (read by {', '.join(fault.read_by)})" if fault.read_by else ""


def _by(*names: str | None) -> str:
    known = ": ".join(filter(None, names))
    return f" ({known})" if known else ""


def failure_mode_table(cases: Sequence[CaseEntry], *, by_case: bool = False) -> list[str]:
    """Write a line per failure mode and component, over all cases or also by case.

    The negative control, and what is no failure by itself, stand apart below.
    """
    by_component = failure_modes_by_component(cases)
    several = len(by_component) > 1
    lines = []
    for component, modes in by_component.items():
        lines += _failure_mode_rows(modes, f" of {component}" if several else "")
    for component, text in decision_time_lines(cases):
        lines.append(f"answers{f' of {component}' if several else ''}: {text}")
    for component, text in decision_age_lines(cases):
        whose = f" of {component}" if several else ""
        lines.append(f"decisions{whose} came into force at an age of {text}")
    for component, text in judge_agreement_lines(cases):
        lines.append(f"{text}{f' of {component}' if several else ''}")
    for case in cases_with_accounts(cases) if by_case else ():
        whose = f" of {case.component}" if several else ""
        lines += [
            "",
            *_failure_mode_rows(
                measured_failure_modes(case.metrics.failure_modes), f" on {case.id}{whose}"
            ),
        ]
    columns = shown_in(failure_mode_columns(), Shown.TERMINAL)
    return [*lines, *wrapped_legend(columns)] if lines else []


def usage_table(cases: Sequence[CaseEntry], price: PriceEntry | None) -> list[str]:
    """Write a line per case and component on the tokens that decisions used."""
    rows = usage_rows(cases, price)
    several = len({row.case.component for row in rows}) > 1
    named = [(row.case.id + (f" ({row.case.component})" if several else ""), row) for row in rows]
    return table("tokens", usage_columns(price), named)


def model_lines(models: Sequence[LanguageModelEntry], price: PriceEntry | None = None) -> list[str]:
    """Write a line on what each language model was asked, and on whether it was available."""
    texts = [
        (model, text)
        for model in models
        for text in (spending_text(model, price), unavailability_text(model))
    ]
    lines = [f"language model {name(model.model)}: {text}" for model, text in texts if text]
    return [part for line in lines for part in textwrap.wrap(line, WIDTH, subsequent_indent="  ")]


def uncovered_mode_lines(head: RecordHead) -> list[str]:
    """Write a line for each component with failures that none of its requirements reads."""
    lines = list(uncovered_lines(head))
    several = len(failure_modes_by_component(head.cases)) > 1
    return [
        line
        for component, text in lines
        for line in textwrap.wrap(
            text + (f", of {component}" if several else ""), WIDTH, subsequent_indent="  "
        )
    ]


def _failure_mode_rows(modes: Sequence[FailureModeEntry], whose: str) -> list[str]:
    columns = shown_in(failure_mode_columns(), Shown.TERMINAL)
    names, rows, kind = [], [], ""
    for mode in modes:
        if mode.kind != kind:
            kind = mode.kind
            if kind != "failure":
                names.append(f"{FAILURE_MODE_HEADINGS[kind]}:")
                rows.append([""] * len(columns))
        names.append(failure_mode_text(mode.name))
        rows.append([column.cell(FailureModeRow(mode)).terminal for column in columns])
    title, headings = FAILURE_MODE_HEADINGS["failure"] + whose, [each.label for each in columns]
    return [line.rstrip() for line in aligned(title, headings, names, rows)]


def further_tables(record: SessionRecord, most: int | None) -> Iterator[str]:
    """Write the further tables of a session, each with at most so many rows."""
    from pytest_dura.reports.concluded import concluded_tables

    for shown in concluded_tables(record):
        first = shown.columns[0]
        rows = [(first.cell(row).terminal, row) for row in shown.rows[:most]]
        yield from [
            "",
            one_line(shown.title),
            *table(first.name, shown.columns, rows, shown.about.rstrip(".")),
        ]
        if len(rows) < len(shown.rows):
            yield f"and {counted(len(shown.rows) - len(rows), 'row')} more; {WHERE_ALL_ARE}"
