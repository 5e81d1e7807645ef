"""Pipe: a program that is started here, and read and written by its standard streams."""

from __future__ import annotations

import os
import select
import subprocess
from typing import BinaryIO, ClassVar

from pytest_dura.adapters.link.transports import LinkLostError, Transport
from pytest_dura.adapters.servers import SERVE, describe_code, end_process, project_program

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
        command = project_program(address, "transport")
        if address.split()[:1] == [SERVE]:
            command += ["--transport", "pipe:"]
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
        if process is not None:
            end_process(process, _PATIENCE)

    def _end(self) -> str:
        """How the program ended, in words."""
        if self._process is None:
            return "the other end has gone"
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            return "the program has closed its streams"
        return f"the program {describe_code(code)}"
