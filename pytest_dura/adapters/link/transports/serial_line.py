"""Serial line, by pyserial (``pip install pytest-dura[link]``)."""

from __future__ import annotations

from typing import Any

from pytest_dura.adapters.link.transports import (
    LinkLostError,
    Transport,
    missing_package,
    wrong_address,
)

_BAUD = 115_200
_SENDING = 1.0
"""Seconds after which a line that takes nothing is as good as cut."""


class Serial(Transport):
    """``serial:/dev/ttyUSB0``, ``serial:COM3@9600``: 8 data bits, no parity, 1 stop bit."""

    def __init__(self, address: str, *, peer: bool = False) -> None:  # noqa: ARG002 - both ends open
        try:
            import serial
        except ImportError:
            raise missing_package("serial", "pyserial", "link") from None
        device, _, baud = address.partition("@")
        if not device or (baud and not baud.isdecimal()):
            raise wrong_address("serial", address, "serial:DEVICE or serial:DEVICE@BAUD")
        self._errors: tuple[type[Exception], ...] = (serial.SerialException, OSError, TypeError)
        self._port: Any = None
        try:
            self._port = serial.Serial(device, int(baud or _BAUD), write_timeout=_SENDING)
            self._port.reset_input_buffer()
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLostError(f"{device} cannot be opened: {error}") from None

    def send(self, data: bytes) -> None:
        """Write all."""
        try:
            self._port.write(data)
        except self._errors as error:
            raise LinkLostError(f"the line is cut: {error}") from None

    def receive(self, seconds: float) -> bytes:
        """Read what is there."""
        try:
            self._port.timeout = max(seconds, 0.0)
            first = self._port.read(1)
            return bytes(first + self._port.read(self._port.in_waiting) if first else first)
        except self._errors as error:  # pyserial has TypeError for a port that was closed
            raise LinkLostError(f"the line is cut: {error}") from None

    def close(self) -> None:
        """Close the device."""
        if self._port is not None:
            self._port.close()
