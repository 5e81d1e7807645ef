"""A world and a component behind topics of ROS 1, by a real master: as in one process.

Skipped where rospy cannot be imported by this Python; Debian's packages, unpacked into a folder on
PYTHONPATH, are enough (docs/ros2.md).
"""

from __future__ import annotations

import gc
import os
import socket
import subprocess
import sys
import warnings
from pathlib import Path
from time import monotonic, sleep

import pytest

from pytest_dura import (
    ConfigurationError,
    RoleSpec,
    Termination,
    check_simulator,
)
from pytest_dura.core.clock import Clock

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
pytest.importorskip("rosbags", reason="the extra ros2 is not installed")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of packages that are not ours
    pytest.importorskip("rospy", reason="rospy is not installed for this Python")
    pytest.importorskip("rosmaster", reason="rosmaster is not installed for this Python")

from free_ports import free_port
from robot_room import BINDING
from robot_topics import SCAN, check_equal_episodes, episode_of, running

from pytest_dura.adapters.ros1 import Ros1Generator, Ros1Simulator, message_type
from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import close_buses

# Its threads use what Python has deprecated, and leave sockets to the collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
ROBOT = Path(__file__).parents[2] / "support" / "ros1_robot.py"
LAGS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.9, 1.1, 1.2)
PARAMETERS = {"binding": "room.ros2.yaml", "timeout": 20.0}


class Room(Ros1Simulator):
    tolerances = {"x": 1e-9}  # noqa: RUF012 - declared as a class variable by the base


@pytest.fixture(scope="module")
def master(tmp_path_factory):
    port = free_port()
    patch = pytest.MonkeyPatch()
    patch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{port}")
    patch.setenv("ROS_IP", "127.0.0.1")
    patch.setenv("ROS_HOME", str(tmp_path_factory.mktemp("ros")))
    with running(ROBOT, "master", port):
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
    gc.collect()  # simulators that failed
    close_buses()


def test_a_world_behind_topics_gives_the_episodes_of_one_process(room) -> None:
    with running(ROBOT, "world"):
        check_equal_episodes(LAGS, simulator=RoleSpec.of(Room, PARAMETERS))


def test_a_component_behind_topics_gives_them_too(room) -> None:
    (room / "room.ros2.yaml").write_text(BINDING.replace("reset: /reset\n", "clock: null\n"))
    with running(ROBOT, "controller"):
        check_equal_episodes(LAGS, roles={"generator": RoleSpec.of(Ros1Generator, PARAMETERS)})


def test_the_simulator_keeps_its_contract(room) -> None:
    with running(ROBOT, "world"):
        scenario = {"name": "a", "duration": 1.0, "world": {"lag": 0.3}}
        check_simulator(RoleSpec.of(Room, PARAMETERS), scenario, [0.5] * 10)


def test_a_world_in_real_time_misses_no_tick(room) -> None:
    with running(ROBOT, "world"):
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
    with running(ROBOT, "world", 5):
        episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert "simulator at tick 4" in episode.failure
    assert "no message of /clock within 2 s" in episode.failure


SERVED = (
    BINDING
    + """\
reset_service: {service: /reset_world, type: std_srvs/srv/Trigger}
step_service: {service: /step, type: std_srvs/srv/SetBool, request: {data: true}}
"""
)


def test_a_world_that_steps_by_services_gives_the_episodes_of_one_process(room) -> None:
    pytest.importorskip("std_srvs", reason="std_srvs is not installed for this Python")
    (room / "room.ros2.yaml").write_text(SERVED)
    with running(ROBOT, "services"):
        check_equal_episodes(LAGS[::2], simulator=RoleSpec.of(Room, PARAMETERS))


@pytest.mark.parametrize(
    "answers, words",
    [
        ("silent", "did not answer within 1 s"),
        ("refuses", "answered success: false, 'the physics engine is not loaded'"),
        ("broken", 'answered success: false, "service [/reset_world] responded with an error: '),
    ],
)
def test_a_service_that_fails_is_infrastructure(room, answers, words) -> None:
    pytest.importorskip("std_srvs", reason="std_srvs is not installed for this Python")
    (room / "room.ros2.yaml").write_text(SERVED)
    hasty = {"timeout": 1.0} if "within 1 s" in words else {}
    world = RoleSpec.of(Room, {**PARAMETERS, **hasty})
    with running(ROBOT, "services", answers):
        episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert episode.failure.startswith("infrastructure: ")
    assert f"the service /reset_world (std_srvs/srv/Trigger) {words}" in episode.failure


def test_a_service_that_is_not_there_is_named(room, monkeypatch) -> None:
    pytest.importorskip("std_srvs", reason="std_srvs is not installed for this Python")
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 1.0)
    (room / "room.ros2.yaml").write_text(SERVED)
    with running(ROBOT, "world"):
        episode = episode_of(0.3, simulator=RoleSpec.of(Room, PARAMETERS))
    assert episode.validity == "missing"
    assert "nothing serves /reset_world, nothing serves /step" in episode.failure


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
    (room / "scan.yaml").write_text(SCAN)
    binding = TopicBinding.read("scan.yaml")
    percept = {"ranges": (1.0, 2.5), "arm": {"second": 0.25}, "count": 3.0}
    made = binding.messages("percept", percept, 1_500_000_000, lambda name: message_type(name)())
    assert (made["/scan"].header.stamp.secs, made["/scan"].header.stamp.nsecs) == (1, 500_000_000)
    back = binding.values("percept", made)
    assert back == {"ranges": (1.0, 2.5), "arm.second": 0.25, "count": 3.0}
    with pytest.raises(ConfigurationError, match="has no message type 'vision_msgs/msg/Nothing'"):
        message_type("vision_msgs/msg/Nothing")
