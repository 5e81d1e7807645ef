"""Operators on a stream of values, one sample at a time: what a monitor keeps between two ticks.

A value is a pair of margin and truth. Pairs are ordered by margin, then by truth; the truth of a
margin of zero depends on the comparison that gave it (``>=`` or ``>``), and elsewhere it is the
margin's sign. So the least of several pairs has the least margin and is true if all are, and the
greatest is true if one is: minimum and maximum carry the robustness and the Boolean verdict alike.

Each operator is called once per sample and in amortised constant time. What was before the first
sample is as in ``windows``: a window is cut there, and an empty one gives :data:`TOP` for "at all
samples" and :data:`BOTTOM` for "at some sample".
"""

from __future__ import annotations

import math
import operator
from collections import deque
from typing import TypeAlias

Value: TypeAlias = tuple[float, bool]
"""Margin, and whether it holds."""

TOP: Value = (math.inf, True)
BOTTOM: Value = (-math.inf, False)


def negated(value: Value) -> Value:
    """The opposite."""
    margin, holds = value
    return -margin, not holds


class Delay:
    """The value of some samples ago.

    Args:
        samples: How many; 0 gives the value itself.
        start: The value before the first sample.
    """

    def __init__(self, samples: int, start: Value) -> None:
        self._samples, self._start = samples, start
        self._held: deque[Value] = deque()

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        self._held.append(value)
        return self._held.popleft() if len(self._held) > self._samples else self._start


class Running:
    """The least, or the greatest, of all values so far."""

    def __init__(self, *, least: bool) -> None:
        self._join = min if least else max
        self._found = TOP if least else BOTTOM

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        self._found = self._join(self._found, value)
        return self._found


class Sliding:
    """The least, or the greatest, of the values from ``last`` to ``first`` samples ago.

    A queue holds the values that may still be an answer, the present one at its head: those with
    none at least as good behind them (Lemire, "Streaming maximum-minimum filter using no more than
    three comparisons per element", 2006). Each enters and leaves once.
    """

    def __init__(self, first: int, last: int, *, least: bool) -> None:
        self._delay = Delay(first, TOP if least else BOTTOM)
        self._covers = operator.le if least else operator.ge
        self._width = last - first + 1
        self._queue: deque[tuple[int, Value]] = deque()
        self._index = 0

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        queue, covers = self._queue, self._covers
        entering = self._delay(value)
        while queue and covers(entering, queue[-1][1]):
            queue.pop()
        queue.append((self._index, entering))
        if queue[0][0] <= self._index - self._width:
            queue.popleft()
        self._index += 1
        return queue[0][1]


class Since:
    """The best sample so far for ``right``, with ``left`` at all after it."""

    def __init__(self) -> None:
        self._found = BOTTOM

    def __call__(self, left: Value, right: Value) -> Value:
        """Take the next two values."""
        self._found = max(right, min(left, self._found))
        return self._found


class SinceWithin:
    """The same where the sample for ``right`` lies ``last`` to ``first`` samples ago.

    ``p since[a:b] q`` is ``(once[a:b] q) and (p since[a:oo] q)``: if ``q`` held within the window,
    and ``p`` since some ``q`` before it, then ``p`` held since the ``q`` within it, too (Donzé,
    Ferrère, Maler, "Efficient Robust Monitoring for STL", 2013, lemma 3, mirrored). And ``p
    since[a:oo] q`` is ``p since q`` of ``a`` samples ago with ``p`` at all samples after that.
    Minimum and maximum distribute over each other, so that both hold for margins as for truth.
    """

    def __init__(self, first: int, last: int) -> None:
        self._since = Since()
        self._begun = Delay(first, BOTTOM)
        self._kept_up = Sliding(0, first - 1, least=True) if first else None
        self._within = Sliding(first, last, least=False)

    def __call__(self, left: Value, right: Value) -> Value:
        """Take the next two values."""
        begun = self._begun(self._since(left, right))
        kept_up = TOP if self._kept_up is None else self._kept_up(left)
        return min(begun, kept_up, self._within(right))
