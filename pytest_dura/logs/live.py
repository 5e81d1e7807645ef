"""What is recorded right now: lines of a table or of JSON from standard input, as they come."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.logs.formats import csv
from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import (
    RECEIPT,
    Columns,
    damaged,
    described,
    number_of,
    value_at,
)

NAME = Path("standard input")
_MOST = 1 << 20
"""Bytes that are taken at a time, at most."""


class LiveLines:
    """Lines of a file descriptor: a table with a header, or one JSON object in each line.

    Args:
        descriptor: To read from; lines are taken as soon as they are there.
        column: Name of the stamps, if it is none of the usual ones.
    """

    def __init__(self, descriptor: int, column: str = "") -> None:
        self._descriptor, self._rest = descriptor, b""
        self._read = 2  # number of the next line of a table
        self._column = column
        self._lines = self._chunks()
        self._waiting: list[str] = []
        self._header = self._next()
        self.is_json = self._header.lstrip().startswith("{")
        if self.is_json:
            self._waiting.insert(0, self._header)
            self.topic = described("", "json", self._object(self._header))
        else:
            line = self._next()
            self._waiting.insert(0, line)
            self.topic = csv.topic_of(NAME, self._header, line)

    def blocks(self, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
        """Yield the columns of the lines that are there, and of those that come.

        Raises:
            ConfigurationError: For a line that cannot be read.
        """
        while True:
            lines, self._waiting = self._waiting, []
            if lines and self.is_json:
                yield {"": self._columns([self._object(line) for line in lines], wanted)}
            elif lines:
                yield from csv.columns_of(NAME, self._header, lines, self._read, wanted)
                self._read += len(lines)
            if not self._more():
                return

    def _columns(self, objects: list[Any], wanted: Mapping[str, Collection[str]]) -> Columns:
        def column(name: str) -> list[float]:
            values = [value_at(each, tuple(name.split("."))) for each in objects]
            found = [number_of(value) for value in values]
            for value, given in zip(found, values, strict=True):
                if value is None:
                    raise damaged(NAME, f"the field {name!r} holds a {type(given).__name__}")
            return [float("nan") if value is None else value for value in found]

        own = self._column or next(
            (name for name in self.topic.fields if name.lower() in TIME_NAMES), ""
        )
        stamps = {self._column or RECEIPT: _exact(objects, own)} if own else {}
        fields = [name for each in wanted.values() for name in each]
        return Columns(stamps, {name: np.array(column(name)) for name in fields})

    def _object(self, line: str) -> Any:
        try:
            found = json.loads(line)
        except ValueError as error:
            raise damaged(NAME, f"a line is not JSON: {error}") from None
        if not isinstance(found, dict):
            raise damaged(NAME, f"a line of JSON holds a {type(found).__name__}")
        return found

    def _next(self) -> str:
        while not self._waiting and self._more():
            pass
        return self._waiting.pop(0) if self._waiting else ""

    def _more(self) -> bool:
        """Take what is there, or wait for it; false at the end."""
        lines = next(self._lines, None)
        self._waiting += lines or []
        return lines is not None

    def _chunks(self) -> Iterator[list[str]]:
        while chunk := os.read(self._descriptor, _MOST):
            *whole, self._rest = (self._rest + chunk).split(b"\n")
            yield [line.decode("utf-8", "replace") for line in whole if line.strip()]
        if self._rest.strip():
            yield [self._rest.decode("utf-8", "replace")]


def _exact(objects: list[Any], name: str) -> Any:
    """Stamps, whole numbers as such."""
    values = [value_at(each, tuple(name.split("."))) for each in objects]
    if any(isinstance(value, bool) or not isinstance(value, (int, float)) for value in values):
        raise damaged(NAME, f"a line has no number {name!r}")
    whole = all(isinstance(value, int) and abs(value) < 2**63 for value in values)
    return np.array(values, np.int64 if whole else np.float64)
