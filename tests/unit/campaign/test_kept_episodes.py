"""Each episode is kept once it is over: whichever process is killed, those that were are there."""

from __future__ import annotations

import errno
import os
import random
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from counted_rooms import (
    FORKS,
    counted_store,
    counted_task,
    in_processes,
    simulated,
)

from pytest_dura import Runner
from pytest_dura.execution import EPISODE, EpisodeCache, EpisodeStore, address_of, pack
from pytest_dura.library import load_library

needs_forks = pytest.mark.skipif(FORKS is None, reason="the system does not fork")
N = 12


def wants(folder, runs, session="s", out=None):
    """What a worker does that has a campaign: it asks for its runs, in their order."""

    def work():
        store = counted_store(folder, session)
        tasks = [counted_task(folder, run) for run in runs]
        found = [store.get(task, tasks[place:]) for place, task in enumerate(tasks)]
        if out is not None:
            lines = [f"{one.spec.run} {one.digest} {one.validity}" for one in found]
            (folder / out).write_text("\n".join(lines))
        os._exit(0)

    return work


def alone(tmp_path, runs):
    """What the same runs come to without anybody else."""
    return [f"{run} {counted_task(tmp_path, run).run().digest} valid" for run in runs]


@needs_forks
def test_processes_that_want_the_same_come_to_the_same_and_wait_for_none(tmp_path):
    names = [f"out{number}" for number in range(4)]
    assert in_processes([wants(tmp_path, range(N), out=name) for name in names]) == [0] * 4
    results = {(tmp_path / name).read_text() for name in names}
    assert results == {"\n".join(alone(tmp_path, range(N)))}, "the order is that of the campaign"
    assert len(list(tmp_path.glob(f"shelf/*/*{EPISODE}"))) == N
    assert len([file for file in tmp_path.glob("shelf/*/*") if file.is_file()]) == N


@needs_forks
def test_what_a_process_had_simulated_before_it_was_killed_is_not_simulated_again(tmp_path):
    """A process is killed at some moment, and another one goes on, five times over."""
    choose = random.Random(7)
    for turn in range(5):
        folder = tmp_path / str(turn)
        folder.mkdir()
        first = FORKS.Process(target=wants(folder, range(N)))
        first.start()
        time.sleep(choose.uniform(0.0, 0.05))
        first.kill()
        first.join(60.0)
        kept = len(list(folder.glob(f"shelf/*/*{EPISODE}")))
        begun = sum(simulated(folder).values())
        assert kept <= begun <= kept + 1
        assert in_processes([wants(folder, range(N), out="out")]) == [0]
        assert sum(simulated(folder).values()) == begun + N - kept
        assert (folder / "out").read_text() == "\n".join(alone(folder, range(N)))


@needs_forks
def test_an_episode_that_killed_its_process_is_tried_again(tmp_path):
    (tmp_path / "deadly").write_text("3")
    assert in_processes([wants(tmp_path, range(N))]) == [-signal.SIGKILL]
    (tmp_path / "deadly").unlink()
    assert in_processes([wants(tmp_path, range(N), out="out")]) == [0]
    assert simulated(tmp_path) == {run: 2 if run == 3 else 1 for run in range(N)}


@pytest.fixture
def shelved(tmp_path):
    """A shelf with one episode, simulated once."""
    counted_store(tmp_path, "before").get(counted_task(tmp_path, 0))
    (file,) = tmp_path.glob(f"shelf/*/*{EPISODE}")
    return tmp_path, file


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: b"",
        lambda data: data[:-1] + bytes([data[-1] ^ 1]),
        lambda data: data.replace(b'"format": 2', b'"format": 1'),
        lambda data: data.replace(b'"run": "0"', b'"run": "1"'),
        lambda data: b"[" * 100_000 + data,
    ],
    ids=["torn", "empty", "a bit", "another form", "another episode", "nested"],
)
def test_a_damaged_file_is_simulated_again_and_replaced(shelved, damage):
    folder, file = shelved
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    store = counted_store(folder, earlier=True)
    assert store.get(counted_task(folder, 0)).validity == "valid"
    assert simulated(folder)[0] == 2
    assert store.earlier.origins == {}
    assert counted_store(folder, "after", earlier=True).get(counted_task(folder, 0)) is not None
    assert simulated(folder)[0] == 2


def test_an_earlier_session_counts_only_where_it_is_asked_for(shelved):
    folder, _ = shelved
    taking = counted_store(folder, earlier=True)
    found = taking.get(counted_task(folder, 0))
    assert taking.earlier.origin(next(iter(taking.earlier.origins))) == {
        "session": "before", "changed": None,
    }  # fmt: skip
    assert simulated(folder)[0] == 1
    assert counted_store(folder).get(counted_task(folder, 0)).digest == found.digest
    assert simulated(folder)[0] == 2


def test_what_was_missing_in_an_earlier_session_is_tried_again(tmp_path):
    from pytest_dura.execution import missing_episode

    task = counted_task(tmp_path, 0)
    address = address_of(task)
    earlier = EpisodeCache(tmp_path / "shelf", "before")
    earlier.put(address, task.spec, pack(missing_episode(task.spec, "gone")))
    store = counted_store(tmp_path, earlier=True)
    assert store.get(task).validity == "valid"
    assert list(store.earlier.outdated.values()) == [()]
    # Another process of this session finds why it was simulated again.
    other = counted_store(tmp_path, earlier=True)
    other.get(task)
    assert list(other.earlier.outdated.values()) == [()]
    assert simulated(tmp_path)[0] == 1


def test_what_changed_is_told_of_the_closest_one(tmp_path):
    task = counted_task(tmp_path, 0)
    store = counted_store(tmp_path, "before")
    store.get(task)
    store.get(
        replace(
            task, spec=replace(task.spec, scenario={"world": {"run": 0, "wall": 2}}, time_step=0.2)
        )
    )
    taking = counted_store(tmp_path, earlier=True)
    taking.get(replace(task, spec=replace(task.spec, scenario={"world": {"run": 0, "wall": 1}})))
    assert list(taking.earlier.outdated.values()) == [("scenario",)]


def test_a_full_disk_keeps_results_in_memory_and_is_told_once(tmp_path, monkeypatch):
    real = Path.write_bytes

    def full(file, data):
        if file.name.endswith(".new"):
            real(file, data[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))
        return real(file, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    store = counted_store(tmp_path)
    digests = [store.get(counted_task(tmp_path, run)).digest for run in range(3)]
    assert [store.get(counted_task(tmp_path, run)).digest for run in range(3)] == digests
    assert simulated(tmp_path) == dict.fromkeys(range(3), 1)
    (problem,) = store.problems
    assert problem == "episodes are not kept for --dura-resume: No space left on device"
    assert not [one for one in tmp_path.glob("shelf/*/*") if one.is_file()]


def test_a_directory_that_cannot_be_made_is_told_and_the_episodes_are_had(tmp_path):
    (tmp_path / "shelf").write_text("mine")
    store = counted_store(tmp_path)
    assert store.get(counted_task(tmp_path, 0)).validity == "valid"
    assert len(store.problems) >= 1
    assert (tmp_path / "shelf").read_text() == "mine"


def test_clearing_touches_nothing_but_what_is_ours(shelved):
    folder, file = shelved
    shelf = folder / "shelf"
    (shelf / "mine.txt").write_text("mine")
    (file.parent / "mine.txt").write_text("mine")
    outside = folder / "outside"
    outside.mkdir()
    (outside / f"x{EPISODE}").write_text("mine")
    (shelf / "zz").symlink_to(outside)
    EpisodeCache(shelf, "s").clear()
    assert not file.exists()
    assert (outside / f"x{EPISODE}").exists()
    assert {one.name for one in shelf.rglob("*.txt")} == {"mine.txt"}
    link = folder / "link"
    link.symlink_to(outside)
    EpisodeCache(link, "s").clear()
    assert not link.is_symlink()
    assert (outside / f"x{EPISODE}").exists()


def test_where_a_twin_is_simulated_elsewhere_the_next_pairs_are_begun(tmp_path):
    (tmp_path / "warm.yaml").write_text(
        "name: room/warm\nsimulator: thermostat:Thermostat\nduration: 1.0\nruns: 3\n"
        'roles: {generator: "thermostat:Controller", recovery_planner: "thermostat:SwitchOff"}\n'
        "requirements: []\n"
    )
    asked = []

    class Store(EpisodeStore):
        def get(self, task, ahead=()):
            asked.append((task.spec.id, [one.spec.id for one in ahead]))
            return super().get(task, ahead)

    library = load_library([tmp_path], builtin=False)
    campaign = Runner(lambda: library, store=Store()).campaign("room/warm")
    pairs = list(campaign.paired("recovery_planner"))
    assert len(pairs) == 3
    own, twin = "room/warm#{}".format, "room/warm~recovery_planner#{}".format
    order = [name(run) for run in range(3) for name in (own, twin)]
    assert asked == [(name, order[at - at % 2 :]) for at, name in enumerate(order)]
