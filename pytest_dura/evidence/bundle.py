"""Writing and reading the evidence directory. A reader never sees half a file."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record import SCHEMA_VERSION

RECORD = "evidence.json"


def write_record(directory: Path, record: Mapping[str, Any]) -> Path:
    """Write ``evidence.json`` atomically and return its path.

    Raises:
        ConfigurationError: If the directory cannot be made or written.
    """
    text = json.dumps(plain(record), indent=1, ensure_ascii=False, allow_nan=False)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        return _replace(directory / RECORD, text + "\n")
    except OSError as error:
        raise ConfigurationError(
            f"the evidence cannot be written: {error.strerror or error}",
            key="--dura-evidence",
            found=str(directory),
            expected="a directory that can be written",
            remedy="choose another directory",
        ) from None


def read_record(directory: Path) -> dict[str, Any]:
    """The record of an evidence directory.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    file = directory / RECORD
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        version = found["schema_version"]
    except FileNotFoundError:
        raise _unreadable("there is no evidence here", file) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _unreadable(f"this is no evidence record ({type(error).__name__})", file) from None
    if version != SCHEMA_VERSION:
        raise ConfigurationError(
            "this evidence was written by another version of pytest-dura",
            file=str(file),
            key="schema_version",
            found=version,
            expected=SCHEMA_VERSION,
            remedy="use the version that the record names under `tool`",
        )
    record: dict[str, Any] = found
    return record


def _unreadable(problem: str, file: Path) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        key="--dura-evidence",
        expected=f"a directory with the {RECORD} of a session",
        remedy="run `pytest --dura-scenarios` first, or name the directory with --dura-evidence",
    )


def _replace(file: Path, text: str) -> Path:
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}-")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files for the owner alone; the record is for whoever may read the folder.
        Path(name).chmod(0o644)
        Path(name).replace(file)
    except BaseException:  # also on ctrl-C no half-written file stays behind; it is raised again
        Path(name).unlink(missing_ok=True)
        raise
    return file
