"""The built-in four-way junction, by its numbers and routes; see ``pytest_dura.driving.roads``.

Geometry of highway-env's intersection: arms 0 south, 1 west, 2 north, 3 east; x east, y south;
lanes 4 m wide, arms 100 m long, stop lines 11 m from the centre. The east-west road has priority.
Nothing here holds for another road: roles read the channel ``map``.
"""

from __future__ import annotations

from pytest_dura.driving.lanes import Route, conflict, route_between, route_by_turn, routes_of
from pytest_dura.driving.roads import FOUR_WAY

__all__ = [
    "ARMS",
    "ARM_LENGTH",
    "SPEED_LIMIT",
    "Route",
    "all_routes",
    "conflict",
    "route",
    "route_between",
]

ARMS = FOUR_WAY.names
ARM_LENGTH = FOUR_WAY.arms[0].length
SPEED_LIMIT = FOUR_WAY.speed_limit


def route(origin: int, turn: str) -> Route:
    """The Route object of this origin and turn, the same at each call."""
    return route_by_turn(FOUR_WAY, origin, turn)


def all_routes() -> list[Route]:
    """The twelve routes."""
    return list(routes_of(FOUR_WAY))
