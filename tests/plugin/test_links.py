"""Sessions with the component at the other end of a wire: the suite, and hardware that fails."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
import rogue_peer
from link_suite import compile_peer, copy_suite

from pytest_dura.evidence import verify_bundle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pipes are waited for by select")
TICK = 5
FAILURES = {
    "pulled": "LinkLostError: the program ended with exit code 3",
    "reset": "LinkError: the device was reset: it counts its frames anew",
    "late": "LinkError: no answer to frame 7 within 3 s",
    "raises": "LinkError: RuntimeError: the motor driver reports overcurrent",
    "garbage": "on the link: 7 bytes of garbage",
    "damaged": "on the link: 1 damaged frame, 36 bytes of garbage",
    "old": "on the link: 1 old frame",
    "doubled": "on the link: 1 doubled frame",
    "lost": "on the link: 2 lost frames",
    "drift": "on the link: its clock is off by ",
}
SCENARIO = """
name: rogue/{mode}
simulator: tank:Tank
domain: tank:TANK
duration: 1
time_budget: 90
roles:
  generator:
    path: link
    params:
      transport: pipe:./rogue_peer.py {mode} 5
      binding: tank.link.yaml
      timeout: {seconds}
requirements: [LEVEL-1]
"""


@pytest.fixture
def tank(project):
    shutil.rmtree(project.path / "scenarios")
    copy_suite(project.path)
    return project


def output(result):
    return result.stdout.str() + result.stderr.str()


def test_the_controller_in_c_is_judged_as_any_component_is(tank) -> None:
    compile_peer(tank.path)
    result = tank.scenarios(select="tank/*")
    assert result.ret == 1, output(result)
    assert tank.verdicts() == {
        ("tank/filling", "LEVEL-1"): "supported",
        ("tank/filling+gain", "LEVEL-1"): "violated",
    }
    assert not any(episode.events for episode in tank.evidence().episodes if not episode.faults)
    assert verify_bundle(tank.path / "dura-evidence").problems == []
    again = tank.run("--dura-replay=tank/filling#1")
    assert again.ret == 0, output(again)
    (tank.path / "controller").unlink()  # the program that runs cannot be written to
    (tank.path / "controller").write_bytes(b"another program")
    again = tank.run("--dura-replay=tank/filling#1")
    assert again.ret == 4
    assert "this is another file than the episode was recorded with" in output(again)


def test_what_hardware_does_wrong_is_the_component_s_and_named_with_the_tick(tank) -> None:
    program = tank.path / "rogue_peer.py"
    program.write_text(f"#!{sys.executable}\n" + Path(rogue_peer.__file__).read_text())
    program.chmod(0o755)
    for mode in FAILURES:
        seconds = 3 if mode == "late" else 20
        tank.write(f"scenarios/{mode}.yaml", SCENARIO.format(mode=mode, seconds=seconds))
    result = tank.scenarios(select="rogue/*")
    episodes = {episode.case: episode for episode in tank.evidence().episodes}
    assert episodes.keys() == {f"rogue/{mode}" for mode in FAILURES}, output(result)
    for mode, words in FAILURES.items():
        events = episodes[f"rogue/{mode}"].events
        first = next(event for event in events if event.kind == "component_failure")
        assert first.tick == TICK, mode
        assert words in first.detail, mode
        assert episodes[f"rogue/{mode}"].validity == "valid"
    assert words in output(result)


LOSSY = """
name: tank/wired
simulator: tank:Tank
domain: tank:TANK
duration: 4
policy: log_only
time_budget: 90
roles:
  generator: {path: link, params: {transport: "pipe:./controller", binding: tank.link.yaml,
    timeout: 30}}
campaigns:
  - {type: latency, target: gauge, activation: {at: 0.5}, parameters: {latency_ms: 500}}
  - {type: loss, target: gauge, activation: {at: 0.5}, parameters: {p: 1.0}}
  - {type: latency, id: late-command, target: command, activation: {at: 0.5},
     parameters: {latency_ms: 500}}
requirements: [LEVEL-1]
"""


def test_faults_of_communication_act_on_what_goes_over_the_link(tank) -> None:
    compile_peer(tank.path)
    tank.write("scenarios/wired.yaml", LOSSY)
    result = tank.scenarios(select="tank/wired*")
    episodes = tank.evidence().episodes
    assert len(episodes) == 3, output(result)
    for episode in episodes:
        (fault,) = episode.faults
        assert episode.validity == "valid", episode.invalid_reason
        assert fault.manifested_at is not None
        assert fault.activated_at == pytest.approx(0.5)
        assert ("generator" in fault.read_by) == ("command" not in fault.target)
    trajectories = {episode.trajectory for episode in episodes}
    assert len(trajectories) == 3


def test_a_program_that_is_not_the_project_s_is_not_started(tank) -> None:
    shell = SCENARIO.format(mode="shell", seconds=1).replace("./rogue_peer.py", "/bin/sh")
    tank.write("scenarios/shell.yaml", shell)
    result = tank.scenarios(select="rogue/*")
    assert "this program cannot be started" in output(result)
    assert result.ret != 0


def test_a_unit_that_the_domain_does_not_have_is_refused_at_its_line(tank) -> None:
    file = tank.path / "tank.link.yaml"
    file.write_text(file.read_text().replace("gauge.level, unit: m}", "gauge.level, unit: cm}"))
    result = tank.scenarios(select="tank/*")
    assert result.ret != 0
    assert "tank.link.yaml:4" in output(result)
    assert "is in m in the domain 'tank', and in cm on the wire" in output(result)
