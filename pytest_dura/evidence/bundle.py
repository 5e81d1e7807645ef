"""Writing and reading the evidence directory. A reader never sees half a file."""

from __future__ import annotations

import hashlib
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
    return load_record(directory / RECORD)[0]


def load_record(file: Path, key: str = "--dura-evidence") -> tuple[dict[str, Any], str]:
    """The record in a file, and the SHA-256 of that file.

    Args:
        file: The file.
        key: The option that named it.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    try:
        data = file.read_bytes()
        found = json.loads(data)
        version = found["schema_version"]
    except FileNotFoundError:
        raise _unreadable("there is no evidence here", file, key) from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        problem = f"this is no evidence record ({type(error).__name__})"
        raise _unreadable(problem, file, key) from None
    if version != SCHEMA_VERSION:
        raise ConfigurationError(
            "this evidence was written by another version of pytest-dura",
            file=str(file),
            key="schema_version",
            found=version,
            expected=SCHEMA_VERSION,
            remedy="use the version that the record names under `tool`",
        )
    return found, hashlib.sha256(data).hexdigest()


def _unreadable(problem: str, file: Path, key: str) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        key=key,
        expected=f"the {RECORD} of a session",
        remedy=f"run `pytest --dura-scenarios` first, or name its directory with {key}",
    )


def _replace(file: Path, text: str) -> Path:
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}-")
    try:
        # A name of a file need not be text; what UTF-8 cannot hold, JSON can, as \\udcff.
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as stream:
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
