"""Guard: runs a program until its own standard input is closed, and then ends it.

``python guard.py SECONDS PROGRAM ARGUMENT...`` So a server ends with the session that started it,
also if that is killed. Program and guard are a process group; all that the program has started goes
with it. The last line of standard output is how the program ended, as an exit code, below 0 for a
signal; what the program prints goes to standard error.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence


def guard(patience: float, command: Sequence[str]) -> None:
    """Run the program; never returns, as the group ends.

    Args:
        patience: Seconds that it has to end by itself.
        command: The program and its arguments.
    """
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(woken)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD):
        signal.signal(number, lambda *_: None)
    try:
        program = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=2)
    except OSError as error:
        _end(127, f"{command[0]}: {error.strerror}")
    is_asked = False
    while program.poll() is None and not is_asked:
        ready = select.select([0, wake], [], [])[0]
        is_asked = 0 in ready  # nothing is written to it: it is closed
        if wake in ready:
            is_asked |= signal.SIGTERM in os.read(wake, 64)
    if program.poll() is None:
        os.killpg(0, signal.SIGTERM)
        try:
            program.wait(patience)
        except subprocess.TimeoutExpired:
            program.kill()
    _end(program.wait())


def _end(code: int, problem: str = "") -> None:
    if problem:
        os.write(2, f"{problem}\n".encode())
    os.write(1, f"{code}\n".encode())
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    guard(float(sys.argv[1]), sys.argv[2:])
