"""Accounts: what a component tells of its proposals, and the failure modes that this shows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.metrics import Tally
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Percept, Tick

Floats = NDArray[np.float64]

DECIDED = "decided"
"""Key of an account: whether the component decided anew, rather than held what it had decided."""
NULL = "null"
"""Key of an account: what a null component, which ignores its input, would have told instead."""
SECONDS = "seconds"
"""Key of an account: how long the component took for its decision, in s of wall-clock time."""
LONGEST = 100_000
"""Characters of one account, as JSON."""


def account_problem(account: Any) -> str | None:
    """What is wrong with an account; ``None`` if nothing is."""
    if not isinstance(account, Mapping):
        return f"gave an account that is {type(account).__name__}, not a mapping"
    if not account:
        return None
    try:
        size = len(json.dumps(dict(account), allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        return f"gave an account that is no plain data: {error}"
    if size > LONGEST:
        return f"gave an account of {size} characters; {LONGEST} are allowed"
    return None


@dataclass(frozen=True)
class Accounted:
    """What the accounts of an episode come to.

    Args:
        signals: Columns of shape ``(ticks,)``; the last decision is still in force at the end.
        tallies: By the same names.
        seconds: Wall-clock seconds of each decision that was made anew and took any.
    """

    signals: Mapping[str, Floats]
    tallies: Mapping[str, Tally]
    seconds: Sequence[float]


def accounted(
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> Accounted | None:
    """Signals and tallies of an episode's accounts; ``None`` without any account.

    Raises:
        ValueError: For a column of another length than there are decisions.
    """
    if not any(accounts):
        return None
    columns = _measures(simulator, ticks, percepts, accounts)
    null = [one.get(NULL, {}) for one in accounts]
    null_columns = _measures(simulator, ticks, percepts, null) if any(null) else {}
    fresh = np.array([bool(one.get(DECIDED)) for one in accounts])
    signals, tallies = {}, {}
    for name, column in columns.items():
        filled = np.nan_to_num(column, nan=0.0)
        signals[name] = np.append(filled, filled[-1:]) if len(ticks) > len(filled) else filled
        counts = _count(column[fresh])
        beside = null_columns.get(name)
        tallies[name] = Tally(*counts, *((0, 0) if beside is None else _count(beside[fresh])))
    seconds = [float(one[SECONDS]) for one in accounts if one.get(DECIDED) and SECONDS in one]
    return Accounted(signals, tallies, seconds)


def _measures(
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> dict[str, Floats]:
    found = simulator.account_measures(ticks, percepts, accounts)
    columns = {name: np.asarray(column, dtype=np.float64) for name, column in found.items()}
    for name, column in columns.items():
        if column.shape != (len(accounts),):
            raise ValueError(
                f"account_measures returned {name!r} of shape {column.shape}, not "
                f"({len(accounts)},)"
            )
    return columns


def _count(column: Floats) -> tuple[int, int]:
    known = column[~np.isnan(column)]
    return int((known > 0.5).sum()), len(known)
