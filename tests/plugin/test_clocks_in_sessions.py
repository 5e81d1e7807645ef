"""Sessions by the wall clock and with latencies: what is judged, shown, replayed and refused."""

from __future__ import annotations

import shutil
import sys

import pytest
from link_suite import copy_suite

from pytest_dura.evidence import verify_bundle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the suite has a pipe")
SCENARIO = """
name: tank/clocked
simulator: tank:Rig
domain: tank:TANK
duration: 1
{keys}
roles: {{generator: "tank:Slow"}}
requirements: [LEVEL-1, TIME-1, TIME-2]
"""
REQUIREMENTS = """
  - {id: TIME-1, text: Commands are in time., kind: performance, check: always (loop.late < 0.5)}
  - id: TIME-2
    text: A tick takes at most a second.
    kind: performance
    check: always (loop.period < 1)
"""
SLOW = """

class Slow(Fill):
    def propose(self, view):
        import time
        if 0.35 < view.time < 0.45:
            time.sleep(0.25)
        return super().propose(view)


class Rig(Tank):
    tolerances = {"level": 0.5}
"""


@pytest.fixture
def tank(project):
    shutil.rmtree(project.path / "scenarios")
    copy_suite(project.path)
    (project.path / "scenarios/tank.yaml").unlink()
    for name, more in (("scenarios/requirements.yaml", REQUIREMENTS), ("tank.py", SLOW)):
        file = project.path / name
        file.write_text(file.read_text() + more)
    return project


def output(result):
    return result.stdout.str() + result.stderr.str()


def test_by_the_wall_clock_misses_are_signals_and_a_table_and_runs_are_draws(tank) -> None:
    tank.write("scenarios/clocked.yaml", SCENARIO.format(keys="clock: wall\nhold: 0.5\nruns: 3"))
    result = tank.scenarios("--dura-evidence-level=all", select="tank/clocked")
    verdicts = tank.verdicts()
    assert verdicts["tank/clocked", "TIME-1"] == "violated", output(result)
    assert "Commands in time" in output(result)
    assert "the clock is that of the wall" in output(result)
    record = tank.evidence()
    episode = record.episodes[0]
    kept = episode.outcome.timeliness
    assert kept.clock == "wall"
    assert kept.ticks == 10
    assert 1 <= kept.late <= 9
    assert 0.08 < kept.period < 0.3
    assert "clock" in (tank.path / "dura-evidence/evidence.json").read_text()
    assert verify_bundle(tank.path / "dura-evidence").problems == []
    again = tank.run("--dura-replay=tank/clocked#0")
    assert "the same within the tolerances of its simulator: level" not in output(again)
    assert "the same within the tolerances of its simulator, no further: level" in output(again)


def test_a_replay_without_tolerances_says_why_it_differs(tank) -> None:
    plain = SCENARIO.replace("tank:Rig", "tank:Tank")
    tank.write("scenarios/clocked.yaml", plain.format(keys="clock: wall"))
    tank.scenarios(select="tank/clocked")
    again = tank.run("--dura-replay=tank/clocked#0")
    assert again.ret == 1
    assert "DIFFERENT, as it may be: the clock is that of the wall" in output(again)


def test_the_option_takes_the_place_of_the_key(tank) -> None:
    tank.write("scenarios/clocked.yaml", SCENARIO.format(keys="clock: wall"))
    result = tank.scenarios("--dura-clock=simulated", select="tank/clocked")
    assert result.ret == 0, output(result)
    assert tank.evidence().episodes[0].outcome.timeliness is None
    tank.write("scenarios/clocked.yaml", SCENARIO.format(keys=""))
    result = tank.scenarios("--dura-clock=wall", select="tank/clocked")
    assert tank.evidence().episodes[0].outcome.timeliness.clock == "wall"


@pytest.mark.parametrize(
    "keys, words",
    [
        ("clock: wall\nlatency: declared", "latencies are what they are"),
        ("latency: declared\npolicy: refine(2)", "asks anew within a tick"),
        ("clock: sundial", "simulated"),
        ("hold: 0", "greater than 0"),
    ],
)
def test_what_does_not_go_together_is_refused_with_its_file(tank, keys, words) -> None:
    tank.write("scenarios/clocked.yaml", SCENARIO.format(keys=keys))
    result = tank.scenarios(select="tank/clocked")
    assert result.ret != 0
    assert "clocked.yaml" in output(result)
    assert words in output(result)


def test_a_policy_that_the_clock_rules_out_is_refused_at_its_place_before_anything_runs(
    tank,
) -> None:
    tank.write("scenarios/tank.yaml", SCENARIO.format(keys="policy: refine(1)"))
    result = tank.run("--dura-scenarios", "--dura-clock=wall")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    text = output(result)
    assert "scenarios/tank.yaml:6: the scenario 'tank/clocked' asks anew within a tick" in text
    assert "expected: recover, halt or log_only by the wall clock" in text
