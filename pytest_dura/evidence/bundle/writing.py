"""Writing a bundle: the record, every format that is rendered from it, and the manifest, last."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.evidence.bundle.directory import RECORD, RENDERED, clear_traces, write_record
from pytest_dura.evidence.bundle.files import write_file
from pytest_dura.evidence.bundle.manifest import MANIFEST, file_entry, manifest_text
from pytest_dura.evidence.bundle.schema import SCHEMA_FILE, schema_text
from pytest_dura.evidence.formats import Format, all_formats
from pytest_dura.evidence.record.session_record import SessionRecord


def write_bundle(record: SessionRecord) -> SessionRecord:
    """Write everything and return the record as it was written.

    A format that cannot be rendered does not cost the others: the record then says which one is
    not there and its gate has failed, and so say all other formats.

    Raises:
        ConfigurationError: If the directory cannot be written. What is left of the bundle then
            says that it is incomplete.
    """
    before = _identity(record.directory / RECORD)
    try:
        return _written(record)
    except BaseException as error:  # also on ctrl-C; it is raised again
        _withdraw(record, error, before)
        raise


def _written(record: SessionRecord) -> SessionRecord:
    traces = {
        one["trace"]["file"]: {"sha256": one["trace"]["sha256"], "bytes": one["trace"]["bytes"]}
        for one in record.episodes()
        if one["trace"] is not None
    }
    clear_traces(record.directory, traces)
    broken = {
        file: "it is not there as it was written"
        for file, told in traces.items()
        if _size(record.directory / file) != told["bytes"]
    }
    while True:
        found = _with_problems(record, broken)
        write_record(found.directory, found)
        before = len(broken)
        for one in all_formats():
            if one.FILE not in broken:
                _write_format(one, found, broken)
        if len(broken) == before:
            break
    write_file(found.directory / SCHEMA_FILE, [schema_text()])
    names = [RECORD, SCHEMA_FILE, *(one.FILE for one in all_formats() if one.FILE not in broken)]
    # A trace is listed with the digest that its writer took, not with one of what lies there now.
    files = {name: file_entry(found.directory / name) for name in names} | traces
    write_file(found.directory / MANIFEST, [manifest_text(files)])
    return found


def _withdraw(record: SessionRecord, error: BaseException, before: object) -> None:
    """Leave no half bundle that reads as a pass: room first, then a record that says so."""
    for name in RENDERED:
        with suppress(OSError):
            (record.directory / name).unlink(missing_ok=True)
    file = record.directory / RECORD
    if _identity(file) == before:
        return  # it says that the session is running
    why = f"infrastructure: the evidence could not be written as a whole: {describe_error(error)}"
    gate = {
        **record["gate"],
        "result": "incomplete",
        "exit_code": record["gate"]["exit_code"] or 1,
        "reasons": [*record["gate"]["reasons"], why],
    }
    told = {"status": "interrupted", "gate": gate}
    told["totals"] = {**record["totals"], "gate": gate["result"]}
    try:
        write_record(record.directory, replace(record, head={**record.head, **told}))
    except ConfigurationError:  # there is not even room for that
        with suppress(OSError):
            file.unlink(missing_ok=True)


def _size(file: Path) -> int | None:
    """Of a file as it lies there; ``None`` for none."""
    try:
        return file.lstat().st_size
    except OSError:
        return None


def _identity(file: Path) -> tuple[int, int] | None:
    """Which file it is that has this name."""
    try:
        found = file.lstat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _write_format(one: Format, record: SessionRecord, broken: dict[str, str]) -> None:
    try:
        text = one.render(record)
    except Exception as error:  # told in the record, and the gate fails
        broken[one.FILE] = _why(error)
        (record.directory / one.FILE).unlink(missing_ok=True)
        return
    write_file(record.directory / one.FILE, [text])


def _why(error: Exception) -> str:
    """On one line; what the user can mend tells of the user's file and not of ours."""
    if isinstance(error, ConfigurationError):
        return "; ".join(" ".join(line.split()) for line in str(error).splitlines())
    return describe_error(error)


def _with_problems(record: SessionRecord, broken: Mapping[str, str]) -> SessionRecord:
    """The record of a session whose evidence is not whole."""
    if not broken:
        return record
    gate: dict[str, Any] = dict(record["gate"])
    reasons = [f"infrastructure: {file} could not be made: {why}" for file, why in broken.items()]
    gate["reasons"] = [*gate["reasons"], *reasons]
    if gate["result"] == "passed":
        gate["result"], gate["exit_code"] = "failed", 1
    totals = {**record["totals"], "gate": gate["result"]}
    return replace(record, head={**record.head, "gate": gate, "totals": totals})
