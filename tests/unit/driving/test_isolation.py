"""Snapshots, camera frames, and what leaks between highway-env users of one process."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.vehicle.behavior import IDMVehicle
from roads import always, begin, bodies_at, drive, run, spec_of_drive

from pytest_dura.core import ConfigurationError, Percept, Tick, leaves
from pytest_dura.driving import Command, HighwaySimulator, Maneuver, camera, route

WORLD: dict[str, Any] = {
    "ego": {"distance": 40.0, "speed": 8.0, "turn": "left"},
    "traffic": {"headway": 5.0},
    "vehicles": [{"id": "A", "arm": "west", "turn": "left", "distance": 20.0}],
    "pedestrians": [{"id": "P1", "start": 1.0}],
}
COMMANDS = [Command(list(Maneuver)[i % 6]) for i in (0, 3, 4, 2, 1, 3, 3, 4)] * 6


def onwards(simulator: HighwaySimulator, count: int = 40) -> list[Any]:
    found = []
    for command in COMMANDS[:count]:
        tick = simulator.step(command)
        found.append(leaves(tick))
        if tick.critical is not None:
            break
    return found


def settings_of_highway_env() -> dict[str, Any]:
    names = [name for name in dir(IDMVehicle) if name.isupper()]
    found = {name: copy.deepcopy(getattr(IDMVehicle, name)) for name in names}
    return {**found, "metadata": copy.deepcopy(AbstractEnv.metadata)}


def test_highway_env_s_classes_are_as_before() -> None:
    before = settings_of_highway_env()
    simulator, ticks = drive(WORLD, 30, always("wait"))
    simulator.render()
    _ = ticks[-1].channels["camera_front"].get()
    assert settings_of_highway_env() == before


def stock_environment() -> Any:
    env = IntersectionEnv(config={"other_vehicles_type": "highway_env.vehicle.behavior.IDMVehicle"})
    env.reset(seed=3)
    for _ in range(3):
        env.step(1)
    return env


def test_a_stock_environment_of_the_same_process_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spec = spec_of_drive(WORLD, generator="rule_based", duration=6.0)
    before = run(spec)
    for name, value in (
        ("DISTANCE_WANTED", 99.0),
        ("COMFORT_ACC_MAX", 1.0),
        ("COMFORT_ACC_MIN", -1.0),
    ):
        monkeypatch.setattr(IDMVehicle, name, value)
    env = stock_environment()
    env.close()
    assert IDMVehicle.COMFORT_ACC_MAX == 6, "highway-env does leak into the class"
    assert run(spec).digest == before.digest


def test_a_snapshot_of_one_instant_can_be_branched_from_twice() -> None:
    simulator, _ = drive(WORLD, 15, always("proceed"))
    snapshot = simulator.snapshot()
    first = onwards(simulator)
    simulator.restore(snapshot)
    other = [leaves(simulator.step(Command(Maneuver.EMERGENCY_BRAKE))) for _ in range(20)]
    simulator.restore(snapshot)
    assert onwards(simulator) == first
    assert other != first[: len(other)]
    simulator.restore(snapshot)
    assert onwards(simulator) == first


def test_a_snapshot_does_not_mind_pictures_or_other_scenarios() -> None:
    simulator, ticks = drive(WORLD, 15, always("proceed"))
    simulator.render()
    _ = ticks[-1].channels["camera_third_person"].get()
    snapshot = simulator.snapshot()
    first = onwards(simulator)
    simulator.reset({"world": {"ego": {"turn": "right"}}, "duration": 5.0}, 9)
    onwards(simulator, 3)
    simulator.restore(snapshot)
    assert onwards(simulator) == first
    tick = simulator.step(Command(Maneuver.WAIT))
    assert tick.channels["map"].route is route(0, "left")


def test_newcomers_after_a_restore_see_their_leaders() -> None:
    # Routes are told apart by identity: a copied one would make strangers of two cars on one lane.
    world = {"ego": {"distance": 90.0, "speed": 0.0}, "traffic": {"headway": 3.0}}
    simulator, _ = drive(world, 20, always("emergency_brake"))
    snapshot = simulator.snapshot()
    for vehicle in simulator._road.vehicles:
        assert vehicle.plan is route(vehicle.plan.origin, vehicle.plan.turn)
    simulator.restore(snapshot)
    for vehicle in simulator._road.vehicles:
        assert vehicle.plan is route(vehicle.plan.origin, vehicle.plan.turn)


def test_a_snapshot_of_another_simulator_works_as_well() -> None:
    simulator, _ = drive(WORLD, 10, always("proceed"))
    snapshot = simulator.snapshot()
    other, _ = begin({})
    other.restore(snapshot)
    assert onwards(other) == onwards(simulator)


def test_nothing_is_drawn_until_a_frame_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    draw = camera.third_person
    monkeypatch.setattr(camera, "third_person", lambda *args: drawn.append("drawn") or draw(*args))
    simulator, ticks = drive(WORLD, 5)
    for name in ("lidar", "radar", "imu", "odometry", "localisation", "map", "controls"):
        _ = Percept(ticks[-1].channels)[name]
    run(spec_of_drive(WORLD, generator="rule_based", duration=2.0))
    assert not drawn
    first = Percept(ticks[-1].channels)["camera_third_person"]
    assert Percept(ticks[-1].channels)["camera_third_person"] is first, "made once, and kept"
    assert drawn == ["drawn"]
    simulator.close()


def test_frames_are_pictures_of_the_road() -> None:
    simulator, ticks = drive(WORLD, 20)
    percept = Percept(ticks[-1].channels)
    for name, size in (("camera_third_person", 300), ("camera_front", 128)):
        frame = percept[name]
        assert frame.shape == (size, size, 3)
        assert frame.dtype == np.uint8
        assert frame.max() > 100
        assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 5
    assert np.array_equal(simulator.render(), percept["camera_third_person"])


def late(simulator: HighwaySimulator, tick: Tick, how: str) -> None:
    if how == "step":
        simulator.step(Command(Maneuver.WAIT))
    elif how == "reset":
        simulator.reset({"world": WORLD}, 1)
    elif how == "close":
        simulator.close()
    elif how == "branch":
        snapshot = simulator.snapshot()
        simulator.step(Command(Maneuver.ACCELERATE))
        simulator.restore(snapshot)
        simulator.step(Command(Maneuver.EMERGENCY_BRAKE))


@pytest.mark.parametrize("how", ["step", "reset", "close", "branch"])
def test_a_frame_that_is_read_too_late_is_refused(how: str) -> None:
    simulator, ticks = begin(WORLD)
    late(simulator, ticks[0], how)
    with pytest.raises(ConfigurationError) as caught:
        ticks[0].channels["camera_front"].get()
    message = str(caught.value)
    assert "only during its tick" in message
    assert "tick 0" in message
    assert "keep the array" in message


def test_a_frame_that_was_read_in_time_stays() -> None:
    simulator, ticks = begin(WORLD)
    frame = ticks[0].channels["camera_front"].get()
    simulator.step(Command(Maneuver.WAIT))
    assert ticks[0].channels["camera_front"].get() is frame


def test_frames_without_a_display() -> None:
    program = (
        "from roads import drive\n"
        "simulator, ticks = drive({'traffic': {'headway': 5.0}}, 3)\n"
        "frame = ticks[-1].channels['camera_third_person'].get()\n"
        "print(frame.shape, frame.max() > 100, simulator.render().max() > 100)\n"
    )
    root = Path(__file__).parents[3]
    path = os.pathsep.join([str(root), str(root / "tests" / "support")])
    environment = {**os.environ, "SDL_VIDEODRIVER": "dummy", "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        env=environment, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "(300, 300, 3) True True"


def test_a_tick_cannot_be_written_to() -> None:
    _, ticks = drive(WORLD, 3)
    bodies = bodies_at(ticks[-1])
    with pytest.raises(ValueError, match="read-only"):
        bodies.data[0, 0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        ticks[-1].channels["radar"][0, 0] = 0.0
    with pytest.raises(AttributeError):
        ticks[-1].truth["ego"].x = 0.0
