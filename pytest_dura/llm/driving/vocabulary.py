"""The words of an answer, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.driving.maneuvers import MAX_BRAKING, Maneuver
from pytest_dura.llm.answers import IDS, OBSERVATIONS, REASONING, answer_schema

INTENTS: tuple[str, ...] = ("slow_down", "hold", "speed_up")

MANEUVERS: Mapping[str, str] = {
    Maneuver.WAIT.value: "stop at the stop line and stand there; past it, brake",
    Maneuver.YIELD.value: "approach the stop line slowly, ready to stop at it; past it, brake",
    Maneuver.PROCEED_CAUTIOUSLY.value: "drive on at up to 5 m/s",
    Maneuver.PROCEED.value: "drive on at up to 9 m/s",
    Maneuver.ACCELERATE.value: "drive on at up to 10 m/s, briskly",
    Maneuver.EMERGENCY_BRAKE.value: f"brake at {MAX_BRAKING:g} m/s2 at once",
}
"""What ``driving.maneuvers`` makes of each."""

SCHEMA: Mapping[str, Any] = answer_schema(tuple(MANEUVERS), INTENTS)

VOCABULARY: Mapping[str, Any] = {
    "maneuvers": MANEUVERS,
    "intents": INTENTS,
    "most_ids": IDS,
    "observations": OBSERVATIONS,
    "reasoning": REASONING,
}
"""What the template of the system message may use."""
