"""Of many episodes few are in memory, and the others come back as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import SPEC, handmade
from thermostat import Controller

from pytest_dura import RoleSpec, Runner
from pytest_dura.campaign import FaultsTraced
from pytest_dura.core import EpisodeSpec, Event
from pytest_dura.execution import EpisodeStore, EpisodeTask, run_episode
from pytest_dura.execution.memory import EpisodeMemory, size_of
from pytest_dura.library import load_library
from pytest_dura.requirements import JudgedEpisode, Requirement

WARM = EpisodeSpec(
    "room/warm", 0, 1, RoleSpec("thermostat:Thermostat"),
    {"generator": RoleSpec("thermostat:Controller")}, {"world": {"start": 15.0}},
)  # fmt: skip


def simulated(spec):
    return JudgedEpisode.of(run_episode(spec, recorded=True))


def never(spec):
    raise AssertionError(f"{spec.id} is simulated again")


def made(spec, **changes):
    return JudgedEpisode.of(replace(handmade(3, spec=spec, x=[0, 1, 2]), **changes))


def had(memory, spec, simulate):
    task = EpisodeTask(spec)
    found = memory.find(task)
    if found is None:
        found = simulate(spec)
        memory.put(task, found, elsewhere=False)
    return found


def test_an_episode_comes_back_from_disk_as_it_was():
    memory = EpisodeMemory(room=size_of(simulated(WARM)))
    specs = [replace(WARM, run=run, seed=run) for run in range(3)]
    first = had(memory, specs[0], simulated)
    digest = first.digest
    for spec in specs[1:]:
        had(memory, spec, simulated)
    again = had(memory, replace(specs[0]), never)
    assert again is not first
    assert again.digest == digest
    assert again.spec == first.spec
    assert again.metrics == first.metrics
    assert (again.events, again.recording) == (first.events, first.recording)
    assert again.robustness("always (headroom > 0)") == first.robustness("always (headroom > 0)")
    assert len(memory) == 3


def test_an_episode_from_disk_cannot_be_changed_either():
    memory = EpisodeMemory(room=0)
    had(memory, WARM, simulated)
    again = had(memory, WARM, never)
    with pytest.raises(ValueError, match="read-only"):
        again.signals["temperature"][0] = 0.0
    with pytest.raises(TypeError, match="cannot be changed"):
        again.signals["temperature"] = np.zeros(3)
    with pytest.raises(AttributeError, match="cannot be changed"):
        again.termination = "goal"


@pytest.mark.parametrize("bound", [{"room": 2 * size_of(made(SPEC))}, {"recent": 2}])
def test_only_the_last_ones_are_in_memory(bound):
    specs = [replace(SPEC, run=run) for run in range(4)]
    memory = EpisodeMemory(**bound)
    for spec in (*specs, specs[0]):
        had(memory, spec, made)
    assert [key[0] for key in memory._recent] == [specs[3].key, specs[0].key]
    assert had(memory, specs[3], never) is had(memory, specs[3], never)


def test_one_that_is_put_again_takes_no_more_room():
    specs = [replace(SPEC, run=run) for run in range(2)]
    memory = EpisodeMemory(room=2 * size_of(made(SPEC)))
    for spec in (specs[0], specs[0], specs[1]):
        memory.put(EpisodeTask(spec), made(spec), elsewhere=False)
    assert [key[0] for key in memory._recent] == [spec.key for spec in specs]


def test_the_size_of_an_episode_is_that_of_its_columns_and_lists():
    episode = simulated(WARM)
    columns = [episode.time, *episode.signals.values(), *episode.decisions.values()]
    times, values = episode.metrics.processing_ns["generator"]
    assert len(times) == len(values) > 0
    least = sum(one.nbytes for one in columns) + 32 * 2 * len(times)
    assert least <= size_of(episode) <= 2 * least


def test_what_cannot_be_pickled_stays_in_memory():
    memory = EpisodeMemory(room=0)

    def odd(spec):
        event = Event(0, 0.0, "note", "x", "", {"data": lambda: 0})
        return made(spec, events=(event,))

    first = had(memory, SPEC, odd)
    had(memory, replace(SPEC, run=1), made)
    assert had(memory, SPEC, never) is first
    assert len(memory) == 2


def test_what_the_disk_has_no_room_for_stays_in_memory(monkeypatch):
    def full(**_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    memory = EpisodeMemory(room=0)
    first = had(memory, SPEC, made)
    assert had(memory, SPEC, never) is first


def test_bare_instances_are_told_apart_on_disk_too():
    memory = EpisodeMemory(room=0)
    one, other = Controller(), Controller()
    specs = [replace(WARM, roles={"generator": RoleSpec.of(who)}) for who in (one, other, one)]
    assert specs[0].key == specs[1].key
    had(memory, specs[0], simulated)
    assert had(memory, specs[2], never).spec.roles["generator"].instance is one
    with pytest.raises(AssertionError, match="simulated again"):
        had(memory, specs[1], never)


def test_what_is_kept_elsewhere_is_forgotten():
    memory = EpisodeMemory(room=size_of(made(SPEC)))
    for run in range(3):
        spec = replace(SPEC, run=run)
        memory.put(EpisodeTask(spec), made(spec), elsewhere=True)
    found = [memory.find(EpisodeTask(replace(SPEC, run=run))) for run in range(3)]
    assert [one is not None for one in found] == [False, False, True]


def test_what_came_of_faults_is_told_once_and_from_disk_as_well(tmp_path):
    (tmp_path / "warm.yaml").write_text(
        "name: room/warm\nsimulator: thermostat:Thermostat\nduration: 1.0\nruns: 3\n"
        'roles: {generator: "thermostat:Controller"}\nrequirements: []\n'
        "faults: [{type: bias, target: thermometer, activation: {at: 0.2},"
        " parameters: {offset: 5.0}}]\n"
    )
    library = load_library([tmp_path], builtin=False)
    told = []
    bench = Runner(lambda: library, store=EpisodeStore(memory=EpisodeMemory(room=0)))
    bench.events.subscribe(
        FaultsTraced, lambda event: told.append((event.episode.id, len(event.chains)))
    )
    for _ in range(2):
        bench.campaign("room/warm").judge(Requirement("R", check="always (headroom > -100)"))
    assert len(told) >= 3
    assert told == [(f"room/warm#{run}", 1) for run in range(len(told))]
