"""What ``--dura-executor=auto`` chooses: processes of this machine, or pytest's own."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pytest_dura.evidence.text import counted
from pytest_dura.plugin.items.scenario_items import ScenarioItem

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pytest

    from pytest_dura.plugin.context import Planned, SessionContext

MIN_EPISODES = 40
"""Planned episodes from which on processes pay that are started anew: one takes about as long to
start as eight episodes of ten seconds in traffic take."""
_EPISODES_PER_PROCESS = 20
_MOST_PROCESSES = 8
"""pytest's own process judges about so many episodes in the time in which each simulates one."""


def choose_for_items(context: SessionContext, items: Sequence[pytest.Item]) -> AutomaticChoice:
    """Choose who simulates once all is collected.

    Args:
        context: The session's context.
        items: Those that will ask for episodes.
    """
    scenario_items = [item for item in items if isinstance(item, ScenarioItem)]
    cases = {item.planned.case.id: item.planned for item in scenario_items}
    return choose_executor(context, list(cases.values()), others=len(scenario_items) < len(items))


@dataclass(frozen=True)
class AutomaticChoice:
    """Who simulates a session that names no executor.

    Args:
        processes: How many processes; ``None`` for pytest's own.
        reason: Why.
        is_notable: Whether a user who waits for the session wants to know.
    """

    processes: int | None
    reason: str
    is_notable: bool = True


def choose_executor(
    context: SessionContext, plan: Sequence[Planned], *, others: bool = False
) -> AutomaticChoice:
    """Choose who simulates.

    Args:
        context: The session's context.
        plan: The cases that scenario items look at.
        others: Whether other items ask for episodes, too.
    """
    from pytest_dura.execution.child import FORKS
    from pytest_dura.execution.processes import usable_cores

    is_shared = context.is_worker or getattr(context.config.option, "numprocesses", None)
    if is_shared and not (context.is_worker and FORKS):
        return AutomaticChoice(None, "auto: pytest-xdist's workers simulate", is_notable=False)
    cores = 1 if is_shared else usable_cores()
    obstacle = _obstacle(context, others=others and not FORKS)
    if obstacle is not None:
        return AutomaticChoice(None, f"auto: {obstacle}")
    if FORKS:
        size = "auto: a worker of pytest-xdist" if is_shared else f"auto: {counted(cores, 'core')}"
        return AutomaticChoice(min(cores, _MOST_PROCESSES), size, is_notable=False)
    runs = context.options.runs
    episodes = sum(runs or planned.case.scenario.planned for planned in plan)
    size = f"auto: {counted(episodes, 'episode')} on {counted(cores, 'core')}"
    if episodes < MIN_EPISODES or cores < 2:
        less = f"{size}, processes pay from {MIN_EPISODES} episodes on, with more than one core"
        return AutomaticChoice(None, less, is_notable=False)
    return AutomaticChoice(min(cores, _MOST_PROCESSES, episodes // _EPISODES_PER_PROCESS), size)


def _obstacle(context: SessionContext, *, others: bool) -> str | None:
    """Return what of the session keeps its episodes in pytest's own process."""
    config = context.config
    option = config.option
    obstacles = {
        "--pdb or --trace is on": option.usepdb or getattr(option, "trace", False),
        "a debugger or profiler is on": _is_traced(),
        context.guests.owner(): True,
        "test functions ask for episodes, and may change what is simulated": others,
    }
    return next((name for name, is_there in obstacles.items() if name and is_there), None)


def _is_traced() -> bool:
    """Whether something looks at what this process executes, and would miss what others do.

    A measurement of coverage does not: it goes with each episode.
    """
    coverage = sys.modules.get("coverage")
    if coverage is not None and coverage.Coverage.current() is not None:
        return False
    if sys.gettrace() is not None or sys.getprofile() is not None:
        return True
    tools = getattr(sys, "monitoring", None)  # from Python 3.12 on
    return tools is not None and any(tools.get_tool(number) for number in range(6))
