"""Pipe: a program that is started here, and read and written by its standard streams."""

from __future__ import annotations

import os
import select
import shlex
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO, ClassVar

from pytest_dura.adapters.link.transports import LinkLostError, Transport, wrong_address
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.trust import check_registered, current_places

_SERVE = "serve"
"""In place of a program: this Python, which serves a component or simulator of the project."""
_PATIENCE = 2.0
"""Seconds that a program has to end by itself once its input is closed."""
_CHUNK = 65_536


class Pipe(Transport):
    """``pipe:./controller --fast``, ``pipe:serve planner:MyPlanner --binding=tank.link.yaml``.

    A program is a file of the project. Its standard error goes to the session's. At the peer's end
    ``pipe:`` is its own standard streams.
    """

    shared: ClassVar[bool] = True

    def __init__(self, address: str, *, peer: bool = False) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if peer:
            # What the component prints must not get between frames.
            self._input, self._output = os.dup(0), os.dup(1)
            os.dup2(2, 1)
            self._files: tuple[BinaryIO, ...] = ()
            return
        command = program_of(address)
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
            )
        except OSError as error:
            raise LinkLostError(f"{command[0]} cannot be started: {error.strerror}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._files = (self._process.stdin, self._process.stdout)  # type: ignore[assignment]
        self._input, self._output = self._process.stdout.fileno(), self._process.stdin.fileno()

    def send(self, data: bytes) -> None:
        """Write; a program that does not read is as good as gone after a second."""
        while data:
            if not select.select([], [self._output], [], 1.0)[1]:
                raise LinkLostError("the program does not read")
            try:
                data = data[os.write(self._output, data[: select.PIPE_BUF]) :]
            except OSError:
                raise LinkLostError(self._end()) from None

    def receive(self, seconds: float) -> bytes:
        """Read what is there."""
        if not select.select([self._input], [], [], max(seconds, 0.0))[0]:
            return b""
        data = os.read(self._input, _CHUNK)
        if not data:
            raise LinkLostError(self._end())
        return data

    def close(self) -> None:
        """Close the program's input, at which it ends; kill it if it does not."""
        process, self._process = self._process, None
        for file in self._files:
            file.close()
        if process is None:
            return
        try:
            process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _end(self) -> str:
        """How the program ended, in words."""
        if self._process is None:
            return "the other end has gone"
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            return "the program has closed its streams"
        return f"the program ended with {'signal' if code < 0 else 'exit code'} {abs(code)}"


def program_of(address: str) -> list[str]:
    """Return the command of an address.

    Raises:
        ConfigurationError: For a program that is not the project's: files may come from strangers.
    """
    try:
        program, *arguments = shlex.split(address)
    except ValueError:
        raise wrong_address("pipe", address, "pipe:PROGRAM ARGUMENTS") from None
    if program == _SERVE:
        for path in arguments[:1]:
            check_registered(path)
        return [sys.executable, "-m", "pytest_dura", _SERVE, *arguments, "--transport", "pipe:"]
    places, file = current_places(), Path(program)
    is_own = any(file.resolve().is_relative_to(folder) for folder in places.own)
    is_allowed = places.trusting or is_own or not places.own
    if not file.is_file() or not is_allowed or places.foreign_folder(file):
        raise ConfigurationError(
            "this program cannot be started" if file.is_file() else "there is no such program",
            key="transport",
            found=f"pipe:{address}",
            expected=f"a file of the project, with its folder, or `{_SERVE} package.module:Name`",
            remedy="compile or copy it into the project, or add --dura-trust-code",
        )
    return [str(file.resolve()), *arguments]
