"""Mutations of the component under test that fit any domain."""

from __future__ import annotations

import os
from collections import deque
from typing import ClassVar

from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.qualification.altered import with_numbers
from pytest_dura.qualification.mutant import Mutation, Parameter


class ComponentMutation(Mutation[Generator], Generator):
    """A component with a defect."""

    def time_limit(self, budget: float | None) -> float | None:
        """As the component's own."""
        return self.part.time_limit(budget)

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose as the component does."""
        return self.part.propose(view)


class Stale(ComponentMutation):
    """Proposes what the component proposed some ticks ago."""

    about = "acts on what it decided some ticks ago"
    parameters: ClassVar = (Parameter("ticks", (5, 15), "ticks"),)
    ticks: int

    def reset(self, context: RoleContext) -> None:
        """Forget the proposals."""
        super().reset(context)
        self._made: deque[Proposal] = deque(maxlen=self.ticks + 1)

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose what was proposed then; the first one until there is such a one."""
        self._made.append(self.part.propose(view))
        return self._made[0]


class Frozen(ComponentMutation):
    """Repeats one proposal for ever."""

    about = "repeats its last proposal from some time on"
    provokes = True
    parameters: ClassVar = (Parameter("since", (2.0, 6.0), "s"),)
    since: float

    def reset(self, context: RoleContext) -> None:
        """Begin to follow the component again."""
        super().reset(context)
        self._kept: Proposal | None = None

    def propose(self, view: GeneratorView) -> Proposal:
        """Ask the component, and pass on its last answer before the time."""
        proposal = self.part.propose(view)
        if self._kept is None or view.time < self.since:
            self._kept = proposal
        return self._kept


class Drops(ComponentMutation):
    """Makes no proposal now and then."""

    about = "makes no valid proposal at every so many ticks"
    parameters: ClassVar = (Parameter("every", (2, 10), "ticks"),)
    every: int

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose nothing at each of these ticks."""
        proposal = self.part.propose(view)
        due = view.index % self.every == self.every - 1
        return proposal.with_action(None) if due else proposal


class Inverted(ComponentMutation):
    """Does the opposite."""

    about = "proposes its numbers with the opposite sign"
    provokes = True

    def propose(self, view: GeneratorView) -> Proposal:
        """Mirror each number of the action."""
        proposal = self.part.propose(view)
        return proposal.with_action(with_numbers(proposal.action, lambda number: -number))


class Scaled(ComponentMutation):
    """Does too much, or too little."""

    about = "proposes its numbers times a factor"
    parameters: ClassVar = (Parameter("factor", (0.5, 2.0)),)
    factor: float

    def propose(self, view: GeneratorView) -> Proposal:
        """Scale each number of the action."""
        proposal = self.part.propose(view)
        return proposal.with_action(with_numbers(proposal.action, lambda each: each * self.factor))


class Biased(ComponentMutation):
    """Is off by a constant."""

    about = "proposes its numbers with an offset"
    parameters: ClassVar = (Parameter("offset", (-0.5, 0.5)),)
    offset: float

    def propose(self, view: GeneratorView) -> Proposal:
        """Shift each number of the action."""
        proposal = self.part.propose(view)
        return proposal.with_action(with_numbers(proposal.action, lambda each: each + self.offset))


class Noisy(ComponentMutation):
    """Trembles."""

    about = "proposes its numbers with noise, drawn from the episode's seed"
    parameters: ClassVar = (Parameter("spread", (1.0,)),)
    spread: float

    def reset(self, context: RoleContext) -> None:
        """Begin its draws anew."""
        super().reset(context)
        self._draws = stream(context.seed, "mutant:noisy")

    def propose(self, view: GeneratorView) -> Proposal:
        """Add a draw to each number of the action."""
        proposal = self.part.propose(view)
        return proposal.with_action(
            with_numbers(
                proposal.action, lambda each: each + self.spread * float(self._draws.normal())
            )
        )


class Leaks(ComponentMutation):
    """Carries state from one episode of its process to the next."""

    about = "remembers earlier episodes, and delays its proposals by two ticks more after each"
    episodes: ClassVar[int] = 0
    """Of this process, up to now."""

    def reset(self, context: RoleContext) -> None:
        """Count the episode."""
        super().reset(context)
        kind = type(self)
        self._made: deque[Proposal] = deque(maxlen=1 + 2 * kind.episodes)
        kind.episodes = min(kind.episodes + 1, 20)

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose later the more episodes its process has seen."""
        self._made.append(self.part.propose(view))
        return self._made[0]


class CoinFlips(ComponentMutation):
    """Draws from the machine, not from the seed."""

    about = "halves its numbers at ticks that the machine draws, not the episode's seed"

    def propose(self, view: GeneratorView) -> Proposal:
        """Halve each number of the action where the coin says so."""
        proposal = self.part.propose(view)
        if os.urandom(1)[0] & 1:
            return proposal
        return proposal.with_action(with_numbers(proposal.action, lambda each: each / 2))
