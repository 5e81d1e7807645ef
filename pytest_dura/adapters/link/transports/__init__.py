"""Transports: how the bytes of frames get to the other end, each by an address ``name:...``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.registry import Registry


class LinkLostError(Exception):
    """Error of a wire that is cut: the peer, its cable or its adapter has gone."""


class Transport(ABC):
    """A wire: bytes out, bytes in; they may get lost, damaged, or come late.

    Args:
        address: The part of the address behind the transport's name.
        peer: Whether this is the end of the component or simulator, which listens.

    Raises:
        ConfigurationError: For an address that the transport cannot use.
        LinkLostError: If nothing is there.
    """

    shared: ClassVar[bool] = False
    """Whether each process may have a wire of its own to a peer of its own."""
    connects: ClassVar[bool] = False
    """Whether opening it fails where no peer is there."""

    @abstractmethod
    def __init__(self, address: str, *, peer: bool = False) -> None: ...

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send the bytes of a frame; it does not wait for the peer for longer than a second.

        Raises:
            LinkLostError: If the wire is cut.
        """

    @abstractmethod
    def receive(self, seconds: float) -> bytes:
        """Return what has come, as soon as something has; nothing after ``seconds`` of waiting.

        Raises:
            LinkLostError: If the wire is cut.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the wire, and end what was started for it. A second call does nothing."""


TRANSPORTS: Registry[type[Transport]] = Registry(
    "pytest_dura.transports",
    "transport",
    lambda value: is_subclass(value, Transport),
    "a subclass of pytest_dura.adapters.link.transports.Transport",
)


def open_transport(address: str, *, peer: bool = False) -> Transport:
    """Open the wire of an address such as ``tcp:127.0.0.1:5000``.

    Raises:
        ConfigurationError: For an unknown transport, or a wrong address.
        LinkLostError: If nothing is there.
    """
    return transport_class(address)(address.partition(":")[2], peer=peer)


def transport_class(address: str) -> type[Transport]:
    """Return the class of an address.

    Raises:
        ConfigurationError: For an unknown transport.
    """
    name = address.partition(":")[0]
    if name not in TRANSPORTS:
        raise TRANSPORTS.unknown(name, key="transport")
    return TRANSPORTS[name]


def missing_package(transport: str, package: str, extra: str) -> ConfigurationError:
    """Make the error for a transport whose package is not installed."""
    return ConfigurationError(
        f"the transport {transport!r} needs the package {package}",
        key="transport",
        remedy=f"pip install 'pytest-dura[{extra}]'",
    )


def wrong_address(transport: str, address: str, expected: str) -> ConfigurationError:
    """Make the error for an address."""
    return ConfigurationError(
        f"the transport {transport!r} cannot use this address",
        key="transport",
        found=f"{transport}:{address}",
        expected=expected,
        remedy="correct it",
    )
