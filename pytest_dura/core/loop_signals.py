"""Signals that the loop adds: what the component declares of proposals, and who is in control.

The account of a proposal is what the component declares of how it came to it, as plain data; the
simulator measures failure modes from accounts. A decision is made at every tick but the last, so
the last sample repeats the one before it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import describe_error, type_name
from pytest_dura.core.metrics import KINDS, Tally
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import NOTHING, Percept, Tick

Floats = NDArray[np.float64]

PROPOSAL_PREFIX = "proposal."
"""Beginning of the names of the signals that accounts come to."""
DECIDED = "decided"
"""Key of an account: ``True`` where the component decided anew, rather than held what it had."""
NULL = "null"
"""Key of an account: what a null component, which ignores its input, would have told instead."""
SECONDS = "seconds"
"""Key of an account: how long the component took for its decision, in s of wall-clock time."""
_AGE = "age"
"""Key of an account: simulated seconds since the percept behind the decision in force."""
_FALLBACK = "fallback"
"""Key of an account: ``True`` where the action is no decision of the component's own."""
INPUT = (DECIDED, "at", "perceived")
"""Keys of an account that tell of the input, which a null component has as well."""
LONGEST = 100_000
"""Characters of one account, as JSON."""
DEEPEST = 12
"""Mappings and lists within each other in one account."""
_DECIMALS = 9


def read_account(account: Any) -> tuple[Mapping[str, Any], str | None]:
    """An account as data of our own, and what is wrong with it; ``None`` if nothing is.

    What plain data it holds is not looked at: who reads it takes what he understands. Reading it
    may call the component's code, whose exceptions are raised.
    """
    if not isinstance(account, Mapping):
        return NOTHING, f"gave an account that is {type_name(account)}, not a mapping"
    try:
        told = dict(account)
        text = json.dumps(told, allow_nan=False) if told else ""
    except Exception as error:
        return NOTHING, f"gave an account that is no plain data: {describe_error(error)}"
    if len(text) > LONGEST:
        return NOTHING, f"gave an account of {len(text)} characters; {LONGEST} are allowed"
    if not all(isinstance(key, str) for key in told):
        return NOTHING, "gave an account with a key that is no text"
    read: Mapping[str, Any] = json.loads(text) if text else NOTHING
    deep = _depth(read) > DEEPEST
    return read, f"gave an account of more than {DEEPEST} levels" if deep else None


def account_problem(account: Any) -> str | None:
    """What is wrong with an account; ``None`` if nothing is."""
    return read_account(account)[1]


def copied_account(account: Mapping[str, Any]) -> Mapping[str, Any]:
    """An account of which the component cannot change anything any more.

    Args:
        account: One with which nothing is wrong.
    """
    if account is NOTHING or not account:
        return NOTHING
    data: dict[str, Any] = json.loads(json.dumps(dict(account)))
    return data


def _depth(value: Any, above: int = 0) -> int:
    """Levels of plain data; no more is looked at than it takes to be too deep."""
    if above > DEEPEST or not isinstance(value, (Mapping, list, tuple)):
        return above
    parts = value.values() if isinstance(value, Mapping) else value
    return max((_depth(part, above + 1) for part in parts), default=above + 1)


@dataclass(frozen=True)
class AccountColumns:
    """What the accounts of an episode come to.

    Args:
        signals: Columns of shape ``(ticks,)``; the last decision is still in force at the end.
        tallies: By the names of the failure modes.
        seconds: Wall-clock seconds of each decision that was made anew and took any.
        ages: Simulated seconds between the percept behind a decision and the tick at which it came
            into force, of each decision of the component's own that says so.
    """

    signals: Mapping[str, Floats]
    tallies: Mapping[str, Tally]
    seconds: Sequence[float]
    ages: Sequence[float]


def account_columns(
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> AccountColumns | None:
    """Signals and tallies of an episode's accounts; ``None`` without any account.

    Raises:
        ValueError: For a column of another length than there are decisions, and for a measure of
            an unknown kind.
    """
    if not any(accounts):
        return None
    world = simulator, ticks, percepts
    columns = _columns("account_measures", *world, accounts)
    null = [_null(account) for account in accounts]
    null_columns = _columns("account_measures", *world, null) if any(null) else {}
    fresh = np.array([_decides(account) for account in accounts])
    tallies = {}
    for name, column in columns.items():
        counts = _count(column[fresh])
        beside = null_columns.get(name)
        null_counts = (0, 0) if beside is None else _count(beside[fresh])
        tallies[name] = Tally(*counts, *null_counts, _kind(simulator, name))
    plain = _columns("account_signals", *world, accounts)
    signals = {
        name: _filled_to_end(item, len(ticks)) for name, item in {**columns, **plain}.items()
    }
    made = [
        (tick, account) for tick, account in zip(ticks, accounts, strict=False) if _decides(account)
    ]
    spent = [declared_seconds(item) for _, item in made]
    ages = [
        _declared_age(item, tick.time) for tick, item in made if item.get(_FALLBACK) is not True
    ]
    return AccountColumns(signals, tallies, _known(spent), _known(ages))


def _decides(account: Mapping[str, Any]) -> bool:
    return account.get(DECIDED) is True


def _known(told: Sequence[float | None]) -> list[float]:
    return [item for item in told if item is not None]


def _null(account: Mapping[str, Any]) -> Mapping[str, Any]:
    """The account of the null component, on the same input."""
    told = account.get(NULL)
    if not isinstance(told, Mapping):
        return {}
    return {**{key: account[key] for key in INPUT if key in account}, **told}


def declared_seconds(account: Mapping[str, Any]) -> float | None:
    """How long the component says that its decision took; ``None`` if it gives no duration."""
    return None if account is NOTHING else _duration(account.get(SECONDS))


def _declared_age(account: Mapping[str, Any], time: float) -> float | None:
    """The age that a decision says it has; ``None`` without one, and if it began before the start.

    Args:
        account: Of the tick at which the decision came into force.
        time: Of that tick, in s.
    """
    age = _duration(account.get(_AGE))
    if age is None:
        return None
    # 0.4 s after 1 s is 1.4 s, whatever the float rounds to.
    age = round(age, _DECIMALS)
    return age if age <= round(time, _DECIMALS) else None


def _duration(told: Any) -> float | None:
    """A number of seconds, if it is one."""
    if isinstance(told, bool) or not isinstance(told, (int, float)):
        return None
    try:
        seconds = float(told)
    except OverflowError:  # an int of hundreds of digits
        return None
    return seconds if 0.0 <= seconds < math.inf else None


def _filled_to_end(column: Floats, ticks: int) -> Floats:
    """One value per tick, 0 where there is none."""
    filled = np.nan_to_num(column, nan=0.0)
    return np.append(filled, filled[-1:]) if ticks > len(filled) else filled


def _kind(simulator: Simulator, name: str) -> str:
    kind = simulator.measure_kinds.get(name, KINDS[0])
    if kind not in KINDS:
        raise ValueError(f"measure_kinds says of {name!r} {kind!r}, not {', '.join(KINDS)}")
    return kind


def _columns(
    hook: str,
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> dict[str, Floats]:
    found = getattr(simulator, hook)(ticks, percepts, accounts)
    columns = {name: np.asarray(column, dtype=np.float64) for name, column in found.items()}
    for name, column in columns.items():
        if column.shape != (len(accounts),):
            raise ValueError(
                f"{hook} returned {name!r} of shape {column.shape}, not ({len(accounts)},)"
            )
    return columns


def _count(column: Floats) -> tuple[int, int]:
    known = column[~np.isnan(column)]
    return int((known > 0.5).sum()), len(known)


LOOP_PREFIX = "loop."
LOOP_SIGNALS = (
    "loop.recovering", "loop.recovering_for", "loop.recovered_time", "loop.fallback", "loop.unsafe"
)  # fmt: skip
"""0 or 1 for: recovery's action, or the simulator's fallback, was carried out; the proposal was
unsafe. ``recovering_for`` is the time since recovery took over, in s, 0 while it does not act;
``recovered_time`` that for which it has been in control so far, in s, which never falls."""


def loop_signals(episode: Episode) -> dict[str, NDArray[np.float64]]:
    """The columns by name, each of shape ``(ticks,)``."""
    return loop_columns(episode.time, episode.decisions)


def loop_columns(
    time: NDArray[np.float64], decisions: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[np.float64]]:
    """The same of an episode's columns.

    Args:
        time: Simulated seconds, shape ``(ticks,)``.
        decisions: ``source`` and ``verdict``, as those of an episode.
    """
    source = _repeated_to_end(decisions["source"], len(time), "")
    verdict = _repeated_to_end(decisions["verdict"], len(time), 0)
    recovering = source == "recovery"
    started = np.where(recovering & ~np.roll(recovering, 1), time, -np.inf)
    if len(recovering) and recovering[0]:
        started[0] = time[0]
    with np.errstate(invalid="ignore"):
        lasting = time - np.maximum.accumulate(started)
    # A decision holds from its tick until the next one.
    spent = np.where(recovering[:-1], np.diff(time), 0.0)
    return {
        "loop.recovering": recovering.astype(float),
        # 12.3 s after 2.3 s is 10 s, whatever the float rounds to: a bound of 10 s holds there.
        "loop.recovering_for": np.where(recovering, np.round(lasting, _DECIMALS), 0.0),
        "loop.recovered_time": np.round(np.cumsum(np.append(0.0, spent))[: len(time)], _DECIMALS),
        "loop.fallback": (source == "fallback").astype(float),
        "loop.unsafe": (verdict == 2).astype(float),
    }


def _repeated_to_end(
    column: NDArray[np.generic], ticks: int, nothing: object
) -> NDArray[np.generic]:
    """The column of decisions with its last value repeated up to the episode's last tick."""
    last = column[-1:] if len(column) else np.array([nothing])
    return np.concatenate([column[:ticks], np.repeat(last, max(ticks - len(column), 0))])
