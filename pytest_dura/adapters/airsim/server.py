"""A server of AirSim as this process has it."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from typing import Any

from pytest_dura.adapters.libraries import client_library
from pytest_dura.adapters.servers import Kept, Server, ServerConnection, project_program
from pytest_dura.core.errors import ConfigurationError

_STARTING = 120.0
_LOOK = 2.0
"""Seconds that a server may take to start, and to answer a look whether it is there."""


class AirSimError(Exception):
    """Error of the server: it does not answer, or not what was asked for."""


class Connection(ServerConnection):
    """A server, for one session at a time; its client has a thread and an event loop of its own.

    Args:
        host: Where it listens.
        port: Where it listens.
        program: Command line of a program of the project that starts it; without one it is there.
        timeout: Seconds that an answer may take.
    """

    def __init__(self, host: str, port: int, program: str, timeout: float) -> None:
        self.address, self._timeout = f"{host}:{port}", timeout
        command = project_program(program, "server") if program else ()
        super().__init__(Server(f"airsim:{self.address}", command, _STARTING))
        self._make = partial(_client, host, port)
        self._thread: ThreadPoolExecutor | None = None
        self._client: Any = None

    def _enter(self) -> None:
        if problem := self.problem():
            raise AirSimError(f"no server of AirSim answers at {self.address}: {problem}")
        self._connect(self._timeout)
        self._check_versions()

    def problem(self) -> str:
        """Say why the server does not answer; nothing if it does."""
        try:
            self._connect(_LOOK)
            self.ask("ping", seconds=_LOOK)
        except AirSimError as error:
            return str(error)
        finally:
            self._leave()
            self._is_lost = False
        return ""

    def ask(self, name: str, *arguments: Any, seconds: float = 0.0, join: bool = True) -> Any:
        """Call a method of the client.

        Args:
            name: Of the method.
            arguments: Of the method.
            seconds: How long an answer may take; by default as usual.
            join: Whether to wait for the end of what an ``Async`` method has begun.

        Raises:
            AirSimError: If the server does not answer in time, or refuses.
        """
        seconds = seconds or self._timeout

        def call() -> Any:
            answer = getattr(self._client, name)(*arguments)
            return answer.get() if name.endswith("Async") and join else answer

        assert self._thread is not None
        try:
            answer = self._thread.submit(call).result(seconds)
        except LateError:
            self._fail(f"{name}: no answer within {seconds:g} s")
        except Exception as error:  # of the client, whose own classes it does not document
            self._fail(f"{name}: {error}")
        return None if name.endswith("Async") else answer

    def close(self) -> None:
        """Let the world go on by itself, and let go of the server; twice does nothing."""
        try:
            if self._thread is not None and not self.is_broken:
                with suppress(AirSimError):  # a server that is gone needs no word
                    self.ask("simPause", False)
        finally:
            self._leave()
            self.server.close()

    def _connect(self, seconds: float) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="airsim")
        self._client = self._thread.submit(self._make, seconds).result()

    def _leave(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            if self._client is not None:
                thread.submit(self._client.client.close)
                self._client = None
            thread.shutdown(wait=False)

    def _fail(self, what: str) -> None:
        self._is_lost = True
        ending = self.server.ending()
        raise AirSimError(f"{what} (AirSim at {self.address})" + (ending and f"; {ending}"))

    def _check_versions(self) -> None:
        ours, theirs = self._client.getClientVersion(), self.ask("getServerVersion")
        least, theirs_least = (
            self._client.getMinRequiredServerVersion(),
            self.ask("getMinRequiredClientVersion"),
        )
        if theirs < least or ours < theirs_least:
            raise ConfigurationError(
                "client and server of AirSim do not fit",
                key="simulator",
                found=f"protocol {ours} of the client, {theirs} of the server",
                expected=f"a server of {least} or later, a client of {theirs_least} or later",
                remedy="update the older one: this client is that of Cosys-AirSim",
            )


CONNECTIONS = Kept(Connection)
"""Connections of this process, which episodes share."""


def _client(host: str, port: int, seconds: float) -> Any:
    """Make a client in the thread that uses it: it takes the event loop that it finds."""
    import asyncio

    made = library().MultirotorClient
    loop = asyncio.new_event_loop()
    # What the library does not take from its own tasks is that a wire is cut: `ask` says so.
    loop.set_exception_handler(lambda *_: None)
    asyncio.set_event_loop(loop)
    return made(host, port, timeout_value=math.ceil(seconds) + 1)


@cache
def library() -> Any:
    """Return the client library.

    Raises:
        ConfigurationError: If it is not installed.
    """
    return client_library(lambda: import_module("cosysairsim"), "cosysairsim", "AirSim", "airsim")
