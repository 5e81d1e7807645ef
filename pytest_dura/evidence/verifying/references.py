"""Whether every format states the record's counts, and whether its references lead somewhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module

from pytest_dura.evidence.formats import Format, all_formats
from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord


def format_problems(record: SessionRecord, counts: Counts) -> Iterator[str]:
    """Everything in which the formats differ from the record."""
    for one in all_formats():
        for problem in _told(one, record, counts):
            yield f"{one.FILE}: {problem}"


def other_version(record: SessionRecord) -> str | None:
    """The version that wrote the record, where it is not this one, which renders other texts."""
    # The package's own name is loaded in any case; importing it here would reach for all of it.
    version = str(record["tool"]["version"])
    return None if version == import_module("pytest_dura").__version__ else version


def _told(one: Format, record: SessionRecord, counts: Counts) -> Iterator[str]:
    try:
        yield from _format(one, record, counts)
    except Exception as error:  # a damaged record may break what renders it anywhere
        yield f"cannot be read back ({type(error).__name__}: {error})"


def _format(one: Format, record: SessionRecord, counts: Counts) -> Iterator[str]:
    text = (record.directory / one.FILE).read_bytes().decode()
    told, held = one.read_counts(text).to_json(), counts.to_json()
    for name in held:
        if told[name] != held[name]:
            yield f"states {name} = {told[name]}, and the record holds {held[name]}"
    if other_version(record) is None and text != _written(one.render(record)):
        yield "not as it is rendered from the record"
    broken = getattr(one, "broken_references", None)
    if broken is not None:
        yield from broken(text, record)
    for fragment in re.findall(r"report\.html#([\w.:~+%/-]+)", text):
        if f'id="{fragment}"' not in _report(record):
            yield f"refers to report.html#{fragment}, which is not there"


def _written(text: str) -> str:
    """A text as it is read back from its file."""
    return text.encode(errors="backslashreplace").decode()


def _report(record: SessionRecord) -> str:
    return (record.directory / "report.html").read_text(encoding="utf-8")
