"""Planners that only their recovery keeps safe: their proposals are stale, or half invalid."""

from __future__ import annotations

from collections import deque

from pytest_dura import Proposal
from pytest_dura.core import GeneratorView, RoleContext
from pytest_dura.driving import RuleBased


class Stale(RuleBased):
    """Proposes what it would have proposed a while ago.

    Args:
        age: In s.
    """

    def __init__(self, age: float = 1.5) -> None:
        super().__init__()
        self.age = age

    def reset(self, context: RoleContext) -> None:
        """Forget earlier proposals."""
        super().reset(context)
        self._earlier: deque[Proposal] = deque(maxlen=round(self.age / context.dt) + 1)

    def propose(self, view: GeneratorView) -> Proposal:
        """The oldest proposal that is kept."""
        self._earlier.append(super().propose(view))
        return self._earlier[0]


class HalfInvalid(RuleBased):
    """Answers every other tick with something that is no maneuver."""

    def propose(self, view: GeneratorView) -> Proposal:
        """A sound proposal at even ticks."""
        return super().propose(view) if view.index % 2 == 0 else Proposal("fly away")
