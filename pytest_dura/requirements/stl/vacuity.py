"""Whether a formula is satisfied only because the conditions of its implications never held."""

from __future__ import annotations

import numpy as np

from pytest_dura.requirements.stl.nodes import FUTURE, Boolean, Node, Temporal
from pytest_dura.requirements.stl.program import Mode, Program
from pytest_dura.requirements.stl.values import Values


def vacuous(node: Node, program: Program, values: Values, *, complete: bool = True) -> bool:
    """Whether the verdict of a satisfied formula rests on conditions that never held.

    An implication is vacuous if its condition held at no sample at which it was evaluated, or if
    what it demands is vacuous itself. Windows are vacuous if what they range over is, a
    conjunction if both parts are, and a disjunction if both are or the other part held nowhere.
    Nothing else is. What may still hold behind the end of the trace does not count as held.

    Args:
        node: The formula.
        program: The program that its values belong to.
        values: The values on the trace.
        complete: Whether the trace is the whole episode.
    """
    return _Vacuity(program, values, complete).of(node, 0, 0)


class _Vacuity:
    def __init__(self, program: Program, values: Values, complete: bool) -> None:
        self.program, self.values = program, values
        self.open_end = not complete
        self.end = values.frame.shape[-1] - 1

    def of(self, node: Node, first: int, last: int) -> bool:
        """Whether it is vacuous, evaluated at the samples ``first .. last``."""
        if isinstance(node, Temporal):
            return self.of(node.operand, *self._reached(node, first, last))
        if not isinstance(node, Boolean):
            return False
        if node.operator == "implies":
            never = not self._held(node.left, first, last)
            return never or self.of(node.right, first, last)
        left, right = (self.of(side, first, last) for side in (node.left, node.right))
        if node.operator == "and":
            return left and right
        if node.operator == "or":
            return (left and (right or not self._held(node.right, first, last))) or (
                right and not self._held(node.left, first, last)
            )
        return False

    def _held(self, node: Node, first: int, last: int) -> bool:
        mode = Mode(-np.inf, self.open_end)
        best = self.values[self.program.slot(node, mode)][first : last + 1].max(initial=-np.inf)
        if best == 0:  # only there the margin does not tell the truth
            slot = self.program.slot(node, mode._replace(truth=True))
            best = self.values[slot][first : last + 1].max()
        return bool(best > 0)

    def _reached(self, node: Temporal, first: int, last: int) -> tuple[int, int]:
        """The samples at which the operand of a temporal operator is evaluated."""
        ahead = node.operator in FUTURE
        if node.window is None:
            return (first, self.end) if ahead else (0, last)
        near, far = self.program.samples(node.window)
        if ahead:
            return first + near, min(last + far, self.end)
        return max(first - far, 0), last - near
