"""What tests call in the processes of a pool."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NoReturn

import pytest

from pytest_dura import ConfigurationError, RoleSpec
from pytest_dura.core.calls import current_calls
from pytest_dura.execution import child, children, replies

HELD: list[bytearray] = []


class KilledStarts:
    """Kills the processes of pools while they start, the first ones.

    Args:
        monkeypatch: Of the test.
        folder: Where each start leaves a mark.
        times: How many are killed.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path, times: int) -> None:
        self._file = folder / "starts"
        deed = (
            "import os, signal; "
            f"starts = os.open({str(self._file)!r}, os.O_WRONLY | os.O_CREAT | os.O_APPEND); "
            f"os.write(starts, b'.'); os.fstat(starts).st_size <= {times} "
            "and os.kill(os.getpid(), signal.SIGKILL); "
        )
        monkeypatch.setattr(children, "_START", deed + children._START)
        serve = child._serve

        def begin(*arguments: Any, **more: Any) -> NoReturn:  # of a child that is forked
            exec(deed)
            serve(*arguments, **more)

        monkeypatch.setattr(child, "_serve", begin)

    @property
    def count(self) -> int:
        """How many processes were started by now, whether killed or not."""
        return self._file.stat().st_size if self._file.exists() else 0


def number() -> bytes:
    """Of this process."""
    return str(os.getpid()).encode()


def noted(folder: str, name: str, seconds: float = 0.0) -> bytes:
    """Leave a file, and take so long."""
    Path(folder, f"{name}.{os.getpid()}").touch()
    time.sleep(seconds)
    return name.encode()


def held(folder: str, name: str, until: str) -> bytes:
    """Leave a file, and come back when there is another one."""
    Path(folder, f"{name}.{os.getpid()}").touch()
    while not Path(until).exists():
        time.sleep(0.01)
    return name.encode()


def fatal(code: int) -> bytes:
    """End this process."""
    os._exit(code)


def dies_in(role: str) -> bytes:
    """End this process in C, while a role is called; empty for none."""
    current_calls().at(7)
    with current_calls().calling(role) if role else nullcontext():
        ctypes.CDLL(None)._exit(0)
    return b""


def closes_all() -> bytes:
    """Close the files of this process, as a component."""
    with current_calls().calling("generator"):
        os.closerange(3, 256)
    return b""


def prints(text: str, *, dies: bool = False) -> bytes:
    """Print to both streams."""
    sys.stdout.write(f"{text}\n")
    sys.stderr.write(f"{text} to the error stream\n")
    if dies:
        ctypes.CDLL(None)._exit(0)
    return b""


def endless(folder: str = "", *, seconds: float | None = None) -> bytes:
    """Never come back; a process that it starts holds on to everything as well."""
    replies.begin()
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    if folder:
        Path(folder, f"{os.getpid()} {child.pid}").touch()
    while True:
        time.sleep(1.0)


def outlived(folder: str, *, seconds: float | None = None) -> bytes:
    """End this process, and leave a copy of it behind that no signal to its group reaches."""
    replies.begin()
    if os.fork() == 0:
        os.setsid()
        Path(folder, str(os.getpid())).touch()
        while True:
            time.sleep(1.0)
    while not any(Path(folder).iterdir()):
        time.sleep(0.01)
    os._exit(3)


def limited(text: str, *, seconds: float | None = None) -> bytes:
    """Take a limit, and come back at once."""
    replies.begin()
    return str(len(text)).encode()


def prepared(takes: float, *, seconds: float | None = None) -> bytes:
    """Take so long before the limit begins."""
    time.sleep(takes)
    replies.begin()
    return number()


def refused(value: list[int]) -> bytes:
    """Raise what a user has to mend."""
    raise ConfigurationError(
        "no such thing", file="a.yaml", line=3, key="b", found=value, expected="c", remedy="d"
    )


def broken() -> bytes:
    """Raise what nobody expects."""
    raise ZeroDivisionError("of the role's own")


def leaky(megabytes: int, most: int) -> bytes:
    """Hold on to memory, in a process that may grow by so many bytes."""
    child.MAX_MEMORY_GROWTH = most
    HELD.append(bytearray(b"x") * (megabytes * 2**20))
    return number()


def surroundings() -> bytes:
    """What this process finds."""
    return json.dumps([sys.path, str(Path.cwd()), sys.flags.optimize]).encode()


def built(path: str) -> bytes:
    return repr(RoleSpec(path).create()).encode()
