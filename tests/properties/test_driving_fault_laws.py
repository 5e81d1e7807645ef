"""The law of each fault of the driving domain, on percepts made up at random.

A test's name begins with its fault's type, which the last test holds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from roads import channels_of

from pytest_dura.core import Fault, stream
from pytest_dura.driving import CAR_LENGTH, Body, BodyList, Pose
from pytest_dura.driving.bodies import HEADING, LENGTH, VX
from pytest_dura.driving.sensors import RANGE
from pytest_dura.faults import FAULT_TYPES, Moment, fault_effect, parse_fault
from pytest_dura.faults.parts import Target

laws = settings(derandomize=True, deadline=None, max_examples=60)

metres = st.floats(-30.0, 30.0, allow_nan=False)
shifts = st.floats(-20.0, 20.0, allow_nan=False).map(lambda value: round(value, 3))
angles = st.floats(-math.pi, math.pi, allow_nan=False)
speeds = st.floats(-12.0, 12.0, allow_nan=False)
sizes = st.sampled_from([(5.0, 2.0), (0.6, 0.6)])


@st.composite
def scenes(draw: Any, least: int = 0) -> dict[str, Any]:
    """Channels of an ego on its route, and what is around it."""
    count = draw(st.integers(least, 5))
    bodies = [
        Body(f"V{index}", *draw(st.tuples(metres, metres, angles, speeds, speeds)), *draw(sizes))
        for index in range(count)
    ]
    turn = draw(st.sampled_from(["left", "straight", "right"]))
    return channels_of(*bodies, s=draw(st.floats(80.0, 140.0)), turn=turn)


def fault(kind: str, **parameters: Any) -> Fault:
    return parse_fault({"type": kind, "activation": {"at": 0.0}, "parameters": parameters})


def moment(channels: dict[str, Any], elapsed: float = 0.0, seed: int = 0) -> Moment:
    index = round(elapsed / 0.1)
    return Moment(elapsed, 0.1, elapsed, channels, [], lambda: stream(seed, f"law:{index}"))


def acted(one: Fault, channels: dict[str, Any], *elapsed: float, seed: int = 0) -> Any:
    """The target after a fault that began now; with times, after each of them."""
    before, effect = channels[Target.parse(one.target).channel], fault_effect(one)
    memory = effect.begin(before, moment(channels, 0.0, seed))
    if memory is None:
        return None
    found = [effect.apply(memory, before, moment(channels, at, seed)) for at in (elapsed or (0.0,))]
    return found if elapsed else found[0]


def alike(one: BodyList, other: BodyList) -> bool:
    return one.ids == other.ids and one.data.tobytes() == other.data.tobytes()


@laws
@given(scenes(), st.floats(0.0, 1.0), st.integers(0, 99))
def test_object_miss_leaves_out_and_changes_nothing_else(
    channels: Any, probability: float, seed: int
) -> None:
    before = channels["lidar"]
    after = acted(fault("object-miss", probability=probability), channels, seed=seed)
    assert [body for body in before if body.id in after.ids] == list(after)
    assert acted(fault("object-miss", probability=0.0), channels, seed=seed) is before
    assert len(acted(fault("object-miss", probability=1.0), channels, seed=seed)) == 0
    fewer = acted(
        fault("object-miss", probability=min(1.0, probability + 0.1)), channels, seed=seed
    )
    assert set(fewer.ids) <= set(after.ids), "the same draws: a higher rate misses those and more"


@laws
@given(scenes(least=2), st.integers(1, 6))
def test_object_miss_can_be_about_some_objects_only(channels: Any, nearest: int) -> None:
    before, pose = channels["lidar"], channels["localisation"]
    kept = acted(fault("object-miss", probability=1.0, nearest=nearest), channels)
    apart = {body.id: math.hypot(body.x - pose.x, body.y - pose.y) for body in before}
    missed = set(before.ids) - set(kept.ids)
    assert len(missed) == min(nearest, len(before))
    assert max(apart[name] for name in missed) <= min(
        (apart[n] for n in kept.ids), default=math.inf
    )
    named = acted(fault("object-miss", probability=1.0, ids=["V1", "other"]), channels)
    assert set(before.ids) - set(named.ids) == {"V1"}


def test_object_miss_misses_as_often_as_it_says() -> None:
    channels = channels_of(
        *[Body(f"V{i}", 9.0 * i, 0.0, 0.0, 0.0, 0.0, 5.0, 2.0) for i in range(4)]
    )
    seen = [len(acted(fault("object-miss"), channels, seed=seed)) for seed in range(500)]
    rate = 1.0 - sum(seen) / 2000
    assert abs(rate - 0.3) < 4 * math.sqrt(0.3 * 0.7 / 2000)


@pytest.mark.parametrize("p", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("kind", ["object-miss", "class-change"])
def test_object_miss_and_class_change_are_by_chance_exactly_if_seeds_differ(
    kind: str, p: float
) -> None:
    """A certain one that manifests nowhere leaves a run invalid, one by chance leaves it valid."""
    channels = channels_of(Body("V1", 9.0, 0.0, 0.0, 0.0, 0.0, 5.0, 2.0))
    one = fault(kind, probability=p)
    hit = {acted(one, channels, seed=seed) is not channels["lidar"] for seed in range(60)}
    assert one.by_chance == (len(hit) == 2)
    assert p == 0.3 or hit == {p == 1.0}


CHOSEN: dict[str, dict[str, Any]] = {
    "object-miss": {"probability": 0.5},
    "position-noise": {"sigma": 1.0},
    "class-change": {"probability": 0.5},
}
"""Faults that draw a number for each object, and may be about some objects only."""


@laws
@given(
    scenes(least=2),
    st.sampled_from(sorted(CHOSEN)),
    st.sets(st.integers(0, 4).map(lambda index: f"V{index}")) | st.integers(1, 4),
    st.integers(0, 99),
)
def test_what_a_fault_draws_for_an_object_depends_on_no_other_that_it_is_about(
    channels: Any, kind: str, chosen: set[str] | int, seed: int
) -> None:
    before, pose = channels["lidar"], channels["localisation"]
    if isinstance(chosen, int):
        some = fault(kind, **CHOSEN[kind], nearest=chosen)
        order = sorted(before, key=lambda b: (math.hypot(b.x - pose.x, b.y - pose.y), b.id))
        chosen = {body.id for body in order[:chosen]}
    else:
        some = fault(kind, **CHOSEN[kind], ids=sorted(chosen))
    all_chosen = acted(fault(kind, **CHOSEN[kind]), channels, seed=seed)
    found = acted(some, channels, seed=seed)
    for body in before:
        expected = all_chosen.get(body.id) if body.id in chosen else body
        assert found.get(body.id) == expected


@laws
@given(scenes(), st.floats(0.01, 5.0), st.integers(0, 99))
def test_position_noise_moves_places_alone_and_in_proportion(
    channels: Any, sigma: float, seed: int
) -> None:
    before = channels["lidar"]
    once = acted(fault("position-noise", sigma=sigma), channels, seed=seed)
    twice = acted(fault("position-noise", sigma=2.0 * sigma), channels, seed=seed)
    assert once.ids == before.ids
    assert once.data[:, HEADING:].tobytes() == before.data[:, HEADING:].tobytes()
    moved, further = ((one.data - before.data)[:, :2] for one in (once, twice))
    np.testing.assert_allclose(further, 2.0 * moved, atol=1e-9)
    assert acted(fault("position-noise", sigma=0.0), channels, seed=seed) is before


def test_position_noise_scatters_as_widely_as_it_says() -> None:
    channels = channels_of(Body("V1", 10.0, 0.0, 0.0, 0.0, 0.0, 5.0, 2.0))
    one = fault("position-noise", sigma=2.0)
    found = np.array([acted(one, channels, seed=seed).data[0, :2] for seed in range(1000)])
    errors = found - [10.0, 0.0]
    assert np.abs(errors.mean(axis=0)).max() < 4 * 2.0 / math.sqrt(1000)
    np.testing.assert_allclose(errors.std(axis=0), 2.0, rtol=0.1)
    assert abs(np.corrcoef(errors.T)[0, 1]) < 0.13
    two = acted(one, channels, 0.1, 0.2)
    assert two[0] != two[1], "drawn anew at each tick"


@laws
@given(scenes(), st.floats(0.0, 100.0))
def test_range_cut_keeps_what_is_near_and_nothing_else(channels: Any, reach: float) -> None:
    before, pose = channels["lidar"], channels["localisation"]
    after = acted(fault("range-cut", reach=reach), channels)
    assert list(after) == [b for b in before if math.hypot(b.x - pose.x, b.y - pose.y) <= reach]
    assert acted(fault("range-cut", reach=RANGE), channels) is before
    assert acted(fault("range-cut", reach=reach), {**channels, "lidar": after}) is after


@laws
@given(scenes(), st.sampled_from(["other", "car", "pedestrian"]))
def test_class_change_changes_sizes_alone(channels: Any, becomes: str) -> None:
    before = channels["lidar"]
    after = acted(fault("class-change", becomes=becomes), channels)
    assert after.ids == before.ids
    assert after.data[:, :LENGTH].tobytes() == before.data[:, :LENGTH].tobytes()
    for was, now in zip(before, after, strict=True):
        assert (
            now.is_pedestrian
            == {"other": not was.is_pedestrian, "car": False, "pedestrian": True}[becomes]
        )
    if becomes == "other":
        assert alike(acted(fault("class-change"), {**channels, "lidar": after}), before)
    assert acted(fault("class-change", probability=0.0), channels) is before
    assert acted(fault("class-change", ids=[]), channels) is before


@laws
@given(scenes(least=1), st.integers(0, 99))
def test_class_change_lasts_for_whom_it_has_hit(channels: Any, seed: int) -> None:
    one = fault("class-change", probability=0.5)
    first, *later = acted(one, channels, 0.0, 0.1, 0.2, 5.0, seed=seed)
    assert all(alike(first, found) for found in later)


@laws
@given(scenes(least=2))
def test_id_switch_is_undone_by_another(channels: Any) -> None:
    before = channels["lidar"]
    one = fault("id-switch")
    after = acted(one, channels)
    assert after.data.tobytes() == before.data.tobytes()
    assert sorted(after.ids) == sorted(before.ids)
    assert sum(a != b for a, b in zip(after.ids, before.ids, strict=True)) == 2
    effect = fault_effect(one)
    memory = effect.begin(before, moment(channels))
    assert alike(effect.apply(memory, after, moment(channels)), before)


def test_id_switch_is_between_the_nearest_and_its_neighbour() -> None:
    ahead, beside, behind = (
        Body(name, x, y, 0.0, 0.0, 0.0, 5.0, 2.0)
        for name, x, y in (("A", 2.0, 51.0), ("B", 2.0, 42.0), ("C", 2.0, 72.0))
    )
    channels = channels_of(ahead, beside, behind, s=50.0)  # the ego is at y = 61
    assert acted(fault("id-switch"), channels).ids == ("B", "A", "C")
    named = acted(fault("id-switch", ids=["C", "B"]), channels)
    assert named.ids == ("A", "C", "B")


@laws
@given(scenes())
def test_id_switch_needs_two(channels: Any) -> None:
    alone = {**channels, "lidar": channels["lidar"][:1]}
    assert acted(fault("id-switch"), alone) is None
    assert acted(fault("id-switch", ids=["V0", "V9"]), channels) is None


@laws
@given(scenes(least=1), shifts, shifts, st.sampled_from(["route", "object"]))
def test_moved_obstacle_is_off_by_the_very_vector(
    channels: Any, dx: float, dy: float, frame: str
) -> None:
    before = channels["lidar"]
    after = acted(fault("moved-obstacle", dx=dx, dy=dy, frame=frame), channels)
    back = acted(fault("moved-obstacle", dx=0.0, dy=0.0, frame=frame), channels)
    assert back is before
    changed = [row for row, body in enumerate(before) if body != after[row]]
    assert len(changed) == (1 if dx or dy else 0)
    if not changed:
        return
    was, now = before[changed[0]], after[changed[0]]
    assert (now.id, *now[3:]) == (was.id, *was[3:])
    route = channels["map"].route
    heading = was.heading
    if frame == "route":
        heading = float(route.pose(route.project(was.x, was.y)[0])[2])
    along = (now.x - was.x) * math.cos(heading) + (now.y - was.y) * math.sin(heading)
    right = (now.y - was.y) * math.cos(heading) - (now.x - was.x) * math.sin(heading)
    np.testing.assert_allclose([along, right], [dx, dy], atol=1e-6)


def test_moved_obstacle_is_the_nearest_or_the_named_one() -> None:
    far, near = (Body(f"V{i}", 2.0, y, 0.0, 0.0, 0.0, 5.0, 2.0) for i, y in enumerate((20.0, 40.0)))
    channels = channels_of(far, near)
    assert acted(fault("moved-obstacle", dx=1.0), channels)[0] == far
    assert acted(fault("moved-obstacle", dx=1.0, id="V0"), channels)[1] == near
    assert acted(fault("moved-obstacle", dx=1.0, id="V0"), channels)[0] != far
    assert acted(fault("moved-obstacle", dx=1.0, id="V7"), channels) is None


@laws
@given(st.floats(40.0, 80.0), shifts, shifts)
def test_moved_obstacle_beside_the_route_is_so_in_the_route_s_own_coordinates(
    s: float, dx: float, dy: float
) -> None:
    channels = channels_of(Body("V1", 2.0, 111.0 - s, 0.0, 0.0, 0.0, 5.0, 2.0), s=30.0)
    after = acted(fault("moved-obstacle", dx=dx, dy=dy), channels)
    at, lateral = channels["map"].route.project(after[0].x, after[0].y)
    np.testing.assert_allclose([at - s, lateral], [dx, dy], atol=1e-6)


@laws
@given(scenes(), st.floats(0.0, 8.0), shifts, angles, st.floats(0.0, 12.0))
def test_ghost_obstacle_is_one_more_and_moves_as_it_says(
    channels: Any, elapsed: float, lateral: float, heading: float, speed: float
) -> None:
    before = channels["lidar"]
    given_ = {"ahead": 10.0, "lateral": lateral, "heading": heading, "speed": speed, "length": 4.0}
    first, later = acted(fault("ghost-obstacle", **given_), channels, 0.0, elapsed)
    for after in (first, later):
        assert alike(after[:-1], before)
        assert len(after) == len(before) + 1
    ghost, moved = first[-1], later[-1]
    pose, route = channels["localisation"], channels["map"].route
    s = route.project(pose.x, pose.y)[0] + CAR_LENGTH / 2 + 10.0 + 2.0
    x, y, along = (float(value) for value in route.pose(s))
    np.testing.assert_allclose(
        [ghost.x, ghost.y, ghost.heading],
        [x - lateral * math.sin(along), y + lateral * math.cos(along), along + heading],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        [ghost.vx, ghost.vy],
        [speed * math.cos(ghost.heading), speed * math.sin(ghost.heading)],
        atol=1e-9,
    )
    expected = [ghost.x + ghost.vx * elapsed, ghost.y + ghost.vy * elapsed]
    np.testing.assert_allclose([moved.x, moved.y], expected, atol=1e-9)
    assert moved[3:] == ghost[3:]


@laws
@given(scenes(least=1), st.floats(0.0, 6.0), st.floats(0.0, 1.0))
def test_trajectory_spoof_leads_from_the_truth_to_the_false_path_in_proportion(
    channels: Any, elapsed: float, magnitude: float
) -> None:
    before = channels["lidar"]
    if all(body.is_pedestrian for body in before):
        assert acted(fault("trajectory-spoof"), channels) is None
        return
    (whole,) = acted(fault("trajectory-spoof"), channels, elapsed)
    (part,) = acted(fault("trajectory-spoof", magnitude=magnitude), channels, elapsed)
    np.testing.assert_allclose(
        part.data, before.data + magnitude * (whole.data - before.data), atol=1e-9
    )
    (none,) = acted(fault("trajectory-spoof", magnitude=0.0), channels, elapsed)
    assert none is before
    (velocity,) = acted(fault("trajectory-spoof", spoofs="velocity"), channels, elapsed)
    # Equal as numbers: -0.0 + 0.0 is 0.0.
    np.testing.assert_array_equal(velocity.data[:, :VX], before.data[:, :VX])
    np.testing.assert_array_equal(velocity.data[:, VX:], whole.data[:, VX:])


@laws
@given(st.floats(0.0, 3.9), shifts, shifts)
def test_trajectory_spoof_with_a_given_velocity_follows_it(
    elapsed: float, along: float, right: float
) -> None:
    channels = channels_of(Body("V1", 2.0, 40.0, 1.0, 3.0, 4.0, 5.0, 2.0), s=30.0)
    given_ = fault("trajectory-spoof", velocity=[along, right])
    (after,) = acted(given_, channels, elapsed)
    # The ego comes from the south: north, which is -y, lies ahead of it, and east to its right.
    np.testing.assert_allclose(
        [after[0].x, after[0].y, after[0].vx, after[0].vy],
        [2.0 + right * elapsed, 40.0 - along * elapsed, right, -along],
        atol=1e-9,
    )


@laws
@given(angles, st.tuples(shifts, shifts, shifts, shifts), st.floats(0.0, 9.0))
def test_gnss_jump_is_the_same_vector_at_any_time(
    heading: float, by: tuple[float, float, float, float], elapsed: float
) -> None:
    channels = {"localisation": Pose(3.0, 7.0, heading)}
    east, north, along, across = by
    parts = {"east": east, "north": north, "along": along, "across": across}
    first, later = acted(fault("gnss-jump", **parts), channels, 0.0, elapsed)
    assert first == later
    assert first.heading == heading
    c, s = math.cos(heading), math.sin(heading)
    expected = [east + along * c - across * s, -north + along * s + across * c]
    np.testing.assert_allclose([first.x - 3.0, first.y - 7.0], expected, atol=1e-9)
    length = math.hypot(along, across)
    alone = acted(fault("gnss-jump", along=along, across=across), channels)
    assert math.isclose(math.hypot(alone.x - 3.0, alone.y - 7.0), length, abs_tol=1e-9)
    assert acted(fault("gnss-jump"), channels) is channels["localisation"]


DIRECTIONS = {
    "ahead": (0.0, -1.0), "behind": (0.0, 1.0), "right": (1.0, 0.0), "left": (-1.0, 0.0),
    "north": (0.0, -1.0), "south": (0.0, 1.0), "east": (1.0, 0.0), "west": (-1.0, 0.0),
}  # fmt: skip
"""Of an ego that drives north, where y points south."""


@laws
@given(st.sampled_from(sorted(DIRECTIONS)), st.floats(0.0, 3.0), st.floats(0.0, 9.0))
def test_gnss_drag_off_grows_with_time(direction: str, rate: float, elapsed: float) -> None:
    channels = {"localisation": Pose(3.0, 7.0, -math.pi / 2)}
    one = fault("gnss-drag-off", rate=rate, direction=direction)
    at_once, later = acted(one, channels, 0.0, elapsed)
    assert at_once is channels["localisation"]
    assert later.heading == -math.pi / 2
    expected = rate * elapsed * np.array(DIRECTIONS[direction])
    np.testing.assert_allclose([later.x - 3.0, later.y - 7.0], expected, atol=1e-9)
    bounded = fault("gnss-drag-off", rate=rate, direction=direction, at_most=2.0)
    (last,) = acted(bounded, channels, elapsed)
    off = math.hypot(last.x - 3.0, last.y - 7.0)
    assert math.isclose(off, min(rate * elapsed, 2.0), abs_tol=1e-9)
    idle = fault("gnss-drag-off", rate=0.0, direction=direction)
    assert acted(idle, channels, elapsed)[0] is channels["localisation"]


@laws
@given(st.lists(st.tuples(metres, metres, angles), min_size=2, max_size=6))
def test_gnss_jam_keeps_the_last_pose_before_it(poses: list[Any]) -> None:
    one = fault_effect(fault("gnss-jam"))
    assert one.memory > 0.0
    fixes = [(0.1 * index, Pose(*pose)) for index, pose in enumerate(poses)]
    now = Moment(0.1, 0.1, 0.0, {}, fixes[:2], lambda: stream(0, "law"))
    memory = one.begin(fixes[1][1], now)
    for _, pose in fixes[1:]:
        assert one.apply(memory, pose, now) == fixes[0][1]
    first = Moment(0.0, 0.1, 0.0, {}, fixes[:1], lambda: stream(0, "law"))
    assert one.begin(fixes[0][1], first) == fixes[0][1]


@laws
@given(scenes(), st.text(max_size=60), st.floats(0.1, 60.0), st.floats(0.0, 9.0))
def test_prompt_text_is_one_sign_more(
    channels: Any, text: str, ahead: float, elapsed: float
) -> None:
    before = channels["controls"]
    (after,) = acted(fault("prompt-text", text=text, ahead=ahead), channels, elapsed)
    if not text:
        assert after is before
        return
    assert after[:-1] == before
    pose = channels["localisation"]
    front = channels["map"].route.project(pose.x, pose.y)[0] + CAR_LENGTH / 2
    assert after[-1].text == text
    assert math.isclose(after[-1].at, front + ahead)
    assert all(not sign.text for sign in before)


def test_each_fault_of_the_domain_has_its_law_here() -> None:
    own = [name for name in FAULT_TYPES if FAULT_TYPES.path(name).startswith("pytest_dura.driving")]
    for name in own:
        prefix = f"test_{name.replace('-', '_')}_"
        assert any(test.startswith(prefix) for test in globals()), name
