"""A world that is reset and steps by services of ROS 2, in another process: as in one process."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest
from dds_network import DOMAIN, LOOPBACK

from pytest_dura import ConfigurationError, RoleSpec

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
pytest.importorskip("rosbags", reason="the extra ros2 is not installed")

import ros_robot
from robot_room import BINDING
from robot_topics import check_equal_episodes, episode_of, running

from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.bus import close_buses
from pytest_dura.adapters.ros2.generator import Ros2Generator
from pytest_dura.adapters.ros2.messages import sample_type
from pytest_dura.adapters.ros2.service_types import SERVICES

NODE = Path(ros_robot.__file__)
SERVED = (
    BINDING
    + """\
reset_service: {service: /reset_world, type: std_srvs/srv/Trigger}
step_service:
  service: /world/room/control
  type: ros_gz_interfaces/srv/ControlWorld
  request: {world_control.pause: true, world_control.multi_step: 100}
"""
)
PARAMETERS = {"binding": "room.ros2.yaml", "domain": DOMAIN, "timeout": 30.0}
WORLD = RoleSpec("robot_room:RosRoom", PARAMETERS)
HASTY = RoleSpec("robot_room:RosRoom", {**PARAMETERS, "timeout": 1.0})


@pytest.fixture
def room(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    (tmp_path / "room.ros2.yaml").write_text(SERVED)
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 20.0)
    yield tmp_path
    gc.collect()  # simulators that failed
    close_buses()


def test_a_world_that_steps_by_services_gives_the_episodes_of_one_process(room) -> None:
    with running(NODE, "services", DOMAIN):
        check_equal_episodes((0.1, 0.3, 0.6, 0.9, 1.2), simulator=WORLD)


@pytest.mark.parametrize(
    "kind, request_", [("Empty", "{}"), ("SetBool", "{data: true}")], ids=["empty", "set-bool"]
)
def test_a_reset_may_be_of_another_type(room, kind, request_) -> None:
    type_ = f"std_srvs/srv/{kind}"
    reset = f"{{service: /reset_world, type: {type_}, request: {request_}}}"
    text = SERVED.replace("{service: /reset_world, type: std_srvs/srv/Trigger}", reset)
    assert text != SERVED
    (room / "room.ros2.yaml").write_text(text)
    with running(NODE, "services", DOMAIN, type_):
        here, there = episode_of(0.6), episode_of(0.6, simulator=WORLD)
    assert there.failure is None
    assert there.signal("x").tolist() == here.signal("x").tolist()


RESET = "the service /reset_world (std_srvs/srv/Trigger)"
STEP = "the service /world/room/control (ros_gz_interfaces/srv/ControlWorld)"


@pytest.mark.parametrize(
    "answers, tick, words",
    [
        ("silent", 0, f"{RESET} did not answer within 1 s"),
        ("others", 0, f"{RESET} did not answer within 1 s"),  # its answers are those to others
        ("refuses", 0, f"{RESET} answered success: false, 'the physics engine is not loaded'"),
        ("stuck", 1, f"{STEP} answered success: false"),
    ],
)
def test_a_service_that_fails_is_infrastructure(room, answers, tick, words) -> None:
    world = HASTY if "within 1 s" in words else WORLD
    with running(NODE, "services", DOMAIN, answers):
        episode = episode_of(0.3, simulator=world)
    assert episode.validity == "missing"
    assert episode.failure.startswith("infrastructure: ")
    assert words in episode.failure
    assert ("reset" if tick == 0 else "tick 0") in episode.failure


def test_a_late_answer_is_none_to_the_next_call(room) -> None:
    with running(NODE, "services", DOMAIN, "late"):
        episode = episode_of(0.3, simulator=HASTY)
        assert episode.validity == "missing"
        assert f"{RESET} did not answer within 1 s" in episode.failure
        here, there = episode_of(0.6), episode_of(0.6, simulator=WORLD)
    assert there.failure is None
    assert there.signal("x").tolist() == here.signal("x").tolist()


def test_a_service_that_is_not_there_is_named(room, monkeypatch) -> None:
    monkeypatch.setattr("pytest_dura.adapters.ros2.bus._FINDING", 1.0)
    with running(NODE, "world", DOMAIN):
        episode = episode_of(0.3, simulator=HASTY)
    assert episode.validity == "missing"
    assert "nothing serves /reset_world, nothing serves /world/room/control" in episode.failure


@pytest.mark.parametrize("kind", SERVICES)
def test_samples_have_the_bytes_of_classes_that_were_written_by_hand(kind) -> None:
    for place, end in enumerate(("Request", "Response")):
        by_hand = ros_robot.SERVICES[kind][place](2**63 + 5, 7)
        for name in vars(by_hand):
            if name in ("success", "data"):
                setattr(by_hand, name, True)
            if name == "message":
                by_hand.message = "ready"
            if name == "world_control":
                by_hand.world_control.multi_step = 100
        made = sample_type(f"{kind}_{end}")(*vars(by_hand).values())
        assert made.serialize() == by_hand.serialize()
        names = [each.__idl__.idl_transformed_typename for each in (made, by_hand)]
        assert names[0] == names[1]


@pytest.mark.parametrize(
    "before, after, words",
    [
        ("srv/Trigger", "srv/Triger", "there is no service type 'std_srvs/srv/Triger'"),
        ("world_control.multi_step", "world_control.steps", "world_control has no field 'steps'"),
        ("multi_step: 100", "multi_step: -1", "is a uint32, and not -1"),
        ("multi_step: 100", "multi_step: 0.5", "is a uint32, and not 0.5"),
        ("pause: true", "pause: 1", "is a bool, and not 1"),
        ("service: /reset_world", "service: /world/room/control", "has the type std_srvs"),
    ],
)
def test_a_wrong_call_is_refused_with_its_line(room, before, after, words) -> None:
    assert before in SERVED
    (room / "room.ros2.yaml").write_text(SERVED.replace(before, after))
    with pytest.raises(ConfigurationError) as error:
        TopicBinding.read("room.ros2.yaml")
    assert words in str(error.value)
    assert "room.ros2.yaml:" in str(error.value)


def test_the_binding_of_the_page_is_one(tmp_path) -> None:
    text = (NODE.parents[2] / "docs" / "ros2.md").read_text()
    block = text.split("## Services")[1].split("```yaml\n")[1].split("```")[0]
    (tmp_path / "page.yaml").write_text(block)
    assert set(TopicBinding.read(tmp_path / "page.yaml").services) == {
        "reset_service",
        "step_service",
    }


def test_a_seed_fits_into_its_field(room) -> None:
    text = SERVED.replace("multi_step: 100", "seed: seed")
    (room / "room.ros2.yaml").write_text(text)
    call = TopicBinding.read("room.ros2.yaml").step_service
    message = ros_robot.ControlRequest()
    assert call.request_of(2**40 + 17, message).world_control.seed == 17
    assert message.world_control.pause is True


def test_a_component_is_asked_by_no_service(room) -> None:
    with pytest.raises(
        ConfigurationError, match="a component behind topics is asked by no service"
    ):
        Ros2Generator("room.ros2.yaml")
