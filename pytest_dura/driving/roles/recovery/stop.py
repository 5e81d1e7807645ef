"""SafeStop: a stop before the conflict zone, as gentle as it can be, or out of the zone."""

from __future__ import annotations

import math

from pytest_dura.core.roles import Recovery, RecoveryPlanner, RoleContext
from pytest_dura.core.state import RoleView
from pytest_dura.driving.junction import SPEED_LIMIT
from pytest_dura.driving.maneuvers import (
    COMFORT_BRAKING,
    MAX_ACCELERATION,
    MAX_BRAKING,
    Command,
    Maneuver,
    braking_distance,
)
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.roles.recovery.outlook import observed
from pytest_dura.driving.scene import HALF, Scene, time_to_cover

BEFORE_LINE = 0.5
"""m; what it leaves to the stop line, where there is room for it."""
BEHIND_LEADER = 1.5
"""m; what it leaves to a leader who brakes as hard as it can. The discs that stand for two cars in
the prediction take 0.9 m of it."""
OVERRUN = 1.0
"""m; who can stop with its front no farther past the line than this does so: the crossing lanes
begin 7 m behind it."""
BUILD_UP = 0.1
"""s; half the time in which the brake builds up to its full force."""
STANDING = 0.1
"""m/s; slower is a standstill."""
_SPENT = 0.05
"""m; room below this is none."""


class SafeStop(RecoveryPlanner):
    """Stops before the conflict zone; inside it, leaves it where the way out is free.

    Before the stop line it brakes comfortably (``COMFORT_BRAKING``), and harder only as far as the
    line, a leader that may brake as hard as it can, or the predicted separation from anybody asks
    for. Who has entered the zone, or cannot stop before it any more, would stand in the way of
    others: it leaves as quickly as it can if nobody is predicted on its way until its rear is out,
    and brakes otherwise. The prediction lets others keep speed and yaw rate, as they are perceived.

    Args:
        separation: Predicted distance in m that counts as free.
        horizon: Seconds that are predicted; a way out that takes longer is not taken.
    """

    BRAKING = (4.0, 5.0, 6.0, 7.0, MAX_BRAKING)
    """Decelerations in m/s2 that are tried where what is needed at least does not suffice."""
    LEAVING = (MAX_ACCELERATION, 2.0, 1.0, 0.0)
    """Accelerations in m/s2 for leaving the zone, the quickest first."""

    def __init__(self, separation: float = 0.5, horizon: float = 5.0) -> None:
        self.separation, self.horizon = separation, horizon
        self._predictor = Predictor(horizon, 0.25)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()

    def run(self, view: RoleView) -> Recovery:
        """The gentlest stop that is safe, or the way out."""
        scene = observed(self._predictor, view)
        why = "; ".join(view.reasons)
        if not scene.cleared and not self._stops_in_time(scene):
            acceleration = self._way_out(scene, view.dt)
            if acceleration is not None:
                command = Command(Maneuver.ACCELERATE, acceleration)
                return Recovery(command, "clear_zone", f"the way out is free ({why})")
        braking = self._braking(scene, view.dt)
        hard = braking >= MAX_BRAKING
        command = Command(Maneuver.EMERGENCY_BRAKE if hard else Maneuver.WAIT, -braking)
        return Recovery(command, "safe_stop", f"brakes with {braking:.1f} m/s2 ({why})")

    @staticmethod
    def _stops_in_time(scene: Scene) -> bool:
        needed = braking_distance(scene.speed, MAX_BRAKING) + scene.speed * BUILD_UP
        return needed <= scene.to_stop_line + OVERRUN

    def _way_out(self, scene: Scene, dt: float) -> float | None:
        """The greatest acceleration in m/s2 with which it gets out unhindered, if there is one."""
        apart, _ = self._predictor.separations(scene, self.LEAVING, dt)
        for row, acceleration in enumerate(self.LEAVING):
            way = scene.exit + HALF - scene.s
            time = (
                time_to_cover(way, scene.speed, acceleration, SPEED_LIMIT)
                if (acceleration > 0.0)
                else way / max(scene.speed, 0.1)
            )
            if time > self.horizon:
                continue
            until_out = apart[row, self._predictor.times <= time + dt]
            if not until_out.size or until_out.min() >= self.separation:
                return min(acceleration, SPEED_LIMIT - scene.speed)
        return None

    def _braking(self, scene: Scene, dt: float) -> float:
        """The least deceleration in m/s2 that suffices, or else the one that helps most."""
        least = min(max(COMFORT_BRAKING, self._needed(scene)), MAX_BRAKING)
        tried = [least, *(one for one in self.BRAKING if one > least)]
        apart, near = self._predictor.separations(scene, [-one for one in tried], dt)
        if not near.ids:
            return least
        nearest = apart.min(axis=(1, 2)).tolist()
        for deceleration, separation in zip(tried, nearest, strict=True):
            if separation >= self.separation:
                return deceleration
        # Below 0 there is contact, of which there is no more or less, but a slower one is better.
        return max((max(one, 0.0), braking) for one, braking in zip(nearest, tried, strict=True))[1]

    def _needed(self, scene: Scene) -> float:
        """The deceleration in m/s2 that the stop line and the leader ask for."""
        rooms = []
        if not scene.cleared and self._stops_in_time(scene):
            to_line = scene.to_stop_line
            rooms.append(max(to_line - BEFORE_LINE, to_line / 2.0))
        leader = scene.leader()
        if leader is not None:
            stops_after = braking_distance(max(leader.speed, 0.0), MAX_BRAKING)
            rooms.append(leader.distance - BEHIND_LEADER + stops_after)
        if scene.speed < STANDING:
            return 0.0
        room = min(rooms, default=math.inf) - scene.speed * BUILD_UP
        return scene.speed**2 / (2.0 * room) if room > _SPENT else MAX_BRAKING
