"""Deadline: one span of time for a whole exchange, whatever the server does in it.

The timeouts of HTTP libraries hold for each read: a server that sends a byte now and then is waited
for without end. Here every step on the network gets what is left.
"""

from __future__ import annotations

import ipaddress
import queue
import socket
import ssl
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpcore2

_LEAST = 0.001
_LONGEST = 86_400.0
_CHUNK = 65_536


@dataclass(frozen=True)
class Deadline:
    """A moment of the monotonic clock."""

    at: float

    @classmethod
    def within(cls, seconds: float) -> Deadline:
        """So many seconds from now; a day at most."""
        return cls(time.monotonic() + min(seconds, _LONGEST))

    def left(self) -> float:
        """Seconds that are left.

        Raises:
            TimeoutError: If none are.
        """
        left = self.at - time.monotonic()
        if left <= 0.0:
            raise TimeoutError("the deadline has passed")
        return max(left, _LEAST)


class Network(httpcore2.NetworkBackend):
    """Connections of the machine's network that end with a deadline."""

    def __init__(self, deadline: Deadline) -> None:
        self._deadline = deadline

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,  # noqa: ARG002 - the deadline holds
        local_address: str | None = None,  # noqa: ARG002 - none is asked for
        socket_options: Iterable[Any] | None = None,  # noqa: ARG002 - none are asked for
    ) -> httpcore2.NetworkStream:
        """A connection to the first address of the host that takes one."""
        with _told(httpcore2.ConnectTimeout, httpcore2.ConnectError):
            addresses = _addresses(host, port, self._deadline)
            for number, address in enumerate(addresses):
                others = len(addresses) - number
                try:
                    return _Stream(_connected(address, self._deadline.left() / others),
                                   self._deadline)  # fmt: skip
                except OSError:
                    if others == 1:
                        raise
            raise OSError(f"{host} has no address")


class _Stream(httpcore2.NetworkStream):
    """A connection, each of whose steps gets what is left."""

    def __init__(self, sock: socket.socket, deadline: Deadline) -> None:
        self._sock, self._deadline = sock, deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:  # noqa: ARG002 - see above
        with _told(httpcore2.ReadTimeout, httpcore2.ReadError):
            self._sock.settimeout(self._deadline.left())
            return self._sock.recv(max_bytes)

    def write(self, buffer: bytes, timeout: float | None = None) -> None:  # noqa: ARG002 - see above
        view = memoryview(buffer)
        with _told(httpcore2.WriteTimeout, httpcore2.WriteError):
            while view:
                self._sock.settimeout(self._deadline.left())
                view = view[self._sock.send(view[:_CHUNK]) :]

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,  # noqa: ARG002 - see above
    ) -> httpcore2.NetworkStream:
        try:
            with _told(httpcore2.ConnectTimeout, httpcore2.ConnectError):
                self._sock.settimeout(self._deadline.left())
                wrapped = ssl_context.wrap_socket(self._sock, server_hostname=server_hostname)
        except BaseException:  # a time limit, too, must leave no socket open; it is raised again
            self.close()
            raise
        return _Stream(wrapped, self._deadline)

    def get_extra_info(self, info: str) -> Any:  # noqa: ARG002 - nothing is told: HTTP/1.1 needs nothing
        return None

    def close(self) -> None:
        self._sock.close()


def _connected(address: tuple[Any, ...], seconds: float) -> socket.socket:
    family, kind, protocol, _, place = address
    sock = socket.socket(family, kind, protocol)
    try:
        sock.settimeout(seconds)
        sock.connect(place)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except BaseException:  # see above
        sock.close()
        raise
    return sock


def _addresses(host: str, port: int, deadline: Deadline) -> list[tuple[Any, ...]]:
    """Addresses of a host. A name is looked up apart: the system's look-up knows no timeout."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        pass
    else:
        return list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
    found: queue.SimpleQueue[list[tuple[Any, ...]] | OSError] = queue.SimpleQueue()

    def look_up() -> None:
        try:
            found.put(list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)))
        except (OSError, UnicodeError) as error:
            found.put(OSError(f"{host} has no address: {error}"))

    threading.Thread(target=look_up, name="dura-look-up", daemon=True).start()
    try:
        answer = found.get(timeout=deadline.left())
    except queue.Empty:
        raise TimeoutError("the deadline has passed while the host was looked up") from None
    if isinstance(answer, OSError):
        raise answer
    return answer


@contextmanager
def _told(late: type[Exception], failed: type[Exception]) -> Iterator[None]:
    """Errors of sockets as the HTTP library knows them."""
    try:
        yield
    except TimeoutError as error:
        raise late(str(error)) from error
    except OSError as error:
        raise failed(str(error)) from error
