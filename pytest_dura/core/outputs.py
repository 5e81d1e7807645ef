"""Checks of what roles and simulator return to the loop, and calls of them with these checks."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, cast

from pytest_dura.core.errors import ActionError
from pytest_dura.core.percepts import NOTHING, Percept
from pytest_dura.core.roles import (
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
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Alert, RoleView, Tick

LONGEST = 1000
"""Characters of the description of an action."""

_REQUIRED_OUTPUTS: tuple[tuple[type[Role], type[Any]], ...] = (
    (SafetyMonitor, Assessment),
    (SecurityAssessor, SecurityAssessment),
    (FaultInjector, Injection),
    (PerformanceOracle, PerformanceAssessment),
    (RecoveryPlanner, Recovery),
)


def required_output(role: Role) -> type[Any]:
    """Type that ``role.run`` must return; ``object`` for a user's own role."""
    return next((output for base, output in _REQUIRED_OUTPUTS if isinstance(role, base)), object)


def check_output(output: Any, required: type[Any]) -> Any:
    """Check an output of a role.

    Returns:
        The output, or a copy of exact types where it is not made of them.

    Raises:
        TypeError: If it, or a part of it, is of the wrong type.
        ValueError: If a number in it is not a number (NaN).
    """
    if not isinstance(output, required):
        raise TypeError(f"returned {type(output).__name__}, not {_with_article(required.__name__)}")
    check = _CHECKS.get(type(output)) or _check_of_subclass(output)
    return output if check is None else check(output)


def _check_of_subclass(output: Any) -> Callable[[Any], Any] | None:
    return next((check for kind, check in _CHECKS.items() if isinstance(output, kind)), None)


def _performance(output: PerformanceAssessment) -> PerformanceAssessment:
    exact = type(output) is PerformanceAssessment
    exact &= _check_numbers("values", output.values)
    exact &= _check_numbers("wall_clock", output.wall_clock)
    exact &= check_texts("performance_fail", output.performance_fail)
    if exact:
        return output
    numbers = _exact_numbers(output.values), _exact_numbers(output.wall_clock)
    return PerformanceAssessment(*numbers, exact_texts(output.performance_fail))


def _injection(output: Injection) -> Injection:
    exact = check_texts("activated", output.activated)
    if check_texts("deactivated", output.deactivated) and exact:
        return output
    return Injection(exact_texts(output.activated), exact_texts(output.deactivated))


def _recovery(output: Recovery) -> Recovery:
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


_CHECKS: dict[type[Any], Callable[[Any], Any]] = {
    Assessment: _assessment,
    SecurityAssessment: _assessment,
    PerformanceAssessment: _performance,
    Injection: _injection,
    Recovery: _recovery,
}


def _check_security(output: SecurityAssessment) -> bool:
    exact = check_texts("directives", output.directives)
    if output.reaction is not None:
        exact &= check_texts("reaction", (output.reaction,))
    if not isinstance(output.alerts, (tuple, list)):
        raise TypeError(
            f"its alerts are {_with_article(type(output.alerts).__name__)}, not a tuple"
        )
    for alert in output.alerts:
        if not isinstance(alert, Alert):
            raise TypeError(
                f"one of its alerts is {_with_article(type(alert).__name__)}, not an Alert"
            )
        exact &= check_texts("alert", (alert.pattern, alert.subject, alert.detail))
        exact &= type(alert) is Alert
    return exact


def _check_number(name: str, value: Any) -> bool:
    """Whether a value is exactly a ``float``; raises for what is no number."""
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
    """Whether a value maps ``str`` to ``float`` exactly; raises for no mapping to numbers."""
    if not _is_mapping(values):
        raise TypeError(f"its {name} is {_with_article(type(values).__name__)}, not a mapping")
    exact = values is NOTHING or type(values) is dict
    for key, value in values.items():
        exact = exact and type(key) is str
        if type(value) is not float or value != value:  # noqa: PLR0124 - NaN is not itself
            exact = _check_number(f"{name}[{key!r}]", value) and exact
    return exact


def _exact_numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {str.__str__(key): float(value) for key, value in values.items()}


def _is_mapping(value: Any) -> bool:
    """``isinstance(value, Mapping)``, quick for a dict."""
    return type(value) is dict or isinstance(value, Mapping)


def check_texts(name: str, texts: Any) -> bool:
    """Check a tuple or list of ``str``.

    Returns:
        Whether it is a tuple of ``str`` exactly; see :func:`exact_texts`.

    Raises:
        TypeError: For anything else.
    """
    if type(texts) is tuple and not texts:  # the usual case
        return True
    # A single str is the usual slip: it would be read as a tuple of letters.
    if not isinstance(texts, (tuple, list)):
        raise TypeError(f"its {name} is {_with_article(type(texts).__name__)}, not a tuple of str")
    exact = type(texts) is tuple
    for text in texts:
        if type(text) is not str:
            if not isinstance(text, str):
                raise TypeError(
                    f"its {name} holds {_with_article(type(text).__name__)}, not only str"
                )
            exact = False
    return exact


def exact_texts(texts: Iterable[str]) -> tuple[str, ...]:
    """Convert texts to ``str`` from any subclass of it."""
    return tuple([str.__str__(text) for text in texts])


def shortened_with_hash(text: str) -> str:
    """Shorten a long text to its beginning, length and hash, so that different texts still differ.

    A column of texts takes the memory of its longest text at every tick.
    """
    if len(text) <= LONGEST:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    note = f"... ({len(text)} characters, #{digest})"
    return text[: LONGEST - len(note)] + note


def _with_article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"


def corrupted_percept(
    injector: FaultInjector, tick: Tick, aliases: Mapping[str, str] = NOTHING
) -> Percept:
    """Percept after active sensor faults.

    Args:
        injector: Changes the channels.
        tick: Has the channels before faults.
        aliases: Second names of channels.

    Raises:
        TypeError: If the injector returns something else.
    """
    channels, tampered = injector.corrupt(tick.channels, tick.time)
    if not _is_mapping(channels):
        raise TypeError(f"corrupt returned channels of type {type(channels).__name__}")
    exact = True
    for faults in tampered.values():
        exact &= check_texts("tampered faults", faults)
    if not exact:
        tampered = {channel: exact_texts(faults) for channel, faults in tampered.items()}
    return Percept(channels, tampered or NOTHING, aliases)


def corrupted_command(
    injector: FaultInjector, action: Any, time: float
) -> tuple[Any, tuple[str, ...]]:
    """Command after active faults, and the ids of the faults that changed it.

    Raises:
        TypeError: If the injector returns something else.
    """
    command, tampered = injector.corrupt_command(action, time)
    if not check_texts("tampered faults", tampered):
        tampered = exact_texts(tampered)
    return command, tampered


def run_if_triggered(role: Role, view: RoleView, required: type[Any]) -> tuple[Any, Any]:
    """Run a role: its output, and the same of exact types; ``None`` without its trigger.

    Raises:
        TypeError: For an output of another type than required.
    """
    if not role.trigger(view):
        return None, None
    output = role.run(view)
    return output, check_output(output, required)


def next_tick(simulator: Simulator, action: Any, index: int, time_step: float) -> Tick:
    """Step the simulator; raises as :func:`checked_tick` does."""
    return checked_tick(simulator.step(action), index, time_step)


def checked_tick(tick: Any, index: int, time_step: float) -> Tick:
    """Check that a tick is the one that is due, on which the loop relies to end.

    Raises:
        TypeError: If it, or a part of it, is of the wrong type.
        ValueError: For another tick than the one that is due.
    """
    if not isinstance(tick, Tick):
        raise TypeError(f"returned {type(tick).__name__}, not a Tick")
    due = index * time_step
    in_time = abs(tick.time - due) <= 0.01 * time_step  # False for NaN
    if tick.index != index or not in_time:
        raise ValueError(
            f"returned tick {tick.index} at {tick.time:g} s where tick {index} at {due:g} s was due"
        )
    exact = type(tick.goal) is type(tick.truncated) is bool
    for event in tick.events:
        exact &= check_texts("event", event)
    if not _is_mapping(tick.channels):
        raise TypeError(f"its channels are a {type(tick.channels).__name__}, not a mapping")
    if tick.critical is not None and type(tick.critical) is not str:
        check_texts("critical", (tick.critical,))
        exact = False
    return tick if exact else _exact_tick(tick)


def _exact_tick(tick: Tick) -> Tick:
    critical = None if tick.critical is None else str.__str__(tick.critical)
    events = tuple([cast("tuple[str, str, str]", exact_texts(event)) for event in tick.events])
    goal, truncated = bool(tick.goal), bool(tick.truncated)
    return replace(tick, goal=goal, critical=critical, events=events, truncated=truncated)


def accepted_action(simulator: Simulator, action: Any) -> tuple[Any, str | None]:
    """Action as the simulator takes it, or ``None`` and what is wrong with it."""
    try:
        return simulator.check_action(action), None
    except ActionError as error:
        return None, f"no valid action: {error}"


def checked_recovery(planner: RecoveryPlanner, view: RoleView, simulator: Simulator) -> Recovery:
    """Run recovery; its action is as the simulator takes it.

    Raises:
        ActionError: For an action that the simulator does not take.
        TypeError: If the planner returns no recovery.
    """
    recovery = planner.run(view)
    check_output(recovery, Recovery)
    action = simulator.check_action(recovery.action)
    return Recovery(action, *exact_texts((recovery.name, recovery.explanation)))


def end_directives(outputs: dict[str, Any], name: str) -> None:
    """Remove the directives of a role's latest output, which hold for their own tick only."""
    latest = outputs.get(name)
    if isinstance(latest, SecurityAssessment) and latest.directives:
        outputs[name] = replace(latest, directives=())
