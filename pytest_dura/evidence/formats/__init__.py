"""One module per output format: each renders the record, and reads its own counts back."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Protocol, cast

from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord

FORMATS = (
    "pytest_dura.evidence.formats.summary",
    "pytest_dura.evidence.formats.report",
    "pytest_dura.evidence.formats.gsn.yaml_file",
    "pytest_dura.evidence.formats.gsn.svg_file",
    "pytest_dura.evidence.formats.cyclonedx",
    "pytest_dura.evidence.formats.intoto",
)
"""The modules of the formats, in the order in which they are written."""


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
    for name in FORMATS:
        yield cast("Format", import_module(name))
