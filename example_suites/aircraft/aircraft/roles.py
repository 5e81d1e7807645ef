"""The autopilot under test, the monitor of its flight envelope, and the envelope protection."""

from __future__ import annotations

from aircraft.flight import Attitude, Controls
from pytest_dura import (
    Assessed,
    Assessment,
    Generator,
    GeneratorView,
    Proposal,
    Recovery,
    RecoveryPlanner,
    RoleView,
    SafetyMonitor,
)

ALPHA_LIMIT = 12.0  # deg; four below the stall
SINK_LIMIT = 1000.0  # ft/min
HEIGHT_LIMIT = 800.0  # ft above the ground, of which 300 are for the pull-up
CLIMB_ALPHA, CRUISE_ALPHA = 6.0, 1.9  # deg; of a climb at 65 kt, and what it is trimmed for


def clip(value: float, limit: float) -> float:
    """Limit a number on both sides."""
    return max(-limit, min(limit, value))


def elevator_to(pitch: float, now: Attitude) -> float:
    """Elevator that brings the nose to this pitch in deg."""
    return clip(-0.06 * (pitch - now.pitch) + 0.03 * now.pitch_rate, 1.0)


def aileron_to(bank: float, now: Attitude) -> float:
    """Aileron that brings the wings to this bank in deg."""
    return clip(0.02 * (bank - now.bank) - 0.01 * now.roll_rate, 1.0)


class Autopilot(Generator):
    """Holds altitude by pitch, airspeed by throttle and the course by bank.

    Args:
        speed: Airspeed to hold in kt.
        climb: Greatest rate of climb and descent in ft/min.
    """

    def __init__(self, speed: float = 85.0, climb: float = 500.0) -> None:
        self.speed, self.climb = speed, climb
        self._pitch, self._trim, self._throttle, self._vertical = 0.0, 0.0, 0.7, 0.0
        self._altitude: float | None = None

    def propose(self, view: GeneratorView) -> Proposal:
        """Compute the controls, with what they are for."""
        percept, now = view.percept, view.percept["attitude"]
        altitude = percept["air"].altitude
        if self._altitude is None:
            self._altitude, self._pitch = altitude, now.pitch
        rate = 60.0 * (altitude - self._altitude) / view.dt
        self._vertical += 0.2 * (rate - self._vertical)
        self._altitude = altitude
        wanted = clip(5.0 * (percept["panel"].assigned - altitude), self.climb)
        off = wanted - self._vertical
        if view.past and view.past[-1].source != "proposal":
            self._pitch, self._trim = now.pitch, 0.0  # it takes over from the protection
        self._pitch = clip(self._pitch + 0.0015 * off * view.dt, 12.0)
        pitch = clip(self._pitch + 0.004 * off, 12.0)
        self._trim = clip(self._trim - 0.03 * (pitch - now.pitch) * view.dt, 0.8)
        slow = self.speed - percept["air"].speed
        self._throttle = min(1.0, max(0.0, self._throttle + 0.01 * slow * view.dt))
        track = clip(-0.03 * percept["gps"].east, 30.0)
        bank = clip(1.2 * (track - percept["gps"].track), 20.0)
        elevator = clip(elevator_to(pitch, now) + self._trim, 1.0)
        throttle = min(1.0, max(0.0, self._throttle + 0.05 * slow))
        controls = Controls(elevator, aileron_to(bank, now), throttle)
        return Proposal(controls, f"{wanted:+.0f} ft/min, {slow:+.0f} kt, track {track:+.0f} deg")


class EnvelopeMonitor(SafetyMonitor):
    """Watches angle of attack, sink and ground; the score is the least margin, 1 being ample.

    It reads a vane, GPS and a radio altimeter: nothing that altitude and airspeed hold rest on.
    """

    def __init__(self) -> None:
        self._outside = False

    def run(self, view: RoleView) -> Assessment:
        """Look a second ahead in angle of attack, and eight in height; ask for some margin back."""
        now, before = view.percept, view.percepts[max(len(view.percepts) - 11, 0)]
        seconds = view.dt * min(len(view.percepts) - 1, 10) or 1.0
        alpha, height = now["air"].alpha, now["panel"].height
        rising = (alpha - before["air"].alpha) / seconds
        soon = height - 8.0 * max((before["panel"].height - height) / seconds, 0.0)
        sink = 60.0 * (before["gps"].altitude - now["gps"].altitude) / seconds
        margins = {
            f"angle of attack {alpha:.1f} deg": 1.0 - (alpha + max(rising, 0.0)) / ALPHA_LIMIT,
            f"sink {sink:.0f} ft/min": 1.0 - sink / SINK_LIMIT,
            f"{height:.0f} ft above ground": soon / HEIGHT_LIMIT - 1.0,
        }
        enough = 0.25 if self._outside else 0.0
        reasons = tuple(reason for reason, margin in margins.items() if margin < enough)
        self._outside = bool(reasons)
        verdict = Assessed.UNSAFE if reasons else Assessed.SAFE
        return Assessment(verdict, min(margins.values()), reasons)


class EnvelopeProtection(RecoveryPlanner):
    """Full power, wings level, and the angle of attack of a good climb, which takes no airspeed."""

    def run(self, view: RoleView) -> Recovery:
        """Pull as far as this angle of attack needs, and no higher than a pitch."""
        now, alpha = view.percept["attitude"], view.percept["air"].alpha
        pull = -0.065 * (CLIMB_ALPHA - CRUISE_ALPHA) - 0.03 * (CLIMB_ALPHA - alpha)
        elevator = max(pull + 0.03 * now.pitch_rate, elevator_to(10.0, now))
        controls = Controls(clip(elevator, 1.0), aileron_to(0.0, now), 1.0)
        return Recovery(controls, "protect the envelope", "; ".join(view.reasons))
