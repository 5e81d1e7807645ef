"""Ports of the loopback interface for servers that are started after their port was chosen."""

from __future__ import annotations

import os
import socket
from itertools import count

_FIRST, _COUNT, _EACH = 20_000, 12_000, 97
"""Below those that systems give to clients and to servers that name none: what another test opens
by then never has such a port. Processes that run tests at once begin at different ones."""

_NUMBERS = count()


def free_port() -> int:
    """A port that is free for streams and for datagrams; this process gets it once."""
    while True:
        port = _FIRST + (os.getpid() * _EACH + next(_NUMBERS)) % _COUNT
        try:
            for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                with socket.socket(type=kind) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return port
