"""The tables in the terminal, from the record alone.

They cover cases, attacks, pairs, monitors, faults and failure modes. Of a great many rows the
worst are shown.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, TypeVar

from pytest_dura.core.metrics import REACTIONS
from pytest_dura.evidence.case_model import ShareEntry
from pytest_dura.evidence.conclude import RECOVERY_ROLE
from pytest_dura.evidence.text import counted, name
from pytest_dura.plugin.messages import indent_if_reserved
from pytest_dura.reports.tables import (
    FAILURE_MODE_HEADINGS,
    cases_with_accounts,
    decision_age_lines,
    decision_time_lines,
    failure_mode_text,
    failure_modes_by_component,
    measured_failure_modes,
    percent_text,
)
from pytest_dura.requirements.model import FAULTS

if TYPE_CHECKING:
    from pytest_dura.evidence.case_model import (
        CaseEntry,
        CaseMetricsEntry,
        FailureModeEntry,
        FaultMetricsEntry,
        LatencyEntry,
        MeanFigure,
        MeasuredNumbers,
        OverallEntry,
        SwitchingFigures,
    )
    from pytest_dura.evidence.episode_model import FaultEntry
    from pytest_dura.evidence.session_model import MeasureEntry
    from pytest_dura.evidence.verdict_model import (
        EffectivenessEntry,
        MonitorEntry,
        PairsEntry,
        VerdictEntry,
    )

WIDTH = 100
LONGEST = 500
"""Characters of a row's name."""


def case_table(
    cases: Sequence[CaseEntry],
    overall: Sequence[OverallEntry] = (),
    measures: Sequence[MeasureEntry] = (),
) -> list[str]:
    """Write the paper's table: a line per case and component, and one per component.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
        measures: The record's.
    """
    users = sorted({name for case in cases for name in case.metrics.user})
    names, metrics = _case_names(cases, overall)
    rows = [_case_row(metric, measures, users) for metric in metrics]
    columns = ("n", "flag %", *map(_heading, measures), "recov", "alerts", "inv", *users)
    legend = [_CASE_LEGEND, *(f"{measure.heading}: {measure.meaning}" for measure in measures)]
    if any(measure.shown == "mean" for measure in measures):
        legend.append("9.1 +- 0.4 (3): mean +- standard deviation over so many runs")
    shares = [measure.name for measure in measures if measure.shown == "share"]
    if any(_beyond(metric.measures.get(name)) for metric in metrics for name in shares):
        legend.append(_BEYOND)
    return [*aligned("case", columns, names, rows), *(name(line, WIDTH) for line in legend)]


def reliance_table(cases: Sequence[CaseEntry], overall: Sequence[OverallEntry] = ()) -> list[str]:
    """Write how often recovery acts, what passengers feel, and reactions to attacks.

    Args:
        cases: Those that are shown.
        overall: The record's, over all of them.
    """
    names, metrics = _case_names(cases, overall)
    known = {name for metric in metrics for name in metric.reactions}
    classes = [*REACTIONS, *sorted(known.difference(REACTIONS))] if known else []
    has_discomfort = any(metric.comfort_failed for metric in metrics)
    if not (
        has_discomfort or known or any(metric.rescued and metric.rescued.run for metric in metrics)
    ):
        return []
    rows = [
        [
            _percent(metric.rescued),
            _share_in_control(metric.switching),
            *([_percent(metric.comfort_failed)] if has_discomfort else ()),
            *(str(metric.reactions.get(kind, 0)) for kind in classes),
        ]
        for metric in metrics
    ]
    columns = ["rescued %", "time %", *(["comfort %"] if has_discomfort else ())]
    columns += [_SHORT.get(kind, kind) for kind in classes]
    legend = [_RESCUED, *([_COMFORT] if has_discomfort else ()), *([_REACTED] if known else ())]
    return [*aligned("reliance", columns, names, rows), *legend]


def _case_names(
    cases: Sequence[CaseEntry], overall: Sequence[OverallEntry]
) -> tuple[list[str], list[CaseMetricsEntry]]:
    """Return names and metrics of the rows: the cases, then all together if several."""
    several = len({case.component for case in cases}) > 1
    names = [f"{case.id} ({case.component})" if several else case.id for case in cases]
    metrics = [case.metrics for case in cases]
    for entry in overall:
        if entry.cases > 1:
            names.append(f"overall ({entry.component})" if several else "overall")
            metrics.append(entry.metrics)
    return names, metrics


_SHORT = {"follows the fake": "follows"}
_RESCUED = (
    "rescued: runs in which recovery took over; time: share of it for which it was in control"
)
_COMFORT = "comfort: runs that at some time were beyond what passengers take"
_REACTED = (
    "unaffected ... follows (the fake): reactions to what looked like an attack, each counted"
)


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


_CASE_LEGEND = "n: valid runs (of those planned); flag: runs with an unsafe proposal"
_BEYOND = "3*: so many more runs that are invalid or missing, which are in no rate"


def _heading(measure: MeasureEntry) -> str:
    unit = {"share": "%", "count": "", "mean": measure.unit}[measure.shown]
    return f"{measure.heading} {unit}".rstrip()


def _case_row(
    metrics: CaseMetricsEntry, measures: Sequence[MeasureEntry], users: Sequence[str]
) -> list[str]:
    valid, planned = metrics.valid, metrics.planned
    missing = f"+{metrics.missing} missing" if metrics.missing else ""
    return [
        str(valid) if valid == planned else f"{valid} ({planned})",
        _percent(metrics.flagged),
        *(_measure(metrics.measures.get(measure.name), measure.shown) for measure in measures),
        str(metrics.recoveries),
        str(metrics.alerts),
        f"{metrics.invalid}{missing}",
        *(_user(metrics.user.get(name)) for name in users),
    ]


def _percent(share: ShareEntry | None) -> str:
    if share is None or share.share_of_valid is None:
        return "-"
    return f"{100 * share.share_of_valid:.0f}"


def _beyond(share: ShareEntry | MeasuredNumbers | None) -> str:
    """Return ``+3*`` for what happened in runs that are not valid."""
    beyond = share.run - share.valid if isinstance(share, ShareEntry) else 0
    return f" +{beyond}*" if beyond else ""


def _share_in_control(switching: SwitchingFigures | None) -> str:
    share = None if switching is None else switching.share
    return "-" if share is None else f"{100 * share:.1f}"


def _measure(value: ShareEntry | MeasuredNumbers | None, shown: str) -> str:
    if isinstance(value, ShareEntry):
        return _percent(value) + _beyond(value) if shown == "share" else str(value.valid)
    if value is None or value.mean is None:
        return "-"
    spread = "" if value.sd is None else f" +- {value.sd:.1f}"
    return f"{value.mean:.1f}{spread} ({value.runs})"


def _user(value: MeanFigure | None) -> str:
    return "-" if value is None or value.mean is None else f"{value.mean:.4g}"


_ATTACK_COLUMNS = ("pairs", "caused", "spared", "both", "cost", "max", "never", "p")
_ATTACK_LEGEND = (
    "pairs: runs with the faults and without, equal seeds; violations there are only with them",
    "(caused) and only without (spared); cost: mean growth of the measure; never: pairs without a",
    "value only with the faults; p: exact McNemar, for a measure exact sign test",
)


def attack_table(verdicts: Sequence[VerdictEntry], cases: Sequence[CaseEntry]) -> list[str]:
    """Write what faults did: a line per case and requirement on pairs without them."""
    from pytest_dura.evidence.verdict_model import PairsEntry

    names: list[str] = []
    rows: list[list[str]] = []
    order = {case.id: place for place, case in enumerate(cases)}
    for verdict in sorted(verdicts, key=lambda verdict: order.get(verdict.case, len(order))):
        pairs = verdict.pairs
        if not pairs or pairs.without != FAULTS:
            continue
        if isinstance(pairs, PairsEntry):
            incomplete = pairs.incomplete
            complete = pairs.pairs - incomplete
            cells = [*map(str, (pairs.only_with, pairs.only_without, pairs.both)), *"---"]
            p_value = pairs.p_value
        else:
            change = pairs.change
            complete, incomplete = change.n, len(change.incomplete)
            p_value = change.p_value
            cost = [
                "-" if value is None else f"{value:+.1f}" for value in (change.mean, change.max)
            ]
            cells = [*"---", *cost, str(len(change.lost))]
        names.append(f"{verdict.requirement} on {verdict.case}")
        rows.append([_complete(complete, incomplete), *cells, _p_value(verdict, p_value)])
    return [*aligned("attack", _ATTACK_COLUMNS, names, rows), *_ATTACK_LEGEND] if rows else []


_PAIR_COLUMNS = (
    "pairs", "prev", "intro", "futile", "unnec", "success", "p", "takeovers", "to safe s",
)  # fmt: skip
_PAIR_LEGEND = (
    "pairs: runs with recovery and without, equal seeds; violations that recovery prevented and",
    "introduced, that it met in vain (futile); runs in which it acted unnecessarily; success:",
    "prevented of prevented and futile, in % (their number); p: exact McNemar; to safe: median",
    "until the proposal was acceptable again",
)


def pair_table(verdicts: Sequence[VerdictEntry], cases: Sequence[CaseEntry]) -> list[str]:
    """Write what recovery did: a line per case, component and requirement on pairs without it."""
    from pytest_dura.evidence.verdict_model import PairsEntry

    metrics = {(case.id, case.component): case.metrics for case in cases}
    names: list[str] = []
    rows: list[list[str]] = []
    sums: dict[tuple[str, str], list[PairsEntry]] = {}
    order = {case.id: place for place, case in enumerate(cases)}
    for verdict in sorted(verdicts, key=lambda verdict: order.get(verdict.case, len(order))):
        pairs = verdict.pairs
        if not isinstance(pairs, PairsEntry) or pairs.without != RECOVERY_ROLE:
            continue
        names.append(f"{verdict.requirement} on {verdict.case}")
        key = verdict.case, verdict.component
        rows.append(_pair_row(verdict, pairs, metrics[key].switching))
        sums.setdefault((verdict.requirement, verdict.component), []).append(pairs)
    for (requirement, component), pairs_of_cases in sums.items():
        if len(pairs_of_cases) > 1:
            whose = f" ({component})" if len({component for _, component in sums}) > 1 else ""
            names.append(f"{requirement} overall{whose}")
            rows.append(_all_pairs_row(pairs_of_cases))
    return [*aligned("recovery", _PAIR_COLUMNS, names, rows), *_PAIR_LEGEND] if rows else []


def _pair_row(
    verdict: VerdictEntry, pairs: PairsEntry, switching: SwitchingFigures | None
) -> list[str]:
    row = [
        _complete(pairs.pairs - pairs.incomplete, pairs.incomplete),
        str(pairs.only_without),
        str(pairs.only_with),
        str(pairs.acted_both),
        str(pairs.acted_neither),
        _success(pairs.acted_only_without, pairs.acted_both),
        _p_value(verdict, pairs.p_value),
    ]
    if switching is None:
        return [*row, "-", "-"]
    safe = switching.time_to_safe
    median = "-" if safe.median is None else f"{safe.median:.1f}"
    never = f" ({safe.censored} never)" if safe.censored else ""
    return [*row, str(switching.takeovers), median + never]


def _all_pairs_row(pairs_of_cases: Sequence[PairsEntry]) -> list[str]:
    """Sum over cases, without a test, which would take all pairs to be of one kind."""
    incomplete = sum(pairs.incomplete for pairs in pairs_of_cases)
    futile = sum(pairs.acted_both for pairs in pairs_of_cases)
    return [
        _complete(sum(pairs.pairs for pairs in pairs_of_cases) - incomplete, incomplete),
        str(sum(pairs.only_without for pairs in pairs_of_cases)),
        str(sum(pairs.only_with for pairs in pairs_of_cases)),
        str(futile),
        str(sum(pairs.acted_neither for pairs in pairs_of_cases)),
        _success(sum(pairs.acted_only_without for pairs in pairs_of_cases), futile),
        *"---",
    ]


def _complete(complete: int, incomplete: int) -> str:
    return f"{complete} (+{incomplete} inc)" if incomplete else str(complete)


def _p_value(verdict: VerdictEntry, value: float | None) -> str:
    # The test's level holds only where the number of pairs does not depend on their results.
    undefined = value is None or verdict.method in ("sprt", "e-process")
    return "-" if undefined else f"{value:.2g}"


def _success(prevented: int, futile: int) -> str:
    tried = prevented + futile
    return f"{100 * prevented / tried:.0f} ({tried})" if tried else "-"


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


_MONITOR_COLUMNS = ("TP", "FN", "FP", "TN", "precision", "recall", "lead s", "false/h")
_MONITOR_LEGEND = (
    "runs without recovery: violated, flagged in the 5 s before (TP) or not (FN); not violated,",
    "flagged (FP) or not (TN); lead: median from flag to violation, for faults from activation",
    "to the alert; false/h: false alarms per simulated hour",
)


def monitor_table(monitors: Sequence[MonitorEntry]) -> list[str]:
    """Write how good each monitor was, a line per case and monitor.

    Requirements on which it did equally well share a line; where nothing was violated and nothing
    flagged there is none.
    """
    same: dict[tuple[str, ...], list[str]] = {}
    for monitor in monitors:
        if monitor.true_positives + monitor.false_negatives + monitor.false_positives:
            key = monitor.case.partition("~")[0], monitor.monitor, *_monitor_row(monitor)
            same.setdefault(key, []).append(monitor.target)
    names = [f"{who}, {case}: {', '.join(on)}" for (case, who, *_), on in same.items()]
    rows = [row for _, _, *row in same]
    return [*aligned("monitor", _MONITOR_COLUMNS, names, rows), *_MONITOR_LEGEND] if rows else []


def _monitor_row(monitor: MonitorEntry) -> list[str]:
    time = monitor.lead_time or monitor.delay
    per_hour = monitor.false_alarms_per_hour
    return [
        str(monitor.true_positives),
        str(monitor.false_negatives),
        str(monitor.false_positives),
        str(monitor.true_negatives),
        *("-" if rate is None else f"{rate:.2f}" for rate in (monitor.precision, monitor.recall)),
        "-" if time is None else f"{time.median:.1f}",
        "-" if per_hour is None else f"{per_hour:.0f}",
    ]


T = TypeVar("T")

MOST_ROWS = 100
"""Rows of a table, verdicts, or failures that are shown at most, unless ``-v`` is given."""
VERDICT_RANK = {"violated": 0, "undecided": 1, "supported": 2}
WHERE_ALL_ARE = "-v shows all of them, as do the report and evidence.json"


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
    cases: Sequence[CaseEntry], verdicts: Iterable[VerdictEntry], *, most: int | None = MOST_ROWS
) -> list[CaseEntry]:
    """Return the cases that tables show: those with the worst verdicts, also on comparisons."""
    rank: dict[tuple[str, str], int] = {}
    for verdict in verdicts:
        for case in (verdict.case, *([verdict.pairs.case] if verdict.pairs else ())):
            key = case, verdict.component
            rank[key] = min(rank.get(key, len(VERDICT_RANK)), VERDICT_RANK[verdict.verdict])
    ranks = [rank.get((case.id, case.component), len(VERDICT_RANK)) for case in cases]
    return keep_worst(cases, ranks, most=most)


def left_out_lines(statuses: Iterable[str]) -> list[str]:
    """Count the verdicts that are not shown, by status; no line where all are shown."""
    counts = Counter(statuses)
    if not counts:
        return []
    parts = ", ".join(f"{counts[status]} {status}" for status in VERDICT_RANK if counts[status])
    return [f"and {counted(counts.total(), 'verdict')} more: {parts}; {WHERE_ALL_ARE}"]


_FAULT_COLUMNS = ("runs", "act", "manif", "prop", "det", "after s", "recov", "after s", "viol")
_FAULT_LEGEND = (
    "act, manif: runs in which it became active, changed what the component read; of the latter,",
    "prop: proposals left those of the fault-free twin; det: an alert, median time from when it",
    "became active; recov: recovery acted, median time from manifestation; viol: a requirement was",
    "violated from then on; a+b: b more runs violated only what they violate without it, too; a/b:",
    "a of the b runs in which that is known; -: it is known of none",
)


def fault_table(cases: Sequence[CaseEntry]) -> list[str]:
    """Write a line per fault, case and component."""
    several = len({case.component for case in cases}) > 1
    names, rows = [], []
    for case in cases:
        for fault in case.metrics.faults:
            # Most cases are named after their only fault, which is not repeated. One of several
            # stays: without it the name would be that of another case.
            is_only = len(case.metrics.faults) == 1
            case_name = case.id.removesuffix(f"+{fault.id}") if is_only else case.id
            component = f" ({case.component})" if several else ""
            names.append(f"{fault.id} on {case_name}{component}")
            rows.append(_fault_row(fault))
    return [*aligned("fault", _FAULT_COLUMNS, names, rows), *_FAULT_LEGEND] if rows else []


def _fault_row(fault: FaultMetricsEntry) -> list[str]:
    propagated = _known(fault.propagated, fault.followed, fault.manifested)
    violated = _known(fault.violated, fault.judged, fault.run, fault.violated_without)
    return [
        str(fault.run),
        str(fault.activated),
        str(fault.manifested),
        propagated,
        str(fault.detected),
        _median(fault.detection_latency),
        str(fault.recovery),
        _median(fault.recovery_latency),
        violated,
    ]


def _known(count: int, known: int, whole: int, beside: int = 0) -> str:
    """Write a count, with the number of runs in which it is known if not all of them.

    Args:
        count: Runs.
        known: Runs in which it is known.
        whole: All runs.
        beside: Runs that are counted beside it.
    """
    text = f"{count}+{beside}" if beside else str(count)
    if known == whole:
        return text
    return f"{text}/{known}" if known else "-"


def _median(latency: LatencyEntry | None) -> str:
    return "-" if latency is None else f"{latency.median:.1f}"


def chain_line(fault: FaultEntry) -> str:
    """Write the causal chain of one fault, with times in s."""
    steps = [
        ("planned", fault.planned_at, ""),
        ("activated", fault.activated_at, ""),
        ("manifested", fault.manifested_at, ""),
        ("propagated", fault.propagated_at, ""),
        ("detected", fault.detected_at, _by(fault.detected_by, fault.pattern)),
        ("recovery", fault.recovery_at, _by(fault.recovery)),
        ("recovered", fault.recovered_at, ""),
    ]
    parts = [f"{step} {time:.2f}{by}" for step, time, by in steps if time is not None]
    if fault.outcome is not None:
        parts.append(fault.outcome)
    return f"{fault.id}: {', '.join(parts) or 'never active'}"


def _by(*names: str | None) -> str:
    known = ": ".join(filter(None, names))
    return f" ({known})" if known else ""


_FAILURE_MODE_COLUMNS = ("decisions", "share %", "null %", "episodes")
_FAILURE_MODE_LEGEND = (
    "decisions: those that showed it, of those that could; episodes: those in which it ever did;",
    "null: a component that ignores its input, on the same decisions: what it also reaches says",
    "nothing about the model",
)


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
    for case in cases_with_accounts(cases) if by_case else ():
        whose = f" of {case.component}" if several else ""
        lines += [
            "",
            *_failure_mode_rows(
                measured_failure_modes(case.metrics.failure_modes), f" on {case.id}{whose}"
            ),
        ]
    return [*lines, *_FAILURE_MODE_LEGEND] if lines else []


def _failure_mode_rows(modes: Sequence[FailureModeEntry], whose: str) -> list[str]:
    names, rows, kind = [], [], ""
    for mode in modes:
        if mode.kind != kind:
            kind = mode.kind
            if kind != "failure":
                names.append(f"{FAILURE_MODE_HEADINGS[kind]}:")
                rows.append([""] * len(_FAILURE_MODE_COLUMNS))
        names.append(failure_mode_text(mode.name))
        rows.append(_failure_mode_row(mode))
    return [
        line.rstrip()
        for line in aligned(
            FAILURE_MODE_HEADINGS["failure"] + whose, _FAILURE_MODE_COLUMNS, names, rows
        )
    ]


def _failure_mode_row(mode: FailureModeEntry) -> list[str]:
    return [
        f"{mode.hits}/{mode.of}",
        percent_text(mode.share),
        percent_text(mode.null_share),
        f"{mode.episodes}/{mode.of_episodes}",
    ]
