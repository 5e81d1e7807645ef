"""``python -m pytest_dura prune``: what goes from a directory of episodes, and what never does."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from counted_rooms import counted_store, counted_task, simulated

from pytest_dura.__main__ import main
from pytest_dura.core import ConfigurationError
from pytest_dura.execution import (
    CLAIM,
    EPISODE,
    Addresses,
    EpisodeCache,
    prune,
    read_age,
    read_size,
)
from pytest_dura.execution.cache import NEW

DAY = 86400.0


def shelf_of(tmp_path: Path, runs: int) -> list[Path]:
    """Episodes of so many runs, each a day older than the one before it."""
    store = counted_store(tmp_path, "first")
    files = []
    for run in range(runs):
        store.get(counted_task(tmp_path, run), [])
        (new,) = set(tmp_path.glob(f"shelf/*/*{EPISODE}")) - set(files)
        files.append(new)
    for run, file in enumerate(files):
        age(file, (run + 0.5) * DAY)
    return files


def age(file: Path, seconds: float) -> None:
    os.utime(file, (time.time() - seconds,) * 2)


def test_what_was_not_used_for_so_long_goes_and_is_simulated_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = shelf_of(tmp_path, 4)
    assert main(["prune", str(tmp_path / "shelf"), "--older-than=2d"]) == 0
    assert [one.exists() for one in files] == [True, True, False, False]
    assert "removed: 2 episodes" in capsys.readouterr().out
    store = counted_store(tmp_path, "second", earlier=True)
    for run in range(4):
        assert store.get(counted_task(tmp_path, run), []).spec.run == run
    assert simulated(tmp_path) == {0: 1, 1: 1, 2: 2, 3: 2}


def test_what_a_session_takes_over_counts_as_used(tmp_path: Path) -> None:
    files = shelf_of(tmp_path, 3)
    store = counted_store(tmp_path, "second", earlier=True)
    store.get(counted_task(tmp_path, 2), [])
    pruned = prune(tmp_path / "shelf", older_than=DAY)
    assert [one.exists() for one in files] == [True, False, True]
    assert (pruned.removed, pruned.kept) == (1, 2)


def test_a_size_is_reached_by_what_was_used_least_recently(tmp_path: Path) -> None:
    files = shelf_of(tmp_path, 4)
    sizes = [one.stat().st_size for one in files]
    age(files[0], 0.0)
    pruned = prune(tmp_path / "shelf", at_most=sizes[0] + sizes[1])
    assert [one.exists() for one in files] == [True, True, False, False]
    assert (pruned.kept_bytes, pruned.removed_bytes) == (sum(sizes[:2]), sum(sizes[2:]))
    prune(tmp_path / "shelf", at_most=0)
    assert [one.exists() for one in files] == [True, False, False, False], "it may be of this hour"


def test_a_session_that_has_an_episode_keeps_it_and_no_claim_of_its_is_touched(
    tmp_path: Path,
) -> None:
    (file,) = shelf_of(tmp_path, 1)
    shelf = EpisodeCache(tmp_path / "shelf", "second", earlier=True)
    held = counted_task(tmp_path, 7)
    address = Addresses().of(held)
    assert address is not None
    claim = shelf.claim(address)
    assert claim is not None
    (name,) = tmp_path.glob(f"shelf/*/*{CLAIM}")
    left = file.with_suffix(CLAIM)
    left.write_text("1 gone")
    half = file.with_suffix(f".77{NEW}")
    half.write_text("half")
    for one in (name, left, half, file):
        age(one, 9 * DAY)
    with file.open("rb") as opened:
        prune(tmp_path / "shelf", older_than=DAY)
        assert opened.read()
    assert not file.exists()
    assert name.exists()
    assert not left.exists()
    assert not half.exists()
    claim.release()
    assert shelf.claim(address) is not None


def test_files_of_others_stay(tmp_path: Path) -> None:
    (file,) = shelf_of(tmp_path, 1)
    others = [
        file.parent / f"notes{EPISODE}",
        file.parent / "weights.bin",
        tmp_path / f"shelf/{'a' * 64}{EPISODE}",
    ]
    target = tmp_path / "elsewhere"
    target.write_text("mine")
    age(target, 9 * DAY)
    link = file.parent / f"{file.name[:2]}{'b' * 62}{EPISODE}"
    link.symlink_to(target)
    for one in others:
        one.write_text("mine")
        age(one, 9 * DAY)
    age(file, 9 * DAY)
    assert prune(tmp_path / "shelf", older_than=DAY).removed == 1
    assert all(one.exists() for one in (*others, link, target))


@pytest.mark.parametrize("text, seconds", [("1h", 3600.0), ("30d", 30 * DAY), ("0.5w", 3.5 * DAY)])
def test_times(text: str, seconds: float) -> None:
    assert read_age(text) == seconds


@pytest.mark.parametrize("text, size", [("500M", 500 * 10**6), ("2.5G", 2_500_000_000)])
def test_sizes(text: str, size: int) -> None:
    assert read_size(text) == size


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["--older-than=30"], "--older-than takes a time"),
        (["--older-than=0.5h"], "of an hour at least"),
        (["--older-than=-3d"], "--older-than takes a time"),
        (["--at-most=2"], "--at-most takes a size"),
        ([], "it is not said what is to be removed"),
    ],
)
def test_a_wrong_call_removes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    files = shelf_of(tmp_path, 2)
    assert main(["prune", str(tmp_path / "shelf"), *arguments]) == 2
    assert told in capsys.readouterr().err
    assert all(one.exists() for one in files)


def test_a_directory_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no such directory"):
        prune(tmp_path / "nowhere", older_than=DAY)
