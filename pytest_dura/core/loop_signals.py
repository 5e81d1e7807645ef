"""Signals that the loop adds: from the accounts of proposals, and the control by recovery.

The account of a proposal is the component's declaration of how it came to it, as plain data; the
simulator measures failure modes from accounts. A decision is made at every tick but the last, so
the last sample repeats the one before it.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.clock import EXPIRED, LATE, PERIOD
from pytest_dura.core.codec import Amount, Count, Number, Share
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import describe_error, type_name
from pytest_dura.core.metrics import KINDS, MeasureKind, Tally
from pytest_dura.core.percepts import NOTHING, Percept
from pytest_dura.core.roles import Assessed
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick

Floats = NDArray[np.float64]

PROPOSAL_PREFIX = "proposal."
"""Prefix of the signals from accounts."""
DECIDED = "decided"
"""Key of an account: ``True`` where the component made a new decision."""
NULL = "null"
"""Key of an account: the account of a null component, which ignores its input."""
SECONDS = "seconds"
"""Key of an account: how long the component took for its decision, in s of wall-clock time."""
USAGE = "usage"
"""Key of an account: what the component's new decisions used, counts by names of its own."""
_MOST_COUNTS = 20
_GREATEST_COUNT = 2**53
EXCHANGE = "exchange"
"""Key of an account: request and answer behind a new decision. Reports show it; nothing is measured
by it, and traces are compared without it."""
_AGE = "age"
"""Key of an account: simulated seconds since the percept behind the decision in force."""
_FALLBACK = "fallback"
"""Key of an account: ``True`` where the action is no decision of the component's own."""
INPUT = (DECIDED, "at", "perceived")
"""Keys of an account that describe the input, which a null component has as well."""
LONGEST = 100_000
"""Characters of one account, as JSON."""
DEEPEST = 12
"""Levels of nested mappings and lists in one account."""
_DECIMALS = 9


def read_account(account: Any) -> tuple[Mapping[str, Any], str | None]:
    """Copy an account to plain data of our own; also returns its problem, ``None`` without one.

    The keys are not checked: each reader takes those that it knows. Reading may call the
    component's code, and raises its exceptions.
    """
    if not isinstance(account, Mapping):
        return NOTHING, f"gave an account that is {type_name(account)}, not a mapping"
    try:
        entries = dict(account)
        text = json.dumps(entries, allow_nan=False) if entries else ""
    except Exception as error:
        return NOTHING, f"gave an account that is no plain data: {describe_error(error)}"
    if len(text) > LONGEST:
        return NOTHING, f"gave an account of {len(text)} characters; {LONGEST} are allowed"
    if not all(isinstance(key, str) for key in entries):
        return NOTHING, "gave an account with a key that is no text"
    read: Mapping[str, Any] = json.loads(text) if text else NOTHING
    deep = _depth(read) > DEEPEST
    return read, f"gave an account of more than {DEEPEST} levels" if deep else None


def account_problem(account: Any) -> str | None:
    """Problem of an account; ``None`` without one."""
    return read_account(account)[1]


def copied_account(account: Mapping[str, Any]) -> Mapping[str, Any]:
    """Copy a valid account, so that the component cannot change it afterwards."""
    if account is NOTHING or not account:
        return NOTHING
    data: dict[str, Any] = json.loads(json.dumps(dict(account)))
    return data


def _depth(value: Any, above: int = 0) -> int:
    """Levels of plain data, counted up to one more than is allowed."""
    if above > DEEPEST or not isinstance(value, (Mapping, list, tuple)):
        return above
    parts = value.values() if isinstance(value, Mapping) else value
    return max((_depth(part, above + 1) for part in parts), default=above + 1)


@dataclass(frozen=True)
class AccountColumns:
    """Columns and counts of the accounts of an episode.

    Args:
        signals: Columns of shape ``(ticks,)``; the last decision is still in force at the end.
        tallies: One per failure mode, by name.
        seconds: Wall-clock seconds of each new decision that declares them.
        ages: Simulated seconds between the percept behind a decision and the tick at which it came
            into force, of each new decision of the component's own that declares them.
        usage: Sums of what new decisions used, by name; empty where none declares any.
    """

    signals: Mapping[str, Floats]
    tallies: Mapping[str, Tally]
    seconds: Sequence[float]
    ages: Sequence[float]
    usage: Mapping[str, int]


def account_columns(
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> AccountColumns | None:
    """Compute signals and tallies of an episode's accounts; ``None`` without any account.

    Raises:
        ValueError: If a column has another length than there are decisions, or a measure has an
            unknown kind.
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
        null_column = null_columns.get(name)
        null_counts = (0, 0) if null_column is None else _count(null_column[fresh])
        tallies[name] = Tally(*counts, *null_counts, _kind(simulator, name))
    plain = _columns("account_signals", *world, accounts)
    signals = {
        name: _filled_to_end(column, len(ticks)) for name, column in {**columns, **plain}.items()
    }
    decisions = [
        (tick, account) for tick, account in zip(ticks, accounts, strict=False) if _decides(account)
    ]
    spent = [declared_seconds(account) for _, account in decisions]
    ages = [
        _declared_age(account, tick.time)
        for tick, account in decisions
        if account.get(_FALLBACK) is not True
    ]
    usage: Counter[str] = Counter()
    for _, account in decisions:
        usage.update(_declared_usage(account))
    return AccountColumns(signals, tallies, _known(spent), _known(ages), dict(usage))


def _decides(account: Mapping[str, Any]) -> bool:
    return account.get(DECIDED) is True


def _known(numbers: Sequence[float | None]) -> list[float]:
    return [number for number in numbers if number is not None]


def _null(account: Mapping[str, Any]) -> Mapping[str, Any]:
    """Account of the null component, on the same input."""
    null = account.get(NULL)
    if not isinstance(null, Mapping):
        return {}
    return {**{key: account[key] for key in INPUT if key in account}, **null}


def declared_seconds(account: Mapping[str, Any]) -> float | None:
    """Seconds that the component declares for its decision; ``None`` if it declares none."""
    return None if account is NOTHING else _duration(account.get(SECONDS))


def _declared_age(account: Mapping[str, Any], time: float) -> float | None:
    """Age that a decision declares; ``None`` without one, or if it precedes the episode.

    Args:
        account: Account of the tick at which the decision came into force.
        time: Time of that tick, in s.
    """
    age = _duration(account.get(_AGE))
    if age is None:
        return None
    # 0.4 s after 1 s is 1.4 s, whatever the float rounds to.
    age = round(age, _DECIMALS)
    return age if age <= round(time, _DECIMALS) else None


def _declared_usage(account: Mapping[str, Any]) -> dict[str, int]:
    """Counts of what a decision declares to have used; empty where one of them is no count."""
    usage = account.get(USAGE)
    if not isinstance(usage, Mapping) or len(usage) > _MOST_COUNTS:
        return {}
    usable = all(
        type(name) is str and type(count) is int and 0 <= count < _GREATEST_COUNT
        for name, count in usage.items()
    )
    return dict(usage) if usable else {}


def _duration(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        seconds = float(value)
    except OverflowError:  # an int of hundreds of digits
        return None
    return seconds if 0.0 <= seconds < math.inf else None


def _filled_to_end(column: Floats, ticks: int) -> Floats:
    """Column of one value per tick, 0 where there is none."""
    filled = np.nan_to_num(column, nan=0.0)
    return np.append(filled, filled[-1:]) if ticks > len(filled) else filled


def _kind(simulator: Simulator, name: str) -> MeasureKind:
    kind: Any = simulator.measure_kinds.get(name, KINDS[0])
    if kind not in KINDS:
        raise ValueError(f"measure_kinds says of {name!r} {kind!r}, not {', '.join(KINDS)}")
    return cast("MeasureKind", kind)


def _columns(
    hook: str,
    simulator: Simulator,
    ticks: Sequence[Tick],
    percepts: Sequence[Percept],
    accounts: Sequence[Mapping[str, Any]],
) -> dict[str, Floats]:
    given = getattr(simulator, hook)(ticks, percepts, accounts)
    columns = {name: np.asarray(column, dtype=np.float64) for name, column in given.items()}
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
    "loop.recovering", "loop.recovering_for", "loop.recovered_time", "loop.fallback", "loop.unsafe",
    LATE, EXPIRED, PERIOD,
)  # fmt: skip
"""``recovering``, ``fallback`` and ``unsafe`` are 0 or 1: recovery's action, or the simulator's
fallback, was carried out; the proposal was unsafe. ``recovering_for`` is the time since recovery
took over, in s, 0 while it does not act; ``recovered_time`` the time for which it has been in
control so far, in s, which never falls. ``late``, ``expired`` and ``period`` are those of
:mod:`pytest_dura.core.clock`."""
TRUTH = "0 or 1"
"""Unit of a signal that holds or does not."""
LOOP_UNITS: Mapping[str, str] = dict(
    zip(LOOP_SIGNALS, (TRUTH, "s", "s", TRUTH, TRUTH, TRUTH, TRUTH, "s"), strict=True)
)
"""Their units."""


def loop_signals(episode: Episode) -> dict[str, NDArray[np.float64]]:
    """Compute the signals of :data:`LOOP_SIGNALS` by name, each of shape ``(ticks,)``."""
    return loop_columns(episode.time, episode.decisions) | {
        name: episode.signals[name] for name in (LATE, EXPIRED, PERIOD) if name in episode.signals
    }


def loop_columns(
    time: NDArray[np.float64], decisions: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[np.float64]]:
    """Compute the same from an episode's columns.

    Args:
        time: Simulated seconds, shape ``(ticks,)``.
        decisions: ``source`` and ``verdict``, each of shape ``(ticks - 1,)``.
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
        # Where the world waits for the component; else the episode has signals of these names.
        LATE: np.zeros(len(time)),
        EXPIRED: np.zeros(len(time)),
        PERIOD: np.diff(time, prepend=time[:1] - np.diff(time)[:1]) if len(time) > 1 else time * 0,
    }


def _repeated_to_end(
    column: NDArray[np.generic], ticks: int, nothing: object
) -> NDArray[np.generic]:
    """Repeat the last value of a column of decisions up to the episode's last tick."""
    last = column[-1:] if len(column) else np.array([nothing])
    return np.concatenate([column[:ticks], np.repeat(last, max(ticks - len(column), 0))])


@dataclass(frozen=True, slots=True)
class Switching:
    """Control of an episode, by the component or by recovery, tick by tick.

    Recovery is in control at a tick whose decision came from it; at every other decided tick the
    component is, the simulator's fallback for a missing proposal included. A decision holds from
    its tick until the next one; the last tick of an episode has none.
    """

    decisions: Count
    """Ticks at which something was decided."""
    recovered: Count
    """Those at which recovery was in control."""
    recovery_time: Amount
    """Simulated seconds for which it was."""
    takeovers: Count
    """Decisions of recovery that do not follow another one of recovery. Recovery that decides at
    the first tick has taken over there."""
    returns: Count
    """Decisions of the component that follow one of recovery."""
    time_to_safe: tuple[Number | None, ...]
    """For each takeover, in order, the seconds until the first later decided tick whose final
    proposal was not unsafe, whichever role was in control there; null where the episode ended
    before such a tick: that time is censored, not zero."""
    share: Share | None
    """Share of the decisions that recovery made; null where nothing was decided."""
    switches: Count
    """Changes of control in both directions."""
    censored: Count
    """Takeovers with null in `time_to_safe`."""


def switching(episode: Episode) -> Switching:
    """Compute who was in control from an episode's decisions and times."""
    recovering = episode.decisions["source"] == "recovery"
    acceptable = episode.decisions["verdict"] < int(Assessed.UNSAFE)
    before = np.concatenate([[False], recovering[:-1]])
    takeovers = np.flatnonzero(recovering & ~before)
    decisions, recovered = len(recovering), int(recovering.sum())
    returns = int((before & ~recovering).sum())
    times = tuple(_time_to_safe(episode, acceptable, int(i)) for i in takeovers)
    return Switching(
        decisions=decisions,
        recovered=recovered,
        recovery_time=float(np.diff(episode.time)[recovering].sum()),
        takeovers=len(takeovers),
        returns=returns,
        time_to_safe=times,
        share=recovered / decisions if decisions else None,
        switches=len(takeovers) + returns,
        censored=times.count(None),
    )


def _time_to_safe(episode: Episode, acceptable: NDArray[np.bool_], takeover: int) -> float | None:
    later = np.flatnonzero(acceptable[takeover + 1 :])
    if not len(later):
        return None
    return float(episode.time[takeover + 1 + later[0]] - episode.time[takeover])
