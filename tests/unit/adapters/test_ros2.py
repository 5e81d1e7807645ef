"""A world and a component behind topics of ROS 2: the same episode as in one process."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest
from dds_network import DOMAIN, LOOPBACK

from pytest_dura import (
    ConfigurationError,
    RoleSpec,
    check_simulator,
)

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
pytest.importorskip("rosbags", reason="the extra ros2 is not installed")

from robot_room import BINDING
from robot_topics import SCAN, check_equal_episodes, episode_of, running

from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import close_buses
from pytest_dura.adapters.ros2.generator import Ros2Generator
from pytest_dura.adapters.ros2.messages import definitions, message_type, zero

NODE = Path(__file__).parents[2] / "support" / "ros_robot.py"
LAGS = (0.1, 0.3, 0.6, 0.9, 1.2)
PARAMETERS = {"binding": "room.ros2.yaml", "domain": DOMAIN, "timeout": 30.0}
WORLD = RoleSpec("robot_room:RosRoom", PARAMETERS)


@pytest.fixture
def room(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    (tmp_path / "room.ros2.yaml").write_text(BINDING)
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 20.0)
    yield tmp_path
    close_buses()


def test_a_world_behind_topics_gives_the_episodes_of_one_process(room) -> None:
    with running(NODE, "world", DOMAIN):
        check_equal_episodes(LAGS, simulator=WORLD)


def test_a_component_behind_topics_gives_them_too(room) -> None:
    # The controller has no state, and reads no topic of resets.
    (room / "room.ros2.yaml").write_text(BINDING.replace("reset: /reset\n", ""))
    role = RoleSpec.of(Ros2Generator, PARAMETERS)
    with running(NODE, "controller", DOMAIN):
        check_equal_episodes(LAGS, roles={"generator": role})


def test_the_simulator_keeps_its_contract(room) -> None:
    with running(NODE, "world", DOMAIN):
        scenario = {"name": "a", "duration": 1.0, "world": {"lag": 0.3}}
        check_simulator(WORLD, scenario, [0.5] * 10)


def test_a_world_that_dies_or_is_not_there_is_infrastructure(room, monkeypatch) -> None:
    world = RoleSpec("robot_room:RosRoom", {**PARAMETERS, "timeout": 2.0})
    with running(NODE, "world", DOMAIN, 5):
        episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert "simulator at tick 4" in episode.failure
    words = "no message of /clock within 2 s"
    assert words in episode.failure
    gc.collect()  # the simulator that failed
    close_buses()
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 0.3)
    episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert "nothing reads /cmd_vel, nothing reads /reset, nothing writes /odom" in episode.failure


def test_a_world_that_goes_on_by_itself_is_not_in_step(room) -> None:
    with running(NODE, "world", DOMAIN):
        simulator = WORLD.create()
        simulator.set_time_step(0.1)
        simulator.reset({"world": {}}, 0)
        simulator.step(0.5)
        simulator._start -= 200_000_000  # as if the clock were two steps ahead
        with pytest.raises(Exception, match="the world is not in step: /clock is at"):
            simulator.step(0.5)
        simulator.close()


PACKAGES = ("std_msgs/", "geometry_msgs/", "nav_msgs/", "sensor_msgs/", "builtin_", "rosgraph_")


def test_messages_have_the_bytes_that_rosbags_gives_them() -> None:
    from rosbags.typesys import Stores, get_typestore

    store, seen = get_typestore(Stores.ROS2_HUMBLE), 0
    for name in definitions():
        if name.startswith(PACKAGES) and "/WString" not in name:
            message = zero(name)
            assert message_type(name).__idl__.idl_transformed_typename
            expected = bytes(store.serialize_cdr(of_rosbags(store, name, message), name))
            assert message.serialize() == expected, name
            seen += 1
    assert seen > 90


def of_rosbags(store, name, message):
    """The same message as an object of rosbags."""
    import numpy as np

    values = {}
    for field, (node_kind, detail) in store.fielddefs[name][1]:
        value = getattr(message, field)
        if node_kind == 2:
            value = of_rosbags(store, detail, value)
        elif node_kind in (3, 4) and detail[0][0] == 1 and detail[0][1][0] != "string":
            kind = {"octet": "uint8", "byte": "uint8"}.get(detail[0][1][0], detail[0][1][0])
            value = np.array(value, dtype=kind)
        elif node_kind in (3, 4) and detail[0][0] == 2:
            value = [of_rosbags(store, detail[0][1], each) for each in value]
        values[field] = value
    return store.types[name](**values)


@pytest.mark.parametrize(
    "before, after, words",
    [
        ("field: linear.x", "field: linear.q", "geometry_msgs/msg/Twist.linear has no field 'q'"),
        ("field: linear.x", "field: linear", "geometry_msgs/msg/Twist.linear is no number"),
        ("topic: /distance", "topic: /distanze", "the type of /distanze is not under `topics`"),
        ("std_msgs/msg/Float64", "std_msgs/msg/Flaot64", "no message type 'std_msgs/msg/Flaot64'"),
        ("pose.pose.position.x", "pose.covariance", "pose.covariance is a list"),
        ("name: speed, unit: m/s", "name: speed, unit: km/h", "is in m/s in the domain 'room'"),
    ],
)
def test_a_wrong_binding_is_refused_with_its_line(room, before, after, words) -> None:
    file = room / "room.ros2.yaml"
    file.write_text(BINDING.replace(before, after))
    with pytest.raises(ConfigurationError) as error:
        TopicBinding.read("room.ros2.yaml")
    assert words in str(error.value)
    assert "room.ros2.yaml:" in str(error.value)


def test_lists_integers_and_stamps_go_both_ways(room) -> None:
    (room / "scan.yaml").write_text(SCAN)
    binding = TopicBinding.read("scan.yaml")
    percept = {"ranges": (1.0, 2.5), "arm": {"second": 0.25}, "count": 3.0}
    messages = binding.messages("percept", percept, 1_500_000_000)
    assert messages["/scan"].ranges == [100.0, 250.0]
    assert (messages["/scan"].header.stamp.sec, messages["/scan"].header.stamp.nanosec) == (
        1,
        500_000_000,
    )
    assert messages["/joints"].position == [0, 0.25]
    back = binding.values("percept", messages)
    assert back == {"ranges": (1.0, 2.5), "arm.second": 0.25, "count": 3.0}
    # A fault removed it: an integer has no NaN.
    removed = binding.messages("percept", {**percept, "count": None}, 0)
    assert "/count" not in removed
