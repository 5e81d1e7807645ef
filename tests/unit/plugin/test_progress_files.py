from __future__ import annotations

import json
import os
from dataclasses import asdict

import pytest

from pytest_dura.campaign import Progress, RunningCampaign
from pytest_dura.plugin.progress import WRITE_INTERVAL, WorkerFile, read_files, remove_files

TOKEN, OTHER = "0123456789abcdef", "fedcba9876543210"
PROGRESS = Progress(
    "room/warm", "T-1", 3, 9, True, taken_over=2, violations=1, upper=0.5, confidence=0.95
)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "evidence/.progress"


class Worker:
    """A worker with a clock that stands."""

    def __init__(self, folder, name="gw0"):
        self.now = 7.0
        self.running = RunningCampaign("room/warm", "T-1", 9)
        self.file = WorkerFile(folder, TOKEN, name, lambda: self.now)
        self.file.begin()

    def tell(self, done, after=0.0):
        self.now += after
        self.last = self.running.reach(done, 9, simulated=done)
        self.file.update(self.last)


def test_a_short_campaign_writes_nothing(folder):
    worker = Worker(folder)
    for done in range(5):
        worker.tell(done, after=WRITE_INTERVAL / 9)
    assert list(folder.iterdir()) == []


def test_what_a_worker_tells_is_read_until_its_campaign_ends(folder):
    worker, other = Worker(folder), Worker(folder, "gw1")
    for one in (worker, other):
        one.tell(0)
        one.tell(2, after=1.01 * WRITE_INTERVAL)
    found = read_files(folder, TOKEN)
    assert found == {"gw0": worker.last, "gw1": worker.last}
    assert found["gw0"].done == 2
    worker.file.update(worker.running.end())
    assert list(read_files(folder, TOKEN)) == ["gw1"]


def test_a_worker_writes_a_few_times_a_second_at_most(folder, monkeypatch):
    written = []
    monkeypatch.setattr(os, "write", lambda handle, data: written.append(data))
    worker = Worker(folder)
    for done in range(1000):
        worker.tell(done % 9, after=0.01)
    assert 10 / WRITE_INTERVAL - 3 <= len(written) <= 10 / WRITE_INTERVAL


def test_where_nothing_can_be_written_there_is_no_progress_and_no_error(folder):
    folder.parent.mkdir()
    folder.write_text("a file")
    worker = Worker(folder)
    for done in range(5):
        worker.tell(done, after=1.0)
    worker.file.update(worker.running.end())
    assert read_files(folder, TOKEN) == {}
    assert folder.read_text() == "a file"


def test_a_session_reads_its_own_files_alone(folder):
    worker = Worker(folder)
    worker.tell(0)
    worker.tell(1, after=1.0)
    assert read_files(folder, OTHER) == {}


def test_plain_data_comes_back_as_it_went(folder):
    put(folder, json.dumps(PLAIN))
    assert read_files(folder, TOKEN) == {"gw0": PROGRESS}


PLAIN = {name: value for name, value in asdict(PROGRESS).items() if name not in ("ended", "judge")}


def put(folder, text, name=f"{TOKEN}.gw0.json"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)


@pytest.mark.parametrize(
    "change",
    [
        {"case": "a\x1b[2Jb"},
        {"case": "x" * 600},
        {"subject": 3},
        {"done": 10},
        {"done": -1, "taken_over": -1},
        {"done": 3.0},
        {"budget": True},
        {"budget": 10**12},
        {"taken_over": 4},
        {"violations": "1"},
        {"upper": 1.5},
        {"upper": float("nan")},
        {"confidence": "0.95"},
        {"may_end_early": 1},
        {"more": 1},
    ],
    ids=str,
)
def test_what_makes_no_sense_is_passed_over(folder, change):
    put(folder, json.dumps(PLAIN | change))
    put(folder, json.dumps(PLAIN), f"{TOKEN}.gw1.json")
    assert read_files(folder, TOKEN) == {"gw1": PROGRESS}


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 4000, "\x00", " " * 5000])
def test_damaged_files_are_passed_over(folder, text):
    put(folder, text)
    assert read_files(folder, TOKEN) == {}


def test_a_great_file_is_passed_over_though_it_is_sound(folder):
    put(folder, json.dumps(PLAIN) + " " * 5000)
    assert read_files(folder, TOKEN) == {}


def test_what_is_no_file_is_passed_over_and_nothing_waits_for_it(folder, tmp_path):
    folder.mkdir(parents=True)
    os.mkfifo(folder / f"{TOKEN}.gw0.json")
    (folder / f"{TOKEN}.gw1.json").mkdir()
    (tmp_path / "sound").write_text(json.dumps(PLAIN))
    (folder / f"{TOKEN}.gw2.json").symlink_to(tmp_path / "sound")
    put(folder, json.dumps(PLAIN), f"{TOKEN}.gw3\x1b[J.json")
    assert read_files(folder, TOKEN) == {}
    assert read_files(folder / "none", TOKEN) == {}


def test_what_is_left_of_any_session_is_removed_and_nothing_else(folder):
    for token in (TOKEN, OTHER):
        put(folder, "{}", f"{token}.gw0.json")
        put(folder, "{}", f"{token}.gw1.tmp")
    put(folder, "mine", "notes.txt")
    remove_files(folder)
    assert [file.name for file in folder.iterdir()] == ["notes.txt"]
    (folder / "notes.txt").unlink()
    remove_files(folder)
    assert not folder.exists()
    remove_files(folder)


def test_of_a_worker_that_died_its_own_files_go(folder):
    for worker in ("gw1", "gw11"):
        put(folder, json.dumps(PLAIN), f"{TOKEN}.{worker}.json")
    remove_files(folder, "gw1")
    assert list(read_files(folder, TOKEN)) == ["gw11"]


def test_a_link_in_place_of_the_folder_is_not_followed(folder, tmp_path):
    put(tmp_path / "elsewhere", "{}")
    folder.parent.mkdir()
    folder.symlink_to(tmp_path / "elsewhere")
    remove_files(folder)
    assert not folder.is_symlink()
    assert len(list((tmp_path / "elsewhere").iterdir())) == 1


def test_a_link_where_a_worker_writes_is_not_followed(folder, tmp_path):
    folder.mkdir(parents=True)
    (folder / f"{TOKEN}.gw0.tmp").symlink_to(tmp_path / "precious")
    worker = Worker(folder)
    worker.tell(0)
    worker.tell(1, after=1.0)
    assert not (tmp_path / "precious").exists()
