"""Simulator: the port to the physical world (the paper's Environment Interface)."""

from __future__ import annotations

import cmath
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ActionError, ConfigurationError, shorten, type_name
from pytest_dura.core.recording import Scene
from pytest_dura.core.state import Percept, Tick


class Simulator(ABC):
    """A world that is reset with a scenario and advanced one tick at a time.

    An adapter must be a pure function of scenario, seed and actions. ``check_simulator`` of
    ``pytest_dura.core.conformance`` tests that, and the rest of this contract.
    """

    time_step: float = 0.1
    """Simulated seconds per tick."""

    hindsight: ClassVar[frozenset[str]] = frozenset()
    """Signals whose value at a tick may change with what follows, such as one that asks when the
    road will be free again. No requirement on one of them is decided before an episode's end."""

    def set_time_step(self, seconds: float) -> None:
        """Choose the simulated seconds per tick; takes effect at the next reset."""
        if not 0.0 < seconds < float("inf"):
            raise ConfigurationError(
                "the time step of a simulator is a positive number of seconds",
                key="time_step",
                found=seconds,
                expected="a number above 0",
            )
        self.time_step = seconds

    @abstractmethod
    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin an episode; the tick has index 0 and time 0."""

    @abstractmethod
    def step(self, action: Any) -> Tick:
        """Apply a checked action for one time step."""

    @abstractmethod
    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Ground-truth signals by name, one value per tick, shape ``(len(ticks),)``.

        Called once per episode, so that it may be vectorised over time; and on the ticks so far
        where episodes end once all is decided. A value may rest on earlier ticks, but on later
        ones only if :attr:`hindsight` names the signal.
        """

    def percept_signals(
        self,
        percepts: Sequence[Percept],  # noqa: ARG002 - for those who override it
    ) -> dict[str, NDArray[np.float64]]:
        """The signals that can be computed from percepts alone, one value per percept.

        The episode stores them with the prefix ``percept.``.
        """
        return {}

    def account_measures(
        self,
        ticks: Sequence[Tick],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
        accounts: Sequence[Mapping[str, Any]],  # noqa: ARG002 - see above
    ) -> dict[str, NDArray[np.float64]]:
        """Failure modes of the component that its accounts show, one value per decision.

        Called once per episode, and only if the component gave an account of any proposal. 1 where
        the decision in force at a tick shows the failure, 0 where it does not, NaN where it could
        not show it. The episode stores them as signals with the prefix ``proposal.``, 0 for NaN,
        and counts them over the ticks at which something was decided anew.

        Args:
            ticks: The world as it was.
            percepts: As it was perceived.
            accounts: Of each decision, :attr:`Proposal.account`; empty where there was none.

        Returns:
            Columns of shape ``(len(accounts),)``.
        """
        return {}

    measure_kinds: ClassVar[Mapping[str, str]] = {}
    """What a measure of :meth:`account_measures` is, where it is no plain failure mode: ``control``
    or ``comparison``; see :class:`~pytest_dura.core.metrics.Tally`."""

    def account_signals(
        self,
        ticks: Sequence[Tick],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
        accounts: Sequence[Mapping[str, Any]],  # noqa: ARG002 - see above
    ) -> dict[str, NDArray[np.float64]]:
        """What accounts tell beside failure modes, such as the age of a decision.

        As :meth:`account_measures`, whose names it shares, but any numbers; nothing is counted.
        """
        return {}

    def scene(
        self,
        ticks: Sequence[Tick],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
    ) -> Scene | None:
        """The episode from above, for the player of the report; ``None`` where there is no such.

        Called at most once per episode, after its end. Nothing is judged by it.
        """
        return None

    def check_action(self, action: Any) -> Any:
        """The action in the form that ``step`` takes.

        What it gets of a component are numbers, texts, lists, tuples, dictionaries and arrays of
        numbers of exactly these types, copied; objects of other classes, a dataclass for example,
        it gets as they are. The base takes finite numbers, texts, and what is made of them. A
        simulator with actions of a class of its own overrides this, and takes no other class;
        one with a closed set of actions refuses more.

        Raises:
            ActionError: If it is not an action of this simulator.
        """
        if action is None:
            raise ActionError("the proposal holds no action (None)")
        if type(action) is not float or not math.isfinite(action):  # the usual case
            wrong = _wrong_action(action)
            if wrong is not None:
                raise ActionError(wrong)
        return action

    @abstractmethod
    def fallback_action(self) -> Any:
        """What the plant does when nobody commands it."""

    def actuation(self, action: Any) -> Any:
        """A checked action as the actuators get it, which is what command faults change.

        The base gives the action itself. A simulator whose actions leave something to it, such as
        the acceleration of a maneuver, fills that in here; ``step`` does the same with either.
        """
        return action

    def describe_action(self, action: Any) -> str:
        """A short, stable text for decisions and reports."""
        return str(action)

    def render(self) -> NDArray[np.uint8]:
        """An RGB picture of the current state, shape ``(height, width, 3)``."""
        raise NotImplementedError(f"{type(self).__name__} does not render")

    def snapshot(self) -> object:
        """The whole state, to branch from; opaque to the caller."""
        raise NotImplementedError(f"{type(self).__name__} has no snapshots")

    def restore(self, snapshot: object) -> None:
        """Return to a snapshot of this simulator; it may be restored more than once."""
        raise NotImplementedError(f"{type(self).__name__} has no snapshots")

    def close(self) -> None:  # noqa: B027 - most simulators hold nothing
        """Release what the simulator holds; it is not used afterwards."""


def _wrong_action(action: Any) -> str | None:
    """Why a value is no action, whatever the simulator; ``None`` if it may be one."""
    kind = type(action)
    if kind in (str, bytes, bool, type(None)):
        return None
    if kind in (int, float, complex):
        return None if _is_finite(action) else f"the action {shorten(action)} is no finite number"
    if kind is dict or kind is list or kind is tuple:
        parts = [*action, *action.values()] if kind is dict else action
        return next((wrong for wrong in map(_wrong_action, parts) if wrong is not None), None)
    if isinstance(action, (np.ndarray, np.generic)) and not action.dtype.hasobject:
        finite = action.dtype.kind not in "fc" or bool(np.isfinite(action).all())
        return None if finite else f"the action {shorten(action)} holds what is no finite number"
    return (
        f"the action holds an object of type {type_name(action)}; a simulator that takes such "
        "actions overrides check_action"
    )


def _is_finite(number: complex) -> bool:
    try:
        return cmath.isfinite(number)
    except OverflowError:  # an int of hundreds of digits
        return False
