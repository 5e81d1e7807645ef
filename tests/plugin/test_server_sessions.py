"""Sessions whose world is a server that is started, shared by episodes, restarted and ended."""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path

import pytest
from dds_network import DOMAIN, LOOPBACK
from free_ports import free_port
from link_suite import copy_suite

from pytest_dura.adapters.link.conversation import close_links

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="servers are started on POSIX")
PROGRAM = Path(__file__).parents[1] / "support" / "tank_server.py"
ROBOT = PROGRAM.with_name("ros_robot.py")
RIG = """
from pytest_dura.adapters.link.simulator import DeviceSimulator


class Rig(DeviceSimulator):
    tolerances = {"level": 1e-9}
    repeatable = True
"""
SCENARIO = """
name: tank/served
simulator:
  path: SIMULATOR
  params:
    transport: ADDRESS
    binding: tank.link.yaml
    server: ./tank_server.py ADDRESS tank.link.yaml lives DEATHS
domain: tank:TANK
duration: 1
runs: 3
time_budget: 60
world: {drain: 0.3}
roles: {generator: tank:Fill}
requirements: [LEVEL-1]
"""


@pytest.fixture
def tank(project):
    shutil.rmtree(project.path / "scenarios")
    copy_suite(project.path)
    program = project.path / "tank_server.py"
    program.write_text(f"#!{sys.executable}\n{PROGRAM.read_text()}")
    program.chmod(0o755)
    project.write("tank_rig.py", RIG)
    return project


def free_address():
    return f"tcp:127.0.0.1:{free_port()}"


def served(tank, *, deaths, simulator="tank_rig:Rig", address=None):
    address = address or free_address()
    values = {"SIMULATOR": simulator, "ADDRESS": address, "DEATHS": str(deaths)}
    text = SCENARIO
    for name, value in values.items():
        text = text.replace(name, value)
    tank.write("scenarios/served.yaml", text)
    return tank.scenarios(select="tank/served")


def lives(tank):
    return [int(number) for number in (tank.path / "lives").read_text().split()]


def all_ended(processes):
    close_links()  # as at the end of the session's process, which is this one here
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        if not any(Path(f"/proc/{process}").exists() for process in processes):
            return True
        time.sleep(0.05)
    return False


def output(result):
    return result.stdout.str() + result.stderr.str()


def test_episodes_share_a_server_that_ends_with_the_session(tank) -> None:
    result = served(tank, deaths=0)
    assert result.ret == 0, output(result)
    assert tank.verdicts() == {("tank/served", "LEVEL-1"): "supported"}
    assert len(lives(tank)) == 1
    assert os.getpid() not in lives(tank)
    assert all_ended(lives(tank))


@pytest.mark.parametrize("wire", ["tcp", "dds"])
def test_one_that_dies_is_infrastructure_and_the_next_run_has_another(
    tank, wire, monkeypatch
) -> None:
    if wire == "dds":
        pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    address = free_address() if wire == "tcp" else f"dds:{DOMAIN}/served"
    result = served(tank, deaths=1, address=address)
    assert result.ret == 1, output(result)
    assert tank.verdicts() == {("tank/served", "LEVEL-1"): "undecided"}
    episodes = tank.evidence().episodes
    missing = [episode for episode in episodes if episode.validity == "missing"]
    assert len(missing) == 1, output(result)
    reason = missing[0].failure
    assert "simulator at tick 4" in reason
    words = {"tcp": "the other end has closed the connection", "dds": "the other end has gone"}
    assert words[wire] in reason
    assert "ended with exit code 3 (its output: the physics engine is out of memory)" in reason
    assert not any(event.kind == "component_failure" for e in episodes for event in e.events)
    assert len(lives(tank)) == 2
    assert all_ended(lives(tank))


def test_each_process_that_simulates_has_a_server_at_a_port_of_its_own(tank) -> None:
    result = served(tank, deaths=0, simulator="link", address="tcp:127.0.0.1:{port}")
    assert result.ret == 0, output(result)
    assert tank.verdicts() == {("tank/served", "LEVEL-1"): "supported"}
    assert lives(tank)
    assert all_ended(lives(tank))


def test_an_address_without_a_server_for_each_process_is_refused(tank) -> None:
    result = served(tank, deaths=0, simulator="link")
    assert result.ret != 0
    assert "take DeviceSimulator" in output(result)


ROOM = """
name: room/wall
simulator:
  path: robot_room:RosRoom
  params: {binding: room.ros2.yaml, domain: DOMAIN, server: ./node.py world DOMAIN 30}
domain: robot_room:ROOM
duration: 1.5
runs: 3
time_budget: 60
requirements: [WALL-1]
"""
WALL = """
requirements:
  - {id: WALL-1, text: Keeps off the wall., kind: safety, check: always (x < 4.9)}
"""


def test_a_world_behind_topics_is_started_and_restarted_too(tank, monkeypatch) -> None:
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    pytest.importorskip("rosbags", reason="the extra ros2 is not installed")
    from robot_room import BINDING

    from pytest_dura.adapters.ros2.bus import close_buses

    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    program = tank.path / "node.py"
    program.write_text(f"#!{sys.executable}\n{ROBOT.read_text()}")
    program.chmod(0o755)
    for name in ("ros_robot.py", "robot_room.py"):
        shutil.copy(ROBOT.with_name(name), tank.path / name)
    tank.write("room.ros2.yaml", BINDING)
    tank.write("scenarios/room.yaml", ROOM.replace("DOMAIN", str(DOMAIN)))
    tank.write("scenarios/requirements.yaml", WALL)
    (tank.path / "scenarios" / "tank.yaml").unlink()
    result = tank.scenarios(select="room/*")
    close_buses()
    episodes = tank.evidence().episodes
    states = [episode.validity for episode in episodes]
    assert states.count("missing") >= 1, output(result)
    assert states.count("valid") >= 1, output(result)
    (reason, *_) = [episode.failure for episode in episodes if episode.failure]
    assert "no message of /clock" in reason or "no message of /distance" in reason
    assert "ended with exit code 3" in reason
    assert tank.verdicts() == {("room/wall", "WALL-1"): "undecided"}
