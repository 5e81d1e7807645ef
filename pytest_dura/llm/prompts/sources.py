"""The files of a wording: a domain's own, and a user's in their place."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError

SUFFIX = ".j2"
FEW_SHOT = "few_shot.yaml"
LONGEST = 65_536
"""Bytes of a file."""


@dataclass(frozen=True)
class Sources:
    """Texts and places of the files in use, by name such as ``system.j2``, sorted by it."""

    texts: Mapping[str, str]
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 over all names and texts, wherever they stand."""
        return hashlib.sha256(json.dumps(sorted(self.texts.items())).encode()).hexdigest()

    @property
    def wordings(self) -> tuple[str, ...]:
        """Names of the other wordings: the folders."""
        folders = (name.partition("/")[0] for name in self.texts if "/" in name)
        return tuple(dict.fromkeys(folders))

    @classmethod
    def read(cls, own: Path, directory: Path | None = None) -> Sources:
        """A domain's files, and those of a user's directory instead of them.

        Args:
            own: The domain's directory.
            directory: Of the user; each file in it replaces the domain's file of its name.

        Raises:
            ConfigurationError: For a directory that is none, a file that replaces nothing, and one
                that cannot be read.
        """
        paths = {_name(own, path): path for path in _files(own)}
        if directory is not None:
            if not directory.is_dir():
                raise ConfigurationError(
                    "there is no such directory of templates",
                    file=str(directory),
                    expected="a directory with files such as " + ", ".join(sorted(paths)),
                    remedy="create it, or leave it out for the built-in templates",
                )
            replaced = {_name(directory, path): path for path in _files(directory)}
            for name, path in replaced.items():
                _check_known(name, path, paths)
            paths |= replaced
        names = sorted(paths)
        return cls(
            {name: _text(paths[name]) for name in names}, {name: str(paths[name]) for name in names}
        )


def _files(directory: Path) -> list[Path]:
    """All files in it but hidden ones."""
    return [
        path
        for path in sorted(directory.rglob("*"))
        if path.is_file() and not any(part[0] in "._" for part in path.relative_to(directory).parts)
    ]


def _name(directory: Path, path: Path) -> str:
    return path.relative_to(directory).as_posix()


def _check_known(name: str, path: Path, known: Mapping[str, Path]) -> None:
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        raise ConfigurationError(
            f"there is no template {name!r} to replace",
            file=str(path),
            found=name,
            expected="one of " + ", ".join(sorted(known)),
            remedy=f"did you mean {near[0]!r}?" if near else "rename or remove it",
        )


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
        text = data.decode("utf-8").replace("\r\n", "\n")
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"the template cannot be read: {error}",
            file=str(path),
            expected="a readable file in UTF-8",
            remedy="correct it, or remove it for the built-in one",
        ) from None
    if len(data) > LONGEST:
        raise ConfigurationError(
            f"the template has {len(data)} bytes",
            file=str(path),
            expected=f"at most {LONGEST} bytes",
            remedy="shorten it, or remove it for the built-in one",
        )
    return text
