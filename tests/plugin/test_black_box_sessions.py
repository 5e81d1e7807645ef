"""Sessions on black boxes: what the page says of them, campaigns, replay, and runs that fail."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from pytest_dura.evidence import verify_bundle

PAGE = (Path(__file__).parents[2] / "docs" / "black-boxes.md").read_text("utf-8")
SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Tank(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inflow, self.drain, self.level = 0.0, 0.5, 1.0
        tunable = Fmi2Variability.tunable
        parameter = Fmi2Causality.parameter
        drain = Real("drain", causality=parameter, variability=tunable)
        self.register_variable(Real("inflow", causality=Fmi2Causality.input))
        self.register_variable(drain)
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.level += step_size * (self.inflow - self.drain * max(self.level, 0.0) ** 0.5)
        return True
"""
FILES = dict(re.findall(r"```(?:python|yaml)\n# (\S+)\n(.*?)```", PAGE, re.DOTALL))


@pytest.fixture
def tank(project):
    shutil.rmtree(project.path / "scenarios")
    for name in ("plant.py", "scenarios/tank.yaml", "scenarios/requirements.yaml", "test_tank.py"):
        project.write(name, FILES[name])
    return project


def output(result):
    return result.stdout.str() + result.stderr.str()


def test_the_page_s_search_finds_what_the_page_shows(tank) -> None:
    result = tank.run("test_tank.py")
    assert result.ret == 1
    (shown,) = re.findall(r"^falsified: .*$", PAGE, re.MULTILINE)
    assert shown in output(result)
    (kept,) = tank.path.glob("scenarios/found/*.yaml")
    assert "simulator: plant:TANK" in kept.read_text()
    again = tank.scenarios(select="found/*")
    assert again.ret == 1
    assert "TANK-1" in output(again)


def test_a_campaign_supports_what_random_inputs_do_not_violate(tank) -> None:
    result = tank.scenarios(select="tank/*")
    assert result.ret == 0, output(result)
    assert tank.verdict("TANK-1", "tank/filling").verdict == "supported"
    record = tank.evidence()
    assert record.component_under_test.name == "TANK"
    assert len({episode.digest for episode in record.episodes}) == 20
    assert verify_bundle(tank.path / "dura-evidence").problems == []


def test_an_episode_is_replayed_from_the_record(tank) -> None:
    tank.scenarios(select="tank/*")
    result = tank.run("--dura-replay=tank/filling#3")
    assert result.ret == 0, output(result)
    digest = next(e.digest for e in tank.evidence().episodes if e.id.endswith("#3"))
    assert output(result).count(digest) == 2


@pytest.mark.parametrize(
    "line, text",
    [
        ("  world.inflow: {min: 0, max: 1.5, pieces: 5}", "from 0 to 1 m3/s"),
        ("  world.inflow: {min: 0, max: 1, pieces: 4}", "a list of 5 numbers"),
        ("  world.outflow: {min: 0, max: 1}", "no input 'outflow'"),
    ],
)
def test_a_variation_that_the_inputs_do_not_take_is_refused_with_its_line(tank, line, text):
    scenario = re.sub(r"  world.inflow: .*", line, FILES["scenarios/tank.yaml"])
    tank.write("scenarios/tank.yaml", scenario)
    result = tank.scenarios(select="tank/*")
    assert result.ret == 4
    assert text in output(result)
    assert "tank.yaml:" in output(result)


@pytest.mark.parametrize(
    "change, reason",
    [
        (("run.y[0]}", 'run.y[0] * float("nan")}'), "returned nan for 'level' at 0 s"),
        (("run = solve", 'raise OSError("no licence")\n    run = solve'), "OSError: no licence"),
        (('"level": run', '"height": run'), "returned no signal 'level'"),
        (("(0.0, time[-1])", "(0.0, 3.0)"), "0 to 3 s of a run from 0 to 20 s"),
    ],
)
def test_a_run_that_fails_is_missing_with_its_reason(tank, change, reason) -> None:
    tank.write("plant.py", FILES["plant.py"].replace(*change))
    result = tank.scenarios("--dura-runs=2", select="tank/*")
    assert result.ret == 1
    text = re.sub(r"\s+", " ", output(result))
    assert reason in text
    assert tank.verdict("TANK-1", "tank/filling").verdict == "undecided"


def drifting(arguments=""):
    """The page's plant, of which each run differs from the one before by a millimetre."""
    source = FILES["plant.py"].replace("def tank(", "CALLS = []\n\n\ndef tank(")
    source = source.replace("    run = solve_ivp(", "    CALLS.append(0)\n    run = solve_ivp(")
    source = source.replace("run.y[0]}", "run.y[0] + 0.001 * len(CALLS)}")
    return source.replace('signals=["level"]', f'signals=["level"]{arguments}')


def test_a_box_that_differs_from_run_to_run_is_named_as_such(tank) -> None:
    tank.write("plant.py", drifting())
    result = tank.scenarios("-o", "dura_require_repeatable=true", "--dura-runs=2", select="tank/*")
    assert result.ret == 1
    assert "not repeatable" in re.sub(r"\s+", " ", output(result))


def test_a_box_may_say_within_what_its_runs_are_the_same(tank) -> None:
    tank.write("plant.py", drifting(", tolerances={'level': 0.01}"))
    arguments = ["-o", "dura_require_repeatable=true", "--dura-runs=2"]
    result = tank.scenarios(*arguments, select="tank/*")
    assert result.ret == 0, output(result)
    assert '"within tolerances"' in (tank.path / "dura-evidence" / "evidence.json").read_text()
    tank.write("plant.py", drifting(", tolerances={'level': 0.0001}"))
    assert tank.scenarios(*arguments, select="tank/*").ret == 1


def test_a_changed_file_makes_other_episodes(tank) -> None:
    source = FILES["plant.py"].replace(
        'signals=["level"])', 'signals=["level"], files=["table.csv"])'
    )
    tank.write("plant.py", source)
    tank.write("table.csv", "1")
    tank.write("stop", "")
    tank.scenarios("--dura-runs=2", "-p", "stopping", select="tank/*")
    tank.write("table.csv", "2")
    result = tank.scenarios("--dura-runs=2", "-p", "stopping", "--dura-resume", select="tank/*")
    assert "2 episodes simulated again: roles and their parameters" in output(result)
    tank.write("table.csv", "3")
    replayed = tank.run("--dura-replay=tank/filling#0")
    assert replayed.ret != 0
    assert "another file than the episode was recorded with" in output(replayed)


def test_the_page_s_fmu_is_searched_and_replayed(tank) -> None:
    tank.write("slave.py", SLAVE)
    build = [sys.executable, "-m", "pythonfmu", "build", "-f", "slave.py"]
    subprocess.run(build, cwd=tank.path, check=True, capture_output=True)
    (tank.path / "slave.py").unlink()
    tank.write("fmu_plant.py", FILES["fmu_plant.py"])
    scenario = FILES["scenarios/tank.yaml"].replace("plant:TANK", "fmu_plant:TANK")
    tank.write("scenarios/tank.yaml", scenario)
    result = tank.run("test_tank.py")
    assert result.ret == 1
    assert "falsified: TANK-1 on tank/filling (TANK)" in output(result)
    (found,) = tank.path.glob("scenarios/found/*.yaml")
    again = tank.scenarios("--dura-executor=processes:1", select="found/*")
    assert again.ret == 1
    assert "1 of 1 valid episodes violated it" in output(again)
    replayed = tank.run(f"--dura-replay=found/{found.stem}#0")
    assert replayed.ret == 0


MIXER = """
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String

class Mixer(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.flow, self.recipe, self.mode, self.open, self.level = 0.5, "soup", 1, True, 1.0
        given = {"causality": Fmi2Causality.input, "variability": Fmi2Variability.discrete}
        self.register_variable(Real("flow", causality=Fmi2Causality.input))
        self.register_variable(Integer("mode", **given))
        self.register_variable(Boolean("open", **given))
        self.register_variable(String("recipe", **given))
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        rate = {"soup": 1.0}[self.recipe] * self.mode * self.open
        self.level += step_size * rate * self.flow
        return True
"""
MIXER_PARTS = """
from pathlib import Path

from pytest_dura import Input
from pytest_dura.adapters.fmi import Fmu

FILE = Path(__file__).parent / "Mixer.fmu"
FLOW = Input("flow", 0.0, 1.0, pieces=2)
PLAIN = Fmu(FILE, [FLOW], ["level"])
VALVE = Fmu(FILE, [FLOW, Input("open", 0, 1)], ["level"])
ODD = Fmu(FILE.with_name("Odd.fmu"), [FLOW], ["level"], validate=False)
TEXT = Fmu(FILE, [Input("recipe", 0.0, 1.0)], ["level"])
"""


def mixer(project, name, requirements="[MIX-1]", **variation):
    project.write(
        "scenarios/mixer.yaml",
        f"name: mixer/run\nsimulator: mixers:{name}\nduration: 2\ntime_step: 0.1\nruns: 4\n"
        f"variation: {json.dumps(variation)}\nrequirements: {requirements}\n",
    )
    return project.scenarios(select="mixer/*")


def test_an_fmu_with_inputs_of_every_type_is_run_and_its_record_says_how(project) -> None:
    shutil.rmtree(project.path / "scenarios")
    for name, text in (("mixer.py", MIXER), ("mixers.py", MIXER_PARTS)):
        project.write(name, text)
    build = [sys.executable, "-m", "pythonfmu", "build", "-f", "mixer.py"]
    subprocess.run(build, cwd=project.path, check=True, capture_output=True)
    (project.path / "mixer.py").unlink()
    with (
        zipfile.ZipFile(project.path / "Mixer.fmu") as old,
        zipfile.ZipFile(project.path / "Odd.fmu", "w") as odd,
    ):
        for name in old.namelist():
            odd.writestr(name, old.read(name).replace(b"<LogCat", b"<VendorsOwn/><LogCat"))
    project.write(
        "scenarios/requirements.yaml",
        "requirements:\n"
        "  - {id: MIX-1, text: Dry., kind: safety, check: always (level <= 4)}\n"
        "  - {id: MIX-2, text: Shut or open., kind: safety,\n"
        "     check: always (open <= 0 or open >= 1)}\n",
    )
    flow = {"min": 0, "max": 1, "pieces": 2}
    result = mixer(project, "PLAIN", **{"world.flow": flow})
    assert (result.ret, "Warning" in output(result)) == (0, False), output(result)
    assert "validate" not in project.evidence().component_under_test.params

    opened = {"world.flow": flow, "world.open": {"min": 0, "max": 1}}
    result = mixer(project, "VALVE", "[MIX-1, MIX-2]", **opened)
    assert result.ret == 0, output(result)
    assert project.verdict("MIX-2", "mixer/run").verdict == "supported"
    worlds = [episode.spec.scenario["world"] for episode in project.evidence().episodes]
    assert all(0.0 < world["open"] < 1.0 for world in worlds)  # as drawn

    result = mixer(project, "TEXT")
    assert result.ret == 4
    assert "the FMU's variable 'recipe' is not a number" in output(result)
    assert "type String" in output(result)

    result = mixer(project, "ODD", **{"world.flow": flow})
    assert result.ret == 0, output(result)
    record = project.evidence()
    assert record.component_under_test.params["validate"] is False
    assert all(e.spec.roles["generator"].params["validate"] is False for e in record.episodes)
    assert "'validate': False" in html.unescape(
        (project.path / "dura-evidence" / "report.html").read_text("utf-8")
    )
    assert verify_bundle(project.path / "dura-evidence").problems == []
    replayed = project.run("--dura-replay=mixer/run#0")
    assert replayed.ret == 0, output(replayed)
    project.write("mixers.py", MIXER_PARTS.replace(", validate=False", ""))
    result = mixer(project, "ODD", **{"world.flow": flow})
    assert result.ret == 4
    assert "validate=False" in output(result)


LOGS = """
import numpy as np

from pytest_dura import BlackBox

TIME, SPEED = np.arange(51) * 0.1, np.linspace(8.0, 0.0, 51)
FAST = SPEED.copy()
FAST[25] = 12.0


def log(time, speed):
    return BlackBox(lambda at, inputs: {"time": time, "speed": speed}, [], ["speed"])


def without(*lines):
    return log(np.delete(TIME, lines), np.delete(FAST, lines))


SECONDS = log(TIME, FAST)
NANOSECONDS = log((TIME * 1e9).astype(np.int64), FAST)
EPOCH = log(TIME + 1.7e9, FAST)
JITTER = log(TIME + np.random.default_rng(0).uniform(-0.01, 0.01, 51), FAST)
GAP = without(*range(20, 34))
LONGER = log(np.arange(151) * 0.1, np.append(np.zeros(100), FAST))
BACKWARDS = log(np.where(np.arange(51) == 30, 2.5, TIME), FAST)
UNKNOWN = log(TIME, np.where(TIME == 1.0, np.nan, FAST))
DOUBLED = log(np.where(np.arange(51) == 20, TIME[19], TIME), SPEED)
"""
PARTS_OF_LOGS = {
    "NANOSECONDS": "0 to 5000000000 s of a run from 0 to 5 s: 1 of 51 lines lie within it; if its "
    "times are in nanoseconds, multiply them by 1e-09",
    "EPOCH": "1700000000 to 1700000005 s of a run from 0 to 5 s: 0 of 51 lines lie within it; "
    "subtract the first stamp: time - time[0]",
    "JITTER": "50 of 51 lines lie within it; subtract the first stamp: time - time[0]",
    "GAP": "the log has gaps: no line from 1.9 to 3.4 s; only 3.5 of 5 s have lines",
    "LONGER": "0 to 15 s of a run from 0 to 5 s: 51 of 151 lines lie within it; let the scenario "
    "run for 15 s (`duration`), or cut the log",
    "SHORTENED": "0 to 5 s of a run from 0 to 1 s: 11 of 51 lines lie within it",
    "BACKWARDS": "times that go back",
    "UNKNOWN": "returned nan for 'speed' at 1 s",
}


def test_a_log_is_judged_as_a_whole_or_not_at_all(project) -> None:
    shutil.rmtree(project.path / "scenarios")
    project.write("logs.py", LOGS)
    project.write(
        "scenarios/requirements.yaml",
        "requirements: [{id: LOG-1, text: Slow., kind: safety, check: always (speed <= 9)}]\n",
    )
    for name in [*PARTS_OF_LOGS, "SECONDS", "DOUBLED"]:
        log, limit = (name, "") if name != "SHORTENED" else ("SECONDS", "iterations: 10\n")
        project.write(
            f"scenarios/{name.lower()}.yaml",
            f"name: log/{name.lower()}\nsimulator: logs:{log}\nduration: 5\ntime_step: 0.1\n"
            f"runs: 1\nrequirements: [LOG-1]\n{limit}",
        )
    result = project.scenarios(select="log/*")
    assert result.ret == 1
    assert project.verdict("LOG-1", "log/seconds").verdict == "violated"
    assert project.verdict("LOG-1", "log/doubled").verdict == "supported"
    failures = {episode.case: episode.failure for episode in project.evidence().episodes}
    for name, reason in PARTS_OF_LOGS.items():
        verdict = project.verdict("LOG-1", f"log/{name.lower()}")
        assert (verdict.verdict, verdict.missing) == ("undecided", 1), name
        assert reason in failures[f"log/{name.lower()}"]
        assert reason in re.sub(r"\s+", " ", output(result))
