"""``python -m pytest_dura verify`` on bundles of sessions that are not plain: they are intact."""

from __future__ import annotations

import json

import pytest

from pytest_dura.evidence import verify_bundle

TESTS = """
import os
import pytest

@pytest.mark.dura(scenario="corridor/tight")
@pytest.mark.requirement("GAP-1")
def test_each_run(episode):
    assert not episode.collided

@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("GAP-1")
def test_campaign(campaign):
    campaign.require()
"""
RECKLESS = "test_it.py", "--dura-generator=corridor:Reckless"


def verified(project, folder="dura-evidence", junit=None):
    return verify_bundle(project.path / folder, junit).problems


def test_the_junit_file_of_repeated_tests_agrees_with_the_record(project):
    project.write("test_it.py", TESTS)
    project.run(*RECKLESS, "--count=2", "-o", "junit_family=xunit1", "--junit-xml=junit.xml")
    file = project.path / "junit.xml"
    assert file.read_text().count('name="episode_verdict" value="violated"') == 4
    assert verified(project, junit=file) == []
    for name, value in ("episode_verdict", "satisfied"), ("verdict", "supported"):
        forged = project.path / "forged.xml"
        text = file.read_text().replace(
            f'name="{name}" value="violated"', f'name="{name}" value="{value}"'
        )
        forged.write_text(text)
        assert verified(project, junit=forged), name


def test_a_counterexample_that_is_run_again_has_the_seed_that_its_file_names(project):
    text = (project.path / "scenarios/corridor/free.yaml").read_text()
    kept = text.replace("corridor/free", "corridor/kept") + "seed: 7\n"
    project.write("scenarios/corridor/kept.yaml", kept)
    project.scenarios("--dura-generator=corridor:Reckless", select="corridor/kept")
    evidence = project.evidence()
    assert evidence.cases[0].seed == 7
    assert evidence.episodes[0].seed == 7
    assert verified(project) == []
    record = json.loads((project.path / "dura-evidence/evidence.json").read_text())
    record["cases"][0]["seed"] = 8
    (project.path / "dura-evidence/evidence.json").write_text(json.dumps(record))
    assert any("its seed is 7, not 8" in problem for problem in verified(project))


WAIVED = """
import pytest

@pytest.mark.xfail(reason="known")
@pytest.mark.dura(scenario="corridor/broken")
@pytest.mark.requirement("GAP-1")
def test_it(campaign):
    campaign.require()
"""


def test_what_a_waived_failure_leaves_for_a_resumption_is_no_difference(project):
    text = (project.path / "scenarios/corridor/free.yaml").read_text()
    broken = text.replace("corridor:Watch", "corridor:Broken")
    project.write(
        "scenarios/corridor/broken.yaml", broken.replace("corridor/free", "corridor/broken")
    )
    project.write("test_it.py", WAIVED)
    result = project.run("test_it.py", "--dura-generator=corridor:Careful")
    assert result.ret == 0
    assert any((project.path / "dura-evidence/.episodes").iterdir())
    assert verified(project) == []
    assert verify_bundle(project.path / "dura-evidence", signed=True).problems


KILLED = """
import os

def test_it(orchestrator):
    orchestrator.run("corridor/tight")

def test_end():
    os.kill(os.getpid(), 9)
"""


def test_of_a_killed_session_it_says_so_and_finds_no_contradiction(project):
    project.write("test_it.py", KILLED)
    project.run_apart(*RECKLESS, "--dura-executor=in-process")
    assert project.evidence().status == "running"
    found = [problem for problem in verified(project) if problem.startswith("evidence.json")]
    assert found == ["evidence.json: the session is running: its evidence is incomplete"]


LOST = """
name: corridor/lost
simulator: corridor:Corridor
duration: 2.0
runs: 2
world: {wall: 9.0, dies: true}
roles: {generator: "corridor:Careful",
        fault_injector: "pytest_dura.faults.injector:CampaignInjector"}
faults: [{type: bias, target: gap, activation: {at: 0.4}, parameters: {offset: 0.1}}]
requirements: [GAP-1]
"""


def test_an_episode_that_a_lost_process_leaves_missing_keeps_the_plan_of_its_faults(project):
    project.write("scenarios/corridor/lost.yaml", LOST)
    project.scenarios("--dura-executor=processes", select="corridor/lost")
    episodes = project.evidence().episodes
    assert {episode.validity for episode in episodes} == {"missing"}
    assert {fault.planned_at for episode in episodes for fault in episode.faults} == {0.4}
    assert verified(project) == []


@pytest.mark.parametrize("listed", [True, False])
def test_a_schema_that_an_earlier_version_left_in_the_bundle_is_replaced(project, listed):
    project.scenarios(select="corridor/tight")
    bundle = project.path / "dura-evidence"
    (bundle / "evidence.schema.json").write_text("{}")
    manifest = json.loads((bundle / "manifest.json").read_text())
    if listed:
        manifest["files"]["evidence.schema.json"] = {"sha256": "0" * 64, "bytes": 2}
        (bundle / "manifest.json").write_text(json.dumps(manifest))
    result = project.scenarios(select="corridor/tight")
    assert result.ret in (0, 1)
    assert not (bundle / "evidence.schema.json").exists()
    assert verified(project) == []


def test_an_infinite_performance_value_is_measured_again_as_it_was(project):
    project.write(
        "conftest.py",
        "import math\n"
        "import pytest\n"
        "from pytest_dura import PerformanceAssessment, PerformanceOracle\n"
        "class Shaken(PerformanceOracle):\n"
        "    def run(self, view):\n"
        "        return PerformanceAssessment(values={'discomfort': math.inf})\n"
        "@pytest.fixture(scope='session')\n"
        "def performance_oracle():\n"
        "    return Shaken\n",
    )
    chosen = "--dura-select=intersection/nominal", "--dura-runs=1", "--dura-evidence-level=all"
    project.run("--dura-scenarios=builtin", *chosen)
    evidence = project.path / "dura-evidence"
    record = json.loads((evidence / "evidence.json").read_text())
    assert record["episodes"][0]["outcome"]["measures"]["uncomfortable"] is True
    assert verify_bundle(evidence).problems == []
