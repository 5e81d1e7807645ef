"""Tables on what faults, recovery and monitors did: their columns, for every format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

from pytest_dura.evidence.case_model import (
    CaseEntry,
    FailureModeEntry,
    FaultMetricsEntry,
    LatencyEntry,
    SwitchingFigures,
)
from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.text import name
from pytest_dura.reports.columns import (
    EMPTY,
    Cell,
    Column,
    Shown,
    given,
    name_cell,
    number_text,
    part_cell,
    percent_cell,
    role_name,
    rounded,
    seconds_text,
    share_text,
)
from pytest_dura.reports.contents import verdict_anchor
from pytest_dura.reports.failure_modes import failure_mode_text
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.pairs import Change, ChangeTable, PairCounts, PairTable
from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

# Pairs of runs: what recovery did, and what faults did.

_SEQUENTIAL_METHODS = ("sprt", "e-process")


def has_fixed_n(verdict: ItemVerdict) -> bool:
    """Whether the number of pairs does not depend on what they show, so that a p-value holds."""
    return verdict.method not in _SEQUENTIAL_METHODS


@dataclass(frozen=True)
class PairRow:
    """What recovery did in the pairs of a verdict.

    Args:
        verdict: On the pairs; ``None`` for the sums over several cases.
        pairs: Their counts.
        switching: Of the case.
        title: What is summed, without a verdict.
    """

    verdict: ItemVerdict | None
    pairs: PairTable
    switching: SwitchingFigures | None = None
    title: str = ""


PAIR_COLUMNS: Sequence[Column[PairRow]] = (
    Column(
        "requirement",
        lambda row: given(row.verdict, _requirement_of_pairs) or row.title,
        shown=Shown.PAGE, kind="",
    ),
    Column("case", lambda row: given(row.verdict, _case_of_pairs), shown=Shown.PAGE, kind=""),
    Column(
        "pairs",
        lambda row: _complete(row.pairs.pairs - row.pairs.incomplete, row.pairs.incomplete),
        meaning="runs of equal seeds, with recovery and without it",
    ),
    Column(
        "prevented", lambda row: row.pairs.only_without, short="prev",
        meaning="violated only without recovery",
    ),
    Column(
        "introduced", lambda row: row.pairs.only_with, short="intro",
        meaning="violated only with recovery",
    ),
    Column(
        "in vain", lambda row: row.pairs.acted_both, short="futile",
        meaning="violated both with and without, though recovery acted",
    ),
    Column(
        "unavoidable", lambda row: row.pairs.reference_both if row.pairs.reference else None,
        short="unavoid", meaning="violated with recovery, and by the reference as well",
    ),
    Column(
        "prevented share", lambda row: _prevented_share(row.pairs), short="share",
        small="95 % interval",
        meaning="violations without recovery that it prevented, of all of them or of those that "
        "the reference avoids, and the exact 95 % interval of that share, in per cent",
    ),
    Column(
        "unnecessary", lambda row: row.pairs.acted_neither, short="unnec",
        meaning="recovery acted, and neither run violated",
    ),
    Column(
        "success", lambda row: _success(row.pairs), small="(n)",
        meaning="prevented, of prevented and in vain",
    ),
    Column("p", lambda row: _p_value(row.verdict, row.pairs), heading="p", small="McNemar",
           meaning="exact test of McNemar"),
    Column(
        "share of time", lambda row: given(row.switching, lambda own: share_text(own.share)),
        shown=Shown.PAGE,
    ),
    Column("takeovers", lambda row: given(row.switching, lambda own: own.takeovers)),
    Column(
        "to safe", lambda row: given(row.switching, _time_to_safe), small="median",
        short="to safe s",
        meaning="median until the proposal was acceptable again",
    ),
)  # fmt: skip


def summed_pairs(pairs: Sequence[PairTable]) -> PairTable:
    """The counts of several cases, without a test, which would take all pairs to be of one kind."""
    counts = {
        field.name: sum(getattr(entry, field.name) for entry in pairs)
        for field in fields(PairCounts)
        if field.name != "p_value"
    }
    return replace(pairs[0], **counts, p_value=None)


def _requirement_of_pairs(verdict: ItemVerdict) -> Cell:
    anchor = verdict_anchor(verdict.requirement, verdict.case)
    return name_cell(verdict.requirement, anchor=anchor)


def _case_of_pairs(verdict: ItemVerdict) -> Cell:
    without = verdict.pairs.without if verdict.pairs else RECOVERY_ROLE
    notes = () if without == RECOVERY_ROLE else (f"without {role_name(without)}",)
    return name_cell(verdict.case, *notes)


def _complete(complete: int, incomplete: int) -> Cell:
    text = str(complete)
    if not incomplete:
        return Cell(text, text, text)
    short = f"{complete} (+{incomplete} inc)"
    return Cell(short, short, text, (f"(+{incomplete} incomplete)",), below=True)


def _success(pairs: PairTable) -> Cell | None:
    tried = pairs.acted_only_without + pairs.acted_both
    if not tried:
        return None
    share = pairs.acted_only_without / tried
    text = f"{100 * share:.0f} ({tried})"
    return Cell(text, text, share_text(share), (f"({tried})",))


def _prevented_share(pairs: PairTable) -> Cell | None:
    """Prevented violations of those to prevent, with the exact interval of their share."""
    count, of = pairs.prevented_of_these, pairs.to_prevent
    interval = interval_cell(count, of)
    if interval is None:
        return None
    return replace(interval, page=f"{count} of {of}", notes=(f"({interval.page})",), below=True)


def _p_value(verdict: ItemVerdict | None, pairs: PairTable | Change) -> Cell | None:
    # The test's level holds only where the number of pairs does not depend on their results.
    if verdict is None or pairs.p_value is None or not has_fixed_n(verdict):
        return None
    text = f"{pairs.p_value:.2g}"
    return Cell(text, text, number_text(pairs.p_value, 2))


def _time_to_safe(switching: SwitchingFigures) -> Cell:
    safe = switching.time_to_safe
    note = f"({safe.censored} never)" if safe.censored else ""
    text = f"{rounded(safe.median, '.1f')} {note}".rstrip()
    return Cell(text, text, seconds_text(safe.median, 1), (note,) if note else ())


def _counts(verdict: ItemVerdict) -> PairTable | None:
    """Violations in the pairs of a verdict, if they are counted."""
    return verdict.pairs if isinstance(verdict.pairs, PairTable) else None


def _change(verdict: ItemVerdict) -> Change | None:
    """Change of a measure in the pairs of a verdict, if that is judged."""
    return verdict.pairs.change if isinstance(verdict.pairs, ChangeTable) else None


def _complete_attacks(verdict: ItemVerdict) -> Cell:
    counts, change = _counts(verdict), _change(verdict)
    if counts is not None:
        return _complete(counts.pairs - counts.incomplete, counts.incomplete)
    return _complete(change.n, len(change.incomplete)) if change else EMPTY


def _p_of_attack(verdict: ItemVerdict) -> Cell | None:
    figures = _counts(verdict) or _change(verdict)
    return None if figures is None else _p_value(verdict, figures)


def _growth(value: float | None) -> Cell | None:
    text = rounded(value, "+.1f")
    return None if value is None else Cell(text, text, number_text(value, 2))


ATTACK_COLUMNS: Sequence[Column[ItemVerdict]] = (
    Column(
        "requirement", _requirement_of_pairs, shown=Shown.PAGE, kind="",
    ),
    Column("case", lambda row: name_cell(row.case), shown=Shown.PAGE, kind=""),
    Column(
        "pairs", _complete_attacks,
        meaning="runs of equal seeds, with the faults and without them",
    ),
    Column(
        "caused", lambda row: given(_counts(row), lambda own: own.only_with),
        meaning="violated only with the faults",
    ),
    Column(
        "spared", lambda row: given(_counts(row), lambda own: own.only_without),
        meaning="violated only without the faults",
    ),
    Column("both", lambda row: given(_counts(row), lambda own: own.both)),
    Column(
        "cost", lambda row: given(_change(row), lambda own: _growth(own.mean)),
        meaning="mean growth of the requirement's measure, in its unit",
    ),
    Column(
        "greatest", lambda row: given(_change(row), lambda own: _growth(own.max)), short="max",
        meaning="the greatest of a pair",
    ),
    Column(
        "never", lambda row: given(_change(row), lambda own: len(own.lost)),
        meaning="pairs whose measure has no value, only with the faults",
    ),
    Column(
        "p", _p_of_attack, heading="p",
        small="McNemar, sign test", meaning="exact test of McNemar, for a measure the sign test",
    ),
)  # fmt: skip


# Pairs of runs: what a reference would have avoided.


@dataclass(frozen=True)
class ReferenceRow:
    """What a reference came to in the pairs of a verdict.

    Args:
        verdict: On the pairs.
        pairs: Their counts.
    """

    verdict: ItemVerdict
    pairs: PairTable


INTERVAL = 0.95
"""Confidence of an exact two-sided interval of a share in tables."""


def interval_cell(count: int, of: int) -> Cell | None:
    """The exact two-sided interval of a share, in per cent; none of nothing."""
    if not of:
        return None
    one_sided = (1.0 + INTERVAL) / 2.0
    low, high = lower_bound(count, of, one_sided), upper_bound(count, of, one_sided)
    text = f"{100 * low:.0f}-{100 * high:.0f}"
    return Cell(text, text, f"{100 * low:.0f} to {100 * high:.0f}\N{NO-BREAK SPACE}%")


REFERENCE_COLUMNS: Sequence[Column[ReferenceRow]] = (
    Column(
        "requirement", lambda row: _requirement_of_pairs(row.verdict),
        shown=Shown.PAGE, kind="",
    ),
    Column("case", lambda row: name_cell(row.verdict.case), shown=Shown.PAGE, kind=""),
    Column("reference", lambda row: name_cell(row.pairs.reference), kind=""),
    Column(
        "pairs", lambda row: _complete(row.pairs.complete, row.pairs.incomplete),
        meaning="runs of equal seeds, of the component and of the reference",
    ),
    Column(
        "avoidable", lambda row: row.pairs.avoidable, short="avoid",
        meaning="violated by the component, and not by the reference",
    ),
    Column(
        "avoidable share", lambda row: interval_cell(row.pairs.avoidable, row.pairs.complete),
        short="95 % interval", small="95 % interval",
        meaning="exact interval of the share of avoidable violations, in per cent",
    ),
    Column(
        "unavoidable", lambda row: row.pairs.unavoidable, short="unavoid",
        meaning="violated by the reference as well",
    ),
    Column(
        "unavoidable share", lambda row: interval_cell(row.pairs.unavoidable, row.pairs.complete),
        small="95 % interval", shown=Shown.FILES,
    ),
    Column(
        "only the reference", lambda row: row.pairs.only_without, short="only ref",
        meaning="violated by the reference alone",
    ),
    Column("p", lambda row: _p_value(row.verdict, row.pairs), heading="p", small="McNemar",
           meaning="exact test of McNemar"),
)  # fmt: skip


# Monitors and faults.


@dataclass(frozen=True)
class MonitorRow:
    """A monitor on a case, with the targets on which it did equally well."""

    entry: MonitorQuality
    targets: Sequence[str] = ()


def _measured_episodes(entry: MonitorQuality) -> Cell:
    text = str(entry.episodes)
    kinds = {"invalid": entry.invalid, "missing": entry.missing}
    notes = tuple(f"{count} {kind}" for kind, count in kinds.items() if count)
    return Cell(text, text, text, notes, below=True)


def _rate_of(rate: float | None, entry: MonitorQuality, false: int) -> Cell | None:
    if rate is None:
        return None
    true = entry.true_positives
    text = f"{rate:.2f}"
    return Cell(text, text, number_text(rate, 2), (f"({true}/{true + false})",))


def _lead(entry: MonitorQuality) -> Cell | None:
    time = entry.lead_time or entry.delay
    if time is None:
        return None
    text = f"{time.median:.1f}"
    page = f"{seconds_text(time.min)} / {seconds_text(time.median)}"
    return Cell(text, text, page if entry.lead_time else f"delay {page}")


def _per_hour(value: float | None) -> Cell | None:
    text = rounded(value, ".0f")
    return None if value is None else Cell(text, text, number_text(value))


MONITOR_COLUMNS: Sequence[Column[MonitorRow]] = (
    Column("monitor", lambda row: role_name(row.entry.monitor), shown=Shown.PAGE, kind=""),
    Column("target", lambda row: ", ".join(map(name, row.targets)), shown=Shown.PAGE, kind=""),
    Column("case", lambda row: name_cell(row.entry.case), shown=Shown.PAGE, kind=""),
    Column("n", lambda row: _measured_episodes(row.entry), heading="n", shown=Shown.PAGE),
    Column(
        "TP", lambda row: row.entry.true_positives, heading="TP",
        meaning="true positives, violated runs that were flagged in time",
    ),
    Column(
        "FN", lambda row: row.entry.false_negatives, heading="FN",
        meaning="false negatives, the other violated runs",
    ),
    Column(
        "FP", lambda row: row.entry.false_positives, heading="FP",
        meaning="false positives, flagged runs without a violation",
    ),
    Column(
        "TN", lambda row: row.entry.true_negatives, heading="TN",
        meaning="true negatives, the others",
    ),
    Column(
        "precision",
        lambda row: _rate_of(row.entry.precision, row.entry, row.entry.false_positives),
    ),
    Column(
        "recall", lambda row: _rate_of(row.entry.recall, row.entry, row.entry.false_negatives)
    ),
    Column(
        "lead time", lambda row: _lead(row.entry), small="min / median", short="lead s",
        meaning="from the flag to the violation, for faults the delay from their activation to the "
        "alert, in the terminal the median",
    ),
    Column(
        "false / h", lambda row: _per_hour(row.entry.false_alarms_per_hour), short="false/h",
        meaning="false alarms per simulated hour",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class FaultRow:
    """A fault of a case.

    Args:
        case: The case.
        fault: Its figures there.
        outcomes: How many episodes came to which outcome, in words; the page has them.
    """

    case: CaseEntry
    fault: FaultMetricsEntry
    outcomes: Sequence[tuple[str, int]] = ()


def _reached(count: int, of: int) -> Cell:
    return Cell(str(count), f"{count} of {of}", f"{count}/{of}")


def _propagated(fault: FaultMetricsEntry) -> Cell:
    terminal = _known(fault.propagated, fault.followed, fault.manifested)
    return replace(_reached(fault.propagated, fault.followed), terminal=terminal)


def _violated_after(fault: FaultMetricsEntry) -> Cell:
    terminal = _known(fault.violated, fault.judged, fault.run, fault.violated_without)
    return replace(_reached(fault.violated, fault.judged), terminal=terminal)


def _known(count: int, known: int, whole: int, beside: int = 0) -> str:
    """A count, with the number of runs in which it is known if not all of them.

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


def _median(latency: LatencyEntry | None) -> str | None:
    return None if latency is None else f"{latency.median:.1f}"


def _latencies(fault: FaultMetricsEntry) -> str | None:
    latencies = {
        "detection": fault.detection_latency,
        "to recovery": fault.recovery_latency,
        "to recover": fault.time_to_recover,
    }
    parts = [f"{what} {seconds_text(time.median)}" for what, time in latencies.items() if time]
    return ", ".join(parts) or None


def _target(fault: FaultMetricsEntry) -> str:
    readers = ", ".join(map(name, fault.read_by))
    on = f"{name(fault.id)} on {name(fault.target)}"
    return f"{on}, read by {readers}" if readers else on


FAULT_COLUMNS: Sequence[Column[FaultRow]] = (
    Column(
        "case and fault",
        lambda row: name_cell(row.case.id, _target(row.fault), below=True),
        shown=Shown.PAGE, kind="",
    ),
    Column("runs", lambda row: row.fault.run, shown=Shown.TERMINAL),
    Column(
        "activated", lambda row: _reached(row.fault.activated, row.fault.run), short="act",
        meaning="it began, of the planned runs",
    ),
    Column(
        "manifested", lambda row: _reached(row.fault.manifested, row.fault.run), short="manif",
        meaning="changed what a role read, or the command, of the planned runs",
    ),
    Column(
        "propagated", lambda row: _propagated(row.fault), short="prop",
        meaning="changed what the component did, of those compared with a run without it",
    ),
    Column(
        "detected", lambda row: _reached(row.fault.detected, row.fault.manifested), short="det",
        meaning="an alert, of those that manifested",
    ),
    Column(
        "detected after", lambda row: _median(row.fault.detection_latency), short="after s",
        shown=Shown.TERMINAL,
    ),
    Column(
        "recovery", lambda row: _reached(row.fault.recovery, row.fault.manifested), short="recov",
        meaning="recovery acted, of those that manifested; after: median time, for det from the "
        "activation, for recov from the first effect",
    ),
    Column(
        "recovery after", lambda row: _median(row.fault.recovery_latency), short="after s",
        shown=Shown.TERMINAL,
    ),
    Column(
        "recovered", lambda row: _reached(row.fault.recovered, row.fault.recovery),
        meaning="control was handed back", shown=Shown.PAGE,
    ),
    Column(
        "violated after", lambda row: _violated_after(row.fault), short="viol",
        meaning="a requirement was violated from the fault's first effect on, and not as well by "
        "the same seed without any fault, which a+b counts behind it; of those whose outcome is "
        "known, a/b, or - of none",
    ),
    Column(
        "outcomes",
        lambda row: ", ".join(f"{count} {name(status)}" for status, count in row.outcomes),
        shown=Shown.PAGE, kind="",
        meaning="idle, it never began; masked, it began and never had an effect, whatever was "
        "violated without it; contained, its effect changed no proposal; tolerated, it may have, "
        "and nothing was violated after it; violated also without it, so does the same seed "
        "without any fault, and it is not to blame; not followed, no verdict asked",
    ),
    Column(
        "median latency", lambda row: _latencies(row.fault), shown=Shown.PAGE, kind="latency",
        meaning="simulated: detection from its activation to the alert, also where that came "
        "before it had an effect, to recovery from its first effect to the first recovery action, "
        "to recover from that action until the proposal was acceptable again",
    ),
)  # fmt: skip


# Failure modes.


@dataclass(frozen=True)
class FailureModeRow:
    """A failure mode of a component.

    Args:
        mode: Its figures.
        component: The component's name.
        case: Of a single case; ``None`` over all of them.
    """

    mode: FailureModeEntry
    component: str = ""
    case: CaseEntry | None = None


def failure_mode_columns(*, by_case: bool = False) -> list[Column[FailureModeRow]]:
    """The figures of failure modes, over all cases or by case."""
    single: list[Column[FailureModeRow]] = [
        Column(
            "case",
            lambda row: given(row.case, lambda own: name_cell(own.id)),
            shown=Shown.PAGE,
            kind="",
        ),
        Column("component", lambda row: name_cell(row.component), shown=Shown.PAGE, kind=""),
    ]
    bound: Column[FailureModeRow] = Column(
        "at most", lambda row: percent_cell(row.mode.upper), shown=Shown.PAGE
    )
    columns: list[Column[FailureModeRow]] = [
        Column(
            "failure mode", lambda row: name_cell(failure_mode_text(row.mode.name)),
            shown=Shown.FILES, kind="",
        ),
        Column("kind", lambda row: row.mode.kind, shown=Shown.SUMMARY),
        Column("component", lambda row: name_cell(row.component), shown=Shown.SUMMARY),
        Column(
            "decisions", lambda row: part_cell(row.mode.hits, row.mode.of),
            meaning="those that showed it, of those that could",
        ),
        Column("share %", lambda row: percent_cell(row.mode.share), heading="Share"),
        Column(
            "null %", lambda row: percent_cell(row.mode.null_share), heading="Null",
        ),
        Column(
            "episodes", lambda row: part_cell(row.mode.episodes, row.mode.of_episodes),
            meaning="those in which it ever showed, of those in which it could",
        ),
    ]  # fmt: skip
    return [*single, *columns, bound] if by_case else columns
