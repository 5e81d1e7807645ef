"""The scene that a viewer shows is what the simulator knew and the sensors reported."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pytest_dura.core import POSE, Percept
from pytest_dura.driving import PLACE, Body, BodyList, Command, HighwaySimulator, Maneuver, Pose

WORLD = {
    "ego": {"distance": 40.0, "speed": 8.0, "turn": "straight"},
    "traffic": {"headway": 3.0, "minimum_headway": 2.0, "arms": ["west", "east", "north"],
                "speed": 8.0, "speed_deviation": 0.5,
                "turns": {"left": 0.2, "straight": 0.6, "right": 0.2}},
}  # fmt: skip


@pytest.fixture(scope="module")
def drive():
    simulator = HighwaySimulator()
    ticks = [simulator.reset({"world": WORLD, "duration": 20.0}, seed=3)]
    ticks += [simulator.step(Command(Maneuver.PROCEED, 0.0)) for _ in range(80)]
    return simulator, ticks


def pose(tracks, tick, name):
    return tracks.poses[tick, tracks.ids.index(name)]


def expected(body):
    speed = math.hypot(body.vx, body.vy)
    return [body.x, body.y, body.heading, speed, body.length, body.width]


def test_every_body_is_where_it_was_and_nowhere_else(drive):
    simulator, ticks = drive
    scene = simulator.scene(ticks, [Percept(tick.channels) for tick in ticks])
    numbers = {len(tick.truth["bodies"]) for tick in ticks}
    assert len(numbers) > 1  # cars come and go
    for tracks, bodies in (
        (scene.truth, [tick.truth["bodies"] for tick in ticks]),
        (scene.percept, [tick.channels["lidar"] for tick in ticks]),
    ):
        assert tracks.poses.shape == (len(ticks), len(tracks.ids), len(POSE))
        for tick, here in enumerate(bodies):
            shown = {
                name
                for name, row in zip(tracks.ids, tracks.poses[tick], strict=True)
                if not np.isnan(row).all()
            }
            assert shown == {scene.ego, *here.ids}
            for body in here:
                assert pose(tracks, tick, body.id) == pytest.approx(expected(body), rel=1e-6)


def test_the_ego_is_shown_where_it_is_and_where_it_believes_to_be(drive):
    simulator, ticks = drive
    percepts = [
        Percept({**tick.channels, "localisation": Pose(1.0 + tick.index, 2.0, 0.5)})
        for tick in ticks
    ]
    scene = simulator.scene(ticks, percepts)
    for tick in ticks:
        ego = tick.truth["ego"]
        true = pose(scene.truth, tick.index, scene.ego)
        assert true[:4] == pytest.approx([ego.x, ego.y, ego.heading, ego.speed], rel=1e-6)
        believed = pose(scene.percept, tick.index, scene.ego)
        assert believed[:3] == pytest.approx([1.0 + tick.index, 2.0, 0.5])


def test_what_is_perceived_and_not_there_is_in_the_percept_alone(drive):
    simulator, ticks = drive
    ghost = Body("V942", 5.0, 6.0, 0.0, 3.0, 4.0, 5.0, 2.0)
    percepts = [
        Percept({**one.channels, "lidar": one.channels["lidar"].with_body(ghost)})
        if 10 <= one.index < 20
        else Percept(one.channels)
        for one in ticks
    ]
    scene = simulator.scene(ticks, percepts)
    assert "V942" not in scene.truth.ids
    column = scene.percept.poses[:, scene.percept.ids.index("V942")]
    assert np.flatnonzero(~np.isnan(column[:, 0])).tolist() == list(range(10, 20))
    assert column[10] == pytest.approx([5.0, 6.0, 0.0, 5.0, 5.0, 2.0])


def test_several_bodies_of_one_id_are_all_shown_and_none_is_taken_for_the_ego(drive):
    simulator, ticks = drive
    twins = BodyList.of(
        [Body(name, x, 0.0, 0.0, 0.0, 0.0, 5.0, 2.0)
         for name, x in (("V1", 1.0), ("V1", 2.0), ("EGO", 3.0))]
    )  # fmt: skip
    scene = simulator.scene(ticks[:1], [Percept({**ticks[0].channels, "lidar": twins})])
    found = {name: float(scene.percept.poses[0, i, 0]) for i, name in enumerate(scene.percept.ids)}
    assert found.pop("EGO") == pytest.approx(ticks[0].truth["ego"].x)
    assert found == {"V1": 1.0, "V1 (2)": 2.0, "EGO (2)": 3.0}


def test_absurd_percepts_are_shown_as_the_roles_take_them(drive):
    simulator, ticks = drive
    absurd = BodyList.of([Body("V1", 1e300, -1e300, 0.0, 0.0, 0.0, 5.0, 2.0)])
    scene = simulator.scene(ticks[:1], [Percept({**ticks[0].channels, "lidar": absurd})])
    assert pose(scene.percept, 0, "V1")[:2] == pytest.approx([PLACE, -PLACE])
    assert np.isfinite(pose(scene.percept, 0, "V1")).all()


def test_the_road_has_four_arms_and_the_route_leads_across(drive):
    simulator, ticks = drive
    scene = simulator.scene(ticks, [Percept(tick.channels) for tick in ticks])
    kinds = [line.kind for line in scene.lines]
    assert (kinds.count("stop_line"), kinds.count("marking")) == (4, 4)
    assert kinds.count("route") == 1
    stops = {tuple(np.round(line.points.mean(axis=0)).tolist())
             for line in scene.lines if line.kind == "stop_line"}  # fmt: skip
    # Whoever comes from the south stands at x = 2, y = 11; the others by quarter turns.
    assert stops == {(2.0, 11.0), (-11.0, 2.0), (-2.0, -11.0), (11.0, -2.0)}
    route = next(line for line in scene.lines if line.kind == "route").points
    assert route[0][1] > 50
    assert route[-1][1] < -50
