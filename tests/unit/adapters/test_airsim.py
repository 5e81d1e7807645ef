"""AirSim: the real client against a loopback server that speaks its protocol."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from pytest_dura import ConfigurationError, EpisodeSpec, RoleSpec, Termination, check_simulator
from pytest_dura.execution import run_episode
from pytest_dura.faults import parse_fault
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

if find_spec("cosysairsim") is None:
    pytest.skip("the extra airsim is not installed", allow_module_level=True)

from airsim_server import AirSimServer
from free_ports import free_port

from pytest_dura.adapters.airsim.__main__ import main
from pytest_dura.adapters.airsim.server import CONNECTIONS, AirSimError
from pytest_dura.adapters.airsim.simulator import AirSimSimulator

PATH = "pytest_dura.adapters.airsim"
NORTH = {"vx": 3.0, "vy": 0.0, "climb": 0.0}


def test_the_client_brings_no_folder_to_import_from() -> None:
    script = (
        "import sys; sys.path.remove('');"
        "from pytest_dura.adapters.airsim.server import library; before = list(sys.path);"
        "library(); assert 'cosysairsim' in sys.modules; sys.exit(sys.path != before)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.fixture
def server():
    made = AirSimServer()
    yield made
    CONNECTIONS.close()
    made.close()


def spec_of(port, world=None, faults=(), **changes):
    return EpisodeSpec(
        case="field/there",
        run=0,
        seed=0,
        simulator=RoleSpec(f"{PATH}.simulator:AirSimSimulator", {"port": port, "timeout": 5.0}),
        roles={
            "generator": RoleSpec(f"{PATH}.flights:FlyThere"),
            "fault_injector": RoleSpec("pytest_dura.faults.injector:CampaignInjector"),
        },
        scenario={"name": "a", "world": world or {}},
        termination=Termination(time_limit=40.0),
        time_budget=60.0,
        faults=tuple(parse_fault(fault) for fault in faults),
        **changes,
    )


def test_it_keeps_the_contract_of_simulators(server) -> None:
    spec = RoleSpec(f"{PATH}.simulator:AirSimSimulator", {"port": server.port})
    report = check_simulator(spec, {"name": "a", "world": {"altitude": 8.0}}, [NORTH] * 12)
    assert report.not_supported == ("lazy channels", "snapshot and restore", "render", "scene")


def test_a_server_that_is_gone_is_let_go_of_all_the_same(server) -> None:
    simulator = AirSimSimulator(port=server.port, timeout=2.0)
    simulator.reset({"name": "a", "world": {}}, 0)
    server.close()
    CONNECTIONS.close()
    with pytest.raises(AirSimError, match="no server of AirSim answers"):
        AirSimSimulator(port=server.port, timeout=2.0).reset({"name": "a", "world": {}}, 0)


def test_a_flight_goes_to_its_goal_in_step(server) -> None:
    episode = run_episode(spec_of(server.port, {"goal_x": 30.0, "goal_y": 12.0, "altitude": 7.0}))
    assert (episode.failure, episode.termination) == (None, "goal")
    x, y, altitude, speed = (episode.signal(name) for name in ("x", "y", "altitude", "speed"))
    assert np.hypot(x[-1] - 30.0, y[-1] - 12.0) <= 2.0
    assert np.abs(altitude - 7.0).max() < 0.1
    assert speed.max() == pytest.approx(5.0, abs=0.1)
    assert not episode.signal("collided").any()
    assert np.abs(np.diff(x)).max() <= 0.1 * speed.max() + 0.01
    assert server.paused
    assert server.wind == [0.0, 0.0, 0.0]


def test_what_the_sensor_misses_is_struck_and_counts(server) -> None:
    far = {"goal_x": 90.0}
    stopped = run_episode(spec_of(server.port, far))
    assert stopped.termination == "time"
    assert 1.0 < stopped.signal("ahead").min() < 3.5
    blind = {"type": "bias", "target": "range.ahead", "activation": {"at": 0.0},
             "parameters": {"offset": 30.0}}  # fmt: skip
    struck = run_episode(spec_of(server.port, far, [blind]))
    assert struck.termination == "critical"
    assert any("it has struck Wall_North" in str(event) for event in struck.events)
    assert struck.signal("collided")[-1] == 1.0
    assert JudgedEpisode.of(struck).robustness("always (ahead > 1)") < 0.0
    again = run_episode(spec_of(server.port, far))  # what was struck before does not count
    assert not again.signal("collided").any()


def test_no_server_and_one_that_does_not_answer_are_infrastructure(server, monkeypatch) -> None:
    port = free_port()
    episode = run_episode(spec_of(port))
    assert episode.validity == "missing"
    assert f"no server of AirSim answers at 127.0.0.1:{port}: ping: Retry" in episode.failure
    monkeypatch.setattr(f"{PATH}.server._LOOK", 0.5)
    server.deaf = "ping"
    episode = run_episode(spec_of(server.port))
    assert f"127.0.0.1:{server.port}: ping: no answer within 0.5 s" in episode.failure


def test_a_server_that_is_lost_in_an_episode_is_found_again_for_the_next(server) -> None:
    simulator = AirSimSimulator(port=server.port, timeout=0.5)
    simulator.reset({"world": {}}, 0)
    simulator.step(NORTH)
    server.deaf = "simContinueForTime"
    with pytest.raises(AirSimError, match=r"simContinueForTime: no answer within 0\.5 s"):
        simulator.step(NORTH)
    server.deaf = ""
    simulator.reset({"world": {}}, 0)
    simulator.step(NORTH)
    server.drop()
    with pytest.raises(AirSimError, match=r"no answer within 0\.5 s"):
        simulator.step(NORTH)
    assert simulator.reset({"world": {}}, 0).truth["altitude"] == 5.0


def test_one_connection_serves_many_episodes(server) -> None:
    for _ in range(3):
        AirSimSimulator(port=server.port).reset({"world": {"wind_x": 2.0}}, 0)
    assert server.asked.count("getMinRequiredClientVersion") == 1
    assert server.wind == [2.0, 0.0, 0.0]
    CONNECTIONS.close()
    assert not server.paused


def test_a_clock_that_does_not_come_to_the_tick_is_refused(server) -> None:
    simulator = AirSimSimulator(port=server.port)
    simulator.reset({"world": {}}, 0)
    server.slip = 0.08
    with pytest.raises(AirSimError, match=r"clock is 0\.\d+ s beyond the tick: is it paused"):
        simulator.step(NORTH)
    server.slip = -0.08
    simulator.reset({"world": {}}, 0)
    with pytest.raises(AirSimError, match="before the tick"):
        simulator.step(NORTH)
    # What the physics rounds off in a tick is made up for in the next.
    server.slip = 0.0
    simulator.reset({"world": {}}, 0)
    for _ in range(40):
        simulator.step(NORTH)
    assert server.time - simulator._start == pytest.approx(4.0, abs=0.003)


def test_a_server_of_another_version_and_a_sensor_that_is_not_there_are_refused(server) -> None:
    server.version = 3
    with pytest.raises(ConfigurationError, match="client and server of AirSim do not fit"):
        AirSimSimulator(port=server.port).reset({"world": {}}, 0)
    server.version = 4
    with pytest.raises(AirSimError, match="No distance sensor with name Below exist"):
        AirSimSimulator(port=server.port, distance_sensor="Below").reset({"world": {}}, 0)


NO_VELOCITIES = [
    None, 3.0, {"vx": 1.0}, {**NORTH, "vx": 16.0}, {**NORTH, "vy": float("nan")},
    {**NORTH, "vz": 1.0},
]  # fmt: skip


@pytest.mark.parametrize("action", NO_VELOCITIES)
def test_what_is_no_velocity_is_refused(action) -> None:
    with pytest.raises(Exception, match="is no velocity; expected numbers vx, vy, climb"):
        AirSimSimulator().check_action(action)


def test_check_says_in_a_line_each_what_works_and_what_to_do(server, capsys) -> None:
    port = str(server.port)
    assert main(["check", "--port", port]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = ["client", "server", "settings", "distance", "flight", "steps", "repeats"]
    assert [line.split()[:2] for line in lines] == [["ok", f"{name}:"] for name in names]
    assert main(["check", "--port", port, "--distance-sensor", "Below"]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("FAIL  distance: AirSimError: getDistanceSensorData: No distance")
    assert 'remedy: add "Sensors"' in last
    assert main(["check", "--port", str(free_port())]) == 1
    assert "remedy: start Cosys-AirSim first" in capsys.readouterr().out
