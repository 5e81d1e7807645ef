"""Checks: what decides a requirement on one episode, a formula or a function of the user's own."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.requirements.stl.formula import Formula, ranging_or_refuse
from pytest_dura.requirements.stl.parser import parse

_PATH = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")

Check: TypeAlias = "str | Callable[..., Any]"
"""A formula, the import path of a function, or the function itself."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a check function may return instead of a truth value or a margin.

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


def is_function_path(check: str) -> bool:
    """Whether a check is an import path ``package.module:function``; no formula looks like one."""
    return _PATH.fullmatch(check.strip()) is not None


def check_name(check: Check) -> str:
    """The text under which a check stands in reports."""
    if isinstance(check, str):
        return check
    named = check if hasattr(check, "__qualname__") else type(check)
    return f"{named.__module__}:{named.__qualname__}"


def read_formula(text: str, signals: tuple[str, ...] | None = None) -> Formula:
    """The formula of a check; ``signals`` are the known names, where they are known.

    Raises:
        ConfigurationError: For anything that is no formula, and for one of which a part reads the
            beginning of an episode alone.
    """
    formula = parse(text, signals)
    ranging_or_refuse(formula)
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
    except ValueError:  # a builtin tells no signature
        pass
    return function


def check_result(value: Any) -> CheckResult:
    """What a check function returned, as a result: a bool, or a float as margin (0 satisfies).

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
    """The same with Python's own types, since the record is JSON; what is none of them is told."""
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
