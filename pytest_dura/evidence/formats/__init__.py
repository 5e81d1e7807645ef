"""One module per output format: each renders the record, and reads its own counts back."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Protocol, cast

from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord

NAMES = ("summary", "report", "gsn.yaml_file", "gsn.svg_file", "cyclonedx", "intoto")
"""The modules of this package that are formats, in the order in which they are written."""


class Format(Protocol):
    """What a module of a format offers."""

    FILE: str

    def render(self, record: SessionRecord) -> str:
        """The file's text: the same record gives the same text."""
        ...

    def read_counts(self, text: str) -> Counts:
        """What such a text states, read without the help of ``render``.

        Raises:
            ValueError: If the text is not what this format writes.
        """
        ...


def all_formats() -> Iterator[Format]:
    """Every format, imported when it is asked for."""
    for name in NAMES:
        yield cast("Format", import_module(f"{__name__}.{name}"))
