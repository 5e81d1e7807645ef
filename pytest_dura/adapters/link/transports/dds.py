"""DDS (``pip install pytest-dura[dds]``): each frame is a sample of a topic."""

from __future__ import annotations

from time import monotonic, sleep
from typing import Any

from pytest_dura.adapters.dds import Participant, Reader, Writer, wait_for_all
from pytest_dura.adapters.link.transports import LinkLostError, Transport, wrong_address

_CONNECTING = 5.0
"""Seconds in which the ends have to find each other."""
_MATCHING = 1.0
"""Seconds after which an answer that nothing reads is as good as lost."""
_LOOK = 0.2
"""Seconds between two looks whether the other end is still there."""


class Dds(Transport):
    """``dds:0/tank``: domain and name; topics ``dura/tank/to_peer`` and ``dura/tank/from_peer``.

    Type ``dura::Frame`` with one field ``data``, a sequence of octets; reliable, volatile.
    """

    def __init__(self, address: str, *, peer: bool = False) -> None:
        domain, slash, name = address.partition("/")
        if not slash or not name.isidentifier() or not domain.isdecimal() or int(domain) > 232:
            raise wrong_address("dds", address, "dds:DOMAIN/NAME, such as dds:0/tank")
        self._participant: Participant | None = Participant(int(domain))
        from cyclonedds import idl

        kinds: Any = idl.types
        self._frame: Any = idl.make_idl_struct(
            "Frame", "dura::Frame", {"data": kinds.sequence[kinds.uint8]}
        )
        out, into = ("from_peer", "to_peer") if peer else ("to_peer", "from_peer")
        self._writer = self._participant.writer(f"dura/{name}/{out}", self._frame)
        self._reader = self._participant.reader(f"dura/{name}/{into}", self._frame)
        self._peer = peer
        ends: dict[str, Writer | Reader] = {"reads": self._writer, "writes": self._reader}
        if not peer and (missing := wait_for_all(ends, _CONNECTING)):
            self.close()
            raise LinkLostError(f"nothing {' or '.join(missing)} at the other end of dds:{address}")

    def send(self, data: bytes) -> None:
        """Write a sample; an answer waits until who has asked reads, too."""
        if self._participant is None:
            raise LinkLostError("the link is closed")
        until = monotonic() + _MATCHING
        while not self._writer.matched or self._writer.matched < self._reader.matched:
            if monotonic() > until:
                raise LinkLostError("nothing reads at the other end")
            sleep(0.001)
        self._writer.write(self._frame(data=list(data)))

    def receive(self, seconds: float) -> bytes:
        """Take the samples that are there."""
        until = monotonic() + seconds
        while self._participant is not None:
            if data := b"".join(bytes(sample.data) for sample in self._reader.take()):
                return data
            if not self._peer and not self._reader.matched:
                raise LinkLostError("the other end has gone")
            left = until - monotonic()
            if left <= 0.0:
                return b""
            self._participant.wait(min(left, _LOOK))
        raise LinkLostError("the link is closed")

    def close(self) -> None:
        """Leave the domain."""
        if self._participant is not None:
            self._participant.close()
            self._participant = None
            del self._writer, self._reader
