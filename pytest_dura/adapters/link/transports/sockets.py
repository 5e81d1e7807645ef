"""TCP and UDP: a host and a port."""

from __future__ import annotations

import select
import socket

from pytest_dura.adapters.link.transports import LinkLostError, Transport, wrong_address

_CHUNK = 65_536
_CONNECTING = 5.0
"""Seconds that a connection may take."""
_SENDING = 1.0
"""Seconds after which a peer that takes nothing is as good as gone."""


def host_and_port(transport: str, address: str) -> tuple[str, int]:
    """Read ``host:port``.

    Raises:
        ConfigurationError: For anything else.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        raise wrong_address(transport, address, f"{transport}:HOST:PORT")
    return host, int(port)


class Tcp(Transport):
    """``tcp:127.0.0.1:5000``: the peer listens, and talks to one at a time."""

    connects = True

    def __init__(self, address: str, *, peer: bool = False) -> None:
        place = host_and_port("tcp", address)
        self._server: socket.socket | None = None
        self._socket: socket.socket | None = None
        try:
            if peer:
                self._server = socket.create_server(place)
            else:
                self._connected(socket.create_connection(place, _CONNECTING))
        except OSError as error:
            raise LinkLostError(f"no connection to {address}: {error.strerror or error}") from None

    def send(self, data: bytes) -> None:
        """Send all."""
        if self._socket is None:
            raise LinkLostError("no peer is connected")
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkLostError(f"the connection is lost: {error}") from None

    def receive(self, seconds: float) -> bytes:
        """Receive what is there; the peer's end waits for the next connection where there is none.

        Raises:
            LinkLostError: If the other end has closed the connection; the peer's end then listens.
        """
        waiting = self._server if self._socket is None else self._socket
        if waiting is None:
            raise LinkLostError("the connection is closed")
        if not select.select([waiting], [], [], max(seconds, 0.0))[0]:
            return b""
        if self._socket is None:
            self._connected(waiting.accept()[0])
            return b""
        try:
            data = self._socket.recv(_CHUNK)
        except OSError:
            data = b""
        if not data and self._server is None:
            raise LinkLostError("the other end has closed the connection")
        if not data:  # the next session connects anew
            self._socket.close()
            self._socket = None
        return data

    def close(self) -> None:
        """Close the connection."""
        for each in (self._socket, self._server):
            if each is not None:
                each.close()
        self._socket = self._server = None

    def _connected(self, connection: socket.socket) -> None:
        connection.settimeout(_SENDING)
        # A frame goes out at once, and not when more has gathered.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection


class Udp(Transport):
    """``udp:127.0.0.1:5000``: the peer has this port, and answers who wrote last."""

    def __init__(self, address: str, *, peer: bool = False) -> None:
        place = host_and_port("udp", address)
        self._other: tuple[str, int] | None = None if peer else place
        self._socket: socket.socket | None = None
        try:
            family = socket.getaddrinfo(*place, type=socket.SOCK_DGRAM)[0][0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            if peer:
                self._socket.bind(place)
        except OSError as error:
            self.close()
            raise LinkLostError(f"{address} cannot be used: {error.strerror or error}") from None

    def send(self, data: bytes) -> None:
        """Send a frame as one datagram."""
        if self._socket is None or self._other is None:
            raise LinkLostError("no peer has written")
        try:
            self._socket.sendto(data, self._other)
        except OSError as error:
            raise LinkLostError(f"a datagram cannot be sent: {error}") from None

    def receive(self, seconds: float) -> bytes:
        """Receive a datagram."""
        if self._socket is None:
            raise LinkLostError("the socket is closed")
        if not select.select([self._socket], [], [], max(seconds, 0.0))[0]:
            return b""
        try:
            data, other = self._socket.recvfrom(_CHUNK)
        except OSError:
            raise LinkLostError("nothing has this port at the other end") from None
        self._other = other[:2]
        return data

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
