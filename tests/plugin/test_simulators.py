"""What simulators say of themselves, as sessions respect it; ``--dura-simulator``."""

from __future__ import annotations

import importlib.util
import os

import pytest

SIMULATORS = """
import os
import random
from pathlib import Path

import markdown_it
from corridor import Corridor


class Bare(Corridor):
    lacks = {"lamps": "it is dark", "channels.gap": "it has no gauge"}


class Wide(Corridor):
    pass


class Served(Corridor):
    @classmethod
    def note(cls, what):
        with Path("served.log").open("a") as opened:
            opened.write(f"{what} {os.getpid()}\\n")

    @classmethod
    def open_process(cls):
        cls.note("open")

    @classmethod
    def close_process(cls):
        cls.note("close")


class Rig(Served):
    instances = "one"


class Drafty(Corridor):
    deterministic = False
    tolerances = {"x": 0.5}
    drafts = random.SystemRandom()

    def signals(self, ticks):
        columns = super().signals(ticks)
        return {**columns, "x": columns["x"] + self.drafts.uniform(0.0, 0.1)}


class Stormy(Drafty):
    tolerances = {"x": 1e-6}
"""


@pytest.fixture
def simulators(project):
    project.write("simulators.py", SIMULATORS)
    return project


def test_the_option_and_the_setting_replace_the_scenarios_simulator(simulators):
    result = simulators.scenarios("--dura-simulator=simulators:Wide", select="corridor/free")
    assert result.ret == 0
    evidence = simulators.evidence()
    assert {each.spec.simulator.path for each in evidence.episodes} == {"simulators:Wide"}
    # What its module imports is among the versions, though no episode has needed it.
    assert "markdown-it-py" in evidence.environment.packages
    simulators.write("pytest.ini", "[pytest]\npythonpath = .\ndura_simulator = simulators:Wide\n")
    simulators.scenarios(select="corridor/tight")
    (case,) = {each.spec.simulator.path for each in simulators.evidence().episodes}
    assert case == "simulators:Wide"


def test_a_name_that_is_none_is_refused_with_those_there_are(project):
    result = project.scenarios("--dura-simulator=drivin")
    assert result.ret == 4
    text = result.stderr.str()
    assert "unknown simulator 'drivin'" in text
    assert "driving.sumo" in text
    result = project.scenarios("--dura-simulator=corridor:Careful")
    assert "--dura-simulator" in result.stderr.str()


def test_a_simulator_of_another_domain_is_refused(project):
    result = project.run(
        "--dura-scenarios=builtin",
        "--dura-simulator=gymnasium",
        "--dura-select=intersection/nominal",
    )
    assert result.ret == 4
    assert "GymnasiumSimulator" in result.stderr.str()


def test_the_option_and_a_fixture_exclude_each_other(simulators):
    simulators.write(
        "conftest.py",
        "import pytest\nfrom simulators import Wide\n"
        "@pytest.fixture(scope='session')\ndef simulator():\n    return Wide\n",
    )
    result = simulators.scenarios("--dura-simulator=simulators:Wide")
    assert result.ret == 4
    assert "the simulator is given twice" in result.stderr.str()


def test_a_scenario_that_needs_what_the_simulator_lacks_is_refused_at_load(simulators):
    scenario = (
        "name: corridor/lit\nsimulator: {}\nduration: 2.0\nworld:\n  wall: 10.0\n  lamps: [A]\n"
        "roles: {{generator: 'corridor:Careful'}}\nrequirements: [GAP-1]\n"
    )
    simulators.write("scenarios/corridor/lit.yaml", scenario.format("'corridor:Corridor'"))
    result = simulators.scenarios("--dura-simulator=simulators:Bare", select="corridor/lit")
    assert result.ret == 4
    text = result.stderr.str()
    assert "Bare lacks lamps: it is dark" in text
    assert "lit.yaml:6" in text
    assert text.count("it is dark") == 1
    assert not (simulators.path / "dura-evidence").exists()
    simulators.write("scenarios/corridor/lit.yaml", scenario.format("'simulators:Bare'"))
    assert "Bare lacks lamps" in simulators.scenarios(select="corridor/free").stderr.str()


def test_a_fault_of_a_channel_that_the_simulator_lacks_is_refused_at_load(simulators):
    simulators.write(
        "scenarios/corridor/foggy.yaml",
        "name: corridor/foggy\nsimulator: 'simulators:Bare'\nduration: 2.0\n"
        "roles: {generator: 'corridor:Careful'}\nrequirements: [GAP-1]\n"
        "faults:\n  - {type: freeze, target: gap, activation: {at: 0.5}}\n",
    )
    text = simulators.scenarios(select="corridor/foggy").stderr.str()
    assert "Bare lacks channels.gap: it has no gauge" in text
    assert "foggy.yaml:7" in text


def test_repetition_and_replay_of_what_is_not_deterministic_keep_to_tolerances(simulators):
    given = ("--dura-simulator=simulators:Drafty", "--dura-evidence-level=all")
    assert simulators.scenarios(*given, "-o", "dura_require_repeatable=true").ret == 0
    for case in simulators.evidence().cases:
        assert case.repeat.result == "within tolerances"
        assert case.repeat.detail == "x within 0.5"
        assert case.repeat.digest != case.repeat.repeated_digest
    result = simulators.run("--dura-replay=corridor/free#0")
    assert result.ret == 0
    text = "  the same within the tolerances of its simulator, no further: x within 0.5"
    result.stdout.fnmatch_lines([text])


def test_beyond_its_tolerances_a_repetition_is_different(simulators):
    given = ("--dura-simulator=simulators:Stormy", "--dura-evidence-level=all")
    result = simulators.scenarios(
        *given, "-o", "dura_require_repeatable=true", select="corridor/free"
    )
    assert result.ret == 1
    (case,) = simulators.evidence().cases
    assert case.repeat.result == "different"
    assert "tolerance 1e-06" in case.repeat.detail
    result = simulators.run("--dura-replay=corridor/free#0")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  DIFFERENT beyond the tolerances of its simulator: x differs *"])


def test_a_replay_without_a_trace_says_that_it_cannot_compare(simulators):
    simulators.scenarios(
        "--dura-simulator=simulators:Drafty",
        "--dura-evidence-level=summary",
        select="corridor/free",
    )
    result = simulators.run("--dura-replay=corridor/free#0")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  DIFFERENT, as it may be: its simulator is not deterministic*"])


def test_a_class_is_opened_once_in_each_process_and_closed_at_its_end(simulators):
    given = ("--dura-simulator=simulators:Served", "--dura-runs=4")
    log = simulators.path / "served.log"
    simulators.scenarios(*given, "--dura-executor=in-process")
    opened, closed = log.read_text().splitlines()
    assert opened.replace("open", "close") == closed
    log.unlink()
    simulators.scenarios(*given, "--dura-executor=processes:2")
    opened = [line for line in log.read_text().splitlines() if line.startswith("open")]
    assert 1 <= len(opened) == len(set(opened)) <= 2
    assert closed.replace("close", "open") not in opened  # this process simulates nothing


@pytest.mark.parametrize("executor", ["auto", "processes:2"])
def test_a_simulator_of_which_one_exists_is_opened_by_this_process_alone(
    simulators, monkeypatch, executor
):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    simulators.write("pytest.ini", "[pytest]\npythonpath = .\n")
    given = ("--dura-simulator=simulators:Rig", "--dura-runs=20", f"--dura-executor={executor}")
    result = simulators.scenarios(*given)
    assert (simulators.path / "served.log").read_text().splitlines() == [
        f"open {os.getpid()}",
        f"close {os.getpid()}",
    ]
    reason = "one instance of its simulator exists"
    result.stdout.fnmatch_lines([f"*simulated in pytest's own process: {reason}"])
    assert simulators.verdict("GAP-1", "corridor/free").verdict == "supported"


def test_workers_refuse_a_simulator_of_which_one_exists_before_they_open_it(simulators):
    given = ("--dura-simulator=simulators:Rig", "-n", "2")
    result = simulators.run_apart("--dura-scenarios", "--dura-select=corridor/free", *given)
    assert result.ret == 1
    result.stdout.fnmatch_lines(["*one instance of the simulator exists, and several processes *"])
    assert not (simulators.path / "served.log").exists()
    simulators.run_apart("--dura-scenarios", "--dura-select=corridor/free", *given[:-1], "1")
    assert simulators.verdict("GAP-1", "corridor/free").verdict == "supported"


@pytest.mark.skipif(
    importlib.util.find_spec("libsumo") is None, reason="needs libsumo, of the extra sumo"
)
def test_sumo_gives_the_same_episodes_in_processes_and_when_they_are_replayed(project):
    given = ("--dura-simulator=sumo", "--dura-runs=2", "--dura-evidence-level=all")
    chosen = "intersection/nominal"
    digests = []
    for executor in ("in-process", "processes:2"):
        project.scenarios(*given, f"--dura-executor={executor}", select=chosen)
        evidence = project.evidence()
        assert evidence.execution.executor == executor.partition(":")[0]
        assert {each.validity for each in evidence.episodes} == {"valid"}
        digests.append({each.id: each.digest for each in evidence.episodes})
        assert {case.repeat.result for case in evidence.cases} == {"equal"}
    assert digests[0] == digests[1]
    assert evidence.environment.packages["libsumo"]
    result = project.run(f"--dura-replay={chosen}#1")
    assert result.ret == 0
    result.stdout.fnmatch_lines(["  the same"])
