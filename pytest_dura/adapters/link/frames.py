"""Frames on a wire: what they hold, and how the next one is found after damage.

All numbers are little-endian::

    0   2  mark: 0xD5 0x5A
    2   1  kind, see Kind
    3   1  flags, bit 0: the sender failed, and the text says why
    4   4  number of the frame, from 1, by sender and connection
    8   4  number of the frame that it answers, 0 for none
    12  8  time of the sender in microseconds, from its last reset
    20  2  length of the payload
    22  2  CRC-16 of bytes 0 to 21: polynomial 0x1021, initial value 0xFFFF
    24  n  payload: numbers as the binding says, then a text
    24+n 4 CRC-32 of all bytes before, as in zlib

Without a check of its own, a damaged length would make the receiver wait for bytes that never come.
"""

from __future__ import annotations

import struct
from binascii import crc32, crc_hqx
from dataclasses import dataclass, field
from enum import IntEnum

MARK = b"\xd5\x5a"
HEAD = struct.Struct("<2sBBIIQH")
CHECK, CRC = struct.Struct("<H"), struct.Struct("<I")
START = HEAD.size + CHECK.size
"""Bytes before the payload."""
LONGEST = 32_768
"""Bytes of a payload: a receiver waits for no more before it looks for another frame."""
FAILED = 1
"""The flag of an answer that is none: its text says why."""


class Kind(IntEnum):
    """Kind of a frame.

    To a component go reset and percept, from it come reset and command; to a simulator go reset and
    command, from it come ticks. ``END`` ends a conversation.
    """

    RESET = 1
    PERCEPT = 2
    COMMAND = 3
    TICK = 4
    END = 5


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Args:
        kind: Its kind.
        number: Its number, from 1; the next frame of the sender has the next one.
        answers: Number of the frame that it answers; 0 for none.
        stamp: Time of the sender in microseconds, from its last reset.
        payload: Numbers, then a text.
        failed: Whether the sender has failed, and the payload is a text that says why.
    """

    kind: Kind
    number: int
    answers: int = 0
    stamp: int = 0
    payload: bytes = b""
    failed: bool = False

    def encode(self) -> bytes:
        """Return the bytes on the wire.

        Raises:
            ValueError: If the payload is longer than :data:`LONGEST`.
        """
        if len(self.payload) > LONGEST:
            raise ValueError(f"a payload of {len(self.payload)} bytes; {LONGEST} are allowed")
        head = HEAD.pack(
            MARK, self.kind, FAILED * self.failed, self.number, self.answers, self.stamp,
            len(self.payload),
        )  # fmt: skip
        whole = head + CHECK.pack(crc_hqx(head, 0xFFFF)) + self.payload
        return whole + CRC.pack(crc32(whole))


@dataclass
class Decoder:
    """Reader of a stream of bytes, which may be damaged anywhere.

    Each byte is part of one frame or counted: of a damaged frame the first byte alone is dropped,
    so that a frame that follows, or lies within, is found.
    """

    damaged: int = 0
    """Frames whose CRC does not hold."""
    garbage: int = 0
    """Bytes that were part of no frame."""
    _pending: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are whole with these bytes."""
        self._pending += data
        frames: list[Frame] = []
        while self._find_mark():
            frame, size = self._first()
            if frame is not None:
                frames.append(frame)
            if size == 0:
                break
            del self._pending[:size]
            self.garbage += size if frame is None else 0
        return frames

    def _find_mark(self) -> bool:
        """Drop what comes before the next mark; whether the whole head of a frame is there."""
        at = self._pending.find(MARK)
        if at < 0:
            at = len(self._pending) - self._pending.endswith(MARK[:1])
        del self._pending[:at]
        self.garbage += at
        return len(self._pending) >= START

    def _first(self) -> tuple[Frame | None, int]:
        """Frame at the beginning, and how many bytes to drop: 0 to wait for more."""
        whole = bytes(self._pending[:START])
        _, kind, flags, number, answers, stamp, length = HEAD.unpack_from(whole)
        (check,) = CHECK.unpack_from(whole, HEAD.size)
        if check != crc_hqx(whole[: HEAD.size], 0xFFFF) or length > LONGEST:
            return None, 1
        end = START + length
        if len(self._pending) < end + CRC.size:
            return None, 0
        body = bytes(self._pending[:end])
        (crc,) = CRC.unpack_from(self._pending, end)
        if crc != crc32(body) or kind not in Kind._value2member_map_ or flags not in (0, FAILED):
            self.damaged += 1
            return None, 1
        frame = Frame(Kind(kind), number, answers, stamp, body[START:], bool(flags))
        return frame, end + CRC.size
