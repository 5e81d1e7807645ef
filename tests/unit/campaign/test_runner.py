from __future__ import annotations

from pathlib import Path

import pytest
from thermostat import Controller, Thermostat

from pytest_dura import ConfigurationError, RequirementViolated, RoleSpec, Runner
from pytest_dura.campaign import EpisodeUsed, Progress
from pytest_dura.library import LocalRole, generator_of_option, load_library, role_of_fixture
from pytest_dura.requirements import Requirement

SCENARIO = """
name: room/{name}
simulator: thermostat:Thermostat
duration: 1.0
runs: {runs}
roles: {{generator: "thermostat:Controller"{roles}}}
faults: {faults}
requirements: []
"""


@pytest.fixture
def bench(tmp_path: Path):
    write(tmp_path, "warm")
    library = load_library([tmp_path], builtin=False)
    return Runner(lambda: library)


def write(folder, name, runs=3, roles="", faults="[]"):
    text = SCENARIO.format(name=name, runs=runs, roles=roles, faults=faults)
    (folder / f"{name}.yaml").write_text(text)


def signal(bench):
    return min(bench.run("room/warm").signals)


def test_an_episode_is_simulated_once(bench):
    assert bench.run("room/warm") is bench.run("room/warm")
    assert bench.run("room/warm", run=1) is not bench.run("room/warm")
    assert len(bench.store.memory) == 2


def test_the_seed_follows_from_the_base_seed(bench):
    other = Runner(bench.library, base_seed=1)
    assert bench.run("room/warm").spec.seed != other.run("room/warm").spec.seed
    assert bench.run("room/warm", seed=7).spec.seed == 7


def test_instances_of_one_class_are_told_apart(bench):
    first, second = Controller(), Controller()
    episodes = []
    for instance in (first, second, first):
        bench.roles = {"generator": role_of_fixture("generator", instance)}
        episodes.append(bench.run("room/warm"))
    assert episodes[0] is episodes[2] is not episodes[1]


def test_a_campaign_runs_what_is_planned(bench):
    assert [one.id for one in bench.campaign("room/warm").episodes] == [
        "room/warm#0",
        "room/warm#1",
        "room/warm#2",
    ]
    assert len(bench.campaign("room/warm", runs=5).episodes) == 5
    bench.runs = 2
    assert len(bench.campaign("room/warm", runs=5).episodes) == 2


class Counting(Thermostat):
    closed = 0

    def close(self):
        type(self).closed += 1


def test_a_simulator_is_closed_unless_it_is_the_users_own_instance(bench):
    bench.simulator = role_of_fixture("simulator", Counting)
    bench.run("room/warm")
    assert Counting.closed == 1
    bench.simulator = role_of_fixture("simulator", Counting())
    bench.run("room/warm")
    assert Counting.closed == 1


def test_progress_is_told(bench):
    told = []

    def tell(event):
        told.append((event.case, event.done, event.budget, event.ended))

    bench.events.subscribe(Progress, tell)
    assert len(bench.campaign("room/warm").episodes) == 3
    assert told == [("room/warm", done, 3, False) for done in range(3)] + [
        ("room/warm", 2, 3, True)
    ]


def test_use_of_episodes_is_told(bench):
    told = []
    bench.events.subscribe(
        EpisodeUsed, lambda event: told.append((event.episode.id, event.planned))
    )
    assert len(bench.campaign("room/warm", runs=2).episodes) == 2
    bench.run("room/warm", seed=9)
    assert told == [("room/warm#0", 2), ("room/warm#1", 2), ("room/warm#0", 0)]


def test_require_returns_the_verdict_or_raises(bench):
    name = signal(bench)
    campaign = bench.campaign("room/warm", requirement=Requirement("T-1", "Stays on earth"))
    verdict = campaign.require(f"always ({name} > -300)")
    assert (verdict.requirement, verdict.verdict, verdict.episodes) == ("T-1", "supported", 3)
    with pytest.raises(RequirementViolated, match="violated: T-1 on room/warm") as caught:
        campaign.require(f"always ({name} > 300)")
    assert caught.value.verdict.violations == 3
    message = str(caught.value)
    assert "required: Stays on earth" in message
    assert "worst:    room/warm#" in message
    with pytest.raises(RequirementViolated, match="undecided: T-1"):
        campaign.require(f"always ({name} > -300)", at_most=0.05)


def test_a_formula_that_cannot_be_read_is_told_from_the_callers_line(bench):
    with pytest.raises(ConfigurationError, match="unknown signal 'gapp'") as caught:
        bench.campaign("room/warm").require("always (gapp > 0)")
    assert len(caught.traceback) == 2


@pytest.mark.parametrize("name", ["room/warn", "room/*"])
def test_an_unknown_name(bench, name):
    with pytest.raises(ConfigurationError, match="no scenario matches") as caught:
        bench.run(name)
    assert len(caught.traceback) == 2


def test_an_unknown_fault(bench):
    with pytest.raises(ConfigurationError, match="unknown fault 'ghost'"):
        bench.run("room/warm", faults="ghost")


def test_the_library_is_read_when_it_is_first_needed():
    def library():
        raise ConfigurationError("not yet")

    bench = Runner(library)
    with pytest.raises(ConfigurationError, match="not yet"):
        bench.run("room/warm")


@pytest.mark.of_guest
def test_short_names_and_paths_of_generators():
    assert generator_of_option("thermostat:Controller") == RoleSpec("thermostat:Controller")
    assert generator_of_option("reactive").path.endswith(":Reactive")


def test_what_is_defined_in_a_conftest_is_known_by_its_file():
    spec = role_of_fixture("generator", Controller, "tests/a/conftest.py")
    assert isinstance(spec, LocalRole)
    assert spec.factory() is Controller
    assert spec.path == "tests/a/conftest.py:Controller"
    assert spec.label == "Controller (tests/a)"
    assert role_of_fixture("generator", Controller, "conftest.py").label == "Controller"


def test_a_runner_without_a_search_refuses_to_search(bench):
    with pytest.raises(ConfigurationError, match="made without a search") as caught:
        bench.campaign("room/warm").falsify("always (temperature > 0)")
    assert "`orchestrator`" in str(caught.value)


@pytest.mark.of_guest
def test_a_script_runs_files_and_the_built_in_scenarios(tmp_path):
    (tmp_path / "hall.yaml").write_text(
        "name: hall/short\nsimulator: driving\nduration: 0.5\nworld: {}\n"
    )
    runner = Runner.of(tmp_path, base_seed=3)
    assert runner.base_seed == 3
    episode = runner.run("hall/short", seed=1)
    assert (episode.ticks, episode.spec.seed) == (6, 1)
    assert "intersection/nominal" in runner.library().scenarios
