"""Processes share episodes: each is simulated once, whoever is killed, and nothing is lost."""

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
from pytest_dura.core import ConfigurationError, RoleSpec
from pytest_dura.execution import CLAIM, EPISODE, EpisodeCache, EpisodeStore, address_of, pack
from pytest_dura.execution import store as store_module
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
def test_processes_that_want_the_same_simulate_each_episode_once(tmp_path):
    names = [f"out{number}" for number in range(4)]
    assert in_processes([wants(tmp_path, range(N), out=name) for name in names]) == [0] * 4
    assert simulated(tmp_path) == dict.fromkeys(range(N), 1)
    told = {(tmp_path / name).read_text() for name in names}
    assert told == {"\n".join(alone(tmp_path, range(N)))}, "the order is that of the campaign"
    assert not list(tmp_path.glob(f"shelf/*/*{CLAIM}"))


@needs_forks
def test_whoever_is_killed_in_the_middle_nothing_is_lost_or_simulated_twice(tmp_path):
    """Two of four processes are killed at some moment, five times over."""
    choose = random.Random(7)
    for turn in range(5):
        folder = tmp_path / str(turn)
        folder.mkdir()
        processes = [
            FORKS.Process(target=wants(folder, range(N), out=f"out{number}")) for number in range(4)
        ]
        for one in processes:
            one.start()
        for one in processes[:2]:
            time.sleep(choose.uniform(0.0, 0.05))
            one.kill()
        for one in processes:
            one.join(60.0)
        assert [one.exitcode for one in processes[2:]] == [0, 0]
        told = {(folder / f"out{number}").read_text() for number in (2, 3)}
        assert told == {"\n".join(f"{line}" for line in alone(folder, range(N)))}
        counts = simulated(folder)
        for run in range(N):
            counts[run] -= 1  # that of `alone`
        # What a killed process was at is simulated again; at most one episode each.
        assert set(counts) == set(range(N))
        assert all(1 <= count <= 3 for count in counts.values())
        assert sum(counts.values()) <= N + 2


@needs_forks
def test_an_episode_that_kills_its_process_twice_is_given_up_and_missing(tmp_path):
    (tmp_path / "deadly").write_text("3")
    for _ in range(2):
        assert in_processes([wants(tmp_path, range(N))]) == [-signal.SIGKILL]
    assert in_processes([wants(tmp_path, range(N), out="out")]) == [0]
    lines = (tmp_path / "out").read_text().split("\n")
    assert [line.split()[2] for line in lines] == [
        "missing" if run == 3 else "valid" for run in range(N)
    ]
    assert simulated(tmp_path) == {run: 2 if run == 3 else 1 for run in range(N)}
    found = counted_store(tmp_path).get(counted_task(tmp_path, 3))
    assert found.failure == ("infrastructure: the episode ended 2 processes that simulated it")


@needs_forks
def test_what_killed_the_processes_of_another_session_is_tried_again(tmp_path):
    (tmp_path / "deadly").write_text("3")
    for _ in range(2):
        in_processes([wants(tmp_path, [3], "before")])
    assert in_processes([wants(tmp_path, [3])]) == [-signal.SIGKILL], "it counts from the beginning"
    (tmp_path / "deadly").unlink()
    assert counted_store(tmp_path).get(counted_task(tmp_path, 3)).validity == "valid"
    assert simulated(tmp_path)[3] == 4


@needs_forks
def test_who_has_to_wait_does_what_is_free_meanwhile(tmp_path):
    (tmp_path / "slow").write_text(f"0 {N}")
    names, begun = ["first", "second"], time.monotonic()
    assert in_processes([wants(tmp_path, range(N), out=name) for name in names]) == [0, 0]
    assert simulated(tmp_path) == dict.fromkeys(range(N), 1)
    # The slow one ends when all others have begun, and gives up after 30 s.
    assert time.monotonic() - begun < 25.0, "nobody waited for it idly"


@needs_forks
def test_a_copy_of_the_process_holds_no_claim(tmp_path):
    """A simulator's own process may outlive the one that started it."""
    shelf, address = (
        EpisodeCache(tmp_path / "shelf", "s"),
        address_of(counted_task(tmp_path, 0)),
    )
    told, tell = os.pipe()
    holder = os.fork()
    if holder == 0:
        shelf.claim(address)
        if os.fork() == 0:
            # A copy lets go once it runs, which on a busy machine may be long after its birth.
            os.write(tell, str(os.getpid()).encode())
        time.sleep(60.0)
        os._exit(0)
    copy = int(os.read(told, 100))
    os.kill(holder, signal.SIGKILL)
    os.waitpid(holder, 0)
    try:
        os.kill(copy, 0)  # it is alive
        claim = shelf.claim(address)
        assert claim is not None
        assert claim.attempts == 1
        claim.release()
    finally:
        os.kill(copy, signal.SIGKILL)
        os.close(told)
        os.close(tell)


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
    store.get(replace(task, spec=replace(task.spec, scenario={"run": 0, "wall": 2}, time_step=0.2)))
    taking = counted_store(tmp_path, earlier=True)
    taking.get(replace(task, spec=replace(task.spec, scenario={"run": 0, "wall": 1})))
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
    assert problem.startswith("episodes cannot be shared with other processes, nor with a later ")
    assert problem.endswith("session: No space left on device")
    assert not [one for one in tmp_path.glob("shelf/*/*") if one.is_file()]


def test_a_directory_that_cannot_be_made_is_told_and_the_episodes_are_had(tmp_path):
    (tmp_path / "shelf").write_text("mine")
    store = counted_store(tmp_path)
    assert store.get(counted_task(tmp_path, 0)).validity == "valid"
    assert len(store.problems) >= 1
    assert (tmp_path / "shelf").read_text() == "mine"


def test_an_error_of_what_is_done_ahead_is_that_of_who_wants_it(tmp_path, monkeypatch):
    good, bad = counted_task(tmp_path, 0), counted_task(tmp_path, 1)
    generator = RoleSpec("counted_rooms:Counted", {"folder": str(tmp_path), "wrong": 1})
    bad = replace(bad, spec=replace(bad.spec, roles={"generator": generator}))
    store = counted_store(tmp_path)
    held = store.cache.claim(address_of(good))
    released = []

    def sleep(_):
        if not released:
            held.release()
        released.append(1)

    monkeypatch.setattr(time, "sleep", sleep)
    assert store.get(good, [good, bad]).validity == "valid"
    assert released, "it waited, and tried what was wanted next"
    with pytest.raises(ConfigurationError, match="does not take these parameters"):
        store.get(bad)


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


def test_nobody_waits_for_ever_for_an_episode_that_another_process_has(tmp_path, monkeypatch):
    monkeypatch.setattr(store_module, "MAX_WAIT", 0.1)
    task = counted_task(tmp_path, 1)
    address = address_of(task)
    claim = EpisodeCache(tmp_path / "shelf", "s").claim(address)
    assert counted_store(tmp_path).get(task).digest == task.run().digest
    claim.release()
    assert EpisodeCache(tmp_path / "shelf", "s").entry(address) is not None


def test_a_claim_whose_file_somebody_closed_closes_nothing_else(tmp_path):
    claim = EpisodeCache(tmp_path / "shelf", "s").claim(address_of(counted_task(tmp_path, 1)))
    number = claim._number
    with (tmp_path / "other").open("w") as other:
        os.dup2(other.fileno(), number)  # as if it were closed, and its number given away
        assert not claim.is_held
        claim.release()
        os.close(number)  # it is open still, on the other file
