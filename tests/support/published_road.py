"""The junction's road as highway-env publishes it: its own search for lanes, steering and checks.

``pytest_dura.driving`` does the same quicker, to the last bit. This is what the benchmarks compare
it with, and the tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle

from pytest_dura.driving import FOUR_WAY, highway, traffic


class Driver(traffic.Driver):
    """Acts as highway-env has it; the limits of route and right of way come afterwards."""

    steering_control = ControlledVehicle.steering_control

    def act(self, action: Any = None) -> None:
        """highway-env's Intelligent Driver Model, then the limits."""
        IDMVehicle.act(self, action)
        if not self.crashed:
            limit = self.road.limit_for(self)
            if limit < self.action["acceleration"]:
                self.action["acceleration"] = max(limit, -self.ACC_MAX)


class Ego(traffic.Ego):
    """Steers as highway-env has it."""

    steering_control = ControlledVehicle.steering_control

    def act(self, _action: Any = None) -> None:
        """highway-env's lane keeping, and the speed control below."""
        ControlledVehicle.act(self, None)

    def speed_control(self, _target_speed: float) -> float:
        """The acceleration that the actuator gives."""
        return self.executed


class JunctionRoad(traffic.JunctionRoad):
    """Asks every pair of bodies whether they touch, and every body whether it is on the lane."""

    def step(self, dt: float) -> None:
        """Move everybody, then see who touches whom."""
        for vehicle in self.vehicles:
            vehicle.step(dt)
        for i, vehicle in enumerate(self.vehicles):
            for other in (*self.vehicles[i + 1 :], *self.objects):
                vehicle.handle_collisions(other)

    def neighbour_vehicles(self, vehicle: Any, lane_index: Any = None) -> tuple[Any, Any]:
        """highway-env's neighbours, without a leader that is not on the vehicle's path."""
        front, rear = Road.neighbour_vehicles(self, vehicle, lane_index)
        if front is not None:
            s, lateral = vehicle.plan.project(*front.position.tolist())
            if s < vehicle.s or abs(lateral) > (vehicle.WIDTH + front.WIDTH) / 2 + 0.8:
                front = None
        return front, rear


def network() -> RoadNetwork:
    """The junction's lanes in a network of highway-env's."""
    plain = RoadNetwork()
    plain.graph = highway._network(FOUR_WAY).graph
    return plain


@contextmanager
def published_road() -> Iterator[None]:
    """Context in which a ``HighwaySimulator`` that is reset gets this road."""
    plain = network()
    own = {"Driver": Driver, "Ego": Ego, "JunctionRoad": JunctionRoad}
    lanes = mock.patch.object(highway, "_network", return_value=plain)
    with mock.patch.multiple(traffic, **own), lanes:
        yield
