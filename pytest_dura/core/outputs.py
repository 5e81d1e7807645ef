"""Which output each kind of role owes the loop, and what makes an output unusable."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from typing import Any

from pytest_dura.core.roles import (
    Alert,
    Assessed,
    Assessment,
    FaultInjector,
    Injection,
    PerformanceAssessment,
    PerformanceOracle,
    Recovery,
    RecoveryPlanner,
    Role,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.core.state import NOTHING

LONGEST = 1000
"""Characters of the description of an action."""

_OWED: tuple[tuple[type[Role], type[Any]], ...] = (
    (SafetyMonitor, Assessment),
    (SecurityAssessor, SecurityAssessment),
    (FaultInjector, Injection),
    (PerformanceOracle, PerformanceAssessment),
    (RecoveryPlanner, Recovery),
)


def owed_output(role: Role) -> type[Any]:
    """The type that ``role.run`` must return; ``object`` for a user's own role."""
    return next((output for base, output in _OWED if isinstance(role, base)), object)


def check_output(output: Any, owed: type[Any]) -> Any:
    """Accept an output that the loop can work with.

    Returns:
        What the loop works with: the output, or a copy of exact types where it is not made of them.

    Raises:
        TypeError: If it, or a part of it, is of the wrong type.
        ValueError: If a number in it is not a number (NaN).
    """
    if not isinstance(output, owed):
        raise TypeError(f"returned {type(output).__name__}, not {_a(owed.__name__)}")
    if isinstance(output, Assessment):
        return _assessment(output)
    if isinstance(output, PerformanceAssessment):
        exact = type(output) is PerformanceAssessment
        exact &= _check_numbers("values", output.values)
        exact &= _check_numbers("wall_clock", output.wall_clock)
        exact &= check_texts("performance_fail", output.performance_fail)
        if exact:
            return output
        numbers = _exact_numbers(output.values), _exact_numbers(output.wall_clock)
        return PerformanceAssessment(*numbers, exact_texts(output.performance_fail))
    if isinstance(output, Injection):
        exact = check_texts("activated", output.activated)
        if check_texts("deactivated", output.deactivated) and exact:
            return output
        return Injection(exact_texts(output.activated), exact_texts(output.deactivated))
    if isinstance(output, Recovery):
        check_texts("name and explanation", (output.name, output.explanation))
    return output


def _assessment(output: Assessment) -> Assessment:
    if type(output.verdict) is not Assessed:
        raise TypeError(f"its verdict is {output.verdict!r}, not one of SAFE, WARNING, UNSAFE")
    kind = type(output)
    exact = kind is Assessment or kind is SecurityAssessment
    exact &= _check_number("score", output.score) and type(output.critical) is bool
    exact &= check_texts("reasons", output.reasons)
    security = output if isinstance(output, SecurityAssessment) else None
    if security is not None:
        exact &= _check_security(security)
    if exact:
        return output
    parts = output.verdict, float(output.score), exact_texts(output.reasons), bool(output.critical)
    if security is None:
        return Assessment(*parts)
    alerts = [Alert(*exact_texts((x.pattern, x.subject, x.detail))) for x in security.alerts]
    reaction = None if security.reaction is None else str.__str__(security.reaction)
    return SecurityAssessment(*parts, tuple(alerts), exact_texts(security.directives), reaction)


def _check_security(output: SecurityAssessment) -> bool:
    exact = check_texts("directives", output.directives)
    if output.reaction is not None:
        exact &= check_texts("reaction", (output.reaction,))
    if not isinstance(output.alerts, (tuple, list)):
        raise TypeError(f"its alerts are {_a(type(output.alerts).__name__)}, not a tuple")
    for alert in output.alerts:
        if not isinstance(alert, Alert):
            raise TypeError(f"one of its alerts is {_a(type(alert).__name__)}, not an Alert")
        exact &= check_texts("alert", (alert.pattern, alert.subject, alert.detail))
        exact &= type(alert) is Alert
    return exact


def _check_number(name: str, value: Any) -> bool:
    """Whether it is a ``float``; raises for what is no number."""
    if type(value) is float and value == value:  # noqa: PLR0124 - the usual case, and no NaN
        return True
    try:
        missing = math.isnan(value)
    except TypeError:
        raise TypeError(f"its {name} is {value!r}, which is not a number") from None
    if missing:
        raise ValueError(f"its {name} is not a number (NaN)")
    return False


def _check_numbers(name: str, values: Any) -> bool:
    """Whether it maps ``str`` to ``float``; raises for what is no mapping to numbers."""
    if not is_mapping(values):
        raise TypeError(f"its {name} is {_a(type(values).__name__)}, not a mapping")
    exact = values is NOTHING or type(values) is dict
    for key, value in values.items():
        exact = exact and type(key) is str
        if type(value) is not float or value != value:  # noqa: PLR0124 - NaN is not itself
            exact = _check_number(f"{name}[{key!r}]", value) and exact
    return exact


def _exact_numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {str.__str__(key): float(value) for key, value in values.items()}


def is_mapping(value: Any) -> bool:
    """Whether it is a Mapping; of a dict, without the cost of asking an abstract class."""
    return type(value) is dict or isinstance(value, Mapping)


def check_texts(name: str, texts: Any) -> bool:
    """Accept a tuple or list of ``str``.

    Returns:
        Whether it is a tuple of ``str`` exactly; see :func:`exact_texts`.

    Raises:
        TypeError: For anything else.
    """
    if type(texts) is tuple and not texts:  # the usual case
        return True
    # A single str is the usual slip: it would be read as a tuple of letters.
    if not isinstance(texts, (tuple, list)):
        raise TypeError(f"its {name} is {_a(type(texts).__name__)}, not a tuple of str")
    exact = type(texts) is tuple
    for text in texts:
        if type(text) is not str:
            if not isinstance(text, str):
                raise TypeError(f"its {name} holds {_a(type(text).__name__)}, not only str")
            exact = False
    return exact


def exact_texts(texts: Iterable[str]) -> tuple[str, ...]:
    """Texts as ``str``, whatever subclass they are of."""
    return tuple([str.__str__(text) for text in texts])


def bounded(text: str) -> str:
    """The text, or how it begins, how long it is and a hash of it: two that differ still do.

    A column of texts needs room for its longest one at every tick.
    """
    if len(text) <= LONGEST:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    note = f"... ({len(text)} characters, #{digest})"
    return text[: LONGEST - len(note)] + note


def _a(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"
