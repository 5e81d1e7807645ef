"""Generators for driving: a competent default, and three that are wrong in known ways."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.driving import prediction
from pytest_dura.driving.bodies import VX, VY
from pytest_dura.driving.maneuvers import (
    COMFORT_BRAKING,
    MAX_ACCELERATION,
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
    braking_distance,
    stop_at,
)
from pytest_dura.driving.percepts import CrossCheck
from pytest_dura.driving.scene import HALF, InLane, Scene, crossing, time_to_cover

_SCALLOP = 0.35
"""m; by so much three discs overstate a car's width where it is widest."""


_PREVIEW = 2.0
"""s; before what it stops for it approaches so that a steady acceleration would not take it there
within this time, by which a monitor can tell that it means to stop."""


def _unhurried(room: float, speed: float) -> float:
    """Greatest acceleration in m/s2 that covers no more than ``room`` metres in the preview.

    No harder braking than is comfortable is asked for: to stop in time is not its purpose.
    """
    return max(2.0 * (room - speed * _PREVIEW) / _PREVIEW**2, -COMFORT_BRAKING)


class RuleBased(Generator):
    """Gap acceptance at the stop line, car following, and a look ahead inside the junction.

    It perceives lidar objects that radar does not contradict, and radar returns that no lidar
    object explains.

    Args:
        margin: Seconds that must lie between its leaving the crossing lanes and a car's arrival.
        separation: Predicted distance in m that it keeps to others inside the junction.
    """

    CANDIDATES = (MAX_ACCELERATION, 2.0, 0.0, -3.0, -MAX_BRAKING)
    """Accelerations in m/s2 that are compared once the stop line is crossed."""

    PATIENCE = 5
    """Ticks after which a car that creeps or brakes counts as waiting for others itself."""
    KERB_PATIENCE = 30
    """Ticks that it stands before a pedestrian at the kerb until it takes them not to cross."""

    def __init__(self, margin: float = 0.8, separation: float = 1.0) -> None:
        self.margin, self.separation = margin, separation
        self._predictor = prediction.Predictor(3.0, 0.3, now=True)
        self._cross_check = CrossCheck()

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()
        self._cross_check.reset()
        self._waits: dict[str, int] = {}
        self._speeds: dict[str, float] = {}
        self._walked: set[str] = set()
        self._given_way = 0

    def propose(self, view: GeneratorView) -> Proposal:
        """The maneuver of this tick, with its acceleration."""
        scene = Scene.of(view.percept)
        scene.bodies = self._cross_check.update(view.percept)
        self._predictor.observe(view.index, scene.bodies)
        self._watch_who_waits(scene)
        command, why = self._on_the_way(scene, view.dt)
        acceleration = acceleration_for(command, scene.speed, scene.to_stop_line, scene.limit)
        if command.maneuver is Maneuver.WAIT:
            acceleration = min(acceleration, _unhurried(scene.to_stop_line, scene.speed))
        follow = self._follow(scene.leader(), scene.speed)
        if follow < acceleration:
            acceleration, why = follow, "follows"
            gently = follow > -COMFORT_BRAKING
            command = Command(Maneuver.YIELD if gently else Maneuver.EMERGENCY_BRAKE)
        walker = self._for_pedestrians(scene)
        if walker < acceleration:
            acceleration, why = walker, "lets a pedestrian cross"
            command = Command(Maneuver.WAIT if walker > -6.0 else Maneuver.EMERGENCY_BRAKE)
        return Proposal(Command(command.maneuver, acceleration), why)

    def _on_the_way(self, scene: Scene, dt: float) -> tuple[Command, str]:
        if scene.cleared:
            return Command(Maneuver.PROCEED), "leaves"
        if not scene.entered:
            to_line = scene.to_stop_line
            if braking_distance(scene.speed, 0.8 * MAX_BRAKING) < to_line + 0.3:
                blocked = self._who_comes(scene, dt)
                if blocked is not None:
                    return Command(Maneuver.WAIT), f"gives way to {blocked}"
                if to_line > 20.0:
                    return Command(Maneuver.PROCEED), "accepts the gap"
                launch = min(MAX_ACCELERATION, scene.limit - scene.speed)
                return Command(Maneuver.ACCELERATE, launch), "accepts the gap"
        return self._inside(scene, dt)

    def _watch_who_waits(self, scene: Scene) -> None:
        """For how many ticks each car outside the junction has crept, or braked at low speed."""
        waits, speeds = {}, {}
        for body in scene.bodies:
            speeds[body.id] = speed = math.hypot(body.vx, body.vy)
            slower = speed < self._speeds.get(body.id, 0.0) - 0.05
            outside = not scene.route.road.inside(body.x, body.y)
            if outside and (speed < 1.0 or (speed < 5.0 and slower)):
                waits[body.id] = self._waits.get(body.id, 0) + 1
        self._waits, self._speeds = waits, speeds

    def _who_comes(self, scene: Scene, dt: float) -> str | None:
        """Id of a car with right of way that would arrive before the ego has crossed."""
        queues: set[str] = set()
        for other in sorted(crossing(scene), key=lambda approach: approach.distance):
            if other.arm in queues:
                continue
            if self._waits.get(other.body.id, 0) >= self.PATIENCE:
                queues.add(other.arm)  # who is behind it waits as well
                continue
            # Far enough for the rear to have left the other's lane.
            beyond = other.meets + other.body.width / 2 + HALF + 0.5
            clear = time_to_cover(beyond - scene.s, scene.speed, 3.5, scene.limit)
            arrives = time_to_cover(other.distance, other.speed, 2.5, scene.limit)
            if arrives < clear + self.margin:
                return other.body.id
        candidate = (MAX_ACCELERATION if scene.to_stop_line < 20.0 else 2.0,)
        apart, who = self._apart(scene, candidate, dt)
        return who if apart[0] < self.separation else None

    def _inside(self, scene: Scene, dt: float) -> tuple[Command, str]:
        """The quickest way out that keeps its distance, or else the one that keeps most."""
        apart, who = self._apart(scene, self.CANDIDATES, dt)
        good = np.flatnonzero(apart >= self.separation)
        choice = int(good[0]) if len(good) else int(apart.argmax())
        acceleration = self.CANDIDATES[choice]
        if acceleration > 0.0:
            maneuver = Maneuver.ACCELERATE if acceleration > 2.0 else Maneuver.PROCEED
            return Command(maneuver, min(acceleration, scene.limit - scene.speed)), "crosses"
        if acceleration == 0.0:
            return Command(Maneuver.PROCEED_CAUTIOUSLY, 0.0), f"keeps its distance to {who}"
        maneuver = Maneuver.YIELD if acceleration > -5.0 else Maneuver.EMERGENCY_BRAKE
        return Command(maneuver, acceleration), f"avoids {who}"

    def _apart(
        self, scene: Scene, accelerations: Sequence[float], dt: float
    ) -> tuple[NDArray[np.float64], str]:
        """Least predicted separation of each candidate, and from whom for the first."""
        apart, near = self._predictor.separations(scene, accelerations, dt)
        if not near.ids:
            return np.full(len(accelerations), 99.0), "none"
        # Who is near already, such as a pedestrian beside a standing car, is no reason against a
        # candidate that comes no nearer.
        standing = np.hypot(near.data[:, VX], near.data[:, VY]) < 0.5
        # Both widths are overstated; beside what stands, that would be taken for too narrow.
        here, apart = apart[0, 0], apart[:, 1:].min(axis=1) + 2 * _SCALLOP * standing
        apart = np.where((apart > here - _SCALLOP) & (here > 0.0), np.maximum(apart, 9.0), apart)
        return apart.min(axis=1), near.ids[int(apart[0].argmin())]

    @staticmethod
    def _follow(leader: InLane | None, speed: float) -> float:
        """Acceleration in m/s2 that keeps a time gap of a second behind the leader."""
        if leader is None:
            return math.inf
        room = leader.distance - 2.0
        if room <= 0.0:
            return -MAX_BRAKING if speed > 0.5 else -COMFORT_BRAKING
        ahead = max(leader.speed, 0.0)
        needed = max(speed - ahead, 0.0) ** 2 / (2.0 * room)
        unhurried = _unhurried(room + ahead * _PREVIEW, speed)
        if ahead < 1.0:
            return min(stop_at(room + braking_distance(ahead, COMFORT_BRAKING), speed), unhurried)
        gentle = 0.3 * (room - 1.0 * speed) + 0.8 * (ahead - speed)
        return max(min(gentle, unhurried, -needed if needed > 1.0 else math.inf), -MAX_BRAKING)

    def _for_pedestrians(self, scene: Scene) -> float:
        """Acceleration in m/s2 that stops before a pedestrian who is on the path or may come.

        One who stands at the kerb and has not walked yet is given way for a few seconds.
        """
        slowest = math.inf
        for body in scene.bodies:
            if not body.is_pedestrian:
                continue
            s, lateral = scene.route.project(body.x, body.y)
            room = s - scene.s - HALF - body.length / 2 - 1.5
            walks = math.hypot(body.vx, body.vy) > 0.1
            if walks:
                self._walked.add(body.id)
            if room < -1.5 - HALF or abs(lateral) > 7.5:
                continue
            heading = float(scene.route.pose(s)[2])
            sideways = body.vy * math.cos(heading) - body.vx * math.sin(heading)
            on_path = abs(lateral) < 2.0
            expected = on_path or sideways * lateral < -0.1
            if not walks and body.id not in self._walked:
                self._given_way += scene.speed < 0.5
                expected |= self._given_way < self.KERB_PATIENCE
            if expected and room > braking_distance(scene.speed, MAX_BRAKING) - 0.5:
                slowest = min(slowest, stop_at(room, scene.speed), _unhurried(room, scene.speed))
            elif on_path and room > -1.5:
                slowest = -MAX_BRAKING
        return slowest


class Reactive(Generator):
    """Trusts whatever lidar reports, and reacts to what is near without predicting.

    It approaches and crosses at a steady pace, slows down where anything on a collision course
    comes near, and brakes hard where it is very near. It checks nothing against radar.

    Args:
        caution: Time to conflict in s below which it yields.
        alarm: The same for an emergency brake.
    """

    def __init__(self, caution: float = 3.0, alarm: float = 1.4) -> None:
        self.caution, self.alarm = caution, alarm

    def propose(self, view: GeneratorView) -> Proposal:
        """The maneuver of this tick."""
        scene = Scene.of(view.percept)
        if scene.cleared:
            return Proposal(Command(Maneuver.PROCEED), "leaves")
        conflict, who = self._conflict(scene)
        if conflict < self.alarm:
            return Proposal(Command(Maneuver.EMERGENCY_BRAKE), f"{who} is {conflict:.1f} s away")
        if conflict < self.caution:
            maneuver = Maneuver.YIELD if not scene.entered else Maneuver.PROCEED_CAUTIOUSLY
            return Proposal(Command(maneuver), f"{who} is {conflict:.1f} s away")
        return Proposal(Command(Maneuver.PROCEED), "sees no conflict")

    @staticmethod
    def _conflict(scene: Scene) -> tuple[float, str]:
        """Least time until an object is where the ego's path is, and who."""
        worst, who = math.inf, "none"
        for body in scene.bodies:
            s, lateral = scene.route.project(body.x, body.y)
            ahead = s - scene.s - HALF - body.length / 2
            if s < scene.s or ahead > 40.0:
                continue
            heading = float(scene.route.pose(s)[2])
            along = body.vx * math.cos(heading) + body.vy * math.sin(heading)
            sideways = body.vy * math.cos(heading) - body.vx * math.sin(heading)
            beside = abs(lateral) - 1.0 - body.width / 2
            if beside <= 0.3:
                closing = max(scene.speed - along, 0.0)
                time = max(ahead - 1.0, 0.0) / max(closing, 0.1)
            elif sideways * lateral < 0.0 and abs(sideways) > 0.5:
                reach = (abs(lateral) - 1.0 - body.length / 2) / abs(sideways)
                arrive = max(ahead, 0.0) / max(scene.speed, 3.0)
                time = max(reach, arrive) if abs(reach - arrive) < 2.0 else math.inf
            else:
                continue
            if time < worst:
                worst, who = time, body.id
        return worst, who


class Aggressive(Generator):
    """Never gives way: accelerates through."""

    def propose(self, view: GeneratorView) -> Proposal:
        """Full acceleration."""
        return Proposal(Command(Maneuver.ACCELERATE), "never gives way")


class RandomPlanner(Generator):
    """Draws a maneuver every half second."""

    def reset(self, context: RoleContext) -> None:
        """Begin its stream of draws anew."""
        self._rng = stream(context.seed, "generator:random")
        self._maneuver = Maneuver.PROCEED

    def propose(self, view: GeneratorView) -> Proposal:
        """The drawn maneuver."""
        if view.index % 5 == 0:
            self._maneuver = list(Maneuver)[int(self._rng.integers(len(Maneuver)))]
        return Proposal(Command(self._maneuver), "drawn")
