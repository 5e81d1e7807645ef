"""The tables in the terminal, from the record alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.evidence.text import name
from pytest_dura.plugin.messages import apart

Data = Mapping[str, Any]

WIDTH = 100
LONGEST = 500
"""Characters of a row's name."""


def case_table(cases: Sequence[Data]) -> list[str]:
    """The paper's table: one line per case and component."""
    several = len({case["component"] for case in cases}) > 1
    users = sorted({name for case in cases for name in case["metrics"]["user"]})
    names = [f"{case['id']} ({case['component']})" if several else case["id"] for case in cases]
    rows = [_row(case["metrics"], users) for case in cases]
    starred = any(_beyond(case["metrics"]["collided"]) for case in cases)
    legend = [*LEGEND, BEYOND] if starred else LEGEND
    return [*aligned("case", (*COLUMNS, *users), names, rows), *legend]


def aligned(
    title: str, columns: Sequence[str], names: Sequence[str], rows: Sequence[Sequence[str]]
) -> list[str]:
    """Lines of a table; a name that is too long stands on a line of its own."""
    # The names of cases, faults and metrics may have any length.
    names = [apart(name(text, LONGEST)) for text in names]
    table = [[name(one) for one in columns], *rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(columns))]
    room = max(24, WIDTH - sum(widths) - 2 * len(widths))
    left = min(max(map(len, [title, *names])), room)
    lines = []
    for label, row in zip([title, *names], table, strict=True):
        cells = "".join(f"  {cell:>{width}}" for cell, width in zip(row, widths, strict=True))
        if len(label) > left:
            lines += [label, " " * left + cells]
        else:
            lines.append(f"{label:<{left}}{cells}")
    return lines


COLUMNS = ("n", "flag %", "coll %", "clearance s", "grid", "recov", "alerts", "inv")
LEGEND = (
    "n: valid runs (of those planned); flag, coll: runs with an unsafe proposal, with a collision;",
    "clearance: mean +- sd over cleared runs (their number); grid: gridlock, not cleared in time",
)
BEYOND = "3*: so many collisions in runs that are invalid or missing, which are in no rate"


def _row(metrics: Data, users: Sequence[str]) -> list[str]:
    valid, planned = metrics["valid"], metrics["planned"]
    grid = metrics["gridlock"]
    missing = f"+{metrics['missing']} missing" if metrics["missing"] else ""
    return [
        str(valid) if valid == planned else f"{valid} ({planned})",
        _percent(metrics["flagged"]),
        _percent(metrics["collided"]) + _beyond(metrics["collided"]),
        _time(metrics["clearance_time"]),
        "-" if grid is None else str(grid["valid"]),
        str(metrics["recoveries"]),
        str(metrics["alerts"]),
        f"{metrics['invalid']}{missing}",
        *(_user(metrics["user"].get(name)) for name in users),
    ]


def _percent(share: Data | None) -> str:
    if share is None or share["share_of_valid"] is None:
        return "-"
    return f"{100 * share['share_of_valid']:.0f}"


def _beyond(share: Data | None) -> str:
    """``+3*`` for what happened in runs that are not valid."""
    beyond = 0 if share is None else share["run"] - share["valid"]
    return f" +{beyond}*" if beyond else ""


def _time(clearance: Data | None) -> str:
    if clearance is None or clearance["mean"] is None:
        return "-"
    spread = "" if clearance["sd"] is None else f" +- {clearance['sd']:.1f}"
    return f"{clearance['mean']:.1f}{spread} ({clearance['runs']})"


def _user(value: Data | None) -> str:
    return "-" if value is None or value["mean"] is None else f"{value['mean']:.4g}"


PAIR_COLUMNS = (
    "pairs", "prev", "intro", "futile", "unnec", "p", "share %", "takeovers", "to safe s",
)  # fmt: skip
PAIR_LEGEND = (
    "pairs: runs with recovery and without, equal seeds; violations that recovery prevented and",
    "introduced, that it met in vain (futile); runs in which it acted unnecessarily; p: exact",
    "McNemar; share of time in control; to safe: median until the proposal was acceptable again",
)


def pair_table(verdicts: Sequence[Data], cases: Sequence[Data]) -> list[str]:
    """What recovery did: one line per case, component and requirement on pairs without it."""
    metrics = {(case["id"], case["component"]): case["metrics"] for case in cases}
    names, rows = [], []
    for verdict in verdicts:
        pairs = verdict["pairs"]
        if not pairs or pairs["without"] != "recovery_planner" or "only_with" not in pairs:
            continue
        names.append(f"{verdict['requirement']} on {verdict['case']}")
        key = verdict["case"], verdict["component"]
        rows.append(_pair_row(verdict, metrics[key]["switching"]))
    return [*aligned("recovery", PAIR_COLUMNS, names, rows), *PAIR_LEGEND] if rows else []


def _pair_row(verdict: Data, switching: Data | None) -> list[str]:
    pairs = verdict["pairs"]
    # The test's level holds for a number of pairs that does not depend on what they show.
    fixed = verdict["method"] not in ("sprt", "e-process")
    incomplete = f" (+{pairs['incomplete']} inc)" if pairs["incomplete"] else ""
    row = [
        f"{pairs['pairs'] - pairs['incomplete']}{incomplete}",
        str(pairs["only_without"]),
        str(pairs["only_with"]),
        str(pairs["acted_both"]),
        str(pairs["acted_neither"]),
        f"{pairs['p_value']:.2g}" if fixed else "-",
    ]
    if switching is None:
        return [*row, "-", "-", "-"]
    safe = switching["time_to_safe"]
    median = "-" if safe["median"] is None else f"{safe['median']:.1f}"
    never = f" ({safe['censored']} never)" if safe["censored"] else ""
    return [*row, f"{100 * switching['share']:.1f}", str(switching["takeovers"]), median + never]


MONITOR_COLUMNS = ("TP", "FN", "FP", "TN", "precision", "recall", "lead s", "false/h")
MONITOR_LEGEND = (
    "runs without recovery: violated, flagged in the 5 s before (TP) or not (FN); not violated,",
    "flagged (FP) or not (TN); lead: median from flag to violation, for faults from activation",
    "to the alert; false/h: false alarms per simulated hour",
)


def monitor_table(monitors: Sequence[Data]) -> list[str]:
    """How good each monitor was, one line per case and monitor.

    Requirements on which it did equally well share a line; where nothing was violated and nothing
    flagged there is none.
    """
    same: dict[tuple[str, ...], list[str]] = {}
    for one in monitors:
        if one["true_positives"] + one["false_negatives"] + one["false_positives"]:
            key = one["case"].partition("~")[0], one["monitor"], *_monitor_row(one)
            same.setdefault(key, []).append(one["target"])
    names = [f"{who}, {case}: {', '.join(on)}" for (case, who, *_), on in same.items()]
    rows = [row for _, _, *row in same]
    return [*aligned("monitor", MONITOR_COLUMNS, names, rows), *MONITOR_LEGEND] if rows else []


def _monitor_row(one: Data) -> list[str]:
    time = one["lead_time"] or one["delay"]
    per_hour = one["false_alarms_per_hour"]
    return [
        str(one["true_positives"]),
        str(one["false_negatives"]),
        str(one["false_positives"]),
        str(one["true_negatives"]),
        *("-" if one[key] is None else f"{one[key]:.2f}" for key in ("precision", "recall")),
        "-" if time is None else f"{time['median']:.1f}",
        "-" if per_hour is None else f"{per_hour:.0f}",
    ]


def counted(number: int, noun: str) -> str:
    """``1 run``, ``2 runs``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")
