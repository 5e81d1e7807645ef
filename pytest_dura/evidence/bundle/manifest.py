"""The manifest of a bundle: the SHA-256 of each of its files, and of the list itself."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

MANIFEST = "manifest.json"
_CHUNK = 1 << 20


def file_entry(file: Path) -> dict[str, Any]:
    """SHA-256 and size of a file."""
    state, size = hashlib.sha256(), 0
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            state.update(chunk)
            size += len(chunk)
    return {"sha256": state.hexdigest(), "bytes": size}


def manifest_text(files: Mapping[str, Mapping[str, Any]]) -> str:
    """The manifest of these files: one text for one bundle, so that no byte of it is free."""
    listed = {name: dict(files[name]) for name in sorted(files)}
    return json.dumps({"files": listed, "digest": _digest(listed)}, indent=1) + "\n"


def manifest_problems(directory: Path, unlisted: Collection[str] = ()) -> Iterator[str]:
    """Everything in which a bundle's files differ from its manifest.

    Args:
        directory: The bundle's.
        unlisted: Names of files that are there for another purpose, and may be.
    """
    try:
        text = (directory / MANIFEST).read_bytes().decode()
        listed = json.loads(text)["files"]
        canonical = manifest_text(listed)
    except FileNotFoundError:
        yield f"{MANIFEST}: missing; the session did not finish writing its evidence"
        return
    except (OSError, UnicodeError, ValueError, LookupError, TypeError, AttributeError) as error:
        yield f"{MANIFEST}: damaged ({type(error).__name__})"
        return
    if text != canonical:
        yield f"{MANIFEST}: not as it was written; its own digest or form does not agree"
    there = set(files_of(directory)) - {MANIFEST}
    for name in sorted(there.difference(listed, unlisted)):
        yield f"{name}: not in the manifest"
    for name in sorted(set(listed) - there):
        yield f"{name}: in the manifest, but not in the bundle"
    for name in sorted(there & set(listed)):
        if (directory / name).is_symlink():
            yield f"{name}: a link, where a bundle holds files only"
        elif file_entry(directory / name) != listed[name]:
            yield f"{name}: changed since it was written (its SHA-256 differs)"


def listed_files(directory: Path) -> list[str]:
    """The names that a bundle's manifest lists; none where it is missing or damaged."""
    try:
        return list(json.loads((directory / MANIFEST).read_bytes())["files"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


def files_of(directory: Path) -> list[str]:
    """All files below a directory, by their path in it, sorted; links are not followed."""
    return sorted(
        path.relative_to(directory).as_posix()
        for path in directory.rglob("*")
        if path.is_symlink() or not path.is_dir()
    )


def _digest(listed: Mapping[str, Any]) -> str:
    canonical = json.dumps(listed, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()
