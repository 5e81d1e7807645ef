"""A controller of the tank that goes wrong at one percept: rogue_peer.py MODE PERCEPT."""

from __future__ import annotations

import os
import struct
import sys
from time import monotonic, sleep

from pytest_dura.adapters.link.conversation import Link
from pytest_dura.adapters.link.frames import Frame, Kind
from pytest_dura.adapters.link.serve import serve
from pytest_dura.adapters.link.transports.pipe import Pipe

LATE, AHEAD = 4.0, 5.0
"""Seconds."""


class Rogue:
    """Answers percepts, and goes wrong before or instead of the answer to one."""

    def __init__(self, mode, at):
        self.mode, self.at, self.percepts = mode, at, -1
        self.pipe = Pipe("", peer=True)
        self.link = Link(self.pipe)

    def answer(self, frame):
        if frame.kind is Kind.RESET:
            self.percepts = -1
            return Kind.RESET, b""
        self.percepts += 1
        (level,) = struct.unpack_from("<d", frame.payload)
        inflow = struct.pack("<d", min(max(2.0 * (2.0 - level), 0.0), 1.0))
        if self.percepts == self.at:
            getattr(self, self.mode, lambda *_: None)(frame, inflow)
        return Kind.COMMAND, inflow

    def clock(self):
        ahead = AHEAD if self.mode == "drift" and self.percepts >= self.at else 0.0
        return monotonic() + ahead

    def pulled(self, *_):
        os._exit(3)

    def raises(self, *_):
        raise RuntimeError("the motor driver reports overcurrent")

    def late(self, *_):
        sleep(LATE)

    def reset(self, *_):
        self.link._sent = 0

    def lost(self, *_):
        self.link._sent += 2

    def garbage(self, *_):
        self.pipe.send(b"\x00\xd5noise")

    def damaged(self, frame, payload):
        data = bytearray(Frame(Kind.COMMAND, 99, frame.number, 0, payload).encode())
        data[26] ^= 4
        self.pipe.send(bytes(data))

    def old(self, frame, payload):
        self.link.send(Kind.COMMAND, payload, answers=frame.number - 1)

    def doubled(self, frame, payload):
        before = Frame(Kind.COMMAND, self.link._sent, frame.number - 1, 0, payload)
        self.pipe.send(before.encode())


if __name__ == "__main__":
    rogue = Rogue(sys.argv[1], int(sys.argv[2]))
    serve(rogue.link, rogue.answer, 60.0, rogue.clock)
