"""The component under test as the loop calls it: within its budget, and never trusted."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import Any

from pytest_dura.core.accounts import account_problem
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import describe_error
from pytest_dura.core.limits import CallNotStopped, TimeBudgetExceeded, call_within
from pytest_dura.core.roles import Generator, Proposal, RoleContext
from pytest_dura.core.state import NOTHING, GeneratorView

ABANDON_AFTER = 3
"""A component that overran its wall-clock budget this often is not called again in the episode."""

IN_RESET = -1
"""The number of ``reset`` among a component's calls; proposals are counted from 0."""


def check_proposal(proposal: Any) -> str | None:
    """What is wrong with a proposal, whatever the simulator; ``None`` if nothing is."""
    if not isinstance(proposal, Proposal):
        return f"returned {type(proposal).__name__}, not a Proposal"
    if not isinstance(proposal.explanation, str):
        return f"gave an explanation that is {type(proposal.explanation).__name__}, not str"
    if not isinstance(proposal.failure, str):
        return f"gave a failure that is {type(proposal.failure).__name__}, not str"
    if proposal.account is not NOTHING:  # most components give none, at any tick
        wrong = account_problem(proposal.account)
        if wrong is not None:
            return wrong
    latency: Any = proposal.latency
    if latency is None or (isinstance(latency, Real) and 0.0 <= float(latency) < math.inf):
        return None
    return f"declared a latency of {latency!r}, which is not a duration in seconds"


def _duration(told: Any) -> float | None:
    """The time limit that a component has named.

    Raises:
        ValueError: If it is no duration.
    """
    number = isinstance(told, Real) and not isinstance(told, bool)
    if told is None or (number and 0.0 < float(told) < math.inf):
        return None if told is None else float(told)
    raise ValueError(f"its time_limit is {told!r}, which is no number of seconds above 0")


class Component:
    """Calls the Generator and turns every way in which it can fail into words.

    Args:
        generator: The role that wraps the component.
        spec: Holds the time budget, and the recorded timeouts of an episode that is replayed.
        timeouts: Filled with the numbers of the calls that overran.
    """

    def __init__(self, generator: Generator, spec: EpisodeSpec, timeouts: list[int]) -> None:
        self.generator, self.spec, self.timeouts = generator, spec, timeouts
        self._limit = spec.time_budget
        self._calls = 0
        self._not_called = ""

    def reset(self, context: RoleContext) -> str | None:
        """Begin an episode; returns what went wrong, if anything. It is not called after that."""
        try:
            self._limit = _duration(self.generator.time_limit(self.spec.time_budget))
            self._timed_call(IN_RESET, self.generator.reset, context)
        except TimeBudgetExceeded:
            problem = "reset overran its wall-clock time budget"
        except (Exception, SystemExit) as error:
            problem = f"reset raised {describe_error(error)}"
        else:
            return None
        self._not_called = "not called: its reset failed"
        return problem

    def ask(self, view: GeneratorView) -> tuple[Proposal | None, str | None]:
        """A proposal whose action is still unchecked, or what is wrong with the answer."""
        number, self._calls = self._calls, self._calls + 1
        if self._not_called:
            return None, self._not_called
        try:
            proposal = self._timed_call(number, self.generator.propose, view)
        except TimeBudgetExceeded:
            return None, "overran its wall-clock time budget"
        except (Exception, SystemExit) as error:
            return None, f"raised {describe_error(error)}"
        problem = check_proposal(proposal)
        if problem is not None:
            return None, problem
        latency, budget = proposal.latency, self.spec.time_budget
        if latency is not None and budget is not None and latency > budget:
            return None, f"answered after {latency:g} s; its budget is {budget:g} s"
        return proposal, None

    def _timed_call(self, number: int, call: Callable[..., Any], argument: Any) -> Any:
        """Call the component within its budget: by the clock, or as it was recorded."""
        recorded = self.spec.timeouts
        if recorded is not None:
            if number in recorded:
                self._overran(number, recorded.count(number))
                raise TimeBudgetExceeded
            return call(argument)
        try:
            return call_within(self._limit, call, argument)
        except CallNotStopped:
            self._overran(number, ABANDON_AFTER)
            raise
        except TimeBudgetExceeded:
            self._overran(number, 1)
            raise

    def _overran(self, number: int, times: int) -> None:
        self.timeouts += [number] * times
        if times >= ABANDON_AFTER:
            self._not_called = "not called: an earlier call has not come back"
        elif len(self.timeouts) >= ABANDON_AFTER:
            self._not_called = f"not called: it overran its time budget {ABANDON_AFTER} times"
