"""The directory that merged evidence goes into: one of its own, so that nothing else is touched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.bundle.files import write_file
from pytest_dura.evidence.bundle.lock import LOCK
from pytest_dura.evidence.merging.parts import Part
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.traces.names import is_trace_path

_CHUNK = 1 << 20


def check_output(output: Path, inputs: Sequence[Path]) -> None:
    """Refuse a directory that holds something, or that belongs to what is merged.

    Raises:
        ConfigurationError: If the merged evidence cannot go there.
    """
    place = output.resolve()
    for one in inputs:
        bundle = one.resolve()
        if place == bundle or place.is_relative_to(bundle) or bundle.is_relative_to(place):
            raise _refused(
                "the merged evidence would go into what is merged, or around it", output, str(one)
            )
    if output.is_symlink():
        raise _refused("the merged evidence would go where a symbolic link leads", output)
    if output.exists() and not output.is_dir():
        raise _refused("the merged evidence goes into a directory, and this is a file", output)
    if output.is_dir() and (held := {one.name for one in output.iterdir()} - {LOCK}):
        raise _refused("this directory is not empty", output, min(held))


def _refused(problem: str, output: Path, found: str | None = None) -> ConfigurationError:
    return ConfigurationError(
        problem,
        key="--output",
        found=str(output) if found is None else f"{output}, with {found}",
        expected="a directory that is empty, or that is not there yet",
        remedy="name another directory, or remove this one",
    )


def copy_traces(record: SessionRecord, parts: Sequence[Part]) -> None:
    """Copy the traces of a merged record out of its parts, each held against its digest.

    Raises:
        ConfigurationError: If one is not there as its record says, or it cannot be written.
    """
    places: dict[tuple[str, str], Path] = {
        (episode["trace"]["file"], episode["trace"]["sha256"]): part.record.directory
        for part in parts
        for episode in part.record.episodes()
        if episode["trace"] is not None
    }
    for episode in record.episodes():
        if episode["trace"] is not None:
            told = episode["trace"]
            _copy(places[told["file"], told["sha256"]], record.directory, told)


def _copy(source: Path, target: Path, told: Mapping[str, Any]) -> None:
    name = told["file"]
    file = source / name
    # Verified already, and yet nothing is opened by a name that could lead anywhere else.
    if not is_trace_path(name) or file.is_symlink() or file.parent.is_symlink():
        raise _damaged(file, "a name or a link that leads out of the bundle")
    try:
        written = write_file(target / name, _chunks(file))
    except OSError as error:
        raise _damaged(file, error.strerror or str(error)) from None
    if (written.sha256, written.bytes) != (told["sha256"], told["bytes"]):
        raise _damaged(file, "another file than the record names")


def _chunks(file: Path) -> Iterator[bytes]:
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            yield chunk


def _damaged(file: Path, found: str) -> ConfigurationError:
    return ConfigurationError(
        "a trace changed while it was copied",
        file=str(file),
        key="BUNDLE",
        found=found,
        expected="the file that the record names, with its SHA-256",
        remedy="let nothing write to the bundles, and merge again",
    )
