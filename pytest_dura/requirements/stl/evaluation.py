"""Evaluation of a formula on a trace: verdict, margin and vacuity, and robustness at each sample.

``evaluate`` says what a trace decides, and what could still change it. ``robustness`` has the
discrete-time semantics of rtamt: windows are cut at the ends of the trace, an empty window is -inf
for ``eventually`` and +inf for ``always``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.formula import FUTURE, Boolean, Formula, Node, Temporal
from pytest_dura.requirements.stl.program import (
    TRUNCATED,
    Conjunct,
    Mode,
    Plan,
    Program,
    Values,
    plan_of,
)
from pytest_dura.requirements.stl.uncertainty import (
    GREATEST,
    LEAST,
    known_share,
    uncertain_signals,
)
from pytest_dura.requirements.stl.windows import Array, Frame, arrays, empty_trace, other_length

_Samples: TypeAlias = NDArray[np.bool_]
"""True at the samples at which something is evaluated or holds, shape ``(n,)``."""


class Vacuity:
    """Whether the verdict of a satisfied formula rests on conditions that never held.

    An implication is vacuous if its condition held at no sample at which it was evaluated, or if
    what it demands there, where its condition held, is vacuous itself: ``a implies (b implies c)``
    is as vacuous as ``(a and b) implies c``. Windows are vacuous if what they range over is, a
    conjunction if both parts are, and a disjunction if both are or the other part held nowhere.
    Nothing else is. What may still hold behind the end of the trace does not count as held.

    Args:
        root: The formula.
        complete: Whether the trace is the whole episode.
    """

    def __init__(self, root: Node, *, complete: bool = True) -> None:
        self._root, self._open_end = root, not complete
        self._held: set[str] = set()  # sides that held, by their way from the root

    def see(self, program: Program, values: Values, at: _Samples) -> None:
        """Take in values, evaluated at some samples; those of a trace may come block by block."""
        self._see(self._root, "", program, values, at)

    @property
    def is_vacuous(self) -> bool:
        """Whether it is, by what was seen."""
        return self._is_vacuous(self._root, "")

    def _see(self, node: Node, way: str, program: Program, values: Values, at: _Samples) -> None:
        if isinstance(node, Temporal):
            self._see(node.operand, way, program, values, _reached(node, program, at))
        if not isinstance(node, Boolean) or node.operator not in ("implies", "and", "or"):
            return
        if node.operator == "implies":
            held = self._held_at(node.left, program, values, at)
            if held.any():
                self._held.add(f"{way}l")
                self._see(node.right, f"{way}r", program, values, held)
            return
        for part, side in ((node.left, f"{way}l"), (node.right, f"{way}r")):
            if node.operator == "or" and self._held_at(part, program, values, at).any():
                self._held.add(side)
            self._see(part, side, program, values, at)

    def _is_vacuous(self, node: Node, way: str) -> bool:
        if isinstance(node, Temporal):
            return self._is_vacuous(node.operand, way)
        if not isinstance(node, Boolean) or node.operator not in ("implies", "and", "or"):
            return False
        left, right = f"{way}l", f"{way}r"
        if node.operator == "implies":
            return left not in self._held or self._is_vacuous(node.right, right)
        both = self._is_vacuous(node.left, left), self._is_vacuous(node.right, right)
        if node.operator == "and":
            return all(both)
        return (both[0] and (both[1] or right not in self._held)) or (
            both[1] and left not in self._held
        )

    def _held_at(self, node: Node, program: Program, values: Values, at: _Samples) -> _Samples:
        """Those of the samples at which a formula held."""
        mode = Mode(-np.inf, self._open_end)
        margins = values[program.slot(node, mode)]
        held = at & (margins > 0)
        open_ = at & (margins == 0)
        if open_.any():  # only there the margin does not tell the truth
            truth = values[program.slot(node, mode._replace(truth=True))]
            held |= open_ & (truth > 0)
        return held


def _reached(node: Temporal, program: Program, at: _Samples) -> _Samples:
    """The samples at which the operand of a temporal operator is evaluated."""
    ahead = node.operator in FUTURE
    marks = at.astype(float)
    # Seen from a sample that is reached, the operator lies on the other side.
    if node.window is None:
        spread = windows.running_past if ahead else windows.running
        return spread(marks, np.maximum) > 0
    slide = windows.sliding_past if ahead else windows.sliding
    return slide(marks, np.maximum, *program.samples(node.window)) > 0


Status = Literal["satisfied", "violated", "undecided"]
Ending = Literal["time", "goal", "stopped", "open"]
"""How a trace ended, which says what its last sample decides:

- ``time``: at its time limit. Operators without a window range over the trace; a window that leaves
  it sees unknown samples there.
- ``goal``: at the component's goal. The trace is judged as it stands, windows are cut at its end.
- ``stopped``: nothing happens any more, after a crash or a halt. What was to happen eventually does
  not; what was to hold always is known for the trace alone.
- ``open``: it is a prefix, and anything may follow.
"""

_UNIFORM = 0.01
"""Share of the time step by which the distance of two samples may differ from it."""


def modes_of(ending: Ending, *, truth: bool = False) -> tuple[Mode, Mode]:
    """Modes of the least and of the greatest value that the ending leaves possible.

    A cut window is the greatest value of a trace that was stopped: in negation normal form, cutting
    takes from ``eventually`` and ``until`` what would have to happen, and from ``always`` what
    could go wrong. Where a formula is negated, the two modes change places and the two operators as
    well.
    """
    cut = Mode(truth=truth)
    least, greatest = (Mode(unknown, ending != "time", truth) for unknown in (-np.inf, np.inf))
    if ending == "goal":
        return cut, cut
    return (least, cut) if ending == "stopped" else (least, greatest)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Verdict and robustness of a formula on a trace.

    Args:
        status: The verdict, Boolean unless the trace ends too early.
        margin: Robustness at the first sample as far as the trace goes. In a conjunction that is
            violated, the worst of the violated parts.
        lower: No longer trace could give less.
        upper: None could give more. Both equal ``margin`` where the whole trace is judged.
        time: Seconds of the first sample that decided a violation: of the first violated part.
        worst_time: Seconds at which the part with the margin reached it, if that is an ``always``
            or ``eventually``; of another one those that decided its violation, or the start.
        detail: Which parts are violated, the one that decided first; or what is missing.
        vacuous: Whether it is satisfied only because conditions never held.
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


@dataclass(slots=True)
class Part:
    """A conjunct judged; ``index`` is where its margin was reached, ``decided`` its violation."""

    conjunct: Conjunct
    status: Status
    margin: float
    lower: float
    upper: float
    index: int | None
    decided: int | None


def evaluate(
    formula: Formula,
    time: ArrayLike,
    signals: Mapping[str, ArrayLike],
    *,
    ending: Ending = "time",
    time_step: float | None = None,
) -> Evaluation:
    """Judge one trace.

    Args:
        formula: What to judge by.
        time: Seconds of each sample, at even distances, shape ``(n,)`` with ``n`` of at least 1.
        signals: Columns of shape ``(n,)`` by name. One with bounds beside it, see
            :mod:`~pytest_dura.requirements.stl.uncertainty`, is read by these alone: the formula is
            satisfied, or violated, only if it is for all values between them.
        ending: How the trace ended, see :data:`Ending`. A trace with bounds is taken as ``open``
            unless it ended at its time.
        time_step: Seconds from sample to sample, by default their median distance.

    Raises:
        ConfigurationError: For an empty trace, uneven sampling, an unknown signal, columns of
            other lengths, a sample or an expression that is not finite, or a window that is no
            multiple of the time step.
    """
    times = np.asarray(time, dtype=float)
    if times.ndim != 1 or len(times) == 0:
        raise empty_trace(f"{times.size} samples")
    step = _time_step(times, time_step)
    uncertain = uncertain_signals(formula.signals, signals)
    plan = plan_of(formula, step, uncertain)
    bounds = [prefix + name for name in sorted(uncertain) for prefix in (LEAST, GREATEST)]
    columns = arrays((*plan.signals, *bounds), signals, formula)
    for name, column in columns.items():
        if column.shape != times.shape:
            raise other_length(name, column.shape, times.shape)
    certain = {name: columns[name] for name in plan.signals if name not in uncertain}
    Frame(certain, times.shape, step or 0.0, times).refuse_not_finite()
    frame = Frame(columns, times.shape, step or 0.0, times)
    if uncertain and ending in ("goal", "stopped"):
        ending = "open"
    with np.errstate(all="ignore"):
        values = Values(plan.program, frame)
        return _evaluation(plan, values, ending)


def _evaluation(plan: Plan, values: Values, ending: Ending) -> Evaluation:
    parts = [judged(conjunct, values, ending) for conjunct in plan.conjuncts]
    times = values.frame.times
    assert times is not None
    uncertain = plan.program.uncertain
    seen = known_share(uncertain, values.frame.columns) if uncertain else 1.0
    concluded = conclude(parts, times.__getitem__, len(times), uncertain, seen)
    is_vacuous = concluded.status == "satisfied" and _vacuous(
        plan, values, ending, concluded.margin
    )
    return replace(concluded, vacuous=is_vacuous)


def conclude(
    parts: Sequence[Part],
    time_of: Callable[[int], Any],
    count: int,
    uncertain: frozenset[str],
    seen: float,
) -> Evaluation:
    """Conclude the verdict on a formula from those on its conjuncts, vacuity apart.

    Args:
        parts: The conjuncts judged.
        time_of: Seconds of a sample by its number.
        count: Samples of the trace.
        uncertain: Signals of which the trace has bounds.
        seen: Share of the samples at which all of these are known.
    """
    # The first one decides: the time is its own, and it stands first where they are named.
    violated = sorted(
        (part for part in parts if part.status == "violated"), key=lambda part: part.decided or 0
    )
    undecided = [part for part in parts if part.status == "undecided"]
    # One violation decides, whatever is still open; the margin is that of the violation.
    worst = min(violated or parts, key=lambda part: part.margin)
    decided = violated[0].decided if violated else None
    index = worst.index if worst.index is not None else worst.decided or 0
    known = f" ({', '.join(sorted(uncertain))} known at {100 * seen:.4g} % of the samples)"
    share = known if uncertain else ""
    detail = worst.conjunct.text + share
    if violated:
        detail = "; ".join(part.conjunct.text for part in violated) + share
    elif undecided:
        names = " and ".join(f"`{part.conjunct.text}`" for part in undecided)
        detail = f"what is known of the samples does not decide {names}{share}"
        if not uncertain:
            detail = f"the trace ends at {time_of(count - 1):g} s, which does not decide {names}"
    return Evaluation(
        status=(violated or undecided or parts)[0].status,
        margin=worst.margin,
        lower=min(part.lower for part in parts),
        upper=min(part.upper for part in parts),
        time=None if decided is None else float(time_of(decided)),
        worst_time=float(time_of(index)),
        detail=detail,
    )


def _vacuous(plan: Plan, values: Values, ending: Ending, margin: float) -> bool:
    """Whether no condition ever held, or every window lies behind the end that was cut."""
    if ending == "goal" and margin == np.inf:
        return True
    if not plan.has_implication:
        return False
    vacuity = Vacuity(plan.formula.root, complete=ending in ("time", "goal"))
    start = np.zeros(values.frame.shape[-1], dtype=bool)
    start[0] = True
    vacuity.see(plan.program, values, start)
    return vacuity.is_vacuous


def judged(conjunct: Conjunct, values: Values, ending: Ending) -> Part:
    """Judge a conjunct on a trace."""
    least, greatest = modes_of(ending)
    lower, at_lower = conjunct.at_start(values, least)
    upper, at_upper = conjunct.at_start(values, greatest)
    status = _status(conjunct, values, ending, lower, upper)
    if conjunct.is_uncertain:
        # The best that a violation, and the worst that anything else may be.
        is_violated = status == "violated"
        margin, index = (upper, at_upper) if is_violated else (lower, at_lower)
    elif lower == upper:
        # Where the greatest possible values have their minimum, the values themselves have it too.
        margin, index = lower, at_upper if conjunct.is_minimum else at_lower
    else:
        margin, index = conjunct.at_start(values, TRUNCATED)
    decided = _violation(conjunct, values) if status == "violated" else None
    return Part(conjunct, status, margin, lower, upper, index, decided)


def _status(
    conjunct: Conjunct, values: Values, ending: Ending, lower: float, upper: float
) -> Status:
    """The verdict. Only a margin of zero does not tell it: that satisfies >= and violates >."""
    least, greatest = modes_of(ending, truth=True)
    if lower > 0 or (lower == 0 and conjunct.at_start(values, least)[0] > 0):
        return "satisfied"
    if upper < 0 or (upper == 0 and conjunct.at_start(values, greatest)[0] < 0):
        return "violated"
    return "undecided"


def _violation(conjunct: Conjunct, values: Values) -> int:
    """The last sample of the shortest prefix that decides the violation.

    A prefix that decides it has none but such continuations, so that bisection finds the first.
    """
    greatest = modes_of("open", truth=True)[1]
    last: int = values.frame.shape[-1] - 1
    if conjunct.at_start(values, greatest)[0] >= 0:
        return last  # no prefix decides it, but the end of the episode
    prefix = values.prefixes()

    def decides(size: int) -> bool:
        return conjunct.at_start(prefix(size), greatest)[0] < 0

    return bisect_left(range(1, last + 1), True, key=decides)


def _time_step(times: Array, declared: float | None) -> float | None:
    """The distance of samples, ``None`` for a single one, refused where it is uneven."""
    if len(times) == 1 and np.isfinite(times[0]):
        return declared
    distances = np.sort(times[1:] - times[:-1])
    half = len(distances) // 2
    median = (distances[half] + distances[-1 - half]) / 2
    # To nine digits, so that sums of float steps give the same step each time.
    step = float(f"{median:.9g}") if declared is None else declared
    tolerance = _UNIFORM * step
    # Also False where a time is not finite.
    if not (step > 0 and distances[0] >= step - tolerance and distances[-1] <= step + tolerance):
        raise _uneven(times, step, declared)
    return step


def _uneven(times: Array, step: float, declared: float | None) -> ConfigurationError:
    if not np.isfinite(times).all():
        return ConfigurationError(
            "a time is not finite",
            found=float(times[~np.isfinite(times)][0]),
            expected="seconds of each sample",
        )
    distances = np.diff(times)
    worst = int(np.argmax(np.abs(distances - step)))
    origin = "the median" if declared is None else "the declared time step"
    return ConfigurationError(
        f"the samples are not at even distances: {distances[worst]:g} s after "
        f"t = {times[worst]:.2f} s",
        found=float(distances[worst]),
        expected=f"{step:g} s ({origin}), to within {_UNIFORM:.0%}",
        remedy="sample the episode at each tick",
    )


_CHUNK = 64
"""Traces that are computed together: their arrays fit into the processor's cache."""


def robustness(formula: Formula, columns: Mapping[str, ArrayLike], time_step: float) -> Array:
    """Robustness at each sample.

    Args:
        formula: What to evaluate.
        columns: Samples by signal, shape ``(n,)`` for a trace or ``(traces, n)`` for several of
            the same length. Others than the formula's are ignored.
        time_step: Seconds from sample to sample.

    Returns:
        Shape ``(n,)`` or ``(traces, n)``.

    Raises:
        ConfigurationError: For an unknown signal, an empty trace, columns that do not fit each
            other, a sample or an expression that is not finite, or a window that is no multiple of
            the time step.
    """
    plan = plan_of(formula, time_step)
    samples = arrays(plan.signals, columns, formula)
    shape = _shape(samples, columns)
    if len(shape) == 1 or shape[0] <= _CHUNK:
        return _computed(plan, Frame(samples, shape, time_step))
    whole = np.empty(shape)
    for start in range(0, shape[0], _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, shape[0]))
        part = {name: column[rows] for name, column in samples.items()}
        frame = Frame(part, (len(rows), shape[1]), time_step, rows=rows)
        whole[rows] = _computed(plan, frame)
    return whole


def robustness_batch(
    formula: Formula, traces: Sequence[Mapping[str, ArrayLike]], time_step: float
) -> list[Array]:
    """Robustness at each sample of many traces, which may differ in length.

    Args:
        formula: What to evaluate.
        traces: Samples by signal, shape ``(n,)`` with an ``n`` of each trace's own.
        time_step: Seconds from sample to sample, the same for all.

    Returns:
        For each trace what ``robustness`` gives.

    Raises:
        ConfigurationError: As ``robustness``; the message names the trace, counted from zero.
    """
    plan = plan_of(formula, time_step)
    inputs = [arrays(plan.signals, trace, formula) for trace in traces]
    shapes = [_shape(samples, trace) for samples, trace in zip(inputs, traces, strict=True)]
    for number, shape in enumerate(shapes):
        if len(shape) != 1:
            raise ConfigurationError(
                f"trace {number} is not one trace", found=shape, expected="columns of shape (n,)"
            )
    results: list[Array] = [np.empty(0)] * len(traces)
    lengths = [shape[0] for shape in shapes]
    for length in set(lengths):  # traces of one length are rows of an array
        rows = np.flatnonzero(np.equal(lengths, length))
        for part in np.split(rows, range(_CHUNK, len(rows), _CHUNK)):
            columns = {name: np.stack([inputs[row][name] for row in part]) for name in plan.signals}
            frame = Frame(columns, (len(part), length), time_step, rows=part)
            for row, values in zip(part, _computed(plan, frame), strict=True):
                results[row] = values
    return results


def _computed(plan: Plan, frame: Frame) -> Array:
    frame.refuse_not_finite()
    with np.errstate(all="ignore"):
        return Values(plan.program, frame)[plan.program.slot(plan.formula.root, TRUNCATED)]


def _shape(samples: Mapping[str, Array], columns: Mapping[str, ArrayLike]) -> tuple[int, ...]:
    """The shape that all columns have; a formula of constants has that of any column."""
    if not samples:
        samples = {name: np.asarray(column) for name, column in columns.items()}
    first = next((column.shape for column in samples.values()), (0,))
    for name, column in samples.items():
        if column.shape != first:
            raise other_length(name, column.shape, first)
    if len(first) not in (1, 2):
        raise ConfigurationError(
            "columns are traces or rows of traces", found=first, expected="shape (n,) or (m, n)"
        )
    if first[-1] == 0:
        raise empty_trace(f"columns of shape {first}")
    return first
