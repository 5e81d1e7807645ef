"""Writing a bundle: the record, every format that is rendered from it, and the manifest, last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.bundle import RECORD, clear_traces, write_record
from pytest_dura.evidence.files import write_file
from pytest_dura.evidence.formats import Format, all_formats
from pytest_dura.evidence.manifest import MANIFEST, file_entry, manifest_text
from pytest_dura.evidence.schema import SCHEMA_FILE, schema_text
from pytest_dura.evidence.session_record import SessionRecord


def write_bundle(record: SessionRecord) -> SessionRecord:
    """Write everything and return the record as it was written.

    A format that cannot be rendered does not cost the others: the record then says which one is
    not there and its gate has failed, and so say all other formats.

    Raises:
        ConfigurationError: If the directory cannot be written.
    """
    traces = {
        one["trace"]["file"]: {"sha256": one["trace"]["sha256"], "bytes": one["trace"]["bytes"]}
        for one in record.episodes()
        if one["trace"] is not None
    }
    clear_traces(record.directory, traces)
    broken: dict[str, str] = {}
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


def _write_format(one: Format, record: SessionRecord, broken: dict[str, str]) -> None:
    try:
        text = one.render(record)
    except Exception as error:  # told in the record, and the gate fails
        broken[one.FILE] = describe_error(error)
        (record.directory / one.FILE).unlink(missing_ok=True)
        return
    write_file(record.directory / one.FILE, [text])


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
