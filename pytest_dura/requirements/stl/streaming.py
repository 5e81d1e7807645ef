"""A formula judged block by block, as on the whole trace, in memory that does not grow with it.

Each part of the conjunction at the root is of one of two kinds. One that looks a bounded time ahead
is judged on the beginning of the trace. ``always p`` and ``eventually p`` without a window keep the
extreme of ``p`` so far, if ``p`` looks a bounded time ahead; blocks overlap by as much as ``p``
looks ahead and back. Operators without a window that look back carry their value from block to
block. Anything else, such as ``always eventually p``, needs the whole trace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.evaluation import (
    Evaluation,
    Part,
    Status,
    Vacuity,
    conclude,
    judged,
    modes_of,
)
from pytest_dura.requirements.stl.formula import (
    FUTURE,
    Boolean,
    Expression,
    Formula,
    Node,
    Step,
    Temporal,
    TemporalPair,
    check_time_step,
    children,
    conjuncts,
    in_samples,
    node_text,
    reach,
    unknown_signal,
    walk,
)
from pytest_dura.requirements.stl.program import (
    TRUNCATED,
    Conjunct,
    Mode,
    Program,
    Values,
    plan_of,
)
from pytest_dura.requirements.stl.uncertainty import GREATEST, LEAST, known_share
from pytest_dura.requirements.stl.windows import Array, Frame, empty_trace

_Key: TypeAlias = tuple[int, "float | None", bool]
"""An operator that looks back without a window, by identity, and the mode of its value."""
_LEAST, _GREATEST = modes_of("time")
_LEAST_TRUTH, _GREATEST_TRUTH = modes_of("time", truth=True)
_OPEN_TRUTH = modes_of("open", truth=True)[1]
BLOCK = 1 << 16
"""Samples that are judged at a time, at least, unless each is to be judged at once."""
LONGEST_BEGINNING = 5_000_000
"""Samples at most that a part may read of the beginning of a trace, and blocks may overlap by."""


@dataclass(slots=True, eq=False)
class _BlockFrame(Frame):
    """A block; operators that look back without a window go on from what they carry."""

    carried: Mapping[_Key, float] = field(default_factory=dict)


def _before(frame: Frame, key: _Key) -> float | None:
    """Value of an operator just before its operand is right; ``None`` where the trace begins."""
    assert isinstance(frame, _BlockFrame)
    own = frame.carried.get(key)
    # While all samples are known, the modes do not differ.
    return own if own is not None else frame.carried.get((key[0], None, key[2]))


def _running_on(operand: Array, frame: Frame, join: np.ufunc, key: _Key, skip: int) -> Array:
    start = _before(frame, key)
    if start is None:
        return windows.running_past(operand, join)
    result = np.full(operand.shape, start)
    result[skip:] = join(join.accumulate(operand[skip:]), start)
    return result


def _since_on(left: Array, right: Array, frame: Frame, key: _Key, skip: int) -> Array:
    start = _before(frame, key)
    if start is None:
        return windows.since(left, right)
    result = np.full(right.shape, start)
    if skip < len(right):
        carried = np.minimum(np.minimum.accumulate(left[skip:]), start)
        result[skip:] = np.maximum(windows.since(left[skip:], right[skip:]), carried)
    return result


class _Stream(Program):
    """The steps of a formula on blocks."""

    def __init__(self, root: Node, time_step: float, uncertain: frozenset[str]) -> None:
        super().__init__(root, time_step, uncertain)
        self.step = time_step
        self.carries: dict[_Key, tuple[int, int]] = {}
        """Slot of each operator that carries its value, and samples before it is right."""

    def _carry(self, node: Node, mode: Mode, kernel: Any, *inputs: int, options: Any = ()) -> int:
        key = (id(node), mode.unknown, mode.truth)
        skip = max(_past(child, self.step) for child in children(node))
        slot = self._add(kernel, *inputs, -1, options=(*options, key, skip))
        self.carries[key] = slot, skip
        return slot

    def _running_past(self, node: Temporal, operand: int, mode: Mode, join: np.ufunc) -> int:
        return self._carry(node, mode, _running_on, operand, options=(join,))

    def _since(self, node: TemporalPair, left: int, right: int, mode: Mode) -> int:
        return self._carry(node, mode, _since_on, left, right)


def _past(node: Node | Expression, step: float) -> int:
    """Samples of a block before the first at which a part is right; carried values are."""
    below = max((_past(child, step) for child in children(node)), default=0)
    if isinstance(node, Step):
        return below + (node.operator not in FUTURE)
    if not isinstance(node, (Temporal, TemporalPair)) or node.operator in FUTURE:
        return below
    return below + (0 if node.window is None else in_samples(node.window, step)[1])


@dataclass
class _Extreme:
    """Least or greatest value so far, and its first sample."""

    least: bool
    value: float
    index: int | None = None

    @classmethod
    def empty(cls, least: bool) -> _Extreme:
        return cls(least, np.inf if least else -np.inf)

    def see(self, values: Array, first: int) -> None:
        if len(values):
            place = int(values.argmin() if self.least else values.argmax())
            self.see_one(float(values[place]), first + place)

    def see_one(self, value: float, index: int) -> None:
        better = value < self.value if self.least else value > self.value
        if better or self.index is None:
            self.value, self.index = value, index


class _Ranging:
    """``always p`` or ``eventually p`` without a window: the extremes of ``p`` so far."""

    def __init__(self, node: Temporal) -> None:
        self.node, self.operand = node, node.operand
        self.least = node.operator == "always"
        modes = (TRUNCATED, _LEAST, _GREATEST, _LEAST_TRUTH, _GREATEST_TRUTH)
        self._extremes = {mode: _Extreme.empty(self.least) for mode in modes}
        self.decided: int | None = None
        self.changes: list[tuple[int, int]] = []
        self._holds = 1
        self.vacuity: Vacuity | None = None
        if any(isinstance(part, Boolean) and part.operator == "implies" for part in walk(node)):
            self.vacuity = Vacuity(self.operand)

    def see(self, block: _Block) -> None:
        """Take in the next samples of a block."""
        values, program, begin, end = block.values, block.program, block.begin, block.end
        every = block.last or program.is_uncertain(self.node)
        truth: dict[Mode, Array] = {}
        for mode, extreme in self._extremes.items():
            if mode.truth:
                continue
            alike = mode if every else TRUNCATED
            margins = values[program.slot(self.operand, alike)][begin:end]
            extreme.see(margins, block.first)
            if mode != TRUNCATED:
                truth[mode] = self._see_truth(block, mode, alike, margins)
        if block.at_once:
            status = np.where(truth[_LEAST] > 0, 1, np.where(truth[_GREATEST] < 0, -1, 0))
            before = np.concatenate([[self._holds], status])
            for place in np.flatnonzero(np.diff(before)).tolist():
                self.changes.append((block.first + place, int(status[place])))
            self._holds = int(before[-1])
        if self.vacuity is not None:
            at = np.zeros(values.frame.shape[-1], dtype=bool)
            at[begin:end] = True
            self.vacuity.see(program, values, at)

    def _see_truth(self, block: _Block, mode: Mode, alike: Mode, margins: Array) -> Array:
        """Take in whether it holds, which only margins of zero do not tell; returns its sign."""
        truth = np.sign(margins)
        if (margins == 0).any() or block.program.carries:
            slot = block.program.slot(self.operand, alike._replace(truth=True))
            truth = block.values[slot][block.begin : block.end]
        self._extremes[mode._replace(truth=True)].see(truth, block.first)
        if mode == _GREATEST and self.least and self.decided is None:
            holds = np.where(margins == 0, truth, margins)
            if (holds < 0).any():
                self.decided = block.first + self._decides(block, int(np.argmax(holds < 0)))
        return truth

    def _decides(self, block: _Block, place: int) -> int:
        """Place of the first sample at which a violation is decided, by bisection of what ends."""
        prefix = block.values.prefixes()
        slot = block.program.slot(self.operand, _OPEN_TRUTH)
        low = block.begin + place
        high = min(low + block.ahead, block.values.frame.shape[-1] - 1)
        while low < high:
            middle = (low + high) // 2
            if (prefix(middle + 1)[slot][block.begin :] < 0).any():
                high = middle
            else:
                low = middle + 1
        return low - block.begin

    def part(self, conjunct: Conjunct, count: int) -> Part:
        """Judge the conjunct."""
        lower, upper, cut = (self._extremes[mode] for mode in (_LEAST, _GREATEST, TRUNCATED))
        holds = self._extremes[_LEAST_TRUTH].value, self._extremes[_GREATEST_TRUTH].value
        status: Status = "undecided"
        if lower.value > 0 or (lower.value == 0 and holds[0] > 0):
            status = "satisfied"
        elif upper.value < 0 or (upper.value == 0 and holds[1] < 0):
            status = "violated"
        if conjunct.is_uncertain:
            chosen = upper if status == "violated" else lower
        elif lower.value == upper.value:
            chosen = _Extreme(self.least, lower.value, (upper if self.least else lower).index)
        else:
            chosen = cut
        decided = None
        if status == "violated":
            decided = count - 1 if self.decided is None else self.decided
        return Part(conjunct, status, chosen.value, lower.value, upper.value, chosen.index, decided)


@dataclass
class _Block:
    """Samples at hand: those from ``begin`` to ``end`` are new, and right.

    ``first`` is the number of the first new one in the trace, ``ahead`` how far the formula looks.
    """

    program: _Stream
    values: Values
    begin: int
    end: int
    first: int
    ahead: int
    last: bool
    at_once: bool


class StreamedFormula:
    """A formula judged block by block; its evaluation is that of the whole trace.

    Args:
        formula: The formula.
        time_step: Seconds from sample to sample.
        at_once: Whether each sample is judged when it comes, as in a live stream.

    Raises:
        ConfigurationError: For a formula that needs the whole trace.
    """

    def __init__(self, formula: Formula, time_step: float, *, at_once: bool = False) -> None:
        check_time_step(formula, time_step)
        self.formula, self.time_step = formula, time_step
        self._block = 1 if at_once else BLOCK
        self._ranging: list[_Ranging] = []
        self._kinds: list[_Ranging | int] = [self._kind(node) for node in conjuncts(formula.root)]
        self._ahead = max(
            (reach(each.operand, time_step) or 0 for each in self._ranging), default=0
        )
        self._past = max((_past(each.operand, time_step) for each in self._ranging), default=0)
        bounded = [kind for kind in self._kinds if isinstance(kind, int)]
        self._beginning = max(bounded, default=-1) + 1
        if max(self._beginning, self._ahead + self._past) > LONGEST_BEGINNING:
            raise self._whole(formula.root)
        names = [prefix + name for name in formula.signals for prefix in ("", LEAST, GREATEST)]
        self._kept: dict[str, Array] = {name: np.empty(0) for name in names}
        self._head: dict[str, list[Array]] = {name: [] for name in names}
        self._programs: dict[frozenset[str], _Stream] = {}
        self._carried: dict[_Key, float] = {}
        self._waiting: list[dict[str, Array]] = []
        self._offset = self._done = self._count = self._seen = 0
        self._uncertain: frozenset[str] = frozenset()

    def _kind(self, node: Node) -> _Ranging | int:
        """What ranges over the trace, or how far a part reads it."""
        samples = reach(node, self.time_step)
        if samples is not None:
            return samples
        if not isinstance(node, Temporal) or node.window is not None:
            raise self._whole(node)
        if reach(node.operand, self.time_step) is None:
            raise self._whole(node)
        for part in walk(node.operand):
            unbounded = isinstance(part, Temporal) and part.window is None
            if unbounded and "implies" in map(_operator, walk(part)):
                raise self._whole(node)  # vacuity would need all samples before
        self._ranging.append(_Ranging(node))
        return self._ranging[-1]

    def _whole(self, node: Node) -> ConfigurationError:
        return ConfigurationError(
            "a formula needs the whole trace",
            found=node_text(node),
            expected="`always p` and `eventually p` of a `p` that looks a bounded time ahead, and "
            "windows",
            remedy="give its inner operators windows, or judge the log as a whole",
        )

    def take(self, columns: Mapping[str, Array]) -> None:
        """Take the next samples.

        Args:
            columns: Of each signal of the formula; with bounds beside it where it is not known at
                each sample.

        Raises:
            ConfigurationError: For a signal that is missing, and an expression that is not finite.
        """
        given = {}
        for name in self.formula.signals:
            if name not in columns:
                raise unknown_signal(name, columns, str(self.formula), None)
            given[name] = np.asarray(columns[name], dtype=float)
            for prefix in (LEAST, GREATEST):
                given[prefix + name] = np.asarray(columns.get(prefix + name, given[name]))
        count = len(next(iter(given.values()), ()))
        if not count:
            return
        for name, column in given.items():
            lacking = self._beginning - self._count
            if lacking > 0:
                self._head[name].append(column[:lacking].copy())
        self._count += count
        uncertain = _uncertain(self.formula.signals, given)
        self._seen += round(known_share(uncertain, given) * count) if uncertain else count
        self._uncertain |= uncertain
        self._waiting.append(given)
        if self._count - self._done - self._ahead >= max(self._block, self._ahead + self._past):
            self._judge(last=False)

    def _judge(self, *, last: bool) -> None:
        """Judge what waits, as far as nothing that follows changes it."""
        if not self._ranging:
            self._waiting.clear()
            return
        parts = [self._kept, *self._waiting]
        kept = {name: np.concatenate([each[name] for each in parts]) for name in self._kept}
        self._waiting.clear()
        count = len(next(iter(kept.values())))
        end = count if last else count - self._ahead
        uncertain = _uncertain(self.formula.signals, kept)
        if self._carried and any(key[1] is not None for key in self._carried):
            uncertain |= self._uncertain  # what is carried of these are bounds
        program = self._programs.get(uncertain)
        if program is None:
            program = _Stream(self.formula.root, self.time_step, uncertain)
            self._programs[uncertain] = program
        times = np.arange(self._offset, self._offset + count, dtype=np.float64)
        times *= self.time_step
        frame = _BlockFrame(kept, (count,), self.time_step, times, carried=self._carried)
        with np.errstate(all="ignore"):
            values = Values(program, frame)
            begin = self._done - self._offset
            block = _Block(
                program, values, begin, end, self._done, self._ahead, last, self._block == 1
            )
            for each in self._ranging:
                each.see(block)
            start = max(end - self._past, 0)
            if start and not last:
                self._carried = {
                    **self._carried,
                    **{
                        key: float(values[slot][start + skip - 1])
                        for key, (slot, skip) in program.carries.items()
                    },
                }
        self._done = self._offset + end
        self._offset += start
        self._kept = {name: column[start:].copy() for name, column in kept.items()}

    def changes(self) -> list[tuple[int, int]]:
        """Samples at which parts that range over the trace began to hold (1), or not to (-1).

        0 is not known. Each change is returned once, and only where each sample is judged at once;
        before the first sample all hold.
        """
        found = [change for each in self._ranging for change in each.changes]
        for each in self._ranging:
            each.changes.clear()
        return sorted(found)

    def finish(self) -> Evaluation:
        """Judge the trace, which has ended at its time.

        Raises:
            ConfigurationError: If there was no sample.
        """
        if not self._count:
            raise empty_trace("0 samples")
        self._judge(last=True)
        plan = plan_of(self.formula, self.time_step, self._uncertain)
        parts, are_vacuous = [], []
        for conjunct, kind in zip(plan.conjuncts, self._kinds, strict=True):
            if isinstance(kind, _Ranging):
                parts.append(kind.part(conjunct, self._count))
                are_vacuous.append(kind.vacuity is not None and kind.vacuity.is_vacuous)
            else:
                part, is_vacuous = self._begun(conjunct, kind + 1)
                parts.append(part)
                are_vacuous.append(is_vacuous)
        seen = self._seen / self._count
        concluded = conclude(
            parts, lambda index: float(index * self.time_step), self._count, self._uncertain, seen
        )
        vacuous = concluded.status == "satisfied" and all(are_vacuous)
        return replace(concluded, vacuous=vacuous)

    def _begun(self, conjunct: Conjunct, count: int) -> tuple[Part, bool]:
        """Judge a part on the beginning of the trace, and whether it is vacuous."""
        whole = {name: np.concatenate(pieces)[:count] for name, pieces in self._head.items()}
        size = min(count, self._count)
        times = np.arange(size, dtype=np.float64) * self.time_step
        with np.errstate(all="ignore"):
            program = conjunct.program
            values = Values(program, Frame(whole, (size,), self.time_step, times))
            vacuity = Vacuity(conjunct.node)
            start = np.zeros(size, dtype=bool)
            start[0] = True
            vacuity.see(program, values, start)
            return judged(conjunct, values, "time"), vacuity.is_vacuous


def _operator(node: Any) -> str:
    return getattr(node, "operator", "")


def _uncertain(names: tuple[str, ...], columns: Mapping[str, Array]) -> frozenset[str]:
    """The signals that are not known at each sample."""
    return frozenset(
        name for name in names if not (columns[LEAST + name] == columns[GREATEST + name]).all()
    )
