"""Calls into roles and simulator whose answers are checked before the loop goes on with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

from pytest_dura.core.errors import ActionError
from pytest_dura.core.outputs import check_output, check_texts, exact_texts, is_mapping
from pytest_dura.core.roles import (
    FaultInjector,
    Recovery,
    RecoveryPlanner,
    Role,
    SecurityAssessment,
)
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Percept, RoleView, Tick


def corrupted(injector: FaultInjector, tick: Tick) -> Percept:
    """What the sensors report after active faults.

    Raises:
        TypeError: For an answer that is none.
    """
    channels, tampered = injector.corrupt(tick.channels, tick.time)
    if not is_mapping(channels):
        raise TypeError(f"corrupt returned channels of type {type(channels).__name__}")
    exact = True
    for faults in tampered.values():
        exact &= check_texts("tampered faults", faults)
    if not exact:
        tampered = {channel: exact_texts(faults) for channel, faults in tampered.items()}
    return Percept(channels, tampered)


def corrupted_command(
    injector: FaultInjector, action: Any, time: float
) -> tuple[Any, tuple[str, ...]]:
    """The command after active faults, and the ids of those that changed it.

    Raises:
        TypeError: For an answer that is none.
    """
    command, tampered = injector.corrupt_command(action, time)
    if not check_texts("tampered faults", tampered):
        tampered = exact_texts(tampered)
    return command, tampered


def run_if_triggered(role: Role, view: RoleView, owed: type[Any]) -> tuple[Any, Any]:
    """The role's output, and the same of exact types; ``None`` where its trigger does not hold.

    Raises:
        TypeError: For an output of another type than it owes.
    """
    if not role.trigger(view):
        return None, None
    output = role.run(view)
    return output, check_output(output, owed)


def next_tick(simulator: Simulator, action: Any, index: int, time_step: float) -> Tick:
    """The simulator's next tick; raises as :func:`checked_tick` does."""
    return checked_tick(simulator.step(action), index, time_step)


def checked_tick(tick: Any, index: int, time_step: float) -> Tick:
    """The simulator's tick, which must be the one that is due: the loop counts on it to end.

    Raises:
        TypeError: For something else, or a part of another type than it should have.
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
    exact = type(tick.goal) is bool
    for event in tick.events:
        exact &= check_texts("event", event)
    if not is_mapping(tick.channels):
        raise TypeError(f"its channels are a {type(tick.channels).__name__}, not a mapping")
    if tick.critical is not None and type(tick.critical) is not str:
        check_texts("critical", (tick.critical,))
        exact = False
    return tick if exact else _exact_tick(tick)


def _exact_tick(tick: Tick) -> Tick:
    critical = None if tick.critical is None else str.__str__(tick.critical)
    events = tuple([cast("tuple[str, str, str]", exact_texts(event)) for event in tick.events])
    return replace(tick, goal=bool(tick.goal), critical=critical, events=events)


def acceptable(simulator: Simulator, action: Any) -> tuple[Any, str | None]:
    """The action as the simulator takes it, or what is wrong with it."""
    try:
        return simulator.check_action(action), None
    except ActionError as error:
        return None, f"no valid action: {error}"


def checked_recovery(planner: RecoveryPlanner, view: RoleView, simulator: Simulator) -> Recovery:
    """The recovery, with its action as the simulator takes it.

    Raises:
        ActionError: For an action that the simulator does not take.
        TypeError: For an answer that is none.
    """
    recovery = planner.run(view)
    check_output(recovery, Recovery)
    action = simulator.check_action(recovery.action)
    return Recovery(action, *exact_texts((recovery.name, recovery.explanation)))


def end_directives(outputs: dict[str, Any], name: str) -> None:
    """A directive holds for the tick in which it was given; the rest of an output stays."""
    latest = outputs.get(name)
    if isinstance(latest, SecurityAssessment) and latest.directives:
        outputs[name] = replace(latest, directives=())
