"""Box geometry against a polygon reference of its own, and its symmetries."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.driving import box_gap, box_time_to_collision
from pytest_dura.driving.bodies import boxes_overlap

CAP = 10.0

quick = settings(derandomize=True, deadline=None, max_examples=150)

coordinates = st.floats(-12.0, 12.0)
angles = st.floats(-7.0, 7.0)
sizes = st.floats(0.3, 8.0)
speeds = st.floats(-12.0, 12.0)
boxes = st.tuples(coordinates, coordinates, angles, sizes, sizes)
velocities = st.tuples(speeds, speeds)

Point = tuple[float, float]


def corners_of(box: Any) -> list[Point]:
    """Counter-clockwise corners, written out without matrices."""
    x, y, heading, length, width = box
    c, s = math.cos(heading), math.sin(heading)
    local = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    ends = [(i * length / 2, j * width / 2) for i, j in local]
    return [(x + c * along - s * across, y + s * along + c * across) for along, across in ends]


def edges_of(points: list[Point]) -> list[tuple[Point, Point]]:
    return list(zip(points, points[1:] + points[:1], strict=True))


def to_segment(point: Point, a: Point, b: Point) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / (dx * dx + dy * dy)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - a[0] - share * dx, point[1] - a[1] - share * dy)


def left_of(point: Point, a: Point, b: Point) -> float:
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])


def inside(point: Point, polygon: list[Point]) -> bool:
    return all(left_of(point, a, b) >= 0.0 for a, b in edges_of(polygon))


def cross(one: tuple[Point, Point], other: tuple[Point, Point]) -> bool:
    """Whether they cross within both; ends that merely touch are a corner's distance of 0."""
    (a, b), (c, d) = one, other
    return left_of(c, a, b) * left_of(d, a, b) < 0.0 and left_of(a, c, d) * left_of(b, c, d) < 0.0


def reference_gap(one: Any, other: Any) -> float:
    """Distance of two polygons by corners, edges and containment."""
    p, q = corners_of(one), corners_of(other)
    if inside(p[0], q) or inside(q[0], p):
        return 0.0
    if any(cross(e, f) for e in edges_of(p) for f in edges_of(q)):
        return 0.0
    return min(
        *(to_segment(point, *edge) for point in p for edge in edges_of(q)),
        *(to_segment(point, *edge) for point in q for edge in edges_of(p)),
    )


def gap(one: Any, other: Any) -> float:
    return float(box_gap(np.array([one]), np.array([other]))[0])


def ttc(one: Any, v: Any, other: Any, w: Any, cap: float = CAP) -> float:
    arrays = (np.array([value], dtype=float) for value in (one, v, other, w))
    return float(box_time_to_collision(*arrays, cap)[0])


def moved(box: Any, velocity: Any, time: float) -> Any:
    return (box[0] + velocity[0] * time, box[1] + velocity[1] * time, *box[2:])


@quick
@given(one=boxes, other=boxes)
def test_gap_is_the_distance_of_the_polygons(one: Any, other: Any) -> None:
    assert gap(one, other) == pytest.approx(reference_gap(one, other), abs=1e-9)


@quick
@given(one=boxes, other=boxes)
def test_gap_is_zero_exactly_on_overlap(one: Any, other: Any) -> None:
    touches = bool(boxes_overlap(np.array([one]), np.array([other]))[0])
    assert (gap(one, other) == 0.0) == touches


@quick
@given(one=boxes, other=boxes, v=velocities, w=velocities)
def test_both_measures_are_symmetric(one: Any, other: Any, v: Any, w: Any) -> None:
    assert gap(one, other) == pytest.approx(gap(other, one), abs=1e-9)
    assert ttc(one, v, other, w) == pytest.approx(ttc(other, w, one, v), abs=1e-6)


@quick
@given(
    pair=st.tuples(boxes, boxes),
    courses=st.tuples(velocities, velocities),
    motion=st.tuples(angles, coordinates, coordinates),
)
def test_rotation_and_translation_change_nothing(pair: Any, courses: Any, motion: Any) -> None:
    (one, other), (v, w), (turn, dx, dy) = pair, courses, motion
    c, s = math.cos(turn), math.sin(turn)

    def turned(x: float, y: float) -> Point:
        return c * x - s * y, s * x + c * y

    def carried(box: Any) -> Any:
        x, y = turned(box[0], box[1])
        return (x + dx, y + dy, box[2] + turn, *box[3:])

    assert gap(carried(one), carried(other)) == pytest.approx(gap(one, other), abs=1e-7)
    before = ttc(one, v, other, w)
    after = ttc(carried(one), turned(*v), carried(other), turned(*w))
    # A graze may turn into a miss by rounding: then it must be a graze.
    if abs(before - after) > 1e-5:
        times = np.linspace(0.0, CAP, 2001)
        least = min(gap(moved(one, v, t), moved(other, w, t)) for t in times)
        deepest = min(
            gap((*moved(one, v, t)[:3], one[3] - 1e-4, one[4] - 1e-4), moved(other, w, t))
            for t in times
        )
        assert least < 0.05
        assert deepest > 0.0


@quick
@given(one=boxes, other=boxes, v=velocities, w=velocities)
def test_pairstepped_forward_meet_at_the_time_to_collision(
    one: Any, other: Any, v: Any, w: Any
) -> None:
    time = ttc(one, v, other, w)
    assert 0.0 <= time <= CAP
    if time == 0.0:
        assert gap(one, other) < 1e-6
        return
    for earlier in np.linspace(0.0, time, 40, endpoint=False):
        there, here = moved(one, v, earlier), moved(other, w, earlier)
        assert reference_gap(there, here) > 0.0
    if time < CAP:
        assert reference_gap(moved(one, v, time), moved(other, w, time)) < 1e-6


@quick
@given(one=boxes, other=boxes, v=velocities, w=velocities, cap=st.floats(0.0, 5.0))
def test_the_time_to_collision_is_capped(one: Any, other: Any, v: Any, w: Any, cap: float) -> None:
    assert ttc(one, v, other, w, cap) == min(ttc(one, v, other, w, 1e9), cap)


@quick
@given(one=boxes, other=boxes, v=velocities)
def test_pairin_step_never_meet(one: Any, other: Any, v: Any) -> None:
    expected = 0.0 if gap(one, other) == 0.0 else CAP
    assert ttc(one, v, other, v) == expected


def test_crossing_pairwhose_corners_are_outside_each_other_overlap() -> None:
    plank, crossing = (0.0, 0.0, 0.0, 10.0, 1.0), (0.0, 0.0, math.pi / 2, 10.0, 1.0)
    assert not any(inside(point, corners_of(plank)) for point in corners_of(crossing))
    assert gap(plank, crossing) == 0.0
    assert ttc(plank, (0, 0), crossing, (0, 0)) == 0.0


def test_a_box_within_a_box_is_in_contact() -> None:
    assert gap((0.0, 0.0, 0.3, 8.0, 8.0), (1.0, 1.0, 1.0, 0.5, 0.5)) == 0.0


def test_touching_counts_as_contact() -> None:
    one, other = np.array([[0.0, 0.0, 0.0, 4.0, 2.0]]), np.array([[4.0, 0.0, 0.0, 4.0, 2.0]])
    assert box_gap(one, other) == 0.0
    assert boxes_overlap(one, other)
    assert gap((0.0, 0.0, 0.0, 4.0, 2.0), (4.5, 0.0, 0.0, 4.0, 2.0)) == pytest.approx(0.5)


def test_a_known_time_to_collision() -> None:
    ahead, behind = (20.0, 0.0, 0.0, 5.0, 2.0), (0.0, 0.0, 0.0, 5.0, 2.0)
    assert ttc(behind, (10, 0), ahead, (5, 0)) == pytest.approx(3.0)
    assert ttc(behind, (10, 0), ahead, (11, 0)) == CAP
    passing = (20.0, 2.1, 0.0, 5.0, 2.0)
    assert ttc(behind, (10, 0), passing, (-10, 0)) == CAP
    assert ttc(behind, (1, 0), ahead, (0, 0), cap=12.0) == 12.0


def test_pairs_are_independent() -> None:
    rng = np.random.default_rng(7)
    one = rng.uniform(0.5, 9.0, (40, 5))
    other = rng.uniform(0.5, 9.0, (40, 5))
    v, w = rng.uniform(-9.0, 9.0, (2, 40, 2))
    together = box_gap(one, other)
    times = box_time_to_collision(one, v, other, w, CAP)
    for i in range(40):
        assert together[i] == pytest.approx(gap(one[i], other[i]), abs=1e-12)
        assert times[i] == pytest.approx(ttc(one[i], v[i], other[i], w[i]), abs=1e-12)


def test_no_pairs_at_all() -> None:
    none = np.empty((0, 5))
    assert box_gap(none, none).shape == (0,)
    assert box_time_to_collision(none, none[:, :2], none, none[:, :2], CAP).shape == (0,)
