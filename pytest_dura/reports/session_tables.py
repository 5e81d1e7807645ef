"""Tables of a session as parts of its document: cases, what roles and faults did, verdicts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CaseEntry, FailureModeEntry, OverallEntry
from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.conclusions.totals import verdict_counts
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import CellValue, ConcludedTable, SessionRecord
from pytest_dura.evidence.text import counted
from pytest_dura.reports.columns import Column, Shown, Value, number_text, prose_cell, shown_in
from pytest_dura.reports.document import Level, Table
from pytest_dura.reports.failure_modes import (
    FAILURE_MODE_HEADINGS,
    NULL_NOTE,
    cases_with_accounts,
    decision_age_lines,
    decision_time_lines,
    failure_mode_text,
    failure_modes_by_component,
    measured_failure_modes,
)
from pytest_dura.reports.hazards import HAZARD_COLUMNS, hazards_by_need
from pytest_dura.reports.role_tables import (
    ATTACK_COLUMNS,
    FAULT_COLUMNS,
    MONITOR_COLUMNS,
    PAIR_COLUMNS,
    REFERENCE_COLUMNS,
    FailureModeRow,
    FaultRow,
    MonitorRow,
    PairRow,
    ReferenceRow,
    failure_mode_columns,
    summed_pairs,
)
from pytest_dura.reports.searches import ordered_outcomes, searcher_name
from pytest_dura.reports.tables import (
    REQUIREMENT_COLUMNS,
    SEARCH_COLUMNS,
    SEARCHER_COLUMNS,
    SPARED,
    VERDICT_COLUMNS,
    CaseRow,
    OutcomeRow,
    RequirementRow,
    SearcherRow,
    case_columns,
)
from pytest_dura.requirements.model import FAULTS, Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.pairs import PairTable
from pytest_dura.requirements.searches import Falsification

Rows = list[tuple[str, CaseRow]]
_MEAN_NOTE = "9.1 +- 0.4 (3): mean +- standard deviation over so many runs"
_BEYOND_NOTE = "3*: so many more runs that are invalid or missing, which are in no rate"


def case_table(
    cases: Sequence[CaseEntry],
    overall: Sequence[OverallEntry] = (),
    measures: Sequence[MeasureInfo] = (),
    verdicts: Iterable[ItemVerdict] = (),
) -> Table:
    """Make the paper's table: a row per case and component, and one per component.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
        measures: The record's.
        verdicts: By which the worst cases are kept where there are too many.
    """
    rows = _case_rows(cases, overall)
    columns = case_columns([row for _, row in rows], measures)
    notes = []
    if any(measure.shown == "mean" for measure in measures):
        notes.append(_MEAN_NOTE)
    shown = shown_in(columns, Shown.TERMINAL)
    beyond = (row for _, row in rows if row.metrics.invalid or row.metrics.missing)
    if any("*" in column.cell(row).terminal for row in beyond for column in shown):
        notes.append(_BEYOND_NOTE)
    return Table(
        "case",
        columns,
        rows,
        notes=tuple(notes),
        weight=Level.TERMINAL,
        ranks=[*case_ranks(cases, verdicts), *(-1 for _ in rows[len(cases) :])],
    )


def case_ranks(cases: Sequence[CaseEntry], verdicts: Iterable[ItemVerdict]) -> list[int]:
    """How bad the worst verdict on each case is, also on comparisons; 0 is the worst."""
    rank: dict[tuple[str, str], int] = {}
    for verdict in verdicts:
        for case in (verdict.case, *([verdict.pairs.case] if verdict.pairs else ())):
            key = case, verdict.component
            rank[key] = min(rank.get(key, len(WORST_FIRST)), WORST_FIRST.index(verdict.verdict))
    return [rank.get((case.id, case.component), len(WORST_FIRST)) for case in cases]


def _case_rows(cases: Sequence[CaseEntry], overall: Sequence[OverallEntry]) -> Rows:
    """The rows with their names: the cases, then all together if several."""
    several = len({case.component for case in cases}) > 1
    rows: Rows = [(case.id, case) for case in cases]
    rows += [("overall", entry) for entry in overall if entry.cases > 1]
    return [(f"{own} ({row.component})" if several else own, row) for own, row in rows]


def reliance_table(
    cases: Sequence[CaseEntry],
    overall: Sequence[OverallEntry] = (),
    measures: Sequence[MeasureInfo] = (),
) -> Table | None:
    """Make the table of how often recovery acts, its measures, and reactions to attacks.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
        measures: The record's.
    """
    own = [measure for measure in measures if measure.table == "reliance"]
    rows = _case_rows(cases, overall)
    if not any(
        row.metrics.reactions
        or any(row.metrics.measures.get(measure.name) for measure in own)
        or (row.metrics.rescued and row.metrics.rescued.run)
        for _, row in rows
    ):
        return None
    columns = case_columns([row for _, row in rows], own)
    return Table("reliance", columns, rows, group="reliance", shown=Shown.TERMINAL)


FaultOutcomes = Mapping[tuple[str, str, str], Counter[str]]
"""How many planned episodes came to which outcome, by case, component and id of the fault."""


def fault_outcomes(record: SessionRecord) -> FaultOutcomes:
    """Count what came of each fault of a case, in one pass over the episodes."""
    outcomes: dict[tuple[str, str, str], Counter[str]] = defaultdict(Counter)
    for episode in record.episodes():
        for fault in episode.faults if episode.planned else ():
            key = episode.case, episode.component, fault.id
            outcomes[key][fault.outcome or "not followed"] += 1
    return outcomes


def fault_table(
    cases: Sequence[CaseEntry],
    verdicts: Iterable[ItemVerdict] = (),
    outcomes: FaultOutcomes | None = None,
) -> Table | None:
    """Make a row per fault, case and component.

    Args:
        cases: Those that are shown.
        verdicts: By which the worst cases are kept where there are too many.
        outcomes: What came of the faults; the page has it.
    """
    several = len({case.component for case in cases}) > 1
    rows, ranks = [], []
    for case, rank in zip(cases, case_ranks(cases, verdicts), strict=True):
        for fault in case.metrics.faults:
            # Most cases are named after their only fault, which is not repeated. One of several
            # stays: without it the name would be that of another case.
            is_only = len(case.metrics.faults) == 1
            case_name = case.id.removesuffix(f"+{fault.id}") if is_only else case.id
            component = f" ({case.component})" if several else ""
            counts = (outcomes or {}).get((case.id, case.component, fault.id), Counter[str]())
            row = FaultRow(case, fault, sorted(counts.items()))
            rows.append((f"{fault.id} on {case_name}{component}", row))
            ranks.append(rank)
    caption = "How far each fault got, in the planned episodes of each case that were run"
    table = _of_view("faults", caption, Table("fault", FAULT_COLUMNS, rows))
    return table and replace(table, ranks=ranks)


def attack_table(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> Table | None:
    """Make the table of what faults did: a row per case and requirement on pairs without them."""
    rows = [
        (f"{verdict.requirement} on {verdict.case}", verdict)
        for verdict in _by_case(verdicts, cases)
        if verdict.pairs and verdict.pairs.without == FAULTS
    ]
    caption = "Attacks: runs of equal seeds with the faults and without them"
    return _of_view("monitors", caption, Table("attack", ATTACK_COLUMNS, rows))


def _of_view(view: str, caption: str, table: Table) -> Table | None:
    """A table of the terminal and of a view of the page; nothing without rows."""
    shown = Shown.TERMINAL | Shown.PAGE
    return replace(table, view=view, caption=caption, shown=shown) if table.rows else None


def pair_table(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> Table | None:
    """Make the table of what recovery did, by case, component and requirement on pairs without."""
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
            title = f"{requirement} overall{whose}"
            rows.append((title, PairRow(None, summed_pairs(pairs_of_cases), title=title)))
    caption = "Recovery: runs of equal seeds with it and without it"
    return _of_view("monitors", caption, Table("recovery", PAIR_COLUMNS, rows))


def reference_table(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> Table | None:
    """Make the table of what a reference would have avoided, by case and requirement."""
    rows = [
        (
            f"{verdict.requirement} on {verdict.case}",
            ReferenceRow(verdict, pairs),
        )
        for verdict in _by_case(verdicts, cases)
        if isinstance(pairs := verdict.pairs, PairTable) and pairs.reference and not pairs.without
    ]
    caption = "Reference: runs of equal seeds of the component, and of another one in its place"
    return _of_view("monitors", caption, Table("reference", REFERENCE_COLUMNS, rows))


def _by_case(verdicts: Sequence[ItemVerdict], cases: Sequence[CaseEntry]) -> Iterable[ItemVerdict]:
    order = {case.id: place for place, case in enumerate(cases)}
    return sorted(verdicts, key=lambda verdict: order.get(verdict.case, len(order)))


def monitor_table(monitors: Sequence[MonitorQuality]) -> Table | None:
    """Make the table of how good each monitor was.

    Targets on which it did equally well share a row; where nothing was violated and nothing
    flagged there is none.
    """
    alike: dict[MonitorQuality, list[str]] = {}
    judged = [
        each for each in monitors
        if each.true_positives + each.false_negatives + each.false_positives
    ]  # fmt: skip
    for each in judged:
        alike.setdefault(replace(each, target=""), []).append(each.target)
    rows = [
        (
            f"{each.monitor}, {each.case.partition('~')[0]}: {', '.join(targets)}",
            MonitorRow(each, targets),
        )
        for each, targets in alike.items()
    ]
    horizons = sorted({each.horizon for each in judged if each.horizon is not None})
    within = f"; in time: in the {' or '.join(map(number_text, horizons))} s before a violation"
    about = f"runs without recovery{within if horizons else ''}"
    silent = len(monitors) - len(judged)
    notes = f"{counted(silent, 'further measurement')} without a violation and without a flag"
    table = Table("monitor", MONITOR_COLUMNS, rows, about, notes=(notes,) if silent else ())
    return _of_view("monitors", "Quality of the monitors", table)


def failure_mode_tables(cases: Sequence[CaseEntry]) -> Iterator[Table]:
    """Make the tables of failure modes over all cases, and the terminal's by case.

    The negative control, and what is no failure by itself, stand apart below.
    """
    by_component = failure_modes_by_component(cases)
    several = len(by_component) > 1
    notes = []
    for component, text in decision_time_lines(cases):
        notes.append(f"answers{f' of {component}' if several else ''}: {text}")
    for component, text in decision_age_lines(cases):
        whose = f" of {component}" if several else ""
        notes.append(f"decisions{whose} came into force at an age of {text}")
    last = len(by_component) - 1
    for number, (component, modes) in enumerate(by_component.items()):
        whose = f" of {component}" if several else ""
        below = tuple(notes) if number == last else ()
        yield replace(_mode_table(modes, component, whose, below), shown=Shown.ALL)
    for case in cases_with_accounts(cases):
        whose = f" of {case.component}" if several else ""
        modes = measured_failure_modes(case.metrics.failure_modes)
        yield _mode_table(modes, case.component, f" on {case.id}{whose}")


def mode_table_of_cases(cases: Sequence[CaseEntry]) -> Table | None:
    """Make the page's table of failure modes by case."""
    rows = [
        (case.id, FailureModeRow(mode, case.component, case))
        for case in cases_with_accounts(cases)
        for mode in measured_failure_modes(case.metrics.failure_modes)
    ]
    about = (
        "the decisions of an episode depend on each other; the bound is on the share of episodes "
        "in which a failure ever shows: exact, one-sided, with 95 % confidence"
    )
    table = Table("case", failure_mode_columns(by_case=True), rows, about, shown=Shown.PAGE,
                  view="failure_modes", caption="Failure modes by case")  # fmt: skip
    return table if rows else None


def _mode_table(
    modes: Sequence[FailureModeEntry], component: str, whose: str, notes: tuple[str, ...] = ()
) -> Table:
    rows: list[tuple[str, FailureModeRow | None]] = []
    kind = ""
    for mode in modes:
        if mode.kind != kind:
            kind = mode.kind
            if kind != "failure":
                rows.append((f"{FAILURE_MODE_HEADINGS[kind]}:", None))
        rows.append((failure_mode_text(mode.name), FailureModeRow(mode, component)))
    title = FAILURE_MODE_HEADINGS["failure"] + whose
    caption = title[:1].upper() + title[1:]
    return Table(title, failure_mode_columns(), rows, NULL_NOTE, notes=notes, caption=caption,
                 shown=Shown.TERMINAL, view="failure_modes")  # fmt: skip


def verdict_table(record: SessionRecord) -> Table:
    """Make a row for each verdict, the most urgent first."""
    verdicts = sorted(record.head.verdicts, key=urgency)
    several = len({each.component for each in verdicts}) > 1
    rows = [
        (
            f"{each.requirement} on {each.case}" + (f" ({each.component})" if several else ""),
            each,
        )
        for each in verdicts
    ]
    statuses = [each.verdict for each in verdicts]
    shown = Shown.TERMINAL | Shown.SUMMARY
    return Table("verdict", VERDICT_COLUMNS, rows, statuses=statuses, shown=shown)


def requirement_table(record: SessionRecord) -> Table:
    """Make a row for each requirement with its verdicts by status, those that fail first."""
    of_each: dict[str, list[ItemVerdict]] = {each.id: [] for each in record.head.requirements}
    for verdict in record.head.verdicts:
        of_each.setdefault(verdict.requirement, []).append(verdict)
    counts = {own: verdict_counts(verdicts) for own, verdicts in of_each.items()}
    cells, left_out = record.head.coverage.cells, record.head.coverage.left_out
    untested = Counter(cell.requirement for cell in cells if cell.verdict is None)
    more = " or more" if left_out else ""

    def failing(requirement: Requirement) -> tuple[bool, bool]:
        own = counts[requirement.id]
        return not own["violated"], not own["undecided"]

    rows = [
        (each.id, RequirementRow(each, counts[each.id], f"{untested[each.id]}{more}"))
        for each in sorted(record.head.requirements, key=failing)
    ]
    columns = [
        column
        for column in REQUIREMENT_COLUMNS
        if column.name not in SPARED or any(column.cell(row).page != "0" for _, row in rows)
    ]
    return Table("requirement", columns, rows, shown=Shown.FILES)


def hazard_table(record: SessionRecord) -> Table | None:
    """Make a row for each hazard, those without evidence first."""
    rows = [(each.hazard.id, each) for each in hazards_by_need(record)]
    about = (
        "Each hazard with the requirements that are to mitigate it, and what was judged by them; "
        "neither that these are all hazards, nor that the requirements suffice against one, is "
        "shown by any run"
    )
    table = Table("hazard", HAZARD_COLUMNS, rows, about, shown=Shown.FILES, view="hazards")
    return table if rows else None


def search_table(record: SessionRecord) -> Table | None:
    """Make a row for each outcome of a search, the worst first."""
    rows = [(search.case, OutcomeRow(search, own)) for search, own in ordered_outcomes(record)]
    table = Table("search", SEARCH_COLUMNS, rows, shown=Shown.FILES, view="searches")
    return table if rows else None


def urgency(verdict: ItemVerdict) -> tuple[bool, int]:
    """Sort key: what makes the gate fail comes first, violations before what is undecided."""
    status = verdict.verdict
    return status == "supported" or verdict.waiver is not None, WORST_FIRST.index(status)


def searcher_table(search: Falsification, requirement: str) -> Table:
    """Make the table of the searchers, and below them each trivial baseline by itself."""
    rows: list[tuple[str, SearcherRow | None]] = [
        (searcher_name(each), SearcherRow(each, requirement)) for each in search.searchers
    ]
    rows.append(("trivial, each by itself:" if search.baselines else "trivial: none was run", None))
    rows += [(searcher_name(each), SearcherRow(each, requirement)) for each in search.baselines]
    shown, caption = Shown.TERMINAL | Shown.PAGE, f"Who violated {requirement} in {search.case}"
    return Table("searcher", SEARCHER_COLUMNS, rows, shown=shown, caption=caption, view="searches")


def further_tables(record: SessionRecord) -> Iterator[tuple[str, Table]]:
    """Yield the further tables of a session with their titles."""
    for table in record.head.conclusions.values():
        columns = [_concluded_column(number, table) for number in range(len(table.columns))]
        rows = [(columns[0].cell(row).terminal, row) for row in table.rows]
        about = table.about.rstrip(".")
        level = Level.SUMMARY if table.detail else Level.TERMINAL
        yield table.title, Table(columns[0].name, columns, rows, about, weight=level)


def _concluded_column(number: int, table: ConcludedTable) -> Column[Sequence[CellValue]]:
    """A column of a further table; the first one names the row, beside which the others stand."""
    column = table.columns[number]
    texts = any(isinstance(row[number], str) for row in table.rows)
    unit = f" {column.unit}" if column.unit else ""

    def cell(row: Sequence[CellValue]) -> Value:
        value = row[number]
        if isinstance(value, str):
            return prose_cell(value)
        if isinstance(value, bool):
            return "yes" if value else "no"
        return None if value is None else number_text(value)

    return Column(
        column.name + unit,
        cell,
        heading=column.name,
        small=column.unit,
        meaning=column.meaning,
        shown=Shown.ALL if number else Shown.FILES,
        kind="" if texts else "n",
    )
