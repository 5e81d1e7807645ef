"""Checks: what decides a requirement on one episode, and when it is decided before the end.

A check is a formula, or a function of the user's own. ``RequirementJudge`` tells the loop when
nothing can change a verdict any more.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.evaluation import evaluate
from pytest_dura.requirements.stl.formula import Formula, ranging_or_refuse, reach
from pytest_dura.requirements.stl.parser import parse
from pytest_dura.requirements.stl.validity import falsifiable_or_refuse
from pytest_dura.requirements.stl.windows import Array

_PATH = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")

Check: TypeAlias = "str | Callable[..., Any]"
"""A formula, the import path of a function, or the function itself."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result that a check function may return instead of a truth value or a margin.

    Args:
        holds: Whether the episode satisfies the requirement.
        margin: By how much, negative for a violation, if there is such a measure.
        time: Seconds at which it was violated first.
        detail: Why, in words.
        vacuous: Whether it holds only because what it is about never happened.
    """

    holds: bool
    margin: float | None = None
    time: float | None = None
    detail: str = ""
    vacuous: bool = False

    __repr__ = short_repr


def is_function_path(check: str) -> bool:
    """Whether a check is an import path ``package.module:function``; no formula looks like one."""
    return _PATH.fullmatch(check.strip()) is not None


def check_name(check: Check) -> str:
    """Name of a check in reports: the formula, or the function's import path."""
    if isinstance(check, str):
        return check
    named = check if hasattr(check, "__qualname__") else type(check)
    return f"{named.__module__}:{named.__qualname__}"


def read_formula(text: str, signals: tuple[str, ...] | None = None) -> Formula:
    """The formula of a check; ``signals`` are the known names, where they are known.

    Raises:
        ConfigurationError: For anything that is no formula, for one of which a part reads the
            beginning of an episode alone, and for one that holds whatever the signals are.
    """
    formula = parse(text, signals)
    ranging_or_refuse(formula)
    falsifiable_or_refuse(formula)
    return formula


@lru_cache(maxsize=256)
def load_function(path: str) -> Callable[..., Any]:
    """The function that an import path leads to.

    Raises:
        ConfigurationError: If it cannot be imported, or cannot be called with one episode.
    """
    function = RoleSpec(path.strip()).function()
    try:
        inspect.signature(function).bind(object())
    except TypeError as error:
        raise ConfigurationError(
            f"{path} cannot be called with an episode: {error}",
            found=f"{path}{inspect.signature(function)}",
            expected="a function of one episode",
            remedy="let it take the episode as its only required parameter",
        ) from None
    except ValueError:  # a builtin has no signature
        pass
    return function


def check_result(value: Any) -> CheckResult:
    """Result of a check function's value: a bool, or a float as margin (0 satisfies).

    Raises:
        TypeError: For anything else. A whole number may be a count or an exit code, of which 0 or
            1 would satisfy whatever it counts.
        ValueError: For a margin or a time that is not a number.
    """
    if isinstance(value, CheckResult):
        return _plain(value)
    if hasattr(value, "item"):
        # An array of one truth value has a number too, and as a margin False would satisfy.
        value = value.item()
    if _is_truth_value(value):
        return CheckResult(bool(value))
    if isinstance(value, (float, np.floating)):
        margin = _number(value)
        return CheckResult(margin >= 0, margin)
    expected = "not a truth value (bool), a margin (float) or a CheckResult"
    if isinstance(value, int):
        raise TypeError(f"returned the int {value}, {expected}; compare it, as in `count == 0`")
    raise TypeError(f"returned {type(value).__name__}, {expected}")


def _plain(result: CheckResult) -> CheckResult:
    """The same with Python's own types, since the record is JSON."""
    for name in ("holds", "vacuous"):
        value = getattr(result, name)
        if not _is_truth_value(value):
            raise TypeError(f"its `{name}` is {value!r}, not a truth value")
    margin = None if result.margin is None else _number(result.margin)
    if result.holds and margin is not None and margin < 0:
        raise ValueError(f"it holds, and its margin is negative ({margin:g})")
    return CheckResult(
        bool(result.holds),
        margin,
        None if result.time is None else _number(result.time, "time"),
        str(result.detail),
        bool(result.vacuous),
    )


def _is_truth_value(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_))


def _number(value: Any, name: str = "margin") -> float:
    number = float(value)
    if math.isnan(number) or (name == "time" and math.isinf(number)):
        raise ValueError(f"its {name} is not a number ({number})".replace("nan", "NaN"))
    return number


LATER = ("percept.", "proposal.", "loop.")
"""Prefixes of signals that exist only once the episode is complete."""
FIRST_LOOK = 20
"""Ticks before the signals are first evaluated, and least distance of two evaluations."""
GROWTH = 3
"""An episode is evaluated again once it has grown by this part of its length, so that all
evaluations together cost a constant number of evaluations of the whole."""


class RequirementJudge:
    """Ends an episode once every requirement is decided.

    A requirement that ranges over the episode and holds so far is not decided, and one on a
    signal of the percept, of the proposals or of the loop, on one that is known with hindsight, on
    pairs of episodes, by a function or without a check never is before the end: each of these
    keeps the episode going.

    Raises:
        ConfigurationError: If a check cannot be read.
    """

    def __init__(self, requirements: Sequence[Requirement]) -> None:
        checks = [
            requirement.check
            for requirement in requirements
            if requirement.check
            and not requirement.paired
            and not is_function_path(requirement.check)
        ]
        self._formulas = [parse(check) for check in checks]
        self._signals = {name for formula in self._formulas for name in formula.signals}
        self._open = len(checks) < len(requirements) or any(
            name.startswith(LATER) for name in self._signals
        )
        self._looks: _Looks | None = None

    def __call__(self, simulator: Simulator, ticks: list[Tick]) -> bool:
        """Whether it may end at a violation; see ``EarlyEndJudge``."""
        if self._stays_open(simulator):
            return False
        signals = simulator.signals(ticks)
        time = [tick.time for tick in ticks]
        evaluations = [
            evaluate(formula, time, signals, ending="open") for formula in self._formulas
        ]
        statuses = {evaluation.status for evaluation in evaluations}
        return "violated" in statuses and "undecided" not in statuses

    def decided(self, simulator: Simulator, ticks: list[Tick], *, violated: bool) -> bool:
        """Whether it may end as it is; see ``EarlyEndJudge.decided``.

        The signals are evaluated where a window of a formula ends, and otherwise ever more rarely
        as the episode goes on. A formula that cannot be judged leaves the episode open: the
        verdict on the requirement reports the error.
        """
        if self._stays_open(simulator):
            return False
        if self._looks is None or len(ticks) == 1:
            self._looks = _Looks(self._formulas, simulator.time_step)
        return self._looks.decided(simulator, ticks, violated=violated)

    def _stays_open(self, simulator: Simulator) -> bool:
        return self._open or not self._formulas or bool(self._signals & simulator.hindsight)


class _Looks:
    """State of the formulas in one episode, evaluated now and then.

    Args:
        formulas: Of all requirements.
        time_step: Seconds per tick.
    """

    def __init__(self, formulas: Sequence[Formula], time_step: float) -> None:
        self._time_step = time_step
        self._left = [(formula, reach(formula.root, time_step)) for formula in formulas]
        self._names = {name for formula in formulas for name in formula.signals}
        self._ends = {end for _, end in self._left if end is not None}
        self._satisfied = False
        self._next = FIRST_LOOK
        self._before: Mapping[str, Array] = {}
        self._misjudged = False

    def decided(self, simulator: Simulator, ticks: list[Tick], *, violated: bool) -> bool:
        index = len(ticks) - 1
        due = index >= self._next or index in self._ends
        if self._misjudged or not due or (violated and self._satisfied):
            return False
        self._next = index + max(FIRST_LOOK, index // GROWTH)
        first = not self._before
        try:
            self._look(simulator, ticks)
            if first and not self._left and len(ticks) > 1:
                # Decided at the only evaluation: a second one, on a prefix, shows what it rests on.
                self._misjudged |= not self._as_before(simulator.signals(ticks[: len(ticks) // 2]))
        except ConfigurationError:
            self._misjudged = True
        return not (self._left or self._misjudged or (violated and self._satisfied))

    def _look(self, simulator: Simulator, ticks: list[Tick]) -> None:
        """Judge formula by formula, up to the first that is still undecided."""
        signals = simulator.signals(ticks)
        time = np.array([tick.time for tick in ticks])
        self._misjudged = not self._as_before(signals)
        while self._left and not self._misjudged:
            formula, end = self._left[0]
            evaluation = evaluate(formula, time, signals, ending="open", time_step=self._time_step)
            within = end is not None and end < len(ticks)
            # A condition that never held may hold yet, and the pass would be no vacuous one.
            if evaluation.status == "undecided" or (evaluation.vacuous and not within):
                return
            self._satisfied = self._satisfied or evaluation.status == "satisfied"
            del self._left[0]

    def _as_before(self, signals: Mapping[str, Array]) -> bool:
        """Whether no sample has changed since the last evaluation, as in signals with hindsight."""
        known = {name: np.asarray(signals[name]) for name in self._names if name in signals}
        before, self._before = self._before, known
        return all(
            np.array_equal(column[: len(before[name])], before[name][: len(column)])
            for name, column in known.items()
            if name in before
        )
