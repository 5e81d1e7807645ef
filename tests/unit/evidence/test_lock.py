"""Two sessions never write one evidence directory at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import filelock
import pytest

from pytest_dura import ConfigurationError
from pytest_dura.core.files import LockedFile
from pytest_dura.evidence import DirectoryLock
from pytest_dura.evidence.files import LOCK_FILE

HOLD = """
import sys
from pathlib import Path
from pytest_dura.evidence.files import DirectoryLock
lock = DirectoryLock(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_session_is_refused_and_told_who_holds_it(tmp_path):
    lock = DirectoryLock(tmp_path / "new")
    with pytest.raises(ConfigurationError, match=rf"another session \(process {os.getpid()} on"):
        DirectoryLock(tmp_path / "new")
    lock.release()
    lock.release()
    assert not list((tmp_path / "new").iterdir())
    DirectoryLock(tmp_path / "new").release()


def test_a_killed_session_blocks_nobody(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as other:  # fmt: skip
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ConfigurationError, match="is writing to this evidence directory"):
            DirectoryLock(tmp_path)
        other.kill()
        other.wait(60)
    assert (tmp_path / LOCK_FILE).exists()
    DirectoryLock(tmp_path).release()


def test_a_file_that_was_removed_by_its_holder_is_no_lock(tmp_path, monkeypatch):
    """The holder releases it between the moments at which another one opens and locks it."""
    first = DirectoryLock(tmp_path)
    really = filelock.lock_descriptor

    def released_meanwhile(number, **options):
        first.release()
        return really(number, **options)

    monkeypatch.setattr(filelock, "lock_descriptor", released_meanwhile)
    second = DirectoryLock(tmp_path)
    monkeypatch.undo()
    with pytest.raises(ConfigurationError, match="another session"):
        DirectoryLock(tmp_path)
    second.release()


def test_a_link_in_its_place_is_not_followed(tmp_path):
    outside = tmp_path / "outside"
    outside.write_text("mine")
    folder = tmp_path / "evidence"
    folder.mkdir()
    (folder / LOCK_FILE).symlink_to(outside)
    with pytest.raises(ConfigurationError, match="cannot be written"):
        DirectoryLock(folder)
    assert outside.read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
def test_a_copy_of_the_process_holds_no_lock(tmp_path):
    """A simulator's own process may outlive the session that started it."""
    lock = DirectoryLock(tmp_path)
    copy = os.fork()
    if copy == 0:
        lock.release()  # is not the copy's to release
        time.sleep(60.0)
        os._exit(0)
    try:
        time.sleep(0.2)
        with pytest.raises(ConfigurationError, match="another session"):
            DirectoryLock(tmp_path)
        lock.release()
        DirectoryLock(tmp_path).release()
    finally:
        os.kill(copy, signal.SIGKILL)
        os.waitpid(copy, 0)


def test_a_lock_whose_descriptor_was_closed_closes_no_other_file(tmp_path):
    locked = LockedFile.acquire(tmp_path / "lock")
    number = locked._number
    with (tmp_path / "other").open("w") as other:
        os.dup2(other.fileno(), number)  # as if it were closed, and its number given away
        assert not locked.is_held
        locked.release()
        os.close(number)  # it is open still, on the other file
