"""What the domain declares: signals and channels with units, ranges and typical errors."""

from __future__ import annotations

from typing import Any

from aircraft.flight import RADIO_RANGE, World
from pytest_dura import Action, Channel, Domain, Signal


def sensor(meaning: str, **fields: tuple[str, Any, Any]) -> Channel:
    """Return a channel of numbers, each with its unit, range and typical error."""
    units, ranges, errors = zip(*fields.values(), strict=True)
    return Channel("numbers", tuple(fields), 0, units, "", meaning, ranges, errors)


CIRCLE = (-180.0, 180.0)
PRESSURE = ("Pa", (30000.0, 110000.0), 25.0)
RATE = ("deg/s", (-100.0, 100.0), 0.1)
AIRCRAFT = Domain(
    name="aircraft",
    roles={"generator": "autopilot", "safety_monitor": "envelope",
           "recovery_planner": "envelope_protection"},
    world=World,
    signals=(
        Signal("altitude", "ft", "above mean sea level"),
        Signal("altitude_error", "ft", "above the assigned altitude"),
        Signal("height", "ft", "above the ground below"),
        Signal("airspeed", "kt", "calibrated"),
        Signal("vertical_speed", "ft/min", "upwards"),
        Signal("heading", "deg", "clockwise from the course"),
        Signal("bank", "deg", "right wing down"),
        Signal("cross_track", "NM", "to the right of the course"),
        Signal("alpha", "deg", "angle of attack"),
        Signal("stall_margin", "deg", "from the angle of attack up to that of the greatest lift"),
        Signal("stalled", "0 or 1", "the stall margin is used up"),
    ),
    percept_signals=(
        Signal("airspeed", "kt", "from the pressures at pitot tube and static port"),
        Signal("altitude", "ft", "from the pressure at the static port"),
    ),
    proposal_signals=(),
    actions=(
        Action("elevator", "1", "share of its travel, nose down", -1.0, 1.0),
        Action("aileron", "1", "share of its travel, to the right", -1.0, 1.0),
        Action("throttle", "1", "share of its travel", 0.0, 1.0),
    ),
    channels={
        "air": sensor("pressures at pitot tube and static port, and a vane in the air flow",
                      pitot=PRESSURE, static=PRESSURE, alpha=("deg", (-30.0, 40.0), 0.3)),
        "attitude": sensor("gyros", pitch=("deg", (-90.0, 90.0), 0.5),
                           bank=("deg", CIRCLE, 0.5),
                           heading=("deg", CIRCLE, 1.0), pitch_rate=RATE, roll_rate=RATE),
        "gps": sensor("from where the course begins", north=("m", None, 5.0), east=("m", None, 5.0),
                      altitude=("ft", None, 30.0), track=("deg", CIRCLE, 1.0)),
        "panel": sensor("radio altimeter and clearance", height=("ft", (0.0, RADIO_RANGE), 5.0),
                        assigned=("ft", None, None)),
    },
    fault_targets={"number": "air.pitot", "any": "air.pitot", "command": "command.elevator"},
)  # fmt: skip
