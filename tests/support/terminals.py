"""A terminal of a few lines: what stands on it after a text of pytest's."""

from __future__ import annotations

import re

_PIECE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b|.", re.DOTALL)


class Terminal:
    """Takes what a process writes, as a VT100 does, and keeps what scrolls off its top.

    Args:
        columns: Its width.
        rows: Its height.
    """

    def __init__(self, columns=80, rows=24):
        self.columns, self.rows = columns, rows
        self.history = []
        self.cells = [[" "] * columns for _ in range(rows)]
        self.y = self.x = 0

    def feed(self, text):
        for piece in _PIECE.findall(text):
            self._take(piece)

    @property
    def everything(self):
        """All lines, those that scrolled off among them."""
        rows = ["".join(row).rstrip() for row in (*self.history, *self.cells)]
        return "\n".join(rows).rstrip().split("\n")

    def _take(self, piece):
        if piece in ("\r", "\n"):  # as the terminal driver sends it on
            self.x = 0
        if piece == "\n":
            self._down()
        elif piece == "\b":
            self.x = max(0, self.x - 1)
        elif piece.isprintable():
            self._put(piece)
        else:
            colour = piece.startswith("\x1b[") and piece.endswith("m")
            assert colour or piece == "\r", f"this terminal does not know {piece!r}"

    def _put(self, character):
        if self.x == self.columns:
            self.x = 0
            self._down()
        self.cells[self.y][self.x] = character
        self.x += 1

    def _down(self):
        if self.y < self.rows - 1:
            self.y += 1
            return
        self.history.append(self.cells.pop(0))
        self.cells.append([" "] * self.columns)
