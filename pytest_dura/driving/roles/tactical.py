"""Tactical: a stand-in for the paper's planner, which a language model was.

It has that planner's weaknesses, not its mind: it decides seldom, among few maneuvers, on few
objects, believes lidar, and misjudges gaps. Each parameter has its source or reason beside it.
They were fixed before any verdict on this planner was looked at, and are not tuned to the paper's
table or to a verdict.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pytest_dura.core.roles import Generator, Proposal, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import GeneratorView
from pytest_dura.driving.bodies import CAR_WIDTH, Body
from pytest_dura.driving.maneuvers import (
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
    braking_distance,
    stop_at,
)
from pytest_dura.driving.roles.planners import follow
from pytest_dura.driving.scene import HALF, InLane, Scene, crossing

PERIOD = 1.0
"""s between decisions; the time in which a language model of 11 billion parameters can answer."""
ATTENTION = 4
"""Objects that a decision considers, the nearest ones; observers track about four at once
(Pylyshyn and Storm 1988)."""
CRITICAL_GAP = 6.5
"""s; the gap to a car on the major road that half of all drivers accept who cross it from a minor
road (Highway Capacity Manual, two lanes, base value). The ego goes if nobody seems nearer."""
GAP_ERROR = 0.3
"""Standard deviation of the logarithm of a perceived gap over the real one: one estimate in six is
a third too long, one in six a quarter too short. A chosen value: how well a language model judges
gaps was not measured."""
SAFE_TIME = 2.0
"""s; the two-second rule: nearer to what is in its lane it waits."""
ALARM_TIME = 1.0
"""s; nearer still it brakes hard; one second is how long the next decision takes."""
BESIDE = 2.0
"""m beside its lane, where it expects a pedestrian to step out; half a lane's width."""
STANDSTILL = 2.0
"""m that it keeps to what it stops for; what queueing drivers leave."""


class _Decision(NamedTuple):
    """A maneuver, why, and the object it stops for or follows, if any."""

    maneuver: Maneuver
    reason: str
    subject: str | None = None


class Tactical(Generator):
    """Decides once a second, and carries the decision out until the next one.

    In between it keeps its distance to the object that it decided to stop for or to follow, and
    reacts to nothing else. It trusts lidar: it checks nothing against radar, camera or time.

    Args:
        period: Seconds between decisions.
        attention: Number of nearest objects that a decision considers.
        critical_gap: Seconds until the next car on the crossing road from which on it goes.
        gap_error: Standard deviation of the logarithm of the perceived over the real gap.
    """

    def __init__(
        self,
        period: float = PERIOD,
        attention: int = ATTENTION,
        critical_gap: float = CRITICAL_GAP,
        gap_error: float = GAP_ERROR,
    ) -> None:
        self.period, self.attention = period, attention
        self.critical_gap, self.gap_error = critical_gap, gap_error

    def reset(self, context: RoleContext) -> None:
        """Forget the last decision, and take the episode's seed."""
        self._seed = context.seed
        self._number = 0
        self._decision = _Decision(Maneuver.PROCEED, "")

    def propose(self, view: GeneratorView) -> Proposal:
        """The maneuver of the current decision, with the acceleration that carries it out."""
        scene = Scene.of(view.percept)
        if view.time >= self._number * self.period - view.dt / 2:
            self._number += 1
            self._decision = self._decide(scene)
        maneuver, reason, subject = self._decision
        acceleration = acceleration_for(Command(maneuver), scene.speed, scene.to_stop_line)
        if subject is not None:
            body = scene.bodies.get(subject)
            if body is not None:
                acceleration = min(acceleration, _behind(scene, body))
        return Proposal(Command(maneuver, acceleration), reason)

    def _decide(self, scene: Scene) -> _Decision:
        attended = self._attended(scene)
        if scene.cleared:
            return _Decision(Maneuver.PROCEED, "The junction lies behind me.")
        obstacle = self._in_lane(scene, attended)
        if obstacle is not None:
            decision = self._for_obstacle(scene, *obstacle)
            if decision is not None:
                return decision
        can_stop = braking_distance(scene.speed, MAX_BRAKING) < scene.to_stop_line
        if not scene.entered and can_stop:
            for approach in crossing(scene):
                name = approach.body.id
                if name not in attended or approach.speed < 1.0:
                    continue
                seconds = approach.distance / approach.speed * self._misjudged(name)
                if seconds < self.critical_gap:
                    near = scene.to_stop_line < 10.0
                    maneuver = Maneuver.WAIT if near else Maneuver.YIELD
                    return _Decision(
                        maneuver, f"{name} crosses in about {seconds:.0f} s, so I give way."
                    )
            if scene.to_stop_line < 20.0:
                subject = obstacle[0].id if obstacle is not None else None
                return _Decision(Maneuver.ACCELERATE, "The gap is long enough, so I go.", subject)
        subject = obstacle[0].id if obstacle is not None else None
        return _Decision(Maneuver.PROCEED, "Nothing is in my way.", subject)

    def _attended(self, scene: Scene) -> dict[str, Body]:
        """The nearest objects by id."""
        nearest = sorted(
            scene.bodies, key=lambda body: (math.hypot(body.x - scene.x, body.y - scene.y), body.id)
        )
        return {body.id: body for body in nearest[: self.attention]}

    @staticmethod
    def _in_lane(scene: Scene, attended: dict[str, Body]) -> tuple[Body, float] | None:
        """The nearest attended object in its lane, or a pedestrian beside it, and metres to it."""
        nearest: tuple[Body, float] | None = None
        for body in attended.values():
            s, lateral = scene.route.project(body.x, body.y)
            distance = s - scene.s - HALF - _extent(scene, body, s, across=False)
            reach = CAR_WIDTH / 2 + _extent(scene, body, s, across=True)
            reach += BESIDE if body.is_pedestrian else 0.0
            in_lane = s > scene.s and abs(lateral) < reach
            if in_lane and (nearest is None or distance < nearest[1]):
                nearest = body, distance
        return nearest

    @staticmethod
    def _for_obstacle(scene: Scene, body: Body, distance: float) -> _Decision | None:
        """What it does about an object in its lane; ``None`` while it is far away."""
        heading = float(scene.route.pose(scene.route.project(body.x, body.y)[0])[2])
        along = body.vx * math.cos(heading) + body.vy * math.sin(heading)
        leads = along > 1.0 and not body.is_pedestrian
        seconds = max(distance, 0.0) / max(scene.speed, 1.0)
        where = f"{body.id} is {max(distance, 0.0):.0f} m ahead in my lane"
        if seconds < ALARM_TIME and scene.speed > along + 1.0:
            return _Decision(Maneuver.EMERGENCY_BRAKE, f"{where}: I brake hard.")
        if leads:
            if seconds < SAFE_TIME:
                reason = f"{where} and drives on, so I follow it."
                return _Decision(Maneuver.PROCEED_CAUTIOUSLY, reason, body.id)
            return None
        # What stands or crosses is stopped for from where comfortable braking suffices.
        if distance < STANDSTILL + SAFE_TIME * scene.speed + braking_distance(scene.speed, 3.0):
            return _Decision(Maneuver.WAIT, f"{where}, so I wait.", body.id)
        return None

    def _misjudged(self, name: str) -> float:
        """The factor by which it misjudges the gap to an object at this decision."""
        # A stream for each object and decision: an object more shifts no other estimate.
        rng = stream(self._seed, f"generator:tactical:{self._number}:{name}")
        return math.exp(self.gap_error * float(rng.standard_normal()))


def _extent(scene: Scene, body: Body, s: float, *, across: bool) -> float:
    """Half of what a body takes of the lane at ``s``, along or across it, in m."""
    angle = body.heading - float(scene.route.pose(s)[2])
    c, sn = abs(math.cos(angle)), abs(math.sin(angle))
    return (body.length * sn + body.width * c if across else body.length * c + body.width * sn) / 2


def _behind(scene: Scene, body: Body) -> float:
    """The acceleration in m/s2 with which the ego stays behind an object in its lane."""
    s, lateral = scene.route.project(body.x, body.y)
    if s <= scene.s or abs(lateral) > CAR_WIDTH / 2 + _extent(scene, body, s, across=True) + BESIDE:
        return math.inf
    heading = float(scene.route.pose(s)[2])
    along = body.vx * math.cos(heading) + body.vy * math.sin(heading)
    distance = s - scene.s - HALF - _extent(scene, body, s, across=False)
    if along > 1.0:
        return follow(InLane(body, distance, along), scene.speed)
    return stop_at(distance - STANDSTILL, scene.speed)
