"""The source files that a component is made of, and one digest of them all."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.provenance.places import is_installed, told_path

LISTED = 50
"""Files that are listed by name; with more of them, the defining one is."""
MOST = 1000
"""Files that are read; with more of them, the defining one is."""
_NO_SOURCES = {"__pycache__", "node_modules", "site-packages"}


@dataclass(frozen=True)
class Sources:
    """What a component is made of.

    Args:
        digest: Of all files, see :func:`digest_of`.
        named: SHA-256 of each file by its name, relative to the folder of the package.
        files: ``{path, sha256}`` of each, or of the defining one where they are many.
        read: The same files on this machine.
    """

    digest: str
    named: dict[str, str]
    files: list[dict[str, str]]
    read: tuple[Path, ...]


def sources_of(file: Path, module: str, root: Path, *, most: int = MOST) -> Sources | None:
    """All Python files of the top-level package that defines something; ``None`` without a file.

    A component changes as well with a function in the next file. What it imports from other
    packages is not part of it, nor are data files.

    Args:
        file: The file that defines it.
        module: The dotted name of that file's module.
        root: The project's root, to which names are relative.
        most: Of how many files at most; see :data:`MOST`.
    """
    package = top_package(file, module)
    found = sorted(python_files(package, most)) if package is not None else []
    base = file.parent
    if package is None or not 0 < len(found) <= most or file not in found:
        found = [file]
    elif len(found) > 1:
        base = package.parent
    else:
        base = package
    told, named = [], {}
    try:
        for one in found:
            sha256 = hashlib.sha256(one.read_bytes()).hexdigest()
            # Names within the package: it is the same component wherever it is installed.
            named[one.relative_to(base).as_posix()] = sha256
            told.append((one, sha256))
    except OSError:  # gone, or not for us to read
        return None
    listed = told if len(told) <= LISTED and not is_installed(file) else []
    listed = listed or [one for one in told if one[0] == file]
    return Sources(
        digest=digest_of(named),
        named=named,
        files=[{"path": told_path(one, root), "sha256": sha256} for one, sha256 in listed],
        read=tuple(one for one, _ in listed),
    )


def digest_of(named: Mapping[str, str]) -> str:
    """SHA-256 of the names and the SHA-256 of files, in order of their names."""
    state = hashlib.sha256()
    for name in sorted(named):
        state.update(f"{name}\0{named[name]}\n".encode("utf-8", "surrogatepass"))
    return state.hexdigest()


def top_package(file: Path, module: str) -> Path | None:
    """The folder of the top-level package, if the file lies where its module's name says."""
    parts = module.split(".")
    if file.name != "__init__.py":
        parts = parts[:-1]
    if not parts or len(file.parents) < len(parts):
        return None
    package = file.parents[len(parts) - 1]
    return package if package.name == parts[0] else None


def python_files(package: Path, most: int) -> Iterator[Path]:
    """The files below a package, one more than ``most`` at most."""
    found = 0
    for folder, inner, names in os.walk(package):
        inner[:] = [one for one in inner if not one.startswith(".") and one not in _NO_SOURCES]
        for name in names:
            if name.endswith(".py"):
                yield Path(folder, name)
                found += 1
                if found > most:
                    return
