"""Mutations for driving: what a planner may fail to see or to do, and what its guards may."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import Percept
from pytest_dura.core.roles import Assessment, Recovery
from pytest_dura.core.state import GeneratorView, Proposal, RoleView, Tick
from pytest_dura.driving.bodies import NO_BODIES, BodyList
from pytest_dura.driving.maneuvers import MAX_ACCELERATION, MAX_BRAKING, Command, Maneuver
from pytest_dura.qualification import AlteredPercept, Parameter
from pytest_dura.qualification.mutants.component import ComponentMutation
from pytest_dura.qualification.mutants.monitor import MonitorMutation, RecoveryMutation
from pytest_dura.qualification.mutants.plant import SimulatorMutation

SIDES = ("left", "right")


def without_objects(percept: Percept, seen: Callable[[float, float], bool]) -> Percept:
    """Return a percept in which lidar and radar miss some objects.

    Args:
        percept: As the sensors report it.
        seen: Whether an object is seen, of its place ahead of the car and to its right, in m.
    """

    def change(channel: str, value: Any) -> Any:
        if channel == "lidar":
            pose = percept["localisation"]
            cosine, sine = math.cos(pose.heading), math.sin(pose.heading)
            places = [(row[0] - pose.x, row[1] - pose.y) for row in value.numbers]
            kept = [
                number
                for number, (x, y) in enumerate(places)
                if seen(x * cosine + y * sine, y * cosine - x * sine)
            ]
            return value.rows(kept) if isinstance(value, BodyList) else value
        if channel == "radar" and len(value):
            returns = np.asarray(value)
            kept = [seen(*_ahead_and_right(row)) for row in returns]
            return returns[np.array(kept, bool)]
        return value

    return AlteredPercept(percept, change)


def _ahead_and_right(row: Any) -> tuple[float, float]:
    """Return the place of a radar return, from range and azimuth, which is to the left."""
    return float(row[0]) * math.cos(row[1]), -float(row[0]) * math.sin(row[1])


def _beside(side: str) -> Callable[[float, float], bool]:
    """Return whether an object is seen by who is blind beyond 2 m on a side."""
    sign = 1.0 if side == "right" else -1.0
    return lambda _, right: right * sign < 2.0


class Sees(ComponentMutation):
    """A planner that sees something else."""

    def percept(self, percept: Percept) -> Percept:
        """Return what it sees."""
        raise NotImplementedError

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose on what it sees."""
        return self.part.propose(replace(view, percept=self.percept(view.percept)))


class BlindSide(Sees):
    """Is blind on one side."""

    about = "sees nothing that is more than 2 m to one side"
    parameters: ClassVar = (Parameter("side", SIDES),)
    side: str

    def percept(self, percept: Percept) -> Percept:
        """Return the percept without what is there."""
        return without_objects(percept, _beside(self.side))


class ShortSighted(Sees):
    """Does not see far."""

    about = "sees nothing beyond some distance"
    parameters: ClassVar = (Parameter("distance", (12.0, 25.0), "m"),)
    distance: float

    def percept(self, percept: Percept) -> Percept:
        """Return the percept without what is farther."""
        return without_objects(percept, lambda x, y: math.hypot(x, y) < self.distance)


class IgnoresLidar(Sees):
    """Ignores lidar."""

    about = "takes no object from lidar"

    def percept(self, percept: Percept) -> Percept:
        """Return the percept without objects."""
        return AlteredPercept(
            percept, lambda channel, value: NO_BODIES if channel == "lidar" else value
        )


class IgnoresRadar(Sees):
    """Ignores radar."""

    about = "takes no return from radar"

    def percept(self, percept: Percept) -> Percept:
        """Return the percept without returns."""
        return AlteredPercept(
            percept, lambda channel, value: value[:0] if channel == "radar" else value
        )


class Mirrored(Sees):
    """Takes left for right."""

    about = "sees objects and radar returns on the other side of its heading"

    def percept(self, percept: Percept) -> Percept:
        """Return the mirrored percept."""

        def change(channel: str, value: Any) -> Any:
            if channel == "lidar" and len(value):
                return _mirrored(value, percept["localisation"])
            if channel == "radar" and len(value):
                returns = np.array(value)
                returns[:, 1] *= -1.0
                return returns
            return value

        return AlteredPercept(percept, change)


def _mirrored(bodies: BodyList, pose: Any) -> BodyList:
    """Mirror objects in the line through the car along its heading."""
    data = np.array(bodies.data)
    twice = 2.0 * pose.heading
    turn = np.array([[math.cos(twice), math.sin(twice)], [math.sin(twice), -math.cos(twice)]])
    own = np.array([pose.x, pose.y])
    data[:, :2] = (data[:, :2] - own) @ turn.T + own
    data[:, 3:5] = data[:, 3:5] @ turn.T
    data[:, 2] = twice - data[:, 2]
    return BodyList(bodies.ids, data)


class Harsh(ComponentMutation):
    """Brakes and accelerates as hard as it can."""

    about = "brakes and accelerates as hard as the car can, where it would do so gently"

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose the greatest acceleration of the sign."""
        proposal = self.part.propose(view)
        command = Command.of(proposal.action)
        wanted = command.acceleration
        if wanted is None or abs(wanted) < 0.5:
            return proposal
        hard = -MAX_BRAKING if wanted < 0.0 else MAX_ACCELERATION
        return proposal.with_action(Command(command.maneuver, hard))


class BrakesForNothing(ComponentMutation):
    """Brakes hard now and then."""

    about = "brakes as hard as the car can for half a second, at every so many seconds"
    parameters: ClassVar = (Parameter("every", (4.0, 10.0), "s"),)
    every: float

    def propose(self, view: GeneratorView) -> Proposal:
        """Brake at these times."""
        proposal = self.part.propose(view)
        if view.time % self.every < self.every - 0.5:
            return proposal
        return proposal.with_action(Command(Maneuver.EMERGENCY_BRAKE, -MAX_BRAKING))


class NeverYields(ComponentMutation):
    """Never gives way."""

    about = "drives on where it would brake or wait"

    def propose(self, view: GeneratorView) -> Proposal:
        """Proceed in place of any maneuver that slows down."""
        proposal = self.part.propose(view)
        command = Command.of(proposal.action)
        if command.acceleration is None or command.acceleration >= 0.0:
            return proposal
        return proposal.with_action(Command(Maneuver.PROCEED))


class MonitorBlindSide(MonitorMutation):
    """Is blind on one side."""

    about = "sees nothing that is more than 2 m to one side"
    parameters: ClassVar = (Parameter("side", SIDES),)
    side: str

    def run(self, view: RoleView) -> Assessment:
        """Assess on what is left."""
        percept = without_objects(view.percept, _beside(self.side))
        return self.part.run(replace(view, percept=percept))


class Accelerates(RecoveryMutation):
    """Accelerates."""

    about = "accelerates as hard as the car can"

    def run(self, view: RoleView) -> Recovery:
        """Return full acceleration."""
        recovery = self.part.run(view)
        return replace(recovery, action=Command(Maneuver.ACCELERATE, MAX_ACCELERATION))


class GapTooLarge(SimulatorMutation):
    """Reports too large a gap."""

    about = "reports the gap to others too large"
    parameters: ClassVar = (Parameter("metres", (0.3, 1.0), "m"),)
    metres: float

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Add to the gap."""
        columns = dict(self.part.signals(ticks))
        return {**columns, "gap": columns["gap"] + self.metres}
