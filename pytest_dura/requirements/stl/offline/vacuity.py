"""Whether a formula is satisfied only because the conditions of its implications never held."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pytest_dura.requirements.stl.language.nodes import FUTURE, Boolean, Node, Temporal
from pytest_dura.requirements.stl.offline import windows
from pytest_dura.requirements.stl.offline.program import Mode, Program
from pytest_dura.requirements.stl.offline.values import Values

_Samples: TypeAlias = NDArray[np.bool_]
"""True at the samples at which something is evaluated or holds, shape ``(n,)``."""


def vacuous(node: Node, program: Program, values: Values, *, complete: bool = True) -> bool:
    """Whether the verdict of a satisfied formula rests on conditions that never held.

    An implication is vacuous if its condition held at no sample at which it was evaluated, or if
    what it demands there, where its condition held, is vacuous itself: ``a implies (b implies c)``
    is as vacuous as ``(a and b) implies c``. Windows are vacuous if what they range over is, a
    conjunction if both parts are, and a disjunction if both are or the other part held nowhere.
    Nothing else is. What may still hold behind the end of the trace does not count as held.

    Args:
        node: The formula.
        program: The program that its values belong to.
        values: The values on the trace.
        complete: Whether the trace is the whole episode.
    """
    start = np.zeros(values.frame.shape[-1], dtype=bool)
    start[0] = True
    return _Vacuity(program, values, complete).of(node, start)


class _Vacuity:
    def __init__(self, program: Program, values: Values, complete: bool) -> None:
        self.program, self.values = program, values
        self.open_end = not complete

    def of(self, node: Node, at: _Samples) -> bool:
        """Whether it is vacuous, evaluated at these samples."""
        if isinstance(node, Temporal):
            return self.of(node.operand, self._reached(node, at))
        if not isinstance(node, Boolean):
            return False
        if node.operator == "implies":
            held = self._held(node.left, at)
            return not held.any() or self.of(node.right, held)
        left, right = (self.of(side, at) for side in (node.left, node.right))
        if node.operator == "and":
            return left and right
        if node.operator == "or":
            return (left and (right or not self._held(node.right, at).any())) or (
                right and not self._held(node.left, at).any()
            )
        return False

    def _held(self, node: Node, at: _Samples) -> _Samples:
        """Those of the samples at which it held."""
        mode = Mode(-np.inf, self.open_end)
        margins = self.values[self.program.slot(node, mode)]
        held = at & (margins > 0)
        open_ = at & (margins == 0)
        if open_.any():  # only there the margin does not tell the truth
            truth = self.values[self.program.slot(node, mode._replace(truth=True))]
            held |= open_ & (truth > 0)
        return held

    def _reached(self, node: Temporal, at: _Samples) -> _Samples:
        """The samples at which the operand of a temporal operator is evaluated."""
        ahead = node.operator in FUTURE
        marks = at.astype(float)
        # Seen from a sample that is reached, the operator lies on the other side.
        if node.window is None:
            spread = windows.running_past if ahead else windows.running
            return spread(np.maximum, marks) > 0
        slide = windows.sliding_past if ahead else windows.sliding
        return slide(np.maximum, marks, *self.program.samples(node.window)) > 0
