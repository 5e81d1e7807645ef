"""Domains of anybody: what is listed, where faults are injected, and who reads them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pytest_dura.evidence.files import file_entry, manifest_text

EXECUTOR = ""
"""Sessions that may not know the option."""

CAR = """
name: car/blinded
simulator: driving
duration: 4
runs: 2
policy: log_only
roles: {{generator: aggressive, security_assessor: null, performance_oracle: null,
  recovery_planner: null{more}}}
faults: [{{type: stuck-at, target: odometry.speed, activation: {{at: 0.5}},
  parameters: {{value: 0.0}}}}]
requirements: [SPEED-1]
"""
REQUIREMENTS = """
requirements:
  - {id: SPEED-1, text: It goes on., kind: performance, check: eventually (speed > 3)}
"""


def write_car(project, more=""):
    project.write("scenarios/car.yaml", CAR.format(more=more))


@pytest.fixture
def car(project):
    project.write("scenarios/requirements_speed.yaml", REQUIREMENTS)
    write_car(project)
    return project


def test_a_fault_that_only_the_monitor_reads_gives_valid_runs_and_names_it(car):
    result = car.run("car/blinded")
    verdict = car.verdict("SPEED-1", "car/blinded")
    assert (verdict.verdict, verdict.episodes, verdict.invalid) == ("supported", 2, 0)
    record = car.evidence()
    for episode in record.episodes:
        (fault,) = episode.faults
        assert episode.validity == "valid"
        assert fault.read_by == ("safety_monitor",)
        assert fault.manifested_at == 0.5
    (chain,) = record.cases[0].metrics.faults
    assert (chain.manifested, chain.read_by) == (2, ["safety_monitor"])
    page = (car.path / "dura-evidence" / "report.html").read_text()
    assert "on odometry.speed, read by safety_monitor" in page
    assert result.ret == 0
    assert car.run("--dura-replay=car/blinded#0").ret == 0


def test_a_replay_compares_who_read_a_fault(car):
    car.run("car/blinded")
    record = car.evidence().to_json()
    for episode in record["episodes"]:
        episode["faults"][0]["read_by"] = ["generator"]
    bundle = car.path / "dura-evidence"
    (bundle / "evidence.json").write_text(json.dumps(record))
    files = json.loads((bundle / "manifest.json").read_text())["files"]
    files["evidence.json"] = file_entry(bundle / "evidence.json")
    (bundle / "manifest.json").write_text(manifest_text(files))
    result = car.run("--dura-replay=car/blinded#0")
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        [
            "  DIFFERENT: other roles read what a fault changed",
            "    stuck-at: recorded generator, now safety_monitor",
        ]
    )


def test_a_fault_that_nobody_reads_is_invalid_all_the_same(car):
    write_car(car, ", safety_monitor: null")
    car.run("car/blinded")
    assert car.verdict("SPEED-1", "car/blinded").verdict == "undecided"
    assert {one.invalid_reason for one in car.evidence().episodes} == {"never manifested: stuck-at"}


def test_a_file_with_faults_and_without_an_injector_is_refused_at_its_line(car):
    write_car(car, ", fault_injector: null")
    result = car.run("car/blinded")
    assert result.ret == 4
    text = result.stderr.str()
    assert "'car/blinded' plans faults, and the fault_injector is switched off" in text
    assert "scenarios/car.yaml:8" in text
    assert "roles.fault_injector" in text


PUMP = """
from pytest_dura import Action, Channel, Domain, Generator, Proposal, Signal, Simulator, Tick

class Pump(Simulator):
    def reset(self, scenario, seed):
        self.level, self.index = 1.0, 0
        return self.tick()
    def step(self, action):
        self.level += (0.5 - action) * self.time_step
        self.index += 1
        return self.tick()
    def tick(self):
        return Tick(self.index, self.index * self.time_step, {"level": self.level},
                    {"gauge": {"level": self.level}})
    def signals(self, ticks):
        import numpy as np
        return {"level": np.array([tick.truth["level"] for tick in ticks])}
    def fallback_action(self):
        return 0.0

class Drains(Generator):
    def propose(self, view):
        return Proposal(1.0 if view.percept["gauge"]["level"] > 1.0 else 0.0)

WATER = Domain(
    "water",
    signals=(Signal("level", "m", "above the bottom of the tank"),),
    percept_signals=(), proposal_signals=(),
    actions=(Action("flow", "m3/s", "out of the tank", least=0.0, greatest=1.0),),
    channels={"gauge": Channel("numbers", ("level",), units=("m",), frame="tank: upwards",
                               meaning="by a float")},
    fault_targets={"number": "gauge.level", "any": "gauge"},
)
"""
TANK = """
name: tank/filling
simulator: pump:Pump
domain: {domain}
duration: 15
roles: {{generator: "pump:Drains"}}
campaigns: {campaigns}
requirements: [LEVEL-1]
"""
LEVEL = """
requirements:
  - {id: LEVEL-1, text: It does not overflow., kind: safety, check: always (level < 1.5)}
"""


@pytest.fixture
def tank(project):
    """A project whose domain is registered nowhere: its scenario names it."""

    def write(domain="pump:WATER", campaigns="[none, bias]", requirements=LEVEL):
        project.write("pump.py", PUMP)
        project.write("water/tank.yaml", TANK.format(domain=domain, campaigns=campaigns))
        project.write("water/requirements.yaml", requirements)
        return project

    project.write(
        "pytest.ini",
        "[pytest]\npythonpath = .\ndura_scenario_paths = water\ndura_builtin_scenarios = false\n",
    )
    project.with_tank = write
    return project


def test_a_domain_named_in_a_scenario_gets_faults_and_an_injector(tank):
    project = tank.with_tank()
    project.run("--dura-scenarios", "--dura-runs=1")
    verdicts = project.verdicts()
    assert set(verdicts) == {("tank/filling", "LEVEL-1"), ("tank/filling+bias", "LEVEL-1")}
    assert verdicts["tank/filling", "LEVEL-1"] == "supported"
    (faulty,) = [one for one in project.evidence().episodes if one.faults]
    assert faulty.validity == "valid"
    assert faulty.faults[0].read_by == ("generator",)
    assert faulty.faults[0].target == "gauge.level"


def test_the_list_without_built_in_files_shows_the_project_s_domains_alone(tank):
    project = tank.with_tank(campaigns="[catalogue]")
    lines = project.run("--dura-list", "--dura-runs=1").outlines
    assert "  LEVEL-1 (safety): It does not overflow." in lines
    assert not any("SAF-1" in line or "intersection/" in line for line in lines)
    names = {line.split()[0] for line in lines if line.startswith("  ") and " (" in line}
    assert {"bias", "stuck-at", "delay"} <= names
    assert not {"ghost-obstacle", "gnss-jump", "brightness"} & names
    assert "  tank/filling+stuck-at::LEVEL-1" in lines
    assert "  tank/filling+ghost-obstacle::LEVEL-1" not in lines
    assert "channels of the domain driving" not in lines


def test_the_list_shows_what_the_project_s_domain_declares(tank):
    project = tank.with_tank()
    lines = project.run("--dura-list").outlines
    for line in (
        "channels of the domain water",
        "  gauge: numbers; level [m]; tank: upwards; by a float",
        "signals of the domain water",
        "  level: [m]; above the bottom of the tank",
        "actions of the domain water",
        "  command.flow: [m3/s]; 0 to 1; out of the tank",
        "fault targets of the domain water",
        "  number: gauge.level",
        "  fault_injector: pytest_dura.faults.injector:CampaignInjector",
    ):
        assert line in lines


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"domain": "watr"}, "unknown domain 'watr'"),
        ({"domain": "pump:Pump"}, "'pump:Pump' is no domain"),
        ({"domain": "pump:FIRE"}, "pump:FIRE"),
        (
            {"requirements": LEVEL.replace("level < 1.5", "gap > 1.5")},
            "gap",
        ),
    ],
)
def test_a_scenario_of_a_wrong_domain_is_refused_in_words(tank, changes, message):
    result = tank.with_tank(**changes).run("--dura-scenarios")
    assert result.ret == 4
    text = result.stderr.str()
    assert message in text
    assert "water/" in text
    assert "Traceback" not in text


def test_the_least_of_a_domain_is_one_as_the_page_prints_it(tank):
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "tank.md").read_text()
    (module,) = re.findall(r"<!-- tank.py -->\n```python\n(.*?)```", page, flags=re.DOTALL)
    (scenario,) = re.findall(r"```yaml\n# scenarios/tank.yaml\n(.*?)```", page, flags=re.DOTALL)
    check = re.search(r"check_simulator\(.*?\* 20\)", page)[0]
    requirement = "{id: LEVEL-1, text: Dry feet., kind: safety, check: always (level < 2.2)}"
    tank.write("tank.py", module)
    tank.write("water/tank.yaml", scenario)
    tank.write("water/requirements.yaml", f"requirements: [{requirement}]")
    tank.write(
        "test_contract.py",
        "from pytest_dura import check_simulator\nfrom tank import Pump, Tank\n"
        f"def test_it():\n    {check}\n",
    )
    tank.run_apart("test_contract.py", "-p", "no:dura").assert_outcomes(passed=1)
    result = tank.run_apart("--dura-scenarios")
    verdicts = tank.verdicts()
    assert verdicts["tank/filling", "LEVEL-1"] == "supported"
    assert verdicts["tank/filling+gain", "LEVEL-1"] == "violated"  # it fills to what it reads
    (head,) = [line for line in result.outlines if line.startswith("case ")]
    assert "highest m" in head
    assert len({episode.trajectory for episode in tank.evidence().episodes}) == 2 * 4  # drains vary


def test_a_registered_simulator_of_another_domain_than_the_named_one_is_refused(tank):
    tank.with_tank()
    file = tank.path / "water" / "tank.yaml"
    file.write_text(file.read_text().replace("simulator: pump:Pump", "simulator: driving"))
    result = tank.run("--dura-scenarios")
    assert result.ret == 4
    text = result.stderr.str()
    assert "tank.yaml:4: the simulator is one of the domain 'driving'" in text
    assert "found:    'pump:WATER'" in text


def test_a_declaration_that_is_refused_says_so_at_its_own_line(tank):
    tank.with_tank()
    pump = tank.path / "pump.py"
    pump.write_text(pump.read_text().replace('Signal("level", "m",', 'Signal("level", "",', 1))
    result = tank.run("--dura-scenarios")
    assert result.ret == 4
    line = next(
        n for n, text in enumerate(pump.read_text().splitlines(), 1) if '"level", ""' in text
    )
    text = result.stderr.str()
    assert f"the signal 'level' has no unit (pump.py:{line})" in text
    assert text.count("remedy:") == 1
    assert "declare Signal('level', unit=..., meaning=...)" in text


def test_an_unknown_domain_of_the_project_is_refused(project):
    project.write("pytest.ini", "[pytest]\ndura_domain = drivign\n")
    result = project.run("--dura-list")
    assert result.ret == 4
    assert "unknown domain 'drivign'" in result.stderr.str()
    assert "driving" in result.stderr.str()


def test_the_setting_of_built_in_files_is_true_or_false(project):
    project.write("pytest.ini", "[pytest]\ndura_builtin_scenarios = perhaps\n")
    result = project.run("--dura-list")
    assert result.ret == 4
    assert "dura_builtin_scenarios is true or false" in result.stderr.str()


def test_role_fixtures_return_the_defaults_of_the_project_s_domain(tank):
    project = tank.with_tank()
    project.write(
        "conftest.py",
        "import pump\nfrom pytest_dura import DOMAINS\nDOMAINS.register('water')(pump.WATER)\n",
    )
    with (project.path / "pytest.ini").open("a") as settings:
        settings.write("dura_domain = water\n")
    project.write(
        "test_defaults.py",
        "def test_it(fault_injector, safety_monitor):\n"
        "    assert fault_injector.path.endswith(':CampaignInjector')\n"
        "    assert safety_monitor.path == 'of the scenario'\n",
    )
    # In processes of their own: what a decorator registers would stay in this one.
    project.run_apart("test_defaults.py").assert_outcomes(passed=1)
    result = project.run_apart("--dura-scenarios", "--dura-runs=1")
    assert set(project.verdicts()) == {
        ("tank/filling", "LEVEL-1"),
        ("tank/filling+bias", "LEVEL-1"),
    }
    assert "RuleBased" not in result.stdout.str()


def test_a_measure_of_another_domain_is_refused_with_those_that_there_are(tank):
    project = tank.with_tank()
    project.write(
        "test_words.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='tank/filling', faults=['none'], runs=1)\n"
        "def test_it(episode):\n"
        "    assert not episode.collided\n"
        "@pytest.mark.dura(scenario='tank/filling', faults=['none'], runs=1)\n"
        "def test_signal(episode):\n"
        "    assert episode.robustness('always (gap > 0)') > 0\n",
    )
    result = project.run("test_words.py")
    result.assert_outcomes(failed=2)
    text = result.stdout.str()
    assert "no attribute 'collided'; the measures of its simulator Pump: none" in text
    assert "unknown signal 'gap'" in text or "no signal 'gap'" in text
    assert "level" in text
