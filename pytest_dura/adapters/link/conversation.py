"""Link: questions and answers over a wire, and what is wrong with them, in words."""

from __future__ import annotations

import atexit
import os
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from weakref import finalize

from pytest_dura.adapters.link.bindings import RESET
from pytest_dura.adapters.link.frames import Decoder, Frame, Kind
from pytest_dura.adapters.link.transports import (
    LinkLostError,
    Transport,
    open_transport,
    transport_class,
)
from pytest_dura.adapters.servers import PORT, Server, project_program, with_port

_MICROSECONDS = 1e6
_NUMBERS = 2**32
_LOOK = 0.5
"""Seconds that a peer has to answer when it is looked for."""


class LinkError(Exception):
    """Error of the other end: it did not answer, was reset, or reported a failure."""


@dataclass
class Faults:
    """What was wrong on the wire since the last answer."""

    old: int = 0
    """Frames that answer an earlier one."""
    doubled: int = 0
    """Frames that came before."""
    lost: int = 0
    """Frames whose numbers are missing."""
    damaged: int = 0
    """Frames whose CRC does not hold."""
    garbage: int = 0
    """Bytes that belong to no frame."""
    drift: float = 0.0
    """Seconds by which the other end's clock is off, beyond what its answers allow."""

    def text(self, tolerated: Collection[str] = ()) -> str:
        """Describe what is not tolerated; empty if there is nothing."""
        counts = {
            "old": (self.old, "old frame"),
            "doubled": (self.doubled, "doubled frame"),
            "lost": (self.lost, "lost frame"),
            "damaged": (self.damaged, "damaged frame"),
            "garbage": (self.garbage, "byte of garbage"),
        }
        parts = [
            f"{count} {what if count == 1 else what.replace('byte', 'bytes', 1)}"
            + ("s" if count != 1 and "byte" not in what else "")
            for name, (count, what) in counts.items()
            if count and name not in tolerated
        ]
        if self.drift:
            parts.append(f"its clock is off by {self.drift:.3g} s")
        return ", ".join(parts)


FAULTS = ("old", "doubled", "lost", "damaged", "garbage")
"""Names of what may be tolerated."""


@dataclass
class Link:
    """One end of a wire.

    Args:
        transport: The wire.
        clock_tolerance: Seconds by which the other end's clock may be off.
        server: What is at the other end, where one exists; it is closed with the link.
    """

    transport: Transport
    clock_tolerance: float = 0.1
    server: Server | None = None
    faults: Faults = field(default_factory=Faults)
    _decoder: Decoder = field(default_factory=Decoder)
    _sent: int = 0
    _received: int = 0
    _zero: tuple[float, float, int] | None = None
    """When the other end's clock was at its first stamp, at the earliest and at the latest, and
    that stamp."""
    _frames: list[Frame] = field(default_factory=list)

    def send(
        self, kind: Kind, payload: bytes = b"", *, answers: int = 0, stamp: float = 0.0,
        failed: bool = False,
    ) -> int:  # fmt: skip
        """Send a frame; returns its number.

        Args:
            kind: Its kind.
            payload: Numbers and text.
            answers: Number of the frame that it answers.
            stamp: Seconds of the sender's time.
            failed: Whether the payload says why the sender failed.

        Raises:
            LinkLostError: If the wire is cut.
        """
        self._sent = self._sent % (_NUMBERS - 1) + 1
        microseconds = round(stamp * _MICROSECONDS)
        frame = Frame(kind, self._sent, answers, microseconds, payload, failed)
        self.transport.send(frame.encode())
        return self._sent

    def receive(self, seconds: float) -> Frame | None:
        """Return the next frame; ``None`` if none comes in time.

        Raises:
            LinkLostError: If the wire is cut.
        """
        until = monotonic() + seconds
        while not self._frames:
            left = until - monotonic()
            before = self._decoder.damaged, self._decoder.garbage
            data = self.transport.receive(max(left, 0.0))
            self._frames += self._decoder.feed(data)
            self.faults.damaged += self._decoder.damaged - before[0]
            self.faults.garbage += self._decoder.garbage - before[1]
            if not self._frames and left <= 0.0:
                return None
        return self._frames.pop(0)

    def ask(
        self, kind: Kind, payload: bytes, expected: Kind, seconds: float, *, stamp: float = 0.0
    ) -> Frame:
        """Send a frame, and return its answer; what else comes is counted in ``faults``.

        Args:
            kind: Of the frame.
            payload: Of the frame.
            expected: Kind of the answer.
            seconds: How long it may take.
            stamp: Our time, in s.

        Raises:
            LinkError: If no answer comes in time, or the other end was reset.
            LinkLostError: If the wire is cut.
        """
        self.faults = Faults()
        asked_at = monotonic()
        number = self.send(kind, payload, stamp=stamp)
        while True:
            left = asked_at + seconds - monotonic()
            frame = self.receive(min(left, _LOOK))
            if frame is None and self.server is not None and self.server.ending():
                raise LinkLostError("the other end has gone")
            if frame is None and left > _LOOK:
                continue
            if frame is None:
                came = self.faults.text()
                raise LinkError(
                    f"no answer to frame {number} within {seconds:g} s" + (came and f"; {came}")
                )
            if self._is_answer(frame, number, kind, expected):
                self._look_at_clock(frame, asked_at, monotonic())
                return frame

    def close(self) -> None:
        """End the conversation, and let go of the wire."""
        with suppress(LinkLostError):
            self.send(Kind.END)
        self.transport.close()
        if self.server is not None:
            self.server.close()

    def is_alive(self) -> bool:
        """Whether the wire holds, and the server at its other end runs, as far as can be seen."""
        try:
            self.receive(0.0)
        except LinkLostError:
            return False
        return self.server is None or not self.server.ending()

    def _is_answer(self, frame: Frame, number: int, asked: Kind, expected: Kind) -> bool:
        """Whether a frame is the answer; counts it otherwise.

        Raises:
            LinkError: If the other end was reset, or answers with something else.
        """
        before, is_current = self._received, frame.answers == number
        if asked is Kind.RESET and (is_current or frame.kind is Kind.RESET):
            self._zero = None
        elif frame.kind is Kind.RESET or (is_current and frame.number <= before):
            self._received, self._zero = frame.number, None
            raise LinkError("the device was reset: it counts its frames anew")
        elif frame.number <= before:
            self.faults.doubled += 1
            return False
        else:
            self.faults.lost += frame.number - before - 1
        self._received = frame.number
        if not is_current:
            self.faults.old += asked is not Kind.RESET
            return False
        if frame.kind is Kind.END:
            raise LinkError("the other end has ended the conversation")
        if frame.failed:
            raise LinkError(frame.payload.decode("utf-8", "replace") or "it failed")
        if frame.kind is not expected:
            raise LinkError(f"it answered by a {frame.kind.name}, not by a {expected.name}")
        return True

    def _look_at_clock(self, frame: Frame, asked: float, answered: float) -> None:
        """Compare the time that passed there with what may have passed here."""
        if self._zero is None:
            self._zero = asked, answered, frame.stamp
            return
        earliest, latest, first = self._zero
        if frame.stamp == first == 0:
            return  # it has no clock
        passed = (frame.stamp - first) / _MICROSECONDS
        off = max(asked - latest - passed, passed - (answered - earliest))
        self.faults.drift = off if off > self.clock_tolerance else 0.0


def open_link(
    address: str, *, program: str = "", clock_tolerance: float = 0.1, starting: float = 60.0
) -> Link:
    """Open a link to a peer, of which one session at a time may have one that cannot be shared.

    Args:
        address: Of the peer; see :data:`~pytest_dura.adapters.servers.PORT`.
        program: What is started where nothing answers at the address, see
            :class:`~pytest_dura.adapters.servers.Server`.
        clock_tolerance: See :class:`Link`.
        starting: Seconds in which that program has to answer.

    Raises:
        ConfigurationError: For a wrong address, and for a device that another process uses.
        LinkLostError: If nothing is there.
        ServerError: If the program does not answer.
    """
    if is_shared(address) and PORT not in address:
        return Link(open_transport(address), clock_tolerance)
    is_own = PORT in address
    address, program = with_port(address, program)
    command = project_program(program, "server") if program else ()
    server = Server(address, command, starting)
    server.open(partial(_problem_at, address), find=not is_own)
    try:
        return Link(open_transport(address), clock_tolerance, server)
    except BaseException:  # ctrl-C too must not leave the device locked; it is raised again
        server.close()
        raise


def is_shared(address: str) -> bool:
    """Whether each process may have a peer of its own at an address."""
    return transport_class(address).shared or PORT in address


def _problem_at(address: str) -> str:
    """Look whether a peer answers; returns why it does not."""
    try:
        transport = open_transport(address)
    except LinkLostError as error:
        return str(error)
    link = Link(transport)
    try:
        if not transport.connects:
            link.send(Kind.RESET, RESET.pack(0, 0.1) + b"{}")
            return "" if link.receive(_LOOK) else "it does not answer a reset"
    except LinkLostError as error:
        return str(error)
    finally:
        transport.close()  # without a word: at an END the program would end
    return ""


_POOL: dict[tuple[int, str, str], list[Link]] = {}
"""Links that no episode uses, by process, address and program."""


class LinkHolder:
    """What asks over a link, which the next episode of its process may have afterwards.

    Args:
        address: Of the other end.
        clock_tolerance: See :class:`Link`.
        program: See :func:`open_link`.
    """

    def __init__(self, address: str, clock_tolerance: float, program: str = "") -> None:
        self._address, self._clock_tolerance, self._program = address, clock_tolerance, program
        self._link: Link | None = None

    def take(self) -> None:
        """Take a link that no episode uses, or open one."""
        self.give_back()
        key = os.getpid(), self._address, self._program
        self._link = _free_link(key) or open_link(
            self._address, program=self._program, clock_tolerance=self._clock_tolerance
        )
        self._returning = finalize(self, _give_back, self._link, key)

    def give_back(self) -> None:
        """Let go of the link; a second call does nothing."""
        if self._link is not None:
            self._link = None
            self._returning()

    @property
    def faults(self) -> Faults:
        """What was wrong on the wire since the last answer."""
        return Faults() if self._link is None else self._link.faults

    def ask(
        self, kind: Kind, payload: bytes, expected: Kind, seconds: float, *, stamp: float = 0.0
    ) -> bytes:
        """Return the payload of the answer, see :meth:`Link.ask`; a wire that is cut is closed."""
        if self._link is None:
            raise LinkLostError("the link was cut before, or has not been reset")
        try:
            return self._link.ask(kind, payload, expected, seconds, stamp=stamp).payload
        except (LinkLostError, LinkError) as error:
            server, is_lost = self._link.server, isinstance(error, LinkLostError)
            ending = "" if server is None else server.ending(_LOOK if is_lost else 0.0)
            if is_lost or ending:
                self._returning.detach()
                self._link.close()
                self._link = None
            if not ending:
                raise
            raise LinkLostError(f"{error}; {ending}") from error


def _free_link(key: tuple[int, str, str]) -> Link | None:
    """Take a link that no episode uses; those whose other end has gone meanwhile are closed."""
    links = _POOL.get(key, [])
    while links:
        link = links.pop()
        if link.is_alive():
            return link
        link.close()
    return None


def _give_back(link: Link, key: tuple[int, str, str]) -> None:
    if key[0] == os.getpid():  # and not in one that was forked of it
        _POOL.setdefault(key, []).append(link)


@atexit.register
def close_links() -> None:
    """Close the links of this process that no episode uses."""
    for (process, *_), links in list(_POOL.items()):
        while links and process == os.getpid():
            links.pop().close()
