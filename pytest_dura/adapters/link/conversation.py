"""Link: questions and answers over a wire, and what is wrong with them, in words."""

from __future__ import annotations

import atexit
import os
import tempfile
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from time import monotonic
from weakref import finalize

from pytest_dura.adapters.link.frames import Decoder, Frame, Kind
from pytest_dura.adapters.link.transports import (
    LinkLostError,
    Transport,
    open_transport,
    transport_class,
)
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import LockedFile, LockHeldError

_MICROSECONDS = 1e6
_NUMBERS = 2**32


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
    """

    transport: Transport
    clock_tolerance: float = 0.1
    lock: LockedFile | None = None
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
            frame = self.receive(asked_at + seconds - monotonic())
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
        if self.lock is not None:
            self.lock.release()

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


def open_link(address: str, *, clock_tolerance: float = 0.1) -> Link:
    """Open a link to a peer, of which one session at a time may have one that cannot be shared.

    Raises:
        ConfigurationError: For a wrong address, and for a device that another process uses.
        LinkLostError: If nothing is there.
    """
    lock = None
    if not transport_class(address).shared:
        name = f"dura-link-{sha256(address.encode()).hexdigest()[:16]}.lock"
        try:
            lock = LockedFile.acquire(Path(tempfile.gettempdir()) / name)
        except LockHeldError:
            raise ConfigurationError(
                "another process uses this device",
                key="transport",
                found=address,
                remedy="wait for the other session, or run this one without -n",
            ) from None
    try:
        return Link(open_transport(address), clock_tolerance, lock)
    except BaseException:  # ctrl-C too must not leave the device locked; it is raised again
        if lock is not None:
            lock.release()
        raise


_POOL: dict[tuple[int, str], list[Link]] = {}
"""Links that no episode uses, by process and address."""


class LinkHolder:
    """What asks over a link, which the next episode of its process may have afterwards.

    Args:
        address: Of the other end.
        clock_tolerance: See :class:`Link`.
    """

    def __init__(self, address: str, clock_tolerance: float) -> None:
        self._address, self._clock_tolerance = address, clock_tolerance
        self._link: Link | None = None

    def take(self) -> None:
        """Take a link that no episode uses, or open one."""
        self.give_back()
        free = _POOL.get((os.getpid(), self._address))
        opened = free or [open_link(self._address, clock_tolerance=self._clock_tolerance)]
        self._link = opened.pop()
        self._returning = finalize(self, _give_back, self._link, self._address, os.getpid())

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
        except LinkLostError:
            self._returning.detach()
            self._link.close()
            self._link = None
            raise


def _give_back(link: Link, address: str, process: int) -> None:
    if process == os.getpid():  # and not in one that was forked of it
        _POOL.setdefault((process, address), []).append(link)


@atexit.register
def close_links() -> None:
    """Close the links of this process that no episode uses."""
    for (process, _), links in list(_POOL.items()):
        while links and process == os.getpid():
            links.pop().close()
