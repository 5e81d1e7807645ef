"""The blocks HISTORY and FEEDBACK: what was decided before, and what was said of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pytest_dura.core.errors import ActionError
from pytest_dura.core.state import PastDecision
from pytest_dura.driving.maneuvers import Command, acceleration_for
from pytest_dura.llm.driving.readings import number, shown
from pytest_dura.llm.prompts.perceived import PerceivedText

EXPLANATION, REASON = 120, 160
"""Characters shown of an explanation, and of a reason."""
MOST_DECISIONS, MOST_REASONS = 5, 4
_LONG_AGO = 1e6


def history_facts(past: Sequence[PastDecision], now: float) -> dict[str, Any]:
    """Facts of the block HISTORY, oldest first.

    An explanation may repeat what a sign said, and is shown as a text of the scene.

    Args:
        past: The decisions to show; only the latest few are.
        now: Simulated seconds.
    """
    shown_ones = [
        {
            "ago": shown(number(now - one.time, -_LONG_AGO, _LONG_AGO)),
            "proposed": maneuver(one.proposed),
            "executed": maneuver(one.executed),
            "source": one.source if one.source in ("proposal", "recovery", "fallback") else None,
            "explanation": PerceivedText(one.explanation, EXPLANATION) if one.explanation else "",
        }
        for one in past[-MOST_DECISIONS:]
    ]
    return {"decisions": tuple(shown_ones)}


def feedback_facts(feedback: Sequence[str]) -> dict[str, Any]:
    """Facts of the block FEEDBACK: why the last proposal of this tick was refused."""
    reasons = tuple(PerceivedText(one, REASON) for one in feedback[:MOST_REASONS])
    return {"reasons": reasons, "more": max(len(feedback) - MOST_REASONS, 0)}


def last_command(
    last: PastDecision | None, speed: float | None, to_stop_line: float | None
) -> dict[str, Any]:
    """The maneuver carried out last, and the acceleration in m/s2 that it asks for now."""
    command = _command(last.executed) if last is not None else None
    if command is None:
        return {"last": None if last is not None else "none yet", "acceleration": None}
    asked = command.acceleration
    if speed is not None and to_stop_line is not None:
        asked = acceleration_for(command, speed, to_stop_line)
    return {"last": command.maneuver.value, "acceleration": shown(asked)}


def maneuver(action: object) -> str | None:
    """The name of an action's maneuver; ``None`` if there is none."""
    command = _command(action)
    return None if command is None else command.maneuver.value


def _command(action: object) -> Command | None:
    if action is None:
        return None
    try:
        return Command.of(action)
    except (ActionError, TypeError):  # of another simulator, or a component's nonsense
        return None
