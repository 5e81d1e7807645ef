"""Tactical: a stand-in for the paper's planner, which a language model was.

It has that planner's weaknesses, not its mind: it decides seldom, among few maneuvers, on few
objects, believes lidar, and misjudges gaps. Each parameter has its source or reason beside it.
They are not tuned to the paper's table or to a verdict: docs/paper.md says when they were fixed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.driving.bodies import CAR_WIDTH, Body
from pytest_dura.driving.maneuvers import MAX_BRAKING, Command, Maneuver, braking_distance
from pytest_dura.driving.scene import HALF, Scene, crossing

_PERIOD = 1.0
"""s between decisions; the time in which a language model of 11 billion parameters can answer."""
_ATTENTION = 4
"""Objects that a decision considers, the nearest ones; observers track about four at once
(Pylyshyn and Storm 1988)."""
_CRITICAL_GAP = 6.5
"""s; the gap to a car on the major road that half of all drivers accept who cross it from a minor
road (Highway Capacity Manual, two lanes, base value). The ego goes if no car seems nearer."""
_GAP_ERROR = 0.3
"""Standard deviation of the logarithm of a perceived gap over the real one: one estimate in six is
a third too long, one in six a quarter too short. A chosen value: how well a language model judges
gaps was not measured."""
_SAFE_TIME = 2.0
"""s; the two-second rule: it slows down behind who drives nearer ahead, and brakes hard before what
stands nearer or crosses."""
_ALARM_TIME = 1.0
"""s; nearer than a decision takes it brakes hard before everybody."""
_BESIDE = 2.0
"""m beside its lane, where it expects a pedestrian to step out; half a lane's width."""


class _Decision(NamedTuple):
    maneuver: Maneuver
    reason: str


class Tactical(Generator):
    """Decides on a maneuver once a second, and reacts to nothing until the next decision.

    It trusts lidar: it checks nothing against radar, camera or what it saw before. How a maneuver
    is carried out is left to the vehicle, which does not know what it was for.

    Args:
        period: Seconds between decisions.
        attention: Number of nearest objects that a decision considers.
        critical_gap: Seconds until the next car on the crossing road from which on it goes.
        gap_error: Standard deviation of the logarithm of the perceived over the real gap.
    """

    def __init__(
        self,
        period: float = _PERIOD,
        attention: int = _ATTENTION,
        critical_gap: float = _CRITICAL_GAP,
        gap_error: float = _GAP_ERROR,
    ) -> None:
        self.period, self.attention = period, attention
        self.critical_gap, self.gap_error = critical_gap, gap_error

    def reset(self, context: RoleContext) -> None:
        """Forget the last decision, and take the episode's seed."""
        self._seed = context.seed
        self._number = 0
        self._decision = _Decision(Maneuver.PROCEED, "")

    def propose(self, view: GeneratorView) -> Proposal:
        """The maneuver of the current decision."""
        if view.time >= self._number * self.period - view.dt / 2:
            self._number += 1
            self._decision = self._decide(Scene.of(view.percept))
        return Proposal(Command(self._decision.maneuver), self._decision.reason)

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
                return _Decision(Maneuver.ACCELERATE, "The gap is long enough, so I go.")
        return _Decision(Maneuver.PROCEED, "Nothing is in my way.")

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
            reach += _BESIDE if body.is_pedestrian else 0.0
            in_lane = s > scene.s and abs(lateral) < reach
            if in_lane and (nearest is None or distance < nearest[1]):
                nearest = body, distance
        return nearest

    @staticmethod
    def _for_obstacle(scene: Scene, body: Body, distance: float) -> _Decision | None:
        """The decision on an object in its lane; ``None`` while it is far away."""
        heading = float(scene.route.pose(scene.route.project(body.x, body.y)[0])[2])
        along = body.vx * math.cos(heading) + body.vy * math.sin(heading)
        leads = along > 1.0 and not body.is_pedestrian
        seconds = max(distance, 0.0) / max(scene.speed, 1.0)
        where = f"{body.id} is {max(distance, 0.0):.0f} m ahead in my lane"
        closing = scene.speed > along
        if (seconds < _ALARM_TIME and closing) or (seconds < _SAFE_TIME and not leads):
            return _Decision(Maneuver.EMERGENCY_BRAKE, f"{where}: I brake hard.")
        if leads and seconds < _SAFE_TIME:
            return _Decision(Maneuver.PROCEED_CAUTIOUSLY, f"{where} and drives on, so I slow down.")
        if not leads and seconds < 2 * _SAFE_TIME:
            return _Decision(Maneuver.YIELD, f"{where}, so I give way.")
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
