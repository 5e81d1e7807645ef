"""The scene of an episode from above: the road, who was where, and who was perceived where."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.recording import POSE, Line, Scene, Tracks
from pytest_dura.core.state import Percept, Tick
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, VX, VY, BodyList
from pytest_dura.driving.junction import ARM_LENGTH, ARMS, LANE_OFFSET, STOP_LINE, Route
from pytest_dura.driving.plausible import objects, own_pose, own_speed

EGO = "EGO"
_ROAD = 2 * LANE_OFFSET
"""Metres from a road's centre line to its edge: one lane on each side."""

Row = tuple[float, float, float, float]


def junction_scene(ticks: Sequence[Tick], percepts: Sequence[Percept], route: Route) -> Scene:
    """The junction with all its bodies, one pose per tick.

    Percepts are shown as the roles take them, see ``plausible``.
    """
    egos = [tick.truth["ego"] for tick in ticks]
    truth = _tracks(
        [(ego.x, ego.y, ego.heading, ego.speed) for ego in egos],
        [tick.truth["bodies"] for tick in ticks],
    )
    believed = [(*own_pose(one), own_speed(one)) for one in percepts]
    percept = _tracks(believed, [objects(one) for one in percepts])
    planned = Line("route", route.grid[::4, 1:3].astype(np.float32))
    return Scene((*_road(), planned), truth, percept, EGO)


def _tracks(egos: Sequence[Row], bodies: Sequence[BodyList]) -> Tracks:
    """Bodies by id. Of several with one id in one tick, as faults may bring them, each is shown."""
    columns = {EGO: 0}
    # Who is there seldom changes: many ticks at once are a fraction of the work.
    runs = [(ids, list(run)) for ids, run in groupby(bodies, key=lambda one: one.ids)]
    chosen = [[columns.setdefault(one, len(columns)) for one in _distinct(ids)] for ids, _ in runs]
    poses = np.full((len(bodies), len(columns), len(POSE)), np.nan, np.float32)
    poses[:, 0, :4] = egos
    poses[:, 0, 4:] = CAR_LENGTH, CAR_WIDTH
    first = 0
    for (ids, run), own in zip(runs, chosen, strict=True):
        if ids:
            data = np.array([one.data for one in run])
            speed = np.hypot(data[:, :, VX], data[:, :, VY])
            rows = [data[:, :, :VX], speed[:, :, None], data[:, :, VY + 1 :]]
            poses[first : first + len(run), own] = np.concatenate(rows, axis=2)
        first += len(run)
    return Tracks(tuple(columns), poses)


def _distinct(ids: tuple[str, ...]) -> tuple[str, ...]:
    """The ids, with a number behind one that comes again, or that is the ego's."""
    found: list[str] = []
    for one in ids:
        name, number = one, 2
        while name in found or name == EGO:
            name, number = f"{one} ({number})", number + 1
        found.append(name)
    return tuple(found)


@cache
def _road() -> tuple[Line, ...]:
    """Edges, centre lines and stop lines of the four arms."""
    far = ARM_LENGTH + STOP_LINE
    lines = []
    for quarter in range(len(ARMS)):
        southern = [
            ("edge", [(-_ROAD, STOP_LINE), (-_ROAD, far)]),
            ("edge", [(_ROAD, STOP_LINE), (_ROAD, far)]),
            ("edge", [(_ROAD, STOP_LINE), (STOP_LINE, _ROAD)]),  # the corner to the next arm
            ("marking", [(0.0, STOP_LINE), (0.0, far)]),
            ("stop_line", [(0.0, STOP_LINE), (_ROAD, STOP_LINE)]),
        ]
        lines += [Line(kind, _turned(points, quarter)) for kind, points in southern]
    return tuple(lines)


def _turned(points: Sequence[tuple[float, float]], quarters: int) -> NDArray[np.float32]:
    """Points of the southern arm, turned by so many quarters."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    matrix = np.array([[cosine, -sine], [sine, cosine]], np.float32)
    turned: NDArray[np.float32] = np.array(points, np.float32) @ matrix.T
    return turned
