"""A world and a component behind topics of ROS 1, by a real master: as in one process.

Skipped where rospy cannot be imported by this Python; Debian's packages, unpacked into a folder on
PYTHONPATH, are enough (docs/ros2.md).
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import warnings
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep

import pytest

from pytest_dura import (
    ConfigurationError,
    EpisodeSpec,
    Orchestrator,
    RoleSpec,
    Termination,
    check_simulator,
)
from pytest_dura.core.clock import Clock
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
pytest.importorskip("rosbags", reason="the extra ros2 is not installed")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of packages that are not ours
    pytest.importorskip("rospy", reason="rospy is not installed for this Python")
    pytest.importorskip("rosmaster", reason="rosmaster is not installed for this Python")

from robot_room import BINDING

from pytest_dura.adapters.ros1 import Ros1Generator, Ros1Simulator, message_type
from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import close_buses

# Its threads use what Python has deprecated, and leave sockets to the collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
ROBOT = Path(__file__).parents[2] / "support" / "ros1_robot.py"
CHECK = "always (x < 4.52)"
PARAMETERS = {"binding": "room.ros2.yaml", "timeout": 20.0}
SPEC = EpisodeSpec(
    case="room/wall",
    run=0,
    seed=0,
    simulator=RoleSpec("robot_room:Room"),
    roles={"generator": RoleSpec("robot_room:Approach")},
    scenario={"name": "a", "world": {"lag": 0.3}},
    termination=Termination(time_limit=6.0),
    time_budget=60.0,
)


class Room(Ros1Simulator):
    tolerances = {"x": 1e-9}  # noqa: RUF012 - declared as a class variable by the base


@contextmanager
def node(*arguments):
    process = subprocess.Popen([sys.executable, str(ROBOT), *map(str, arguments)])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def master(tmp_path_factory):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    patch = pytest.MonkeyPatch()
    patch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{port}")
    patch.setenv("ROS_IP", "127.0.0.1")
    patch.setenv("ROS_HOME", str(tmp_path_factory.mktemp("ros")))
    with node("master", port):
        until = monotonic() + 30.0
        while monotonic() < until:
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                break
            except OSError:
                sleep(0.05)
        yield port
    patch.undo()


@pytest.fixture
def room(master, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.ros2.yaml").write_text(BINDING)
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 20.0)
    yield tmp_path
    close_buses()


def episode_of(lag, **changes):
    spec = replace(SPEC, scenario={"name": "a", "world": {"lag": lag}}, **changes)
    return Orchestrator.build(spec).run(spec)


def check_equal_episodes(**changes):
    margins = []
    for lag in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.9, 1.1, 1.2):
        here, there = episode_of(lag), episode_of(lag, **changes)
        assert there.failure is None
        assert (there.validity, there.events) == ("valid", ())
        assert there.signal("x").tolist() == here.signal("x").tolist()
        margins.append(JudgedEpisode.of(there).robustness(CHECK))
        assert margins[-1] == JudgedEpisode.of(here).robustness(CHECK)
    assert min(margins) < 0.0 < max(margins)


def test_a_world_behind_topics_gives_the_episodes_of_one_process(room) -> None:
    with node("world"):
        check_equal_episodes(simulator=RoleSpec.of(Room, PARAMETERS))


def test_a_component_behind_topics_gives_them_too(room) -> None:
    (room / "room.ros2.yaml").write_text(BINDING.replace("reset: /reset\n", "clock: null\n"))
    with node("controller"):
        check_equal_episodes(roles={"generator": RoleSpec.of(Ros1Generator, PARAMETERS)})


def test_the_simulator_keeps_its_contract(room) -> None:
    with node("world"):
        scenario = {"name": "a", "duration": 1.0, "world": {"lag": 0.3}}
        check_simulator(RoleSpec.of(Room, PARAMETERS), scenario, [0.5] * 10)


def test_a_world_in_real_time_misses_no_tick(room) -> None:
    with node("world"):
        episode = episode_of(
            0.3,
            simulator=RoleSpec.of(Room, PARAMETERS),
            clock=Clock(kind="wall"),
            termination=Termination(time_limit=2.0),
        )
    assert (episode.failure, episode.validity) == (None, "valid")
    assert episode.signal("loop.period").mean() == pytest.approx(0.1, abs=0.02)


def test_a_world_that_dies_is_infrastructure(room) -> None:
    world = RoleSpec.of(Room, {**PARAMETERS, "timeout": 2.0})
    with node("world", 5):
        episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert "simulator at tick 4" in episode.failure
    assert "no message of /clock within 2 s" in episode.failure


def test_without_a_master_it_is_said_and_not_waited_for(tmp_path) -> None:
    (tmp_path / "room.ros2.yaml").write_text(BINDING)
    script = (
        "from pytest_dura.adapters.ros1 import Ros1Simulator\n"
        "Ros1Simulator('room.ros2.yaml').reset({}, 0)\n"
    )
    environment = {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:1", "PYTHONWARNINGS": "ignore"}
    path = [str(ROBOT.parent), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(path)
    ended = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path, env=environment, text=True, capture_output=True, check=False, timeout=60.0,
    )  # fmt: skip
    assert "Ros2Error: no master of ROS 1 answers at http://127.0.0.1:1" in ended.stderr


def test_lists_integers_and_stamps_go_both_ways(room) -> None:
    (room / "scan.yaml").write_text(
        """\
topics: {/scan: sensor_msgs/msg/LaserScan, /joints: sensor_msgs/msg/JointState,
         /count: std_msgs/msg/Int32}
percept:
  - {name: ranges, unit: cm, scale: 100, topic: /scan, field: ranges}
  - {name: arm.second, unit: rad, topic: /joints, field: position.1}
  - {name: count, unit: "1", topic: /count, field: data}
command: [{name: count, unit: "1", topic: /count, field: data}]
"""
    )
    binding = TopicBinding.read("scan.yaml")
    percept = {"ranges": (1.0, 2.5), "arm": {"second": 0.25}, "count": 3.0}
    made = binding.messages("percept", percept, 1_500_000_000, lambda name: message_type(name)())
    assert (made["/scan"].header.stamp.secs, made["/scan"].header.stamp.nsecs) == (1, 500_000_000)
    back = binding.values("percept", made)
    assert back == {"ranges": (1.0, 2.5), "arm.second": 0.25, "count": 3.0}
    with pytest.raises(ConfigurationError, match="has no message type 'vision_msgs/msg/Nothing'"):
        message_type("vision_msgs/msg/Nothing")
