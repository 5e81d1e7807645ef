"""The planner under test, a careless one, speed and separation monitoring, the protective stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arm.cell import BODY, BRAKING, PLACES, TOP_RATE, Joints, arm_speed, distance, links
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

WALKING = 1.6  # m/s; v_h of a person whose speed is not measured (ISO/TS 15066 5.5.4, ISO 13855)
REACTION = 0.2  # s; T_r: a tick until it is seen, another one until the arm is commanded
INTRUSION = 0.85  # m; C, what a hand reaches ahead of legs (ISO 13855, a scanner's parallel field)
UNCERTAINTY = 0.1  # m; Z_d + Z_r, of the person's place and the arm's
SPARE = 0.3  # m that the planner keeps beyond it, so that the monitor need not act
APART = 0.4  # m between what two scanners report, from where on one of them must be wrong


def protective_distance(speed: float, rates: Sequence[float]) -> float:
    """S_p = S_h + S_r + S_s + C + Z_d + Z_r, in m, of an arm at a speed in m/s.

    ISO/TS 15066, 5.5.4. S_h: what the person walks until the arm stands; S_r: what the arm moves
    until it brakes; S_s: what it moves while braking.
    """
    stopping = max(map(abs, rates)) / BRAKING
    moved = speed * REACTION + speed * stopping / 2
    return WALKING * (REACTION + stopping) + moved + INTRUSION + UNCERTAINTY


def perceived_gap(percept: Percept, scanners: Sequence[str]) -> float:
    """Least gap in m between arm and trunk, by encoders and scanners: the nearest person counts."""
    places = np.array([percept[name].place(name) for name in scanners])
    return float(distance(links(*percept["joints"][:2]), places).min()) - BODY


class Considerate(Generator):
    """Moves parts as fast as the separation allows.

    Args:
        scanners: Those that it looks at.
        creep: Speed in m/s at which it goes on where the separation is not enough.
    """

    def __init__(self, scanners: Sequence[str] = ("left", "right"), creep: float = 0.0) -> None:
        self.scanners, self.creep, self._to = scanners, creep, 1

    def propose(self, view: GeneratorView) -> Proposal:
        """Drive both joints to the next place so that they arrive together."""
        joints = view.percept["joints"]
        way = PLACES[self._to] - np.array(joints[:2])
        left = float(np.abs(way).max())
        if left < 0.02:
            self._to = 1 - self._to
        rates = way / (left + 1e-9) * min(TOP_RATE, 3.0 * left)
        share = self.share(view.percept, rates)
        return Proposal(Joints(*(share * rates).tolist()), f"at {100 * share:.0f} % of its speed")

    def share(self, percept: Percept, rates: np.ndarray) -> float:
        """Greatest share of these rates at which the separation is enough."""
        gap = perceived_gap(percept, self.scanners) - SPARE
        speed = arm_speed(percept["joints"].elbow, rates)
        shares = (share / 10 for share in range(10, 0, -1))
        fits = (each for each in shares if protective_distance(each * speed, each * rates) <= gap)
        return max(next(fits, 0.0), min(1.0, self.creep / (speed + 1e-9)))


class Careless(Considerate):
    """Moves at full speed, whoever is near."""

    def share(self, percept: Percept, rates: np.ndarray) -> float:
        """All of it."""
        return 1.0


class SeparationMonitor(SafetyMonitor):
    """Speed and separation monitoring; the score is the rest of the separation in m.

    Args:
        scanners: Those that it looks at. It refuses to move where two of them disagree.
        creep: Speed in m/s up to which the limits of force and pressure protect the person.
    """

    def __init__(self, scanners: Sequence[str] = ("left", "right"), creep: float = 0.01) -> None:
        self.scanners, self.creep = scanners, creep

    def run(self, view: RoleView) -> Assessment:
        """Compare gap and protective distance, at the speed that is measured or proposed."""
        percept, proposal = view.percept, view.proposal
        assert proposal is not None
        joints = percept["joints"]
        rates = max(proposal.action, joints[2:], key=lambda each: arm_speed(joints.elbow, each))
        speed = arm_speed(joints.elbow, rates)
        rest = perceived_gap(percept, self.scanners) - protective_distance(speed, rates)
        places = np.array([percept[name].place(name) for name in self.scanners])
        apart = float(np.linalg.norm(places - places[0], axis=-1).max())
        reasons = [f"{-rest:.2f} m too near for {speed:.1f} m/s"] if rest < 0.0 else []
        if apart > APART:
            reasons.append(f"the scanners disagree by {apart:.1f} m")
        if reasons and speed > self.creep:
            return Assessment(Assessed.UNSAFE, rest, tuple(reasons))
        return Assessment(Assessed.SAFE, rest)


class ProtectiveStop(RecoveryPlanner):
    """Brakes both joints as hard as they can, and holds them."""

    def run(self, view: RoleView) -> Recovery:
        """Stop."""
        return Recovery(Joints(0.0, 0.0), "protective stop", "; ".join(view.reasons))
