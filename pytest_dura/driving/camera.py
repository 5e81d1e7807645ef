"""Pictures of the road, drawn by highway-env on a surface in memory.

No display is opened, so ``SDL_VIDEODRIVER=dummy``, which makes highway-env's own viewer black,
does no harm here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SIZE = 300
"""Pixels of the third-person view, square."""
SCALING = 3.75
"""Pixels per metre: the picture shows 80 m by 80 m."""
FRONT_SIZE = 128
FRONT_REACH = 40.0
"""m; the front view shows this far ahead, and half of it to each side."""


def third_person(road: Any, position: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The road from above, ``position`` in the middle, north up; shape ``(300, 300, 3)``, RGB."""
    import pygame
    from highway_env.road.graphics import RoadGraphics, WorldSurface

    surface = WorldSurface((SIZE, SIZE), 0, pygame.Surface((SIZE, SIZE)))
    surface.scaling = SCALING
    surface.centering_position = [0.5, 0.5]
    surface.move_display_window_to(position)
    RoadGraphics.display(road, surface)
    RoadGraphics.display_road_objects(road, surface, offscreen=True)
    RoadGraphics.display_traffic(road, surface, simulation_frequency=10, offscreen=True)
    picture: NDArray[np.uint8] = pygame.surfarray.array3d(surface).transpose(1, 0, 2)
    return np.ascontiguousarray(picture)


def front(road: Any, x: float, y: float, heading: float) -> NDArray[np.uint8]:
    """What lies ahead, seen from above with the heading up; shape ``(128, 128, 3)``, RGB.

    A rectified bird's-eye view, as a front camera gives it after inverse perspective mapping.
    """
    picture = third_person(road, np.array([x, y]))
    steps = (np.arange(FRONT_SIZE) + 0.5) / FRONT_SIZE
    ahead = FRONT_REACH * (1.0 - steps)[:, None]
    right = FRONT_REACH * (steps - 0.5)[None, :]
    c, s = np.cos(heading), np.sin(heading)
    column = SIZE / 2 + SCALING * (c * ahead - s * right)
    row = SIZE / 2 + SCALING * (s * ahead + c * right)
    rows = np.clip(row.astype(int), 0, SIZE - 1)
    columns = np.clip(column.astype(int), 0, SIZE - 1)
    view: NDArray[np.uint8] = picture[rows, columns]
    return view
