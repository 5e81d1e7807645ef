"""TimedComponent: the component under test where thinking takes time in the world.

It thinks about one percept at a time. Its answer comes into force at the first tick at which it is
there; then it gets the percept of that tick. Until then the command before stays in force.
"""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

from pytest_dura.core.boundary import Boundary
from pytest_dura.core.component import Answer, Component
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    environment_errors,
    report_environment_error,
)
from pytest_dura.core.loop_signals import DECIDED, declared_seconds
from pytest_dura.core.roles import Generator
from pytest_dura.core.state import GeneratorView, StateManager
from pytest_dura.core.time_limits import ROLE_TIMEOUT, with_pauses

_ROUNDING = 1e-9
"""Seconds: 0.3 s is there at the tick of 0.1 s + 0.2 s."""


class _Thought:
    """Answer of the component on one percept, which is there at once or some time later."""

    def __init__(self, view: GeneratorView, state: StateManager) -> None:
        self.view = view
        self.answer: Answer | None = None
        self.error: BaseException | None = None
        self.raised: BaseException | None = None
        self.seconds = 0.0
        self.environment: list[ComponentEnvironmentError] = []
        self.thread: threading.Thread | None = None
        self._tampered, self._reads = state.percept.tampered, state.generator_reads

    @property
    def is_under_way(self) -> bool:
        """Whether the component is still thinking."""
        return self.thread is not None and self.thread.is_alive()

    def think(
        self, propose: Callable[[GeneratorView], tuple[Answer, BaseException | None]]
    ) -> None:
        """Call the component, and measure how long it takes."""
        began = perf_counter()
        try:
            with environment_errors() as self.environment, with_pauses() as pauses:
                self.answer, self.error = propose(self.view)
            self.seconds = perf_counter() - began - pauses.seconds
        except BaseException as raised:  # for the loop, at the tick at which it looks
            self.raised = raised

    def faults_read(self) -> set[str]:
        """Ids of the faults that changed what the component read of its percept."""
        read = [faults for name, faults in self._tampered.items() if name in self._reads]
        return {fault for faults in read for fault in faults}


class TimedComponent(Component):
    """As :class:`Component`, with the clock of the spec.

    The first command is waited for. By the wall clock the component thinks in a thread of its own,
    in which its time budget holds as in any call.

    Args:
        state: Of the episode.
    """

    def __init__(
        self,
        generator: Generator,
        spec: EpisodeSpec,
        timeouts: list[int],
        boundary: Boundary,
        state: StateManager,
    ) -> None:
        super().__init__(generator, spec, timeouts, boundary)
        self._state, self._clock = state, spec.clock
        self._thought: _Thought | None = None
        self._in_force: Answer | None = None
        self._since = 0.0
        self._landed_error: BaseException | None = None

    def take_error(self) -> BaseException | None:
        """What the answer that has just come into force raised, if it did."""
        error, self._landed_error = self._landed_error, None
        return error

    def propose(self, view: GeneratorView) -> Answer:
        """Return the answer in force, and let the component think where it is free to."""
        self.thought_seconds = 0.0
        is_first = self._in_force is None
        has_landed = self._land(view.time)
        if self._thought is not None:
            self.late.append(view.index)
            if view.time - self._since >= self._clock.hold - _ROUNDING:
                self.expired.append(view.index)
                held = f"{self._since:g} s has been in force for {self._clock.hold:g} s"
                return Answer(None, f"late: its command of {held}, the longest that is allowed")
        else:
            self._think(view, waits=is_first)
            if is_first or self._clock.kind != "wall":  # however quick it is: as at any other tick
                has_landed = self._land(view.time, waited=is_first) or has_landed
        assert self._in_force is not None
        return self._in_force if has_landed else _held(self._in_force)

    def finish(self) -> None:
        """Wait for the component, whose process goes on with the next episode."""
        if self._thought is not None and self._thought.thread is not None:
            self._thought.thread.join(self._limit or ROLE_TIMEOUT)

    def _think(self, view: GeneratorView, *, waits: bool) -> None:
        self._thought = thought = _Thought(view, self._state)
        if waits or self._clock.kind != "wall":
            thought.think(self._answer)
            return
        context = contextvars.copy_context()
        thought.thread = threading.Thread(
            target=context.run, args=(thought.think, self._answer), name="dura-component",
            daemon=True,
        )  # fmt: skip
        thought.thread.start()

    def _answer(self, view: GeneratorView) -> tuple[Answer, BaseException | None]:
        return super().propose(view), super().take_error()

    def _land(self, time: float, *, waited: bool = False) -> bool:
        """Put an answer into force that is there; returns whether there was one."""
        thought = self._thought
        if thought is None or thought.is_under_way:
            return False
        if thought.raised is not None:
            raise thought.raised
        assert thought.answer is not None
        due = thought.view.time + self._latency(thought.answer, thought.seconds)
        if time < due - _ROUNDING and not waited:
            return False
        self._in_force, self._landed_error = thought.answer, thought.error
        self._thought, self._since, self.thought_seconds = None, time, thought.seconds
        # By the wall clock it may have read its percept after the loop had gone on.
        self._state.message_faults |= thought.faults_read()
        for error in thought.environment:
            report_environment_error(error)
        return True

    def _latency(self, answer: Answer, measured: float) -> float:
        """Seconds of simulated time that the answer took; by the wall clock it is there."""
        proposal = answer.proposal
        if self._clock.kind == "wall" or self._clock.latency == "none":
            return 0.0
        if self._clock.latency == "declared":
            return 0.0 if proposal is None else proposal.latency or 0.0
        seconds = None if proposal is None else declared_seconds(proposal.account)
        return measured if seconds is None else seconds


def _held(answer: Answer) -> Answer:
    """An answer at a later tick than that at which it came into force: nothing new was decided."""
    proposal = answer.proposal
    if proposal is None or not proposal.account.get(DECIDED):
        return answer
    return answer._replace(proposal=replace(proposal, account={**proposal.account, DECIDED: False}))
