"""Bodies with a box, for road simulators whose own objects driving does not see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, boxes_overlap

_TOUCH = 1e-6


class BoxBody:
    """A body as :class:`~pytest_dura.driving.highway.JunctionSimulator` handles it."""

    LENGTH, WIDTH = CAR_LENGTH, CAR_WIDTH
    action: Mapping[str, float] = {"steering": 0.0}  # without a slip angle

    def __init__(self, body_id: str, x: float, y: float, heading: float, speed: float) -> None:
        self.body_id, self.speed, self.crashed = body_id, speed, False
        self.stand_at(x, y, heading)

    def stand_at(self, x: float, y: float, heading: float) -> None:
        """Take a place and heading, as driving has them."""
        self.position, self.heading = np.array([x, y]), heading
        self.direction = np.array([math.cos(heading), math.sin(heading)])

    @property
    def velocity(self) -> Any:
        """In m/s, shape ``(2,)``."""
        return self.speed * self.direction

    @property
    def reach(self) -> float:
        """Half of the diagonal in m."""
        return math.hypot(self.LENGTH, self.WIDTH) / 2

    @property
    def box(self) -> tuple[float, ...]:
        """A row as ``bodies.boxes_overlap`` takes it."""
        return (*self.position.tolist(), self.heading, self.LENGTH, self.WIDTH)


def touching(
    cars: Sequence[BoxBody], others: Sequence[BoxBody]
) -> Iterator[tuple[BoxBody, BoxBody]]:
    """Yield the pairs whose boxes overlap, at least one of them a car."""
    bodies = [(body, *body.position.tolist(), body.reach) for body in (*cars, *others)]
    for i, (car, x, y, reach) in enumerate(bodies[: len(cars)]):
        for other, other_x, other_y, other_reach in bodies[i + 1 :]:
            if math.hypot(other_x - x, other_y - y) > reach + other_reach + _TOUCH:
                continue
            if boxes_overlap(np.array([car.box]), np.array([other.box]))[0]:
                yield car, other


def refuse_rules_of_drivers(vehicles: Sequence[Mapping[str, Any]], whose: str) -> None:
    """Refuse vehicles that drive by rules of driving's own drivers.

    Raises:
        ConfigurationError: With the vehicle's number in ``key``.
    """
    for number, vehicle in enumerate(vehicles):
        for key in vehicle.keys() & {"gives_way", "brakes_at"}:
            raise ConfigurationError(
                f"{whose} drivers know no {key!r}",
                key=f"world.vehicles.{number}.{key}",
                found=vehicle[key],
                expected=f"a vehicle that drives as {whose} drivers do",
                remedy="run the scenario in the simulator `driving`",
            )
