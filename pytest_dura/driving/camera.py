"""Pictures of the road in perspective: the views of the ego's two cameras on the ground truth.

A pinhole camera: the ground is looked up where each pixel's ray meets it, and what stands on it is
filled polygon by polygon, the nearest one first in a buffer of inverse distances. Everything is
plain arithmetic on arrays: no display is opened, and no draw is random. Faults of lidar are not in
it, so that a picture contradicts a ghost that lidar reports.

Metres, x east and y south as highway-env has it, z up; headings in radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH
from pytest_dura.driving.outlines import corners, flat_sides
from pytest_dura.driving.roads import FOUR_WAY, Arm, Road

Colour = tuple[int, int, int]
Point = tuple[float, float, float]

FRONT_SIZE, THIRD_PERSON_SIZE = 128, 300
"""Pixels of a side; both pictures are square."""

COLOURS: Mapping[str, Colour] = {
    "car": (36, 92, 214), "ego": (0, 172, 168), "parked_car": (140, 104, 176),
    "parked_van": (140, 104, 176), "hedge": (52, 92, 48),
    "pedestrian": (236, 32, 150), "cones": (255, 116, 0), "island": (228, 214, 120),
    "give_way": (214, 18, 28), "priority_road": (252, 190, 0),
    "red": (255, 30, 20), "yellow": (255, 200, 0), "green": (20, 230, 90),
    "sky": (158, 196, 234), "haze": (218, 230, 240), "trees": (84, 112, 84),
    "grass": (104, 148, 84), "pavement": (172, 166, 156), "kerb": (208, 204, 196),
    "road": (82, 84, 90), "marking": (240, 240, 236), "shadow": (52, 54, 58),
}  # fmt: skip
"""Colours by kind, in full light: sides of a body that face away from the sun are darker."""

_WINDOW, _TYRE, _SKIN, _METAL = (44, 56, 70), (26, 26, 28), (226, 178, 146), (128, 132, 136)
_WHITE, _LAMP, _REAR_LAMP, _UNLIT = (248, 248, 244), (255, 246, 206), (206, 16, 16), (40, 40, 42)
_SIGN, _LIGHT = 1.5, 0.8
"""m right of the road's edge to the post of a sign, and to that of a signal."""
_SUN = (-0.45, 0.35, 0.82)
_AMBIENT = 0.6
"""Share of its colour that a side in the shade keeps."""
_NEAR = 0.3
"""m; what is nearer to a camera is cut off."""
_FARTHEST = 150.0
"""m; what stands farther away is not drawn."""
_MARK = 0.1
"""m; half the width of the centre line."""
_KERB, _PAVEMENT = 0.25, 2.6
"""m from the edge of the road to where the kerb and the pavement end."""
_GROUND = ("grass", "pavement", "kerb", "road", "marking")


class Posed(Protocol):
    """Anything with a place and a heading."""

    @property
    def x(self) -> float:
        """Metres east."""

    @property
    def y(self) -> float:
        """Metres south."""

    @property
    def heading(self) -> float:
        """Radians."""


class Solid(NamedTuple):
    """Something that stands on the ground; ``kind`` is one of :data:`COLOURS`.

    A car, the ego, a pedestrian or an obstacle has a footprint. A sign (``give_way``,
    ``priority_road``) or the head of a signal (its state) faces ``heading``, and has none.
    """

    kind: str
    x: float
    y: float
    heading: float
    length: float = 0.0
    width: float = 0.0


class Mount(NamedTuple):
    """Place of a camera on the ego, in m and degrees, and its optics."""

    size: int
    ahead: float
    height: float
    pitch: float
    """Downwards."""
    field_of_view: float
    samples: int
    """Per pixel, along each side."""


FRONT = Mount(FRONT_SIZE, 1.2, 1.6, 7.0, 60.0, 2)
"""Behind the windscreen, with the bonnet at the lower edge."""
THIRD_PERSON = Mount(THIRD_PERSON_SIZE, -11.0, 6.5, 19.0, 70.0, 2)
"""Behind the ego and above it."""


def front(ego: Posed, solids: Sequence[Solid], road: Road = FOUR_WAY) -> NDArray[np.uint8]:
    """The view through the windscreen; shape ``(128, 128, 3)``, RGB.

    Args:
        ego: Where it is.
        solids: What else stands on the ground.
        road: On which it is.
    """
    return _Picture(FRONT, ego, road).of([*solids, _ego(ego)])


def third_person(ego: Posed, solids: Sequence[Solid], road: Road = FOUR_WAY) -> NDArray[np.uint8]:
    """The ego from behind and above, and what is ahead of it; shape ``(300, 300, 3)``, RGB.

    Args:
        ego: Where it is.
        solids: What else stands on the ground.
        road: On which it is.
    """
    return _Picture(THIRD_PERSON, ego, road).of([*solids, _ego(ego)])


def sign_beside(arm: Arm, kind: str) -> Solid:
    """A sign at the stop line of an arm, facing who comes on it; ``kind`` is its colour's."""
    return _at_line(arm, kind, arm.lane_width + _SIGN)


def light_beside(arm: Arm, state: str) -> Solid:
    """The head of a signal in a state, at the stop line of an arm, facing who comes on it."""
    return _at_line(arm, state, arm.lane_width + _LIGHT)


def _at_line(arm: Arm, kind: str, beside: float) -> Solid:
    x, y = arm.place(arm.stop_line + 0.4, beside)
    return Solid(kind, x, y, arm.angle + math.pi / 2)


def _ego(ego: Posed) -> Solid:
    return Solid("ego", ego.x, ego.y, ego.heading, CAR_LENGTH, CAR_WIDTH)


class _Face(NamedTuple):
    """A flat convex polygon that is seen from where its normal points."""

    points: Sequence[Point]
    normal: Point
    colour: Colour


class _Picture:
    """A picture that is being made, with ``mount.samples`` times as many pixels along a side."""

    def __init__(self, mount: Mount, ego: Posed, road: Road) -> None:
        self._road = road
        size = mount.size * mount.samples
        self._mount, self._size = mount, size
        c, s = math.cos(ego.heading), math.sin(ego.heading)
        pitch = math.radians(mount.pitch)
        dip, level = math.sin(pitch), math.cos(pitch)
        self._place = ego.x + c * mount.ahead, ego.y + s * mount.ahead, mount.height
        self._at = np.array(self._place)
        right, down, ahead = (
            (-s, c, 0.0),
            (-c * dip, -s * dip, -level),
            (c * level, s * level, -dip),
        )
        self._axes = np.array([right, down, ahead])
        self._focal = size / 2 / math.tan(math.radians(mount.field_of_view) / 2)
        self._steps = ((np.arange(size) + 0.5 - size / 2) / self._focal).astype(np.float32)
        self._pixels = np.empty((size, size, 3), np.uint8)
        self._nearness = np.zeros((size, size), np.float32)
        """Inverse distance along the view of what each pixel shows; 0 for ground and sky."""

    def of(self, solids: Sequence[Solid]) -> NDArray[np.uint8]:
        """The picture of sky, ground and what stands there."""
        self._paint_sky_and_ground()
        visible = [solid for solid in solids if self._may_see(solid)]
        for solid in visible:
            if solid.length:
                self._fill(_footprint(solid), COLOURS["shadow"], flat=True)
        for solid in visible:
            for face in _faces(solid):
                self._show(face)
        samples, fine = self._mount.samples, self._pixels.astype(np.uint16)
        parts = [fine[i::samples, j::samples] for i in range(samples) for j in range(samples)]
        picture: NDArray[np.uint8] = (sum(parts, np.uint16(samples**2 // 2)) // samples**2).astype(
            np.uint8
        )
        return picture

    def _may_see(self, solid: Solid) -> bool:
        dx, dy = solid.x - self._at[0], solid.y - self._at[1]
        ahead = dx * self._axes[2, 0] + dy * self._axes[2, 1]
        return bool(math.hypot(dx, dy) < _FARTHEST and ahead > -max(solid.length, 1.0))

    def _paint_sky_and_ground(self) -> None:
        (r_x, r_y, _), (d_x, d_y, d_z), (f_x, f_y, f_z) = self._axes.tolist()
        rises = f_z + self._steps.astype(float) * d_z
        horizon = int(np.count_nonzero(rises > -self._at[2] / _FARTHEST))
        upwards = np.clip(np.arange(horizon, 0, -1) / self._focal / 0.6, 0.0, 1.0)[:, None]
        sky = (1 - upwards) * np.array(COLOURS["haze"]) + upwards * np.array(COLOURS["sky"])
        self._pixels[:horizon] = sky[:, None, :].astype(np.uint8)
        trees = max(horizon - int(0.035 * self._focal), 0)
        self._pixels[trees:horizon] = COLOURS["trees"]
        # Where the ray of each pixel below the horizon meets the ground.
        reach = (-self._at[2] / rises[horizon:]).astype(np.float32)[:, None]
        across, below = self._steps[None, :], self._steps[horizon:, None]
        x = np.float32(self._at[0]) + reach * (f_x + across * r_x + below * d_x)
        y = np.float32(self._at[1]) + reach * (f_y + across * r_y + below * d_y)
        palette = np.array([COLOURS[name] for name in _GROUND], np.uint8)
        self._pixels[horizon:] = palette[
            _ground(x.astype(np.float32), y.astype(np.float32), self._road)
        ]

    def _show(self, face: _Face) -> None:
        (x, y, z), (n_x, n_y, n_z) = face.points[0], face.normal
        at_x, at_y, at_z = self._place
        if n_x * (at_x - x) + n_y * (at_y - y) + n_z * (at_z - z) <= 0.0:
            return
        light = max(n_x * _SUN[0] + n_y * _SUN[1] + n_z * _SUN[2], 0.0)
        light = _AMBIENT + (1.0 - _AMBIENT) * light
        self._fill(face.points, [round(part * light) for part in face.colour])

    def _fill(self, points: Sequence[Point], colour: Sequence[int], *, flat: bool = False) -> None:
        """Fill a convex polygon where nothing nearer is.

        Args:
            points: Its corners.
            colour: As it is shown.
            flat: Whether it lies on the ground, below all that stands there.
        """
        seen = _clipped(((np.array(points) - self._at) @ self._axes.T).tolist())
        if len(seen) < 3:
            return
        corners = [(a / c, b / c) for a, b, c in seen]
        half, focal = self._size / 2, self._focal
        columns, rows = (
            [value * focal + half for value in axis] for axis in zip(*corners, strict=True)
        )
        left, top = max(math.floor(min(columns)), 0), max(math.floor(min(rows)), 0)
        right = min(math.ceil(max(columns)) + 1, self._size)
        low = min(math.ceil(max(rows)) + 1, self._size)
        if left >= right or top >= low:
            return
        across, below = self._steps[None, left:right], self._steps[top:low, None]
        edges = [(*corners[index - 1], *corners[index]) for index in range(len(corners))]
        turning = math.copysign(1.0, sum(a0 * b1 - a1 * b0 for a0, b0, a1, b1 in edges))
        inside: NDArray[np.bool_] = np.ones((1, 1), bool)
        for a0, b0, a1, b1 in edges:
            # Which side of the edge: the cross product of edge and way to the pixel.
            slope_a, slope_b = turning * (a1 - a0), turning * (b1 - b0)
            within = slope_a * below - slope_b * across >= slope_a * b0 - slope_b * a0
            inside = inside & within
        pixels = self._pixels[top:low, left:right]
        if flat:
            pixels[inside] = colour
            return
        n_a, n_b, n_c = _cross(seen[0], seen[1], seen[2])
        offset = n_a * seen[0][0] + n_b * seen[0][1] + n_c * seen[0][2]
        if offset == 0.0:
            return  # seen edge on
        nearness = n_a / offset * across + (n_b / offset * below + n_c / offset)
        known = self._nearness[top:low, left:right]
        inside &= nearness > known
        pixels[inside] = colour
        known[inside] = nearness[inside]


def _ground(x: NDArray[np.float32], y: NDArray[np.float32], road: Road) -> NDArray[np.uint8]:
    """Index into ``_GROUND`` of each point on the ground."""
    # On which arm each point is: the one along which it lies farthest out.
    along, beside = _dot(x, y, road.arms[0].outward), _dot(x, y, road.arms[0].right)
    number = np.zeros(x.shape, np.int8)
    for index, arm in enumerate(road.arms[1:], start=1):
        out = _dot(x, y, arm.outward)
        on_it = out > along
        along = np.maximum(out, along)
        beside = np.where(on_it, _dot(x, y, arm.right), beside)
        number[on_it] = index
    width, stop_line, end, two_lanes, towards = (
        column[0] if len(set(column.tolist())) == 1 else column[number] for column in _columns(road)
    )
    off = np.abs(beside)
    inner = along < stop_line
    beyond_edge = off - width
    beyond_edge[inner] = _beyond_kerbs(x[inner], y[inner], road)
    beyond_edge[along > end] = np.inf
    surface = np.zeros(x.shape, np.uint8)
    surface[beyond_edge < _PAVEMENT] = 1
    surface[beyond_edge < _KERB] = 2
    surface[beyond_edge < 0.0] = 3
    dashes = (off < _MARK) & (along > stop_line + 1.0) & (surface == 3) & (two_lanes > 0.0)
    dashes[dashes] = along[dashes] % 6.0 < 3.0
    # The lane towards the junction is right of the middle, on each arm.
    across = (beside > 0.25) & (off < width - 0.25) & (towards > 0.0)
    line = across & ~inner & (along < stop_line + 0.5)
    surface[dashes | line] = 4
    return surface


def _dot(
    x: NDArray[np.float32], y: NDArray[np.float32], along: tuple[float, float]
) -> NDArray[np.float32]:
    product: NDArray[np.float32] = x * np.float32(along[0]) + y * np.float32(along[1])
    return product


@cache
def _columns(road: Road) -> NDArray[np.float32]:
    """Of each arm: lane width, stop line, end, whether it has two lanes, and one inwards."""
    rows = [
        (arm.lane_width, arm.stop_line, arm.end, arm.lanes == "both", arm.lanes != "out")
        for arm in road.arms
    ]
    columns: NDArray[np.float32] = np.array(rows, np.float32).T
    return columns


def _beyond_kerbs(
    x: NDArray[np.float32], y: NDArray[np.float32], road: Road
) -> NDArray[np.float32]:
    """Metres beyond the kerbs that bound the area between the stop lines; negative within them."""
    beyond = np.full(x.shape, -np.inf, np.float32)
    for (centre_x, centre_y), radius in corners(road):
        away = np.hypot(np.float32(centre_x) - x, np.float32(centre_y) - y)
        beyond = np.maximum(beyond, np.float32(radius) - away)
    for (x0, y0), (x1, y1) in flat_sides(road):
        length = math.hypot(x1 - x0, y1 - y0)
        # Seen from the first arm to the next one, counter-clockwise, the outside is to the right.
        out = (y0 - y1) / length, (x1 - x0) / length
        side = _dot(x, y, out) - np.float32(x0 * out[0] + y0 * out[1])
        beyond = np.maximum(beyond, side)
    return beyond


def _clipped(points: list[list[float]]) -> list[list[float]]:
    """The part of a convex polygon that lies before the camera, in the camera's axes."""
    before = [point[2] >= _NEAR for point in points]
    if all(before) or not any(before):
        return points if before[0] else []
    kept = []
    for index, point in enumerate(points):
        last = points[index - 1]
        if before[index] != before[index - 1]:
            share = (_NEAR - last[2]) / (point[2] - last[2])
            kept.append([a + share * (b - a) for a, b in zip(last, point, strict=True)])
        if before[index]:
            kept.append(point)
    return kept


def _cross(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> Point:
    """The cross product of the ways from a point to two others."""
    x0, y0, z0 = (q - p for p, q in zip(a, b, strict=True))
    x1, y1, z1 = (q - p for p, q in zip(a, c, strict=True))
    return y0 * z1 - z0 * y1, z0 * x1 - x0 * z1, x0 * y1 - y0 * x1


def _faces(solid: Solid) -> Iterator[_Face]:
    """All faces of what stands there."""
    kind, colour = solid.kind, COLOURS[solid.kind]
    if kind == "pedestrian":
        yield from _pedestrian(solid, colour)
    elif kind == "cones":
        yield from _cones(solid, colour)
    elif kind == "hedge":
        size = solid.length, solid.width
        yield from _box(solid, (0.0, 2.0), size, size, colour)
    elif kind == "island":
        size = solid.length, solid.width
        yield from _box(solid, (0.0, 0.18), size, size, colour)
    elif kind in ("give_way", "priority_road"):
        yield from _sign(solid, colour)
    elif kind in ("red", "yellow", "green"):
        yield from _signal(solid)
    else:
        yield from _car(solid, colour)


def _car(car: Solid, paint: Colour) -> Iterator[_Face]:
    length, width = car.length, car.width
    low = 0.86 * length, 0.96 * width
    yield from _box(car, (0.0, 0.35), low, low, _TYRE)
    yield from _box(car, (0.3, 0.85), (length, width), (0.97 * length, 0.95 * width), paint)
    back = -0.07 * length
    cabin, roof = (0.62 * length, 0.9 * width), (0.4 * length, 0.76 * width)
    yield from _box(car, (0.85, 1.45), cabin, roof, _WINDOW, top=paint, ahead=back)
    for end, lamp in ((1.0, _LAMP), (-1.0, _REAR_LAMP)):
        for side in (1.0, -1.0):
            inner, outer = side * 0.24 * width, side * 0.47 * width
            corners = [(inner, 0.5), (outer, 0.5), (outer, 0.75), (inner, 0.75)]
            yield _plate(car, corners, lamp, ahead=length / 2 + 0.01, turned=end)


def _pedestrian(person: Solid, colour: Colour) -> Iterator[_Face]:
    darker = tuple(round(0.72 * part) for part in colour)
    legs, chest, head = (0.3, 0.36), (0.34, 0.56), (0.26, 0.24)
    yield from _box(person, (0.0, 0.85), legs, legs, (darker[0], darker[1], darker[2]))
    yield from _box(person, (0.85, 1.48), chest, chest, colour)
    yield from _box(person, (1.5, 1.76), head, head, _SKIN)


def _cones(row: Solid, colour: Colour) -> Iterator[_Face]:
    """A row of cones along its length, about a metre apart."""
    count = max(round(row.length) + 1, 2)
    foot = min(row.width, 0.5)
    for place in np.linspace(-0.5, 0.5, count).tolist():
        ahead = place * (row.length - foot)
        yield from _box(row, (0.0, 0.75), (foot, foot), (0.06, 0.06), colour, ahead=ahead)


def _sign(sign: Solid, colour: Colour) -> Iterator[_Face]:
    yield from _box(sign, (0.0, 1.7), (0.08, 0.08), (0.08, 0.08), _METAL)
    if sign.kind == "give_way":
        outline, inner = [(-0.62, 2.72), (0.62, 2.72), (0.0, 1.65)], _WHITE
        outer, share, middle = colour, 0.52, 2.37
    else:
        outline = [(-0.6, 2.2), (0.0, 2.8), (0.6, 2.2), (0.0, 1.6)]
        outer, inner, share, middle = _WHITE, colour, 0.78, 2.2
    symbol = [(share * across, middle + share * (z - middle)) for across, z in outline]
    yield _plate(sign, outline, outer, ahead=0.05)
    yield _plate(sign, symbol, inner, ahead=0.07)
    yield _plate(sign, outline, _METAL, ahead=-0.04, turned=-1.0)


def _signal(head: Solid) -> Iterator[_Face]:
    """The three lamps of a signal, of which one is lit."""
    yield from _box(head, (0.0, 2.2), (0.12, 0.12), (0.12, 0.12), _METAL)
    yield from _box(head, (2.2, 3.7), (0.3, 0.56), (0.3, 0.56), _TYRE)
    angles = np.arange(8) * math.pi / 4
    for place, state in enumerate(("green", "yellow", "red")):
        lamp = COLOURS[state] if state == head.kind else _UNLIT
        middle = 2.45 + 0.5 * place
        corners = [
            (0.22 * math.cos(angle), middle + 0.22 * math.sin(angle)) for angle in angles.tolist()
        ]
        yield _plate(head, corners, lamp, ahead=0.17)


def _box(
    solid: Solid,
    heights: tuple[float, float],
    bottom: tuple[float, float],
    top_size: tuple[float, float],
    colour: Colour,
    *,
    top: Colour | None = None,
    ahead: float = 0.0,
) -> Iterator[_Face]:
    """Top and sides of a box whose top may be smaller than its bottom.

    Args:
        solid: Along whose heading it lies.
        heights: Of bottom and top.
        bottom: Length and width at the bottom.
        top_size: The same at the top.
        colour: Of the sides.
        top: Of the top; that of the sides by default.
        ahead: Metres from the middle of the solid to the middle of the box.
    """
    lower, upper = (
        [
            _beside(solid, ahead + fore * length / 2, side * width / 2, z)
            for fore, side in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        for (length, width), z in ((bottom, heights[0]), (top_size, heights[1]))
    )
    yield _Face(upper, (0.0, 0.0, 1.0), top or colour)
    for index in range(4):
        following = (index + 1) % 4
        n_x, n_y, n_z = _cross(lower[index], lower[following], upper[index])
        size = math.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
        side = [lower[index], lower[following], upper[following], upper[index]]
        yield _Face(side, (n_x / size, n_y / size, n_z / size), colour)


def _plate(
    solid: Solid,
    corners: Sequence[tuple[float, float]],
    colour: Colour,
    *,
    ahead: float,
    turned: float = 1.0,
) -> _Face:
    """An upright polygon across a solid, facing its heading.

    Args:
        solid: Along whose heading it faces.
        corners: Metres to the right and up.
        colour: Of it.
        ahead: Metres from the middle of the solid to it.
        turned: -1 to face backwards, where ``ahead`` counts backwards as well if it is positive.
    """
    distance = ahead if ahead < 0.0 else turned * ahead
    points = [_beside(solid, distance, right, z) for right, z in corners]
    normal = turned * math.cos(solid.heading), turned * math.sin(solid.heading), 0.0
    return _Face(points, normal, colour)


def _footprint(solid: Solid) -> list[Point]:
    """The shadow on the ground: a little more than the footprint."""
    length, width = solid.length / 2 + 0.15, solid.width / 2 + 0.15
    return [
        _beside(solid, fore * length, side * width, 0.0)
        for fore, side in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]


def _beside(solid: Solid, ahead: float, right: float, z: float) -> Point:
    """The point so many metres ahead of a solid's middle, right of it and above the ground."""
    c, s = math.cos(solid.heading), math.sin(solid.heading)
    return solid.x + c * ahead - s * right, solid.y + s * ahead + c * right, z
