"""Bounds on signals, a small and strict subset of STL: a formula, and what it says of a trace.

::

    formula  := term ("and" term)*
    term     := ("always" | "eventually") [interval] "(" signal op number ")" | "(" formula ")"
    interval := "[" seconds ":" seconds "]"
    op       := ">" | ">=" | "<" | "<="

An interval is closed and counts from the start of the episode; without one, a term ranges over the
episode. The module is the place of the full language, which will keep these names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.formula import Formula, Term, unknown_signal
from pytest_dura.requirements.parser import parse_terms

__all__ = ["Evaluation", "Formula", "Status", "Term", "evaluate", "parse"]

Status = Literal["satisfied", "violated", "undecided"]

TIME_TOLERANCE = 1e-6
"""Seconds by which a sample may miss a bound of an interval: times are sums of float steps."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What a formula says of a trace.

    Args:
        status: The verdict, Boolean unless the trace ends too early.
        margin: Robustness as far as the trace goes: the worst signed distance to a bound.
        lower: Least robustness that a longer trace could still give.
        upper: Greatest one. Both equal ``margin`` where the whole trace is judged.
        time: Seconds at which it was violated first, for a violation.
        worst_time: Seconds at which the margin was reached.
        detail: Which term decided, or what is missing.
    """

    status: Status
    margin: float
    lower: float
    upper: float
    time: float | None
    worst_time: float
    detail: str
    vacuous: bool = False

    @property
    def robustness(self) -> float:
        """The margin, or for an undecided formula the least robustness that is possible."""
        return self.lower if self.status == "undecided" else self.margin


@lru_cache(maxsize=512)
def parse(text: str, signals: tuple[str, ...] | None = None) -> Formula:
    """The formula in ``text``; ``signals`` are the known names, where they are known.

    Raises:
        ConfigurationError: For anything that is not a formula, with a mark under the place.
    """
    return Formula(parse_terms(text, signals))


def evaluate(
    formula: Formula,
    time: ArrayLike,
    signals: Mapping[str, ArrayLike],
    *,
    complete: bool = True,
) -> Evaluation:
    """Judge one trace.

    Args:
        formula: What to judge by.
        time: Seconds of each sample, increasing, shape ``(n,)`` with ``n`` of at least 1.
        signals: Columns of shape ``(n,)`` by name.
        complete: Whether the trace is the whole episode. A prefix leaves terms without an
            interval undecided, unless a sample decides them.

    Raises:
        ConfigurationError: For an empty trace, an unknown signal, a sample that is not finite,
            or an interval between two samples.
    """
    times = np.asarray(time, dtype=float)
    if times.ndim != 1 or len(times) == 0:
        raise ConfigurationError(
            "an empty trace cannot be judged",
            found=f"{times.size} samples",
            expected="at least one sample",
            remedy="check that the episode ran",
        )
    found = [_term(term, times, _column(term, times, signals), complete) for term in formula.terms]
    return found[0] if len(found) == 1 else _conjunction(found)


def check_time_step(formula: Formula, time_step: float) -> None:
    """Refuse an interval that no sample falls into when there is one every ``time_step`` seconds.

    Raises:
        ConfigurationError: For such an interval.
    """
    for term in formula.terms:
        if term.end is not None:
            first = np.ceil((term.start - TIME_TOLERANCE) / time_step)
            if first * time_step > term.end + TIME_TOLERANCE:
                raise _no_sample(term)


def _column(
    term: Term, times: NDArray[np.float64], signals: Mapping[str, ArrayLike]
) -> NDArray[np.float64]:
    if term.signal not in signals:
        raise unknown_signal(term.signal, signals, str(term), None)
    column = np.asarray(signals[term.signal], dtype=float)
    if column.shape != times.shape:
        raise ConfigurationError(
            f"the signal {term.signal!r} and the time have different lengths",
            found=f"{column.shape} and {times.shape}",
            expected="one value per sample",
        )
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        raise ConfigurationError(
            f"the signal {term.signal!r} is not finite at t = {times[bad[0]]:.2f} s",
            found=float(column[bad[0]]),
            expected="finite samples",
            remedy="let the simulator saturate the signal at a declared cap",
        )
    return column


def _term(
    term: Term, times: NDArray[np.float64], column: NDArray[np.float64], complete: bool
) -> Evaluation:
    first, last, cut = _window(term, times, complete)
    name = str(term)
    if first == last:
        detail = f"the trace ends at {times[-1]:g} s, before the interval of `{name}`"
        return Evaluation("undecided", np.inf, -np.inf, np.inf, None, float(times[-1]), detail)
    values, when = column[first:last], times[first:last]
    upward = term.comparison[0] == ">"
    with np.errstate(over="ignore"):
        margins = values - term.bound if upward else term.bound - values
    # A margin of zero satisfies `>=` and violates `>`, so the margin's sign is not the verdict.
    holds = margins > 0 if len(term.comparison) == 1 else margins >= 0
    if term.operator == "always":
        worst = int(np.argmin(margins))
        margin, failed = float(margins[worst]), np.flatnonzero(~holds)
        lower = -np.inf if cut else margin
        if len(failed):
            begin = float(when[failed[0]])
            return Evaluation("violated", margin, lower, margin, begin, float(when[worst]), name)
        status: Status = "undecided" if cut else "satisfied"
        detail = _cut_detail(name, times) if cut else name
        return Evaluation(status, margin, lower, margin, None, float(when[worst]), detail)
    best = int(np.argmax(margins))
    margin, at = float(margins[best]), float(when[best])
    upper = np.inf if cut else margin
    if holds.any():
        return Evaluation("satisfied", margin, margin, upper, None, at, name)
    if cut:
        return Evaluation("undecided", margin, margin, upper, None, at, _cut_detail(name, times))
    return Evaluation("violated", margin, margin, upper, float(when[-1]), at, name)


def _window(term: Term, times: NDArray[np.float64], complete: bool) -> tuple[int, int, bool]:
    """First and last (exclusive) sample of a term, and whether more would follow."""
    if term.end is None:
        return 0, len(times), not complete
    elapsed = times - times[0]
    first = int(np.searchsorted(elapsed, term.start - TIME_TOLERANCE))
    last = int(np.searchsorted(elapsed, term.end + TIME_TOLERANCE))
    cut = bool(elapsed[-1] < term.end - TIME_TOLERANCE)
    if first == last and not cut:
        raise _no_sample(term)
    return first, last, cut


def _no_sample(term: Term) -> ConfigurationError:
    return ConfigurationError(
        f"no sample falls into the interval of `{term}`",
        found=f"[{term.start:g}:{term.end:g}]",
        expected="an interval that holds at least one time step",
        remedy="widen the interval to multiples of the time step",
    )


def _cut_detail(name: str, times: NDArray[np.float64]) -> str:
    return f"the trace ends at {times[-1]:g} s, which does not decide `{name}`"


def _conjunction(found: list[Evaluation]) -> Evaluation:
    """All must hold. One violation decides, whatever is still open; the worst margin counts."""
    violated = [one for one in found if one.status == "violated"]
    undecided = [one for one in found if one.status == "undecided"]
    pool = violated or undecided or found
    status = pool[0].status
    worst = min(violated or found, key=lambda one: one.margin)
    begins = [one.time for one in violated if one.time is not None]
    return Evaluation(
        status=status,
        margin=worst.margin,
        lower=min(one.lower for one in found),
        upper=min(one.upper for one in found),
        time=min(begins) if begins else None,
        worst_time=worst.worst_time,
        detail="; ".join(one.detail for one in pool) if status != "satisfied" else worst.detail,
    )
