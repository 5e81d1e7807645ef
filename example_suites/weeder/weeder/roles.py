"""The planner under test, one that trusts its map, the monitor, and the recovery."""

from __future__ import annotations

import numpy as np

from pytest_dura import (
    Assessed,
    Assessment,
    Generator,
    GeneratorView,
    Percept,
    Proposal,
    Recovery,
    RecoveryPlanner,
    RoleView,
    SafetyMonitor,
)
from weeder.field import LENGTH, SIGHT, SOWN, TOP_SPEED, Command

KEPT = 1.5  # m to an animal at which it stops
LOWERED, LIFTED = 0.06, 0.12  # m around a weed, and around a cabbage
MAPPED = 0.13  # m around a cabbage of the sowing map from where on the hoe goes up
APART = 0.12  # m between the row by camera and by satellites, from where on one of them is wrong
SOWN_HERE = "a cabbage was sown here"


def way_left(percept: Percept) -> float:
    """How far the robot may go before it has to stop for what is warm, in m."""
    return float(percept["thermal"].range) - LENGTH / 2 - KEPT


class Sighted(Generator):
    """Steers by camera, and hoes what looked like a weed most of the time while it came nearer."""

    def __init__(self) -> None:
        self._plants: list[list[float]] = []  # how far ahead, votes for a crop, votes

    def propose(self, view: GeneratorView) -> Proposal:
        """Follow the row, hoe between the cabbages, and stop for animals."""
        self._look(view.percept, view.dt)
        near = {crop: min((abs(at) for at, yes, n in self._plants if (2 * yes >= n) is crop),
                          default=np.inf) for crop in (True, False)}  # fmt: skip
        hoe = near[False] < LOWERED and near[True] > LIFTED
        speed = min(TOP_SPEED, max(0.0, way_left(view.percept)))
        offset, heading = self.row(view.percept)
        return Proposal(Command(speed, 2.0 * offset + 2.0 * heading, float(hoe)))

    def row(self, percept: Percept) -> tuple[float, float]:
        """Where the row is, to the right in m, and its direction."""
        return percept["camera"].offset, percept["camera"].heading

    def _look(self, percept: Percept, dt: float) -> None:
        """Move what was seen by the way that the wheels rolled, and add what the camera sees."""
        for plant in self._plants:
            plant[0] -= percept["odometry"].speed * dt
        self._plants = [plant for plant in self._plants if plant[0] > -0.2]
        _, _, distance, crop = percept["camera"]
        if distance >= SIGHT[1]:
            return
        known = next((each for each in self._plants if abs(each[0] - distance) < 0.1), [0, 0, 0])
        self._plants = [each for each in self._plants if each is not known]
        self._plants.append([distance, known[1] + crop, known[2] + 1.0])


class ByMap(Sighted):
    """Steers by satellites and the map of the rows."""

    def row(self, percept: Percept) -> tuple[float, float]:
        """The row is where it was sown."""
        return -percept["gnss"].y, percept["camera"].heading


class CrossCheck(SafetyMonitor):
    """Compares camera, satellites and the sowing map, and looks out for animals."""

    def run(self, view: RoleView) -> Assessment:
        """Refuse to go on beside the row, up to an animal, and to hoe where a cabbage was sown."""
        percept, proposal = view.percept, view.proposal
        assert proposal is not None
        apart = abs(percept["camera"].offset + percept["gnss"].y)
        sown = float(np.abs(SOWN - percept["gnss"].x).min())
        speed, moves = percept["odometry"].speed, proposal.action[0] > 0.0
        rest = way_left(percept) + 0.3 - speed * view.dt - speed * speed / 2
        reasons = [f"the rows by camera and satellites are {apart:.2f} m apart"] * (
            moves and apart > APART
        )
        reasons += [f"an animal is {-rest:.2f} m too near"] * (moves and rest < 0.0)
        reasons += [SOWN_HERE] * (proposal.action[2] > 0.5 and sown < MAPPED)
        verdict = Assessed.UNSAFE if reasons else Assessed.SAFE
        return Assessment(verdict, min(rest, APART - apart), tuple(reasons))


class LiftAndStop(RecoveryPlanner):
    """Lifts the hoe; stops, but where the hoe alone was refused."""

    def run(self, view: RoleView) -> Recovery:
        """Go on along the row with the hoe up, or stop."""
        proposal, reasons = view.proposal, view.reasons
        if proposal is not None and all(SOWN_HERE in reason for reason in reasons):
            return Recovery(Command(*proposal.action[:2], 0.0), "lift the hoe", SOWN_HERE)
        return Recovery(Command(0.0, 0.0, 0.0), "lift the hoe and stop", "; ".join(reasons))
