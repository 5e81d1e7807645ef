"""Attribution of the ego's collision: with whom, on which side, who ran into whom."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pytest_dura.driving import geometry
from pytest_dura.driving.bodies import CAR_LENGTH
from pytest_dura.driving.junction import ARM_LENGTH
from pytest_dura.driving.sensors import EgoState

STANDING = 0.5
"""m/s; slower counts as standing."""


@dataclass(frozen=True)
class Contact:
    """The ego's first contact. All contacts are collisions; ``code`` tells them apart.

    ``code`` is 1 where the ego ran into the other, 2 where the other ran into the ego, and 3 where
    it did so while the ego stood. Who ran into whom is decided by whose speed along the line
    between the two centres was greater. ``side`` is the ego's.
    """

    partner: str
    side: str
    speed: float
    partner_speed: float
    in_conflict_zone: bool
    code: int

    def describe(self) -> str:
        """One line for events and messages."""
        how = {1: "ran into", 2: "was struck by", 3: "was struck while standing by"}[self.code]
        zone = "inside" if self.in_conflict_zone else "outside"
        return (
            f"the ego ({self.speed:.1f} m/s) {how} {self.partner} ({self.partner_speed:.1f} m/s), "
            f"contact on its {self.side}, {zone} the conflict zone"
        )


def attribute(ego: Any, before: EgoState, road: Any, exit_at: float) -> Contact:
    """The contact that has just crashed the ego; ``before`` is its state one step earlier."""
    box = np.array([[*ego.position, ego.heading, ego.LENGTH, ego.WIDTH]])
    bodies = (*road.vehicles, *road.objects, *road.obstacles)
    crashed = [b for b in bodies if b is not ego and b.crashed]
    partner = min(crashed, key=lambda b: (_gap(box, b), b.body_id))
    offset = partner.position - ego.position
    distance = max(float(np.linalg.norm(offset)), 1e-6)
    line = offset / distance
    towards = before.speed * float(ego.direction @ line)
    approach = -float(partner.velocity @ line)
    standing = abs(before.speed) < STANDING
    code = 1 if towards >= approach and not standing else 3 if standing else 2
    angle = math.atan2(
        ego.direction[0] * offset[1] - ego.direction[1] * offset[0], float(ego.direction @ offset)
    )
    half = CAR_LENGTH / 2
    inside = before.s + half > ARM_LENGTH and before.s - half < exit_at
    return Contact(partner.body_id, _side(angle), before.speed, float(partner.speed), inside, code)


def _gap(box: Any, body: Any) -> float:
    other = np.array([[*body.position, body.heading, body.LENGTH, body.WIDTH]])
    return float(geometry.gap(box, other)[0])


def _side(angle: float) -> str:
    """Where an angle from straight ahead points; y is south, so positive is to the right."""
    if abs(angle) < math.pi / 4:
        return "front"
    if abs(angle) > 3 * math.pi / 4:
        return "rear"
    return "right" if angle > 0 else "left"
