"""The maneuvers that a component may propose, and the acceleration that each one asks for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from numbers import Real

from pytest_dura.core.errors import ActionError, shorten


class Maneuver(str, Enum):
    """High-level driving decisions along the planned route."""

    WAIT = "wait"
    YIELD = "yield"
    PROCEED_CAUTIOUSLY = "proceed_cautiously"
    PROCEED = "proceed"
    ACCELERATE = "accelerate"
    EMERGENCY_BRAKE = "emergency_brake"

    __str__ = str.__str__


MAX_BRAKING = 8.0
"""m/s2; what a dry road gives a passenger car with ABS, rounded down."""
MAX_ACCELERATION = 4.0
"""m/s2; a brisk passenger car."""
COMFORT_BRAKING = 3.0
"""m/s2; braking that does not alarm passengers."""

_TARGETS = {  # target speed in m/s, greatest acceleration in m/s2
    Maneuver.PROCEED_CAUTIOUSLY: (5.0, 1.5),
    Maneuver.PROCEED: (9.0, 2.0),
    Maneuver.ACCELERATE: (10.0, 3.5),
}
_CREEPING = 4.0
"""m/s; who gives way rolls up to the line no faster."""
TOP_SPEED = max(speed for speed, _ in _TARGETS.values())
"""m/s; no maneuver aims at more."""
_GAIN = 1.0
"""1/s; how fast a speed error is taken out."""


@dataclass(frozen=True, slots=True)
class Command:
    """A maneuver, and the acceleration in m/s2 that carries it out.

    ``None`` leaves the acceleration to the maneuver.
    """

    maneuver: Maneuver
    acceleration: float | None = None

    @classmethod
    def of(cls, action: object) -> Command:
        """Make a command of a Command, a maneuver, its name, or plain data.

        Plain data is ``{"maneuver": ..., "acceleration": ...}``, the acceleration in m/s2.

        Raises:
            ActionError: For anything else, and for an acceleration that is not a finite number.
        """
        if type(action) is not Command and isinstance(action, Mapping):
            if not set(action) <= {"maneuver", "acceleration"} or "maneuver" not in action:
                text = ", ".join(sorted(map(_name, action))) or "nothing"
                raise ActionError(f"a command has maneuver and acceleration, not {text}")
            action = cls(action["maneuver"], action.get("acceleration"))
        maneuver, acceleration = action, None
        if isinstance(action, Command):
            maneuver, acceleration = action.maneuver, action.acceleration
        try:
            maneuver = Maneuver(maneuver)
        except ValueError:
            known = ", ".join(Maneuver)
            raise ActionError(f"{_name(maneuver)} is not a maneuver; there are: {known}") from None
        if acceleration is None:
            return cls(maneuver)
        is_float = type(acceleration) is float
        if not is_float and (isinstance(acceleration, bool) or not isinstance(acceleration, Real)):
            raise ActionError(f"an acceleration is a number of m/s2, not {_name(acceleration)}")
        try:
            number = float(acceleration)
        except OverflowError:  # an int of hundreds of digits
            number = math.inf
        if not math.isfinite(number):
            raise ActionError(
                f"the acceleration is {shorten(acceleration)}, not a finite number of m/s2"
            )
        return cls(maneuver, number)

    def __str__(self) -> str:
        return self.maneuver.value


def _name(value: object) -> str:
    """A value in a message: other than plain data by its type, since a repr may hold an address."""
    plain = value is None or isinstance(value, (str, bool, int, float))
    return shorten(value) if plain else f"an object of type {type(value).__name__}"


def braking_distance(speed: float, deceleration: float) -> float:
    """Metres to a standstill at constant deceleration."""
    return speed * speed / (2.0 * deceleration)


def stop_at(distance: float, speed: float) -> float:
    """Acceleration that brings a vehicle to a standstill after ``distance`` metres, in m/s2.

    Rolls up gently while the distance is long, and holds once there.
    """
    if distance <= 0.3:
        return -COMFORT_BRAKING if distance > -1.0 else -2.0 * COMFORT_BRAKING
    needed = speed * speed / (2.0 * distance)
    if needed > 0.7 * COMFORT_BRAKING:
        return -min(needed * 1.05, MAX_BRAKING)
    cruise = min(_TARGETS[Maneuver.PROCEED][0], math.sqrt(1.4 * COMFORT_BRAKING * distance) * 0.85)
    return max(min(_GAIN * (cruise - speed), 2.0), -COMFORT_BRAKING)


def _track_speed(target: float, speed: float, limit: float) -> float:
    """Acceleration towards a target speed, at most ``limit``, braking comfortably."""
    return max(min(_GAIN * (target - speed), limit), -COMFORT_BRAKING)


def speeds_of(maneuver: Maneuver) -> tuple[float, float]:
    """The least and the greatest speed in m/s that a maneuver aims at.

    Who waits or brakes aims at a standstill, wherever that is; who gives way is ready for one.
    """
    if maneuver in _TARGETS:
        target, _ = _TARGETS[maneuver]
        return target, target
    return 0.0, _CREEPING if maneuver is Maneuver.YIELD else 0.0


def acceleration_for(
    command: Command, speed: float, to_stop_line: float, limit: float = math.inf
) -> float:
    """The acceleration in m/s2 that a command asks for, within the vehicle's envelope.

    Args:
        command: The command.
        speed: Of the ego in m/s.
        to_stop_line: Metres from the ego's front to the stop line; negative past it.
        limit: Speed limit of the road in m/s, above which no maneuver aims.
    """
    if command.acceleration is not None:
        return max(-MAX_BRAKING, min(MAX_ACCELERATION, command.acceleration))
    maneuver = command.maneuver
    if maneuver is Maneuver.EMERGENCY_BRAKE:
        return -MAX_BRAKING
    if maneuver in _TARGETS:
        target, most = _TARGETS[maneuver]
        return _track_speed(min(target, limit), speed, most)
    if to_stop_line < 0.0 or braking_distance(speed, MAX_BRAKING) > to_stop_line:
        return -COMFORT_BRAKING
    if maneuver is Maneuver.WAIT:
        return stop_at(to_stop_line - 0.5, speed)
    return min(stop_at(to_stop_line - 0.5, speed), _track_speed(_CREEPING, speed, 1.5))
