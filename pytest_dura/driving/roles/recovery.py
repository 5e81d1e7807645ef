"""RecoveryPlanners for driving: what is done instead of a refused proposal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pytest_dura.core.percepts import NOTHING, Percept
from pytest_dura.core.roles import Assessed, Assessment, Recovery, RecoveryPlanner, RoleContext
from pytest_dura.core.state import Proposal, RoleView
from pytest_dura.driving.bodies import BodyList
from pytest_dura.driving.maneuvers import (
    COMFORT_BRAKING,
    MAX_ACCELERATION,
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
    braking_distance,
)
from pytest_dura.driving.percepts import plausible_objects, with_unexplained_returns
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.roles.safety import SeparationMonitor
from pytest_dura.driving.scene import HALF, Scene, time_to_cover

Perceived = Callable[[Percept], BodyList]
"""Selects the objects of a percept that count."""


def _lidar_objects(percept: Percept) -> BodyList:
    """All objects, just as lidar reports them."""
    bodies: BodyList = percept["lidar"]
    return bodies


def _observed_scene(predictor: Predictor, view: RoleView) -> Scene:
    """The scene of this tick; the predictor has seen the tick before as well.

    A planner is asked at some ticks only, and yaw rates need two in a row.
    """
    if view.index and len(view.percepts) > 1:
        predictor.observe(view.index - 1, plausible_objects(view.percepts[-2]))
    scene = Scene.of(view.percept)
    predictor.observe(view.index, scene.bodies)
    return scene


class SecondOpinion:
    """The SeparationMonitor's judgement of any action, on all objects or on those that count.

    Args:
        params: The monitor's parameters: those of the scenario's own monitor, if it has any.
    """

    def __init__(self, params: Mapping[str, float] | None = None) -> None:
        self._monitor = SeparationMonitor(**(params or NOTHING))

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._monitor.reset(context)

    def judge(
        self, view: RoleView, action: Command, seen: Perceived = _lidar_objects
    ) -> Assessment:
        """The monitor's assessment of an action at this tick."""
        if view.index and len(view.percepts) > 1:
            before = _percept(view.percepts[-2], seen)
            self._monitor.run(replace(view, index=view.index - 1, percept=before, proposal=None))
        now = _percept(view.percept, seen)
        return self._monitor.run(replace(view, percept=now, proposal=Proposal(action)))


def _percept(percept: Percept, seen: Perceived) -> Percept:
    """The channels that the monitor reads; the others, such as pictures, are not made for it."""
    channels: dict[str, Any] = {name: percept[name] for name in ("localisation", "odometry", "map")}
    return Percept({**channels, "lidar": seen(percept)}, aliases=percept.aliases)


class EmergencyBrake(RecoveryPlanner):
    """Brakes as hard as the car can, wherever it is.

    Inside the conflict zone that may get it struck by others: braking is no general benefit, and
    the paired runs of the benchmark say by how much.
    """

    def run(self, view: RoleView) -> Recovery:
        """Full braking."""
        reasons = "; ".join(view.reasons)
        return Recovery(Command(Maneuver.EMERGENCY_BRAKE), "emergency_brake", reasons)


class AlertOnly(RecoveryPlanner):
    """Lets the proposal stand. That it was called is recorded; it takes no action of its own.

    Where the component made no valid proposal, the car keeps its speed, as without any recovery.
    """

    def run(self, view: RoleView) -> Recovery:
        """The proposal itself."""
        action = Command(Maneuver.PROCEED, 0.0)
        if view.proposal is not None:
            action = view.proposal.action
        return Recovery(action, "alert", "; ".join(view.reasons))


_BEFORE_LINE = 0.5
"""m; what it leaves to the stop line, where there is room for it."""
_BEHIND_LEADER = 1.5
"""m; what it leaves to a leader who brakes as hard as it can. The discs that stand for two cars in
the prediction take 0.9 m of it."""
_OVERRUN = 1.0
"""m; who can stop with its front no farther past the line than this does so: the crossing lanes
begin 7 m behind it."""
_BUILD_UP = 0.1
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
    others: it leaves as quickly as it can if no object is predicted on its way until its rear is
    out, and brakes otherwise. The prediction lets others keep speed and yaw rate, as they are
    perceived.

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
        scene = _observed_scene(self._predictor, view)
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
        needed = braking_distance(scene.speed, MAX_BRAKING) + scene.speed * _BUILD_UP
        return needed <= scene.to_stop_line + _OVERRUN

    def _way_out(self, scene: Scene, dt: float) -> float | None:
        """The greatest acceleration in m/s2 with which it gets out unhindered, if there is one."""
        apart, _ = self._predictor.separations(scene, self.LEAVING, dt)
        for row, acceleration in enumerate(self.LEAVING):
            way = scene.exit + HALF - scene.s
            time = (
                time_to_cover(way, scene.speed, acceleration, scene.limit)
                if (acceleration > 0.0)
                else way / max(scene.speed, 0.1)
            )
            if time > self.horizon:
                continue
            until_out = apart[row, self._predictor.times <= time + dt]
            if not until_out.size or until_out.min() >= self.separation:
                return min(acceleration, scene.limit - scene.speed)
        return None

    def _braking(self, scene: Scene, dt: float) -> float:
        """The least deceleration in m/s2 that suffices, or else the one that helps most."""
        least = min(max(COMFORT_BRAKING, self._needed(scene)), MAX_BRAKING)
        tried = [least, *(deceleration for deceleration in self.BRAKING if deceleration > least)]
        apart, near = self._predictor.separations(
            scene, [-deceleration for deceleration in tried], dt
        )
        if not near.ids:
            return least
        nearest = apart.min(axis=(1, 2)).tolist()
        for deceleration, separation in zip(tried, nearest, strict=True):
            if separation >= self.separation:
                return deceleration
        # Below 0 there is contact, of which there is no more or less, but a slower one is better.
        # Of equal ones, the hardest braking.
        gaps = [max(separation, 0.0) for separation in nearest]
        return max(zip(gaps, tried, strict=True))[1]

    def _needed(self, scene: Scene) -> float:
        """The deceleration in m/s2 that the stop line and the leader ask for."""
        rooms = []
        if not scene.cleared and self._stops_in_time(scene):
            to_line = scene.to_stop_line
            rooms.append(max(to_line - _BEFORE_LINE, to_line / 2.0))
        leader = scene.leader()
        if leader is not None:
            stops_after = braking_distance(max(leader.speed, 0.0), MAX_BRAKING)
            rooms.append(leader.distance - _BEHIND_LEADER + stops_after)
        if scene.speed < STANDING:
            return 0.0
        room = min(rooms, default=math.inf) - scene.speed * _BUILD_UP
        return scene.speed**2 / (2.0 * room) if room > _SPENT else MAX_BRAKING


class Replan(RecoveryPlanner):
    """Rolls out each maneuver for a few seconds and takes the one that ends best.

    What the SeparationMonitor would refuse again comes last. Of the rest, the least predicted
    separation from anybody decides, in steps of 0.1 m and up to ``enough``; then the way made, or
    where contact is predicted whatever it does, the way not made. The ego follows its route and the
    maneuver's own law of speed; others keep the speed and yaw rate that two successive percepts
    show. They do not react, and who turns is seen to turn for ever, so that the end of a rollout
    says less than its beginning. It believes its percept: away from an object that is not there, it
    may well accelerate. Each call rolls out six maneuvers over ``horizon / STEP`` instants,
    whatever the traffic; the cost is in ``benchmarks/README.md``.

    Args:
        horizon: Seconds of a rollout.
        enough: Predicted separation in m beyond which more is not better.
        monitor: Parameters of the SeparationMonitor whose judgement it asks; give those of the
            scenario's own monitor, if it has any.
    """

    STEP = 0.25
    """Seconds between two instants of a rollout."""

    def __init__(
        self,
        horizon: float = 4.0,
        enough: float = 2.0,
        monitor: Mapping[str, float] | None = None,
    ) -> None:
        self.horizon, self.enough = horizon, enough
        self._predictor = Predictor(horizon, self.STEP)
        self._opinion = SecondOpinion(monitor)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()
        self._opinion.reset(context)

    def run(self, view: RoleView) -> Recovery:
        """The best maneuver."""
        scene = _observed_scene(self._predictor, view)
        driven = np.array([self._rollout(scene, Command(maneuver)) for maneuver in Maneuver])
        apart, _ = self._predictor.along(scene, driven, view.dt)
        least = apart.min(axis=(1, 2), initial=self.enough)
        scores = []
        for maneuver, gap, way in zip(
            Maneuver, least.tolist(), driven[:, -1].tolist(), strict=True
        ):
            refused = self._opinion.judge(view, Command(maneuver)).verdict is Assessed.UNSAFE
            kept = max(round(gap, 1), 0.0)  # of contact there is no more or less
            scores.append((not refused, kept, way if kept > 0.0 else -way))
        best = max(range(len(scores)), key=scores.__getitem__)  # the first of equal ones
        maneuver, (_, gap, way) = list(Maneuver)[best], scores[best]
        reasons = "; ".join(view.reasons)
        why = f"predicts a gap of {gap:.1f} m and {abs(way):.0f} m of way ({reasons})"
        return Recovery(Command(maneuver), "replan", f"{maneuver}: {why}")

    def _rollout(self, scene: Scene, command: Command) -> list[float]:
        """Metres driven at each instant."""
        speed, way, driven = scene.speed, 0.0, []
        for _ in self._predictor.times:
            acceleration = acceleration_for(command, speed, scene.to_stop_line - way, scene.limit)
            reached = max(speed + acceleration * self.STEP, 0.0)
            way += (speed + reached) / 2.0 * self.STEP
            speed = reached
            driven.append(way)
        return driven


class IgnoreUntrusted(RecoveryPlanner):
    """Lets the proposal stand if it is safe without the objects under suspicion; else brakes.

    An object is distrusted for a while after any SecurityAssessor has alerted to it. The
    SeparationMonitor's own predicate is asked again without it; what radar sees at a place where
    lidar then reports nothing counts as a car. If another role refused the proposal as well, or
    nothing is distrusted, it brakes as hard as it can.

    **It trusts the assessor, and that can be abused.** An attacker who makes a real car look
    implausible, to lidar and radar alike, has it driven into; so has a failing sensor that lets a
    real object vanish and appear again, or leap. Radar is the only safeguard, and it knows no
    course: a car that it sees is taken to keep the speed that its road lets expect. Ids are what
    is distrusted: a real object that takes over the id of a ghost is ignored with it.

    Args:
        memory: Seconds for which an alert counts.
        monitor: Parameters of the SeparationMonitor whose predicate is asked; give those of the
            scenario's own monitor, if it has any.
    """

    def __init__(self, memory: float = 5.0, monitor: Mapping[str, float] | None = None) -> None:
        self.memory = memory
        self._opinion = SecondOpinion(monitor)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._opinion.reset(context)

    def run(self, view: RoleView) -> Recovery:
        """The proposal, or full braking."""
        distrusted = {
            alert.subject for time, alert in view.alerts if view.time - time <= self.memory
        }
        present = [name for name in _lidar_objects(view.percept).ids if name in distrusted]
        why = "; ".join(view.reasons)
        if present and view.proposal is not None and not _others_refuse(view):

            def trusted(percept: Percept) -> BodyList:
                return _without(percept, distrusted)

            judged = self._opinion.judge(view, view.proposal.action, trusted)
            if judged.verdict is not Assessed.UNSAFE and not judged.critical:
                text = f"safe without {', '.join(present)} ({why})"
                return Recovery(view.proposal.action, "ignore_untrusted", text)
            why = "; ".join(judged.reasons)
        return Recovery(Command(Maneuver.EMERGENCY_BRAKE), "emergency_brake", why)


def _others_refuse(view: RoleView) -> bool:
    """Whether another role refuses, for reasons that the SeparationMonitor cannot assess."""
    return any(
        isinstance(output, Assessment)
        and (output.critical or (output.verdict is Assessed.UNSAFE and name != "safety_monitor"))
        for name, output in view.outputs.items()
    )


def _without(percept: Percept, distrusted: set[str]) -> BodyList:
    """The objects that are trusted, and a car for each radar return that they do not explain."""
    bodies = _lidar_objects(percept)
    kept = bodies.rows([row for row, name in enumerate(bodies.ids) if name not in distrusted])
    names = ("localisation", "odometry", "radar", "map")
    return with_unexplained_returns({"lidar": kept, **{name: percept[name] for name in names}})
