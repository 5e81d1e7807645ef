"""CAN, by python-can (``pip install pytest-dura[link]``): frames in pieces of eight bytes.

Messages of one identifier keep their order on a bus, so that the pieces are a stream of bytes.
"""

from __future__ import annotations

from time import monotonic
from typing import Any

from pytest_dura.adapters.link.transports import (
    LinkLostError,
    Transport,
    missing_package,
    wrong_address,
)

_PIECE = 8
_TO_PEER, _FROM_PEER = 0x2D0, 0x2D1
"""Identifiers of the messages to the component or simulator, and from it."""
_EXPECTED = "can:INTERFACE/CHANNEL, such as can:socketcan/can0 or can:udp_multicast/239.74.163.2"


class Can(Transport):
    """``can:socketcan/can0``; identifiers 0x2D0 to the component or simulator, 0x2D1 from it."""

    def __init__(self, address: str, *, peer: bool = False) -> None:
        try:
            import can
        except ImportError:
            raise missing_package("can", "python-can", "link") from None
        interface, slash, channel = address.partition("/")
        if not slash or not interface or not channel:
            raise wrong_address("can", address, _EXPECTED)
        self._can: Any = can
        self._own, other = (_FROM_PEER, _TO_PEER) if peer else (_TO_PEER, _FROM_PEER)
        filters = [{"can_id": other, "can_mask": 0x7FF, "extended": False}]
        self._bus: Any = None
        try:
            self._bus = can.Bus(interface=interface, channel=channel, can_filters=filters)
        except can.CanInterfaceNotImplementedError:
            raise wrong_address("can", address, _EXPECTED) from None
        except (can.CanError, OSError, ValueError) as error:
            raise LinkLostError(f"the bus {address} cannot be opened: {error}") from None

    def send(self, data: bytes) -> None:
        """Send the pieces."""
        for at in range(0, len(data), _PIECE):
            piece = data[at : at + _PIECE]
            message = self._can.Message(
                arbitration_id=self._own, data=piece, is_extended_id=False, is_rx=False
            )
            try:
                self._bus.send(message, timeout=1.0)
            except (self._can.CanError, OSError) as error:
                raise LinkLostError(f"the bus takes nothing: {error}") from None

    def receive(self, seconds: float) -> bytes:
        """Receive the next piece, and those that are there behind it."""
        data, until = bytearray(), monotonic() + seconds
        while True:
            left = 0.0 if data else max(until - monotonic(), 0.0)
            try:
                message = self._bus.recv(left)
            except (self._can.CanError, OSError) as error:
                raise LinkLostError(f"the bus is lost: {error}") from None
            if message is None:
                return bytes(data)
            if not message.is_error_frame and message.is_rx:
                data += message.data

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None
