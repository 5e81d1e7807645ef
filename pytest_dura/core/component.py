"""Component under test as the loop calls it: within its time budget, by copies of plain data.

The values of a proposal may be of classes whose methods do anything: raise, block, answer
differently each time. So the loop works with copies whose types are Python's and NumPy's own. They
are made by the methods of those types, past what a subclass overrides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from numbers import Real
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pytest_dura.core.boundary import Boundary, CallEnded, let_pass
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    describe_error,
    report_environment_error,
    shorten,
    type_name,
)
from pytest_dura.core.loop_signals import read_account
from pytest_dura.core.outputs import accepted_action, check_texts, exact_texts
from pytest_dura.core.percepts import ATOMS, NOTHING
from pytest_dura.core.roles import FaultInjector, Generator, RoleContext
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import GeneratorView, Proposal, StateManager
from pytest_dura.core.time_limits import CallNotStopped, TimeBudgetExceeded, call_within

DEEPEST = 32
"""Levels of nested containers in a value that is copied to exact types."""

_dtype_of: Any = vars(np.ndarray)["dtype"].__get__


def plain_copy(value: Any) -> Any:
    """Deep copy of plain data."""
    if isinstance(value, Mapping):
        return {key: plain_copy(part) for key, part in value.items()}
    if isinstance(value, list):
        return [plain_copy(part) for part in value]
    return tuple(plain_copy(part) for part in value) if isinstance(value, tuple) else value


def exact_copy(value: Any) -> tuple[Any, bool]:
    """Copy to exact types, and whether the copy is plain throughout.

    Numbers, texts, lists, dictionaries and NumPy arrays of numbers become ``int``, ``float``,
    ``str``, ``list``, ``dict`` and ``ndarray``, whatever subclass they are of; so does the value of
    an enumeration of texts or numbers. An object of any other class, such as a named tuple or a
    dataclass, is passed on as it is: then the copy is not plain.

    Raises:
        ValueError: For containers that are nested beyond :data:`DEEPEST`, or in themselves.
    """
    if type(value) in ATOMS:
        return value, True
    kind = type(value)
    if (kind is tuple or kind is list) and ATOMS.issuperset(map(type, value)):
        return kind(value), True  # the usual containers, at each tick
    if _base_of(kind) is None:
        return value, False
    copier = _Copier()
    copied = copier.copy(value, 0)
    return copied, copier.is_plain


class _Copier:
    """Copier of one value; ``is_plain`` says whether it left an object as it is."""

    __slots__ = ("is_plain",)

    def __init__(self) -> None:
        self.is_plain = True

    def copy(self, value: Any, above: int) -> Any:
        kind = type(value)
        if kind in ATOMS:
            return value
        if above > DEEPEST:
            raise ValueError(f"it holds more than {DEEPEST} containers within each other")
        base = _base_of(kind)
        if base is dict:
            pairs = value.items() if kind is MappingProxyType else dict.items(value)
            return {self.copy(key, above + 1): self.copy(part, above + 1) for key, part in pairs}
        if base is list:
            return [self.copy(part, above + 1) for part in list.__iter__(value)]
        if base is tuple:
            return tuple([self.copy(part, above + 1) for part in value])
        if base is np.ndarray and not _dtype_of(value).hasobject:
            return np.array(value, copy=True, subok=False)
        if base is not None and base is not np.ndarray:
            value = _EXACTLY[base](value)
        self.is_plain &= type(value) in ATOMS
        return value


_EXACTLY: dict[Any, Any] = {
    str: str.__str__,
    float: float.__float__,
    int: int.__int__,
    bytes: lambda value: bytes.__getitem__(value, slice(None)),
    np.generic: np.generic.item,
}


def _base_of(kind: type[Any]) -> type[Any] | None:
    """Class as whose instance a value is copied; ``None`` where it is left as it is."""
    if kind is tuple or kind is MappingProxyType:
        return tuple if kind is tuple else dict
    return next((base for base in _BASES if issubclass(kind, base)), None)


_BASES: tuple[type[Any], ...] = (dict, list, np.ndarray, *_EXACTLY)


class Messages:
    """Transport of the component's own messages, such as requests to a server.

    The component calls :meth:`transmit` from within its proposal. A failure of the injector there
    is an environment error, never the component's.

    Args:
        injector: Applies the faults of messages; ``None`` without any.
        state: Records the faults that changed a message.
    """

    def __init__(self, injector: FaultInjector | None, state: StateManager) -> None:
        self._injector, self._state = injector, state

    def transmit(self, channel: str, message: Any) -> Any:
        """Return the message as it arrives."""
        if self._injector is None:
            return message
        try:
            changed, tampered = self._injector.corrupt_message(
                channel, message, self._state.tick.time
            )
            check_texts("tampered faults", tampered)
            faults = exact_texts(tampered)
        except CallEnded:
            raise
        except BaseException as error:
            let_pass(error)
            raise report_environment_error(
                ComponentEnvironmentError("fault_injector", describe_error(error))
            ) from error
        self._state.message_faults.update(faults)
        return changed


ABANDON_AFTER = 3
"""A component that overran its wall-clock budget this often is not called again in the episode."""

_IN_RESET = -1
"""Number of ``reset`` among a component's calls; proposals are counted from 0."""


class Answer(NamedTuple):
    """Answer of the component, as exact types.

    Args:
        proposal: The proposal, whose action is still unchecked; ``None`` with a problem.
        problem: What is wrong with the answer.
        is_plain: Whether the action holds no object of a class that may be the component's own.
    """

    proposal: Proposal | None
    problem: str | None
    is_plain: bool = True


def _read_proposal(answer: Any) -> Answer:
    """Read a proposal as exact types; this may call the component's code, and raise its errors."""
    if type(answer) is Proposal:
        action, explanation, latency = answer.action, answer.explanation, answer.latency
        failure, account = answer.failure, answer.account
    elif issubclass(type(answer), Proposal):  # past what a subclass overrides
        action, explanation, latency, failure, account = (part(answer) for part in _PARTS)
    else:
        return Answer(None, f"returned {type_name(answer)}, not a Proposal")
    is_plain = True
    try:
        if type(explanation) is not str:
            explanation = _text("an explanation", explanation)
        if type(failure) is not str:
            failure = _text("a failure", failure)
        if account is not NOTHING:  # most components give none, at any tick
            account = _account(account)
        if latency is not None:
            latency = _latency(latency)
        if type(action) not in ATOMS:
            action, is_plain = _action(action)
    except _UnusableError as wrong:
        return Answer(None, str(wrong))
    # Of our own, which the component does not hold.
    return Answer(Proposal(action, explanation, latency, failure, account), None, is_plain)


class _UnusableError(Exception):
    """Problem of a part of a proposal."""


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise _UnusableError(f"gave {name} that is {type_name(value)}, not str")
    return str.__str__(value)


def _account(value: Any) -> Mapping[str, Any]:
    account, wrong = read_account(value)
    if wrong is not None:
        raise _UnusableError(wrong)
    return account


def _latency(value: Any) -> float:
    seconds = _seconds(value)
    if seconds is None or seconds < 0.0:
        raise _UnusableError(
            f"declared a latency of {shorten(value)}, which is not a duration in seconds"
        )
    return seconds


def _action(value: Any) -> tuple[Any, bool]:
    try:
        return exact_copy(value)
    except ValueError as error:
        raise _UnusableError(f"no valid action: {error}") from None


_PARTS = [vars(Proposal)[field.name].__get__ for field in fields(Proposal)]


def check_proposal(proposal: Any) -> str | None:
    """Problem of a proposal with any simulator; ``None`` if there is none."""
    return _read_proposal(proposal).problem


def _seconds(value: Any) -> float | None:
    """Finite number of seconds; ``None`` for anything else."""
    if type(value) is not float:
        if not isinstance(value, Real):
            return None
        try:
            value = float(exact_copy(value)[0])
        except OverflowError:  # an int of hundreds of digits
            return None
    return value if -math.inf < value < math.inf else None


def _time_limit(value: Any) -> float | None:
    seconds = None if isinstance(value, bool) else _seconds(value)
    if value is None or (seconds is not None and seconds > 0.0):
        return seconds
    raise ValueError(f"its time_limit is {shorten(value)}, which is no number of seconds above 0")


class Component:
    """Caller of the Generator, which turns each of its failures into a problem text.

    Args:
        generator: The role that wraps the component.
        spec: Gives the time budget, and the recorded timeouts of an episode that is replayed.
        timeouts: Filled with the numbers of the calls that overran.
        boundary: The open boundary of the episode.
    """

    def __init__(
        self, generator: Generator, spec: EpisodeSpec, timeouts: list[int], boundary: Boundary
    ) -> None:
        self.generator, self.spec, self.timeouts = generator, spec, timeouts
        self._boundary = boundary
        self._limit = spec.time_budget
        self._calls = 0
        self._not_called = ""
        self._error: BaseException | None = None
        self.thought_seconds: float | None = None
        """Seconds of the call whose answer came into force, where that is another than the last."""
        self.late: list[int] = []
        """Ticks at which a command was due that the component was still computing."""
        self.expired: list[int] = []
        """Those at which none was in force any more."""

    def take_error(self) -> BaseException | None:
        """What the last call raised, if it did; its frames are kept no longer than that."""
        error, self._error = self._error, None
        return error

    def reset(self, context: RoleContext) -> str | None:
        """Begin an episode; returns the problem, if any, after which it is not called again."""
        answer = self._caught(self._read_limit, None)
        if answer.problem is None:
            answer = self._limited(_IN_RESET, self._reset, context)
        if answer.problem is None:
            return None
        self._not_called = "not called: its reset failed"
        return f"reset {answer.problem}"

    def propose(self, view: GeneratorView) -> Answer:
        """Ask for a proposal; its action is still unchecked."""
        number, self._calls = self._calls, self._calls + 1
        if self._not_called:
            return Answer(None, self._not_called)
        answer = self._limited(number, self._propose, view)
        latency = None if answer.proposal is None else answer.proposal.latency
        if latency is not None:
            budget = self.spec.time_budget
            if budget is not None and latency > budget:
                return Answer(None, f"answered after {latency:g} s; its budget is {budget:g} s")
        return answer

    def finish(self) -> None:
        """End an episode."""

    def check_action(self, simulator: Simulator, action: Any) -> tuple[Any, str | None]:
        """Check an action that is not plain: as the simulator takes it, and its problem.

        The check calls the component's code, so that what it raises is the component's failure.
        """
        try:
            checked, problem = accepted_action(simulator, action)
        except CallEnded:
            raise
        except BaseException as error:
            self._boundary.let_pass(error)
            checked, problem = None, f"no valid action: to check it raised {describe_error(error)}"
            self._error = error
        self._boundary.raise_signalled()
        return checked, problem

    def _read_limit(self, _: None) -> Answer:
        self._limit = _time_limit(self.generator.time_limit(self.spec.time_budget))
        return _DONE

    def _reset(self, context: RoleContext) -> Answer:
        self.generator.reset(context)
        return _DONE

    def _propose(self, view: GeneratorView) -> Answer:
        return _read_proposal(self.generator.propose(view))

    def _limited(self, number: int, call: Callable[[Any], Answer], argument: Any) -> Answer:
        """Call within the component's budget, of which reading the answer is a part."""
        try:
            if self.spec.timeouts is None:
                answer = call_within(self._limit, self._caught, call, argument)
            else:
                answer = self._replayed(number, call, argument)
        except TimeBudgetExceeded as overrun:
            if self.spec.timeouts is None:
                is_lost = isinstance(overrun, CallNotStopped)
                self._overran(number, ABANDON_AFTER if is_lost else 1)
            answer = Answer(None, "overran its wall-clock time budget")
        if self._boundary.signalled is not None:
            self._boundary.raise_signalled()
        return answer

    def _caught(self, call: Callable[[Any], Answer], argument: Any) -> Answer:
        try:
            return call(argument)
        except TimeBudgetExceeded:
            raise
        except BaseException as error:
            self._boundary.let_pass(error)
            self._error = error
            return Answer(None, f"raised {describe_error(error)}")

    def _replayed(self, number: int, call: Callable[[Any], Answer], argument: Any) -> Answer:
        """Call the component, unless this call overran its budget when it was recorded."""
        recorded = self.spec.timeouts or ()
        if number in recorded:
            self._overran(number, recorded.count(number))
            raise TimeBudgetExceeded
        return self._caught(call, argument)

    def _overran(self, number: int, times: int) -> None:
        self.timeouts += [number] * times
        if times >= ABANDON_AFTER:
            self._not_called = "not called: an earlier call has not come back"
        elif len(self.timeouts) >= ABANDON_AFTER:
            self._not_called = f"not called: it overran its time budget {ABANDON_AFTER} times"


_DONE = Answer(None, None)
