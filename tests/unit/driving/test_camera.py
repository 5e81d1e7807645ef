"""The cameras: perspective, what can be recognised in them, and what is never in them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from roads import begin, drive, run, spec_of_drive

from pytest_dura import Generator, GeneratorView, Proposal, RoleSpec
from pytest_dura.core import RoleContext
from pytest_dura.driving import FOUR_WAY, Pose, camera, route
from pytest_dura.driving.camera import COLOURS, Solid, front, third_person

Picture = np.ndarray[Any, Any]

STRAIGHT_ON = Pose(2.0, 40.0, -math.pi / 2)
"""On the lane of the southern arm, 29 m before the stop line, facing north."""


def ahead(kind: str, metres: float, right: float = 0.0, **size: float) -> Solid:
    """A solid so many metres ahead of the ego's middle, turned like it."""
    x, y = STRAIGHT_ON.x + right, STRAIGHT_ON.y - metres
    return Solid(kind, x, y, STRAIGHT_ON.heading, size.get("length", 5.0), size.get("width", 2.0))


def pixels_of(picture: Picture, kind: str) -> tuple[Any, Any]:
    """Rows and columns of the pixels that have the colour of a kind, in light or shade."""
    colour = np.array(COLOURS[kind], float)
    values = picture.astype(float)
    size = np.maximum(np.linalg.norm(values, axis=2), 1.0)
    alike = values @ colour / size / np.linalg.norm(colour) > 0.99
    bright = size > 0.45 * np.linalg.norm(colour)
    return np.nonzero(alike & bright)


def count(picture: Picture, kind: str) -> int:
    return len(pixels_of(picture, kind)[0])


EGO = {"ego": {"distance": 29.0, "speed": 0.0}}


@pytest.mark.parametrize(
    "solid, square_metres",
    [
        # Nearest face 15 m ahead of the bumper. What of it has the kind's colour, seen from there:
        # legs and chest; the rear without window, lamps and tyres; four triangles; the rear face.
        (ahead("pedestrian", 17.5, length=0.6, width=0.6), 0.36 * 0.85 + 0.56 * 0.63),
        (ahead("car", 20.0), 2.0 * 0.55 - 2 * 0.46 * 0.25),
        (ahead("parked_car", 19.75, 3.2, length=4.5, width=1.8), 1.8 * 0.55 - 2 * 0.41 * 0.25),
        (ahead("cones", 19.0, 1.5, length=3.0, width=0.4), 0.4 * 0.75 / 2 * 3),
        (ahead("island", 20.5, -2.0, length=6.0, width=1.0), 1.0 * 0.18),
    ],
    ids=lambda value: value.kind if isinstance(value, Solid) else "",
)
def test_who_is_15_m_ahead_covers_the_pixels_that_a_pinhole_gives(
    solid: Solid, square_metres: float
) -> None:
    for view, mount in ((front, camera.FRONT), (third_person, camera.THIRD_PERSON)):
        focal = mount.size / 2 / math.tan(math.radians(mount.field_of_view) / 2)
        area = square_metres * (focal / (17.5 - mount.ahead)) ** 2
        assert count(view(STRAIGHT_ON, []), solid.kind) == 0
        seen = count(view(STRAIGHT_ON, [solid]), solid.kind)
        assert seen >= max(area / 2, 8), "the rest is mixed at the edges"


@pytest.mark.parametrize("channel", ["camera_front", "camera_third_person"])
@pytest.mark.parametrize(
    "kind, world",
    [
        ("pedestrian", {"pedestrians": [{"id": "P1", "offset": 11.5, "start": 0.0, "speed": 3.0}]}),
        ("car", {"vehicles": [{"id": "A", "arm": "south", "distance": 9.0, "speed": 0.0}]}),
        ("parked_car", {"obstacles": [{"id": "K", "offset": 9.0, "beside": 5.2}]}),
        ("cones", {"obstacles": [{"id": "K", "offset": 12.0, "beside": 3.5}]}),
        ("island", {"obstacles": [{"id": "K", "offset": 9.0, "beside": 0.0}]}),
    ],
)
def test_who_is_in_the_world_is_in_its_pictures(
    kind: str, world: dict[str, Any], channel: str
) -> None:
    obstacles = [{**one, "kind": kind} for one in world.get("obstacles", ())]
    world = {**EGO, **world, "obstacles": obstacles}
    _, ticks = drive(world, 20 if kind == "pedestrian" else 0)
    assert count(ticks[-1].channels[channel].get(), kind) >= 15
    _, alone = begin(EGO)
    assert count(alone[0].channels[channel].get(), kind) <= 2, "mixed at the edges of others"


@pytest.mark.parametrize("arm, kind", [(0, "give_way"), (1, "priority_road")])
def test_the_sign_of_an_arm_covers_enough_pixels_of_its_own_colour(arm: int, kind: str) -> None:
    near = Pose(*(float(value) for value in route(arm, "straight").pose(88.0)))
    sign = camera.sign_beside(FOUR_WAY.arms[arm], kind)
    assert count(front(near, [sign]), kind) >= 12
    assert count(front(near, []), kind) == 0
    assert count(third_person(near, [sign]), kind) - count(third_person(near, []), kind) >= 15
    turned = sign._replace(heading=sign.heading + math.pi)
    assert count(front(near, [turned]), kind) == 0, "from behind it is grey"


def test_every_arm_of_the_world_has_its_sign() -> None:
    _, ticks = begin({"ego": {"distance": 10.0, "speed": 0.0}})
    rows, columns = pixels_of(ticks[0].channels["camera_front"].get(), "give_way")
    assert len(rows) >= 12
    assert columns.mean() > 70, "right of the road"
    assert rows.mean() < 55, "above the road"


def test_what_is_twice_as_far_is_half_as_large() -> None:
    def height(metres: float) -> int:
        rows, _ = pixels_of(third_person(STRAIGHT_ON, [ahead("car", metres)]), "car")
        return int(np.ptp(rows)) + 1

    def width(metres: float) -> int:
        _, columns = pixels_of(front(STRAIGHT_ON, [ahead("car", metres)]), "car")
        return int(np.ptp(columns)) + 1

    # From the camera, 1.2 m ahead of the middle, to the rear of a car of 5 m.
    assert width(13.7) == pytest.approx(2 * width(23.7), abs=2)
    assert width(13.7) == pytest.approx(2.0 / 10.0 * 64 / math.tan(math.radians(30)), abs=2)
    assert height(20.0) > height(40.0)


def test_right_is_right_and_red_stands_before_blue() -> None:
    columns = {
        right: pixels_of(front(STRAIGHT_ON, [ahead("car", 20.0, right)]), "car")[1].mean()
        for right in (-4.0, 0.0, 4.0)
    }
    assert columns[-4.0] < 50
    assert columns[0.0] == pytest.approx(63.5, abs=3)
    assert columns[4.0] > 78
    picture = front(STRAIGHT_ON, [ahead("car", 12.0)])
    rows, columns_of_car = pixels_of(picture, "car")
    red, _, blue = picture[rows, columns_of_car].mean(axis=0)
    assert blue > 2 * red


def test_the_nearer_car_hides_the_farther_whatever_their_order() -> None:
    near, far = ahead("car", 12.0), ahead("parked_car", 24.0)
    both = front(STRAIGHT_ON, [near, far])
    assert np.array_equal(both, front(STRAIGHT_ON, [far, near]))
    assert count(both, "parked_car") < 0.2 * count(front(STRAIGHT_ON, [far]), "parked_car")
    assert count(both, "car") == pytest.approx(count(front(STRAIGHT_ON, [near]), "car"), abs=3)


@pytest.mark.parametrize("metres", [-30.0, -8.0, 400.0])
def test_what_is_behind_or_far_away_is_not_in_the_picture(metres: float) -> None:
    assert np.array_equal(front(STRAIGHT_ON, [ahead("car", metres)]), front(STRAIGHT_ON, []))


@pytest.mark.parametrize("metres", [0.0, 1.0, 1.2, 1.5, 2.6, 3.8, 5.0])
def test_a_car_across_the_camera_is_cut_off_and_does_no_harm(metres: float) -> None:
    for turned in (0.0, 0.3, math.pi / 2, 2.5):
        near = ahead("car", metres)._replace(heading=turned)
        assert front(STRAIGHT_ON, [near]).shape == (128, 128, 3)
        assert third_person(STRAIGHT_ON, [near]).shape == (300, 300, 3)


def test_the_ego_is_in_the_third_person_view_and_its_bonnet_in_the_front_view() -> None:
    rows, columns = pixels_of(third_person(STRAIGHT_ON, []), "ego")
    assert len(rows) > 1000
    assert abs(columns.mean() - 150) < 3
    assert rows.mean() > 150
    bonnet, _ = pixels_of(front(STRAIGHT_ON, []), "ego")
    assert bonnet.min() > 105


@pytest.mark.parametrize("heading", [0.0, 0.7, -math.pi / 2, 2.9])
def test_the_road_is_grey_where_it_is_and_the_sky_is_above(heading: float) -> None:
    picture = front(Pose(0.0, 0.0, heading), [])
    assert (picture[100, 40:90] == COLOURS["road"]).all(), "in the middle of the junction"
    assert picture[2].mean(axis=0).argmax() == 2


def test_the_lane_s_markings_are_where_the_map_has_them() -> None:
    picture = third_person(Pose(2.0, 16.0 + 2.5, -math.pi / 2), [])
    white = (picture > 225).all(axis=2)
    rows, _ = np.nonzero(white[100:300])
    line = np.bincount(rows).argmax() + 100
    across = np.flatnonzero(white[line])
    assert np.ptp(across) > 30, "the stop line, 3.5 m wide"
    assert across.min() > 110, "from the middle of the road to the right"


def test_a_picture_is_the_same_each_time_and_of_a_snapshot_too() -> None:
    world = {"traffic": {"headway": 5.0}, "pedestrians": [{"id": "P1"}]}
    simulator, ticks = drive(world, 10)
    snapshot = simulator.snapshot()
    first = simulator.render()
    assert first.tobytes() == simulator.render().tobytes()
    assert first.tobytes() == ticks[-1].channels["camera_third_person"].get().tobytes()
    simulator.step(simulator.check_action("wait"))
    assert simulator.render().tobytes() != first.tobytes()
    simulator.restore(snapshot)
    assert simulator.render().tobytes() == first.tobytes()


@pytest.mark.parametrize("state", ["red", "yellow", "green"])
def test_a_traffic_light_shows_its_state(state: str) -> None:
    phases = [{"state": state, "lasts": 9.0}]
    light = {"controls": {"signals": [{"arms": ["south"], "phases": phases}]}}
    world = {"ego": {"distance": 8.0, "speed": 0.0}, **light}
    _, ticks = begin(world)
    lit = ticks[0].channels["camera_front"].get()
    _, dark = begin({"ego": world["ego"]})
    new = (lit != dark[0].channels["camera_front"].get()).any(axis=2)
    shown = {one: int(new[pixels_of(lit, one)].sum()) for one in ("red", "yellow", "green")}
    assert shown[state] >= 3
    assert all(number == 0 for one, number in shown.items() if one != state)


class Looking(Generator):
    """Stands, and keeps what lidar and the front camera say at one tick."""

    seen: list[tuple[int, Picture]] = []  # noqa: RUF012 - of the class, to be read afterwards

    def reset(self, context: RoleContext) -> None:
        self.seen.clear()

    def propose(self, view: GeneratorView) -> Proposal:
        if view.index == 15:
            self.seen.append((len(view.percept["lidar"]), view.percept["camera_front"]))
        return Proposal("wait")


def test_a_ghost_of_lidar_is_not_in_the_picture() -> None:
    ghost = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "parameters": {"ahead": 8.0}}
    seen = []
    for faults in ([], [ghost]):
        spec = spec_of_drive(
            EGO, generator=RoleSpec("test_camera:Looking"), duration=2.0, faults=faults
        )
        assert run(spec).failure is None
        seen += Looking.seen
    (without, plain), (attacked, picture) = seen
    assert attacked == without + 1
    assert np.array_equal(plain, picture)
