"""Bus: the topics of a binding in one DDS domain, written and read."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from time import monotonic, sleep
from typing import Any, ClassVar
from weakref import finalize

from pytest_dura.adapters.dds import Participant, Reader, Writer, wait_for_all
from pytest_dura.adapters.ros2.bindings import TopicBinding
from pytest_dura.adapters.ros2.messages import CLOCK, TEXT, has_stamp, message_type, stamp_of, zero
from pytest_dura.adapters.ros2.services import ServiceCall, ServiceClient
from pytest_dura.adapters.servers import Server, project_program

_FINDING = 60.0
"""Seconds in which writers and readers have to find their other ends."""
_SETTLING = 0.2
"""Seconds that the other ends have to find these."""
_LEASE = 15.0
"""Seconds after which an end that was killed is no longer matched; it is 10 by default."""
_LOOK = 0.2
"""Seconds of one wait, between two looks whether a server still runs."""
_ROUNDING = 1_000
"""Nanoseconds by which times in floating point may be off."""


class Ros2Error(Exception):
    """Error of the other end: a topic without messages, or a world that is not in step."""


class Bus:
    """Topics that are written and read in one domain.

    Args:
        domain: Number of the domain, ``ROS_DOMAIN_ID`` of the other end.
        binding: Types of the topics.
        written: Topics that are written, with their types.
        read: Topics that are read, with their types.
        services: Services that are asked.
    """

    participant: ClassVar[Callable[[int], Any]] = Participant
    """Makes what writes and reads topics, of a domain."""
    client: ClassVar[type[Any]] = ServiceClient
    """Makes a client of a service, of that."""
    prefix: ClassVar[str] = "rt"
    """Of the names of topics on DDS."""

    @classmethod
    def message_type(cls, name: str) -> Any:
        """Return the type of a message."""
        return message_type(name)

    @classmethod
    def zero(cls, name: str) -> Any:
        """Make a message with 0, empty texts and empty lists in it."""
        return zero(name)

    @classmethod
    def address(cls, domain: int) -> str:
        """Name of the domain, by which what is at the other end is locked."""
        return f"ros2:{domain}"

    def __init__(
        self,
        domain: int,
        binding: TopicBinding,
        written: Mapping[str, str],
        read: Mapping[str, str],
        services: Sequence[ServiceCall] = (),
    ) -> None:
        self._participant, self._types = type(self).participant(domain), dict(read)
        self.clients = {call.service: self.client(self._participant, call) for call in services}
        self.writers: dict[str, Writer] = {
            topic: self._participant.writer(f"{self.prefix}{topic}", self.message_type(name))
            for topic, name in written.items()
        }
        self.readers: dict[str, Reader] = {
            topic: self._participant.reader(
                f"{self.prefix}{topic}",
                self.message_type(name),
                best_effort=topic in binding.best_effort,
            )
            for topic, name in read.items()
        }
        self._optional = {topic for topic, name in written.items() if name == CLOCK}
        self.newest: dict[str, Any] = {}
        """The newest message of each topic since :meth:`drain`."""

    def missing(self, seconds: float) -> str:
        """Wait for the other ends; returns in words which are not there."""
        ends: dict[str, Any] = {
            **{
                f"nothing reads {topic}": writer
                for topic, writer in self.writers.items()
                if topic not in self._optional
            },
            **{f"nothing writes {topic}": reader for topic, reader in self.readers.items()},
            **{f"nothing serves {name}": client for name, client in self.clients.items()},
        }
        return ", ".join(wait_for_all(ends, seconds))

    def settle(self, seconds: float) -> None:
        """Wait for the other ends, and until they have found these, too.

        Raises:
            Ros2Error: If one is not there in time.
        """
        if missing := self.missing(seconds):
            raise Ros2Error(f"{missing}, within {seconds:g} s")
        wait_for_all({topic: self.writers[topic] for topic in self._optional}, _SETTLING)
        sleep(_SETTLING)

    def wait_until_gone(self, seconds: float) -> None:
        """Wait until DDS has noticed that the other ends have gone, for so long at most."""
        until = monotonic() + seconds
        ends = [*self.writers.values(), *self.readers.values(), *self.clients.values()]
        while any(end.matched for end in ends) and monotonic() < until:
            sleep(_SETTLING)

    def write(self, messages: Mapping[str, Any]) -> None:
        """Write messages, by topic."""
        for topic, message in messages.items():
            self.writers[topic].write(message)

    def drain(self) -> None:
        """Forget what has come."""
        self._take()
        self.newest.clear()

    def wait(self, topics: Collection[str], since: int, seconds: float, server: Server) -> None:
        """Wait until each topic has a message since a time, or any if it has no stamp.

        Args:
            topics: The topics.
            since: Nanoseconds that a stamp has at least.
            seconds: How long it may take.
            server: What is at the other end.

        Raises:
            Ros2Error: If it takes longer, or the server has ended; it names the topics.
        """
        until = monotonic() + seconds
        while True:
            self._take()
            missing = [topic for topic in topics if not self._has(topic, since)]
            if not missing:
                return
            left = until - monotonic()
            ending = server.ending()
            if left <= 0.0 or ending:
                raise Ros2Error(
                    self._described(missing, since, seconds) + (ending and f"; {ending}")
                )
            self._participant.wait(min(left, _LOOK))

    def ask(self, call: ServiceCall | None, seed: int, seconds: float, server: Server) -> None:
        """Ask a service, and wait for its reply; messages that come meanwhile count as new.

        Args:
            call: What to ask; nothing without one.
            seed: Of the episode.
            seconds: How long the reply may take.
            server: What is at the other end.

        Raises:
            Ros2Error: If it takes longer, the server has ended, or the reply is that it failed.
        """
        if call is None:
            return
        client, until = self.clients[call.service], monotonic() + seconds
        client.send(call, seed)
        while (reply := client.take()) is None:
            left = until - monotonic()
            ending = server.ending()
            if left <= 0.0 or ending:
                raise Ros2Error(
                    f"{call} did not answer within {seconds:g} s" + (ending and f"; {ending}")
                )
            self._take()
            self._participant.wait(min(left, _LOOK))
        if refusal := call.refusal(reply):
            raise Ros2Error(refusal)

    def close(self) -> None:
        """Leave the domain."""
        self.clients.clear()
        self.writers.clear()
        self.readers.clear()
        self._participant.close()

    def _take(self) -> None:
        for topic, reader in self.readers.items():
            for message in reader.take():
                self.newest[topic] = message

    def _is_stamped(self, topic: str) -> bool:
        return self._types[topic] == CLOCK or has_stamp(self._types[topic])

    def _has(self, topic: str, since: int) -> bool:
        message = self.newest.get(topic)
        if message is None or not self._is_stamped(topic):
            return message is not None
        return stamp_of(message) >= since - _ROUNDING

    def _described(self, missing: list[str], since: int, seconds: float) -> str:
        parts = []
        for topic in missing:
            message = self.newest.get(topic)
            stamp = "" if message is None else f" of {since / 1e9:g} s or later"
            last = "" if message is None else f", the last one is of {stamp_of(message) / 1e9:g} s"
            parts.append(f"no message of {topic}{stamp} within {seconds:g} s{last}")
        return "; ".join(parts)


class BusHolder:
    """What talks over a bus, which the next episode of its process has afterwards.

    Args:
        domain: See :class:`Bus`.
        binding: See :class:`Bus`.
        written: Lists of the binding that are written.
        read: Lists of the binding that are read.
        extra: Topics that are written beside, with their types.
        services: Services that are asked.
        server: Command line of the server at the other end, see :class:`Server`.
        kind: Of the bus.
    """

    def __init__(
        self,
        domain: int,
        binding: TopicBinding,
        *,
        written: str,
        read: tuple[str, ...],
        extra: Mapping[str, str],
        services: Sequence[ServiceCall] = (),
        server: str = "",
        kind: type[Bus] = Bus,
    ) -> None:
        self._services = tuple(services)
        self._domain, self._binding, self._server, self._kind = domain, binding, server, kind
        self._written = {**binding.topics_of(written), **extra}
        self._read = binding.topics_of(*read)
        self._open: tuple[Bus, Server] | None = None
        self._key: tuple[Any, ...] = ()

    def take(self, *clock: str) -> tuple[Bus, Server]:
        """Take the bus that no episode uses, or open one.

        Args:
            clock: Topic of a clock that is read.

        Raises:
            ConfigurationError: If another session has the topics.
            Ros2Error: If the other ends are not there.
        """
        self.give_back()
        read = {**self._read, **dict.fromkeys(clock, CLOCK)}
        self._key = (
            os.getpid(),
            self._kind,
            self._domain,
            tuple(self._written),
            tuple(read),
            tuple((call.service, call.type) for call in self._services),
            self._server,
        )
        free = _FREE.pop(self._key, None)
        if free is not None and (free[1].ending() or free[0].missing(0.0)):
            free[0].wait_until_gone(_LEASE)
            _close(*free)
            free = None
        self._open = free or self._opened(
            self._kind(self._domain, self._binding, self._written, read, self._services)
        )
        self._returning = finalize(self, _give_back, self._key, self._open)
        return self._open

    def _opened(self, bus: Bus) -> tuple[Bus, Server]:
        """Lock what is at the other end, and find or start it."""
        names = ",".join(sorted(self._written))
        command = project_program(self._server, "server") if self._server else ()
        server = Server(f"{bus.address(self._domain)}{names}", command, _FINDING)
        try:
            server.open(partial(bus.missing, _LOOK))
            bus.settle(0.0 if self._server else _FINDING)
        except BaseException:  # ctrl-C too must not leave it locked; it is raised again
            _close(bus, server)
            raise
        return bus, server

    def give_back(self) -> None:
        """Let go of the bus; a second call does nothing."""
        if self._open is not None:
            self._open = None
            self._returning()


_FREE: dict[tuple[Any, ...], tuple[Bus, Server]] = {}
"""Buses that no episode uses, by process and topics."""


def _give_back(key: tuple[Any, ...], opened: tuple[Bus, Server]) -> None:
    if key[0] == os.getpid():  # and not in one that was forked of it
        _FREE[key] = opened


@atexit.register
def close_buses() -> None:
    """Close the buses of this process, and the servers at their other ends."""
    for key in [key for key in _FREE if key[0] == os.getpid()]:
        _close(*_FREE.pop(key))


def _close(bus: Bus, server: Server) -> None:
    bus.close()
    server.close()


def text_topic(topic: str | None) -> dict[str, str]:
    """Type of a topic of resets, if there is one."""
    return {} if topic is None else {topic: TEXT}
