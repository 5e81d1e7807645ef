"""What the terminal shows of faults: how far each got, and the chain of one that went far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pytest_dura.plugin.tables import Data, aligned

COLUMNS = ("runs", "act", "manif", "prop", "det", "after s", "recov", "after s", "viol")
LEGEND = (
    "act, manif: runs in which it became active, changed what the component read; of the latter,",
    "prop: proposals left those of the fault-free twin; det: an alert, median time from when it",
    "became active; recov: recovery acted, median time from manifestation; viol: a requirement was",
    "violated from then on; a+b: b more runs violated only what they violate without it, too; a/b:",
    "a of the b runs in which that is known; -: it is known of none",
)


def fault_table(cases: Sequence[Data]) -> list[str]:
    """One line per fault, case and component."""
    several = len({case["component"] for case in cases}) > 1
    names, rows = [], []
    for case in cases:
        for fault in case["metrics"]["faults"]:
            # Most cases are named after their only fault, which need not be said twice. Of several
            # none is left out: what remained would be the name of another case.
            alone = len(case["metrics"]["faults"]) == 1
            told = case["id"].removesuffix(f"+{fault['id']}") if alone else case["id"]
            component = f" ({case['component']})" if several else ""
            names.append(f"{fault['id']} on {told}{component}")
            rows.append(_row(fault))
    return [*aligned("fault", COLUMNS, names, rows), *LEGEND] if rows else []


def _row(fault: Data) -> list[str]:
    propagated = _known(fault["propagated"], fault["followed"], fault["manifested"])
    violated = _known(fault["violated"], fault["judged"], fault["run"], fault["violated_without"])
    return [
        str(fault["run"]),
        str(fault["activated"]),
        str(fault["manifested"]),
        propagated,
        str(fault["detected"]),
        _median(fault["detection_latency"]),
        str(fault["recovery"]),
        _median(fault["recovery_latency"]),
        violated,
    ]


def _known(count: int, known: int, whole: int, apart: int = 0) -> str:
    """A count; with the number of runs in which it is known, if that is not all of them.

    Args:
        count: Runs.
        known: Runs in which it is known.
        whole: All runs.
        apart: Runs that are counted beside it.
    """
    shown = f"{count}+{apart}" if apart else str(count)
    if known == whole:
        return shown
    return f"{shown}/{known}" if known else "-"


def _median(latency: Data | None) -> str:
    return "-" if latency is None else f"{latency['median']:.1f}"


def chain_line(fault: Data) -> str:
    """The chain of one fault in words, with times in s."""
    steps = [
        ("planned", fault["planned_at"], ""),
        ("activated", fault["activated_at"], ""),
        ("manifested", fault["manifested_at"], ""),
        ("propagated", fault["propagated_at"], ""),
        ("detected", fault["detected_at"], _by(fault["detected_by"], fault["pattern"])),
        ("recovery", fault["recovery_at"], _by(fault["recovery"])),
        ("recovered", fault["recovered_at"], ""),
    ]
    told = [f"{word} {time:.2f}{by}" for word, time, by in steps if time is not None]
    if fault["outcome"] is not None:
        told.append(str(fault["outcome"]))
    return f"{fault['id']}: {', '.join(told) or 'never active'}"


def _by(*names: Any) -> str:
    known = [str(name) for name in names if name]
    return f" ({': '.join(known)})" if known else ""
