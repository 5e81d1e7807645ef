"""What the domain declares to files, faults, searches and reports."""

from __future__ import annotations

from typing import Any

from pytest_dura import Action, Channel, Domain, Signal
from weeder.field import END, SIGHT, TOP_SPEED, TOP_TURN, WARM, World


def sensor(meaning: str, **fields: tuple[str, Any, Any]) -> Channel:
    """Return a channel of numbers, each with its unit, range and typical error."""
    units, ranges, errors = zip(*fields.values(), strict=True)
    return Channel("numbers", tuple(fields), 0, units, "", meaning, ranges, errors)


WEEDER = Domain(
    name="weeder",
    roles={"generator": "sighted", "safety_monitor": "cross_check",
           "recovery_planner": "lift_and_stop"},
    provokers=("by_map",),
    world=World,
    signals=(
        Signal("crops_lost", "1", "cabbages that were hoed or run over so far", 0.0),
        Signal("weeds_cut", "1", "weeds that were hoed so far", 0.0),
        Signal("weeds_missed", "1", "weeds that it went by so far", 0.0),
        Signal("animal_gap", "m", "between robot and animal; 0 on contact", 0.0, 2 * WARM),
        Signal("offset", "m", "of the robot to the right of its row"),
        Signal("speed", "m/s", "over ground"),
        Signal("x", "m", "along the row"),
    ),
    percept_signals=(
        Signal("offset", "m", "by camera"),
        Signal("gnss_offset", "m", "by satellites and the map of the rows"),
    ),
    proposal_signals=(),
    actions=(
        Action("speed", "m/s", "ahead", 0.0, TOP_SPEED),
        Action("turn", "rad/s", "clockwise", -TOP_TURN, TOP_TURN),
        Action("hoe", "1", "0 up, 1 down", 0.0, 1.0),
    ),
    channels={
        "camera": sensor("row and next plant, seen from the hoe",
                         offset=("m", (-0.5, 0.5), 0.01), heading=("rad", (-1.0, 1.0), 0.01),
                         distance=("m", SIGHT, 0.02), crop=("1", (0.0, 1.0), None)),
        "gnss": sensor("place in the field", x=("m", (0.0, END), 0.02), y=("m", (-2, 2), 0.02)),
        "thermal": sensor("nearest warm body, all round", range=("m", (0.0, WARM), 0.1),
                          bearing=("rad", (-3.2, 3.2), 0.05)),
        "odometry": sensor("as the wheels turn", speed=("m/s", (0.0, 0.5), 0.01)),
    },
    fault_targets={"number": "gnss.y", "any": "camera", "command": "command.turn"},
)  # fmt: skip
