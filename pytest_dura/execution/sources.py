"""Sources: the Python files and versions that all episodes of a session rest on.

With them the files that a single episode rests on beside those, and the modules that a process has
imported. Whether an episode of an earlier session counts is decided by what is equal here.
"""

from __future__ import annotations

import fnmatch
import hashlib
import inspect
import json
import os
import sys
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from pathlib import Path
from typing import Any

from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.execution.task import EpisodeTask
from pytest_dura.library.roles import LocalRole
from pytest_dura.provenance import (
    installed_in_place,
    installed_versions,
    is_installed,
    recorded_path,
    sources_of,
)
from pytest_dura.requirements.checks import is_function_path

MAX_FILES = 20_000
"""Python files that are read at most; reading them takes about a second."""
_MAX_ENTRIES = 200_000
"""Names of files and folders that are looked at, at most."""
_MAX_FILE_BYTES = 1 << 30
_SUFFIXES = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
_NO_SOURCES = ("__pycache__", "site-packages", "dist-packages")
_ANY_MODULE = "component.py"
_UNREADABLE = "not readable"
_DIGITS = 16
"""Hexadecimal digits that are kept of a SHA-256."""
_MOST_NAMED = 3
"""Differences that are named; of more, the others are counted."""
_LONGEST_VERSION = 60
_OURS = "pytest_dura"
_NAMED_DIFFERENTLY = ("conftest", "__main__", "__mp_main__")
"""Modules that are others in another process."""


@dataclass(frozen=True)
class SourceRules:
    """Rules for which files count.

    Args:
        root: The project's root directory.
        ignored: Patterns of folders that are not read, as pytest's ``norecursedirs``.
        tests: Patterns of test modules, as pytest's ``python_files``. An edited assertion makes no
            other episodes, so that they do not count, unless a part of an episode is defined there.
        outputs: Folders and files that sessions write.
    """

    root: Path
    ignored: Sequence[str] = ()
    tests: Sequence[str] = ()
    outputs: Sequence[Path] = ()

    def is_read(self, folder: str, name: str) -> bool:
        """Whether the files of a folder count."""
        return not (
            name in _NO_SOURCES
            or Path(folder) in self.outputs
            or any(_matches(folder, name, pattern) for pattern in self.ignored)
        )

    def is_test_module(self, file: str, name: str) -> bool:
        """Whether pytest collects tests from a file.

        A pattern that any module matches tells no test modules from components.
        """
        return name != "conftest.py" and any(
            _matches(file, name, pattern)
            and not fnmatch.fnmatch(_ANY_MODULE, pattern.replace(os.sep, "/").rpartition("/")[2])
            for pattern in self.tests
        )


def _matches(path: str, name: str, pattern: str) -> bool:
    """Compare as pytest does: a pattern without a separator is one of names."""
    if "/" not in pattern and os.sep not in pattern:
        return fnmatch.fnmatch(name, pattern)
    return fnmatch.fnmatch(path, pattern if os.path.isabs(pattern) else f"*{os.sep}{pattern}")  # noqa: PTH117 - a pattern is not a path


class TooManyFilesError(Exception):
    """Error for a root directory with more files than are read."""


@dataclass(frozen=True)
class Sources:
    """Python files of a project, and versions of what is installed.

    Args:
        files: The beginning of the SHA-256 of each file, by its name below the root directory; of
            a project that is installed in place, behind the name of its distribution.
        versions: Version of each installed package, of Python, and of pytest-dura by its code.
    """

    files: Mapping[str, str]
    versions: Mapping[str, str]

    @classmethod
    def of(cls, rules: SourceRules, machine: Mapping[str, str]) -> Sources:
        """Read the files as they are now.

        Args:
            rules: Which files count.
            machine: What describes the machine and our own code.

        Raises:
            TooManyFilesError: If there are more than :data:`MAX_FILES`.
        """
        files = dict(_read_files(rules, rules.root))
        for name, folder in installed_in_place():
            if not folder.is_relative_to(rules.root):
                files |= {f"{name}/{file}": sha for file, sha in _read_files(rules, folder)}
        return cls(files, {**machine, **installed_versions()})

    @cached_property
    def digest(self) -> str:
        """SHA-256 over all files and versions."""
        state = hashlib.sha256()
        for each in (self.files, self.versions):
            for name in sorted(each):
                state.update(f"{name}\0{each[name]}\n".encode("utf-8", "surrogatepass"))
            state.update(b"\0")
        return state.hexdigest()

    def changed_since(self, earlier: Sources) -> tuple[str, ...]:
        """Name what differs from earlier ones: a few files and packages, and how many others."""
        versions = []
        for name in differences(self.versions, earlier.versions):
            then, now = (each.versions.get(name) or "none" for each in (earlier, self))
            # A digest says nothing to a reader.
            is_short = max(len(then), len(now)) <= _LONGEST_VERSION
            versions.append(f"{name} ({then} before, {now} now)" if is_short else name)
        return shortened([*differences(self.files, earlier.files), *versions])

    def to_bytes(self) -> bytes:
        """Return them as JSON, for a later session."""
        data = {"digest": self.digest, "files": self.files, "versions": self.versions}
        return json.dumps(data).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Sources | None:
        """Invert :meth:`to_bytes`; ``None`` if the data is damaged."""
        try:
            given = json.loads(data)
            sources = cls(dict(given["files"]), dict(given["versions"]))
            whole = given["digest"] == sources.digest
        except (AttributeError, LookupError, RecursionError, TypeError, ValueError):
            return None
        return sources if whole else None


def changed_sources(now: Sources | None, earlier: Sources | None) -> tuple[str, ...]:
    """Name what changed since an earlier session, whose sources may be missing."""
    if now is None or earlier is None:
        return () if now is earlier else ("the list of its files",)
    return now.changed_since(earlier) if now.digest != earlier.digest else ()


def differences(first: Mapping[str, str], second: Mapping[str, str]) -> list[str]:
    """Names under which two mappings hold something else, sorted."""
    names = sorted(first.keys() | second.keys())
    return [name for name in names if first.get(name) != second.get(name)]


def shortened(names: Sequence[str]) -> tuple[str, ...]:
    """The first few names, and the number of others."""
    others = len(names) - _MOST_NAMED
    return (*names[:_MOST_NAMED], f"{others} others") if others > 1 else tuple(names)


def _read_files(rules: SourceRules, top: Path) -> Iterator[tuple[str, str]]:
    """Yield name and digest of each file below a folder that counts.

    No link to a folder is followed. A link to a file outside counts by where it leads to.

    Raises:
        TooManyFilesError: If there are more than :data:`MAX_FILES`.
    """
    folders, entries, files = [(os.fspath(top), "")], 0, 0
    while folders:
        folder, prefix = folders.pop()
        try:
            with os.scandir(folder) as listing:
                inner = list(listing)
        except OSError:  # gone, or not for us to read: nothing is imported from there either
            continue
        if prefix and any(entry.name in ("pyvenv.cfg", "conda-meta") for entry in inner):
            continue  # a virtual environment, of `venv` or conda
        for entry in inner:
            name = prefix + entry.name
            if entry.is_dir(follow_symlinks=False):
                if rules.is_read(entry.path, entry.name):
                    folders.append((entry.path, f"{name}/"))
                continue
            if entry.name.endswith(_SUFFIXES) and not rules.is_test_module(entry.path, entry.name):
                files += 1
                yield name, _digest_in(top, entry)
        entries += len(inner)
        if entries > _MAX_ENTRIES or files > MAX_FILES:
            raise TooManyFilesError


def _digest_in(top: Path, entry: os.DirEntry[str]) -> str:
    file = Path(entry.path)
    if entry.is_symlink() and not file.resolve().is_relative_to(top.resolve()):
        return f"link to {os.readlink(file)}"  # noqa: PTH115 - as text
    return digest_of_file(file) or _UNREADABLE


def digest_of_file(file: Path) -> str | None:
    """The beginning of the SHA-256 of a file; ``None`` if it cannot be read.

    Of one that takes seconds to read size and time tell enough.
    """
    state = hashlib.sha256()
    try:
        if not file.is_file():  # reading a pipe would never end
            return None
        size = file.stat().st_size
        if size > _MAX_FILE_BYTES:
            return f"{size} bytes of {file.stat().st_mtime_ns}"
        with file.open("rb") as opened:
            while chunk := opened.read(1 << 20):
                state.update(chunk)
    except OSError:
        return None
    return state.hexdigest()[:_DIGITS]


class EpisodeFiles:
    """Files that an episode rests on beside the sources of the session, each read once.

    They are the test module in which a part of it is defined, the package of a part that lies
    elsewhere, and what its scenario and the parameters of its roles name, such as weights.

    Args:
        rules: Which files the sources of the session have; without them, none is read.
    """

    def __init__(self, rules: SourceRules | None = None) -> None:
        self._rules = rules
        self._of_targets: dict[Hashable, dict[str, str]] = {}
        self._of_texts: dict[str, dict[str, str]] = {}

    def of(self, task: EpisodeTask, covered: Collection[str]) -> dict[str, str]:
        """Return the beginning of the SHA-256 of each file by its name.

        Args:
            task: The task of the episode.
            covered: Names of the files that the sources of the session have.
        """
        found: dict[str, str] = {}
        if self._rules is None:
            return found
        for target in _targets(task):
            if target not in self._of_targets:
                self._of_targets[target] = dict(_defining(target, self._rules, covered))
            found |= self._of_targets[target]
        parameters = [part.params for part in task.parts.values()]
        for text in _texts([task.spec.scenario, parameters]):
            if text not in self._of_texts:
                self._of_texts[text] = dict(_named(text, self._rules))
            found |= self._of_texts[text]
        return found


def _defining(
    target: Any, rules: SourceRules, covered: Collection[str]
) -> Iterator[tuple[str, str]]:
    for module, file in _files_of(target).items():
        name = recorded_path(file, rules.root)
        if module.partition(".")[0] == _OURS or name in covered or is_installed(file):
            continue
        if rules.is_test_module(os.fspath(file), file.name):
            yield name, digest_of_file(file) or _UNREADABLE
        else:
            package = sources_of(file, module, rules.root)
            yield name, _UNREADABLE if package is None else package.digest[:_DIGITS]


def _named(text: str, rules: SourceRules) -> Iterator[tuple[str, str]]:
    for folder in (rules.root, Path.cwd()):
        file = folder / text
        if any(file.is_relative_to(output) for output in rules.outputs):
            continue
        digest = digest_of_file(file)
        if digest is not None:
            yield recorded_path(file, rules.root), digest
            return


def _targets(task: EpisodeTask) -> Iterator[Hashable]:
    """Yield classes and functions that make and judge an episode, or their import paths."""
    for part in task.parts.values():
        yield part.target if isinstance(part, LocalRole) else part.path
    yield from task.metrics.values()
    for requirement in task.judging:
        check = requirement.check.strip()
        if is_function_path(check) and ".py:" not in check:  # a conftest.py counts anyway
            yield check


def _files_of(target: Any) -> dict[str, Path]:
    """Files of the module of an import path, of a function, or of a class and those it rests on."""
    names = []
    if isinstance(target, str):
        names.append(target.rpartition(":")[0])
        target = RoleSpec(target).resolve()
    target = inspect.unwrap(target)
    bases = inspect.getmro(target) if inspect.isclass(target) else (target,)
    names += [getattr(base, "__module__", None) or "" for base in bases]
    return {name: file for name in names if (file := module_file(name)) is not None}


def module_file(name: str) -> Path | None:
    """File of a module that this process has imported; ``None`` without one."""
    file = getattr(sys.modules.get(name), "__file__", None)
    return Path(file).absolute() if file and Path(file).is_file() else None


_LONGEST_PATH = 1000


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts within plain data that may be the path of a file."""
    if isinstance(value, str):
        if 0 < len(value) <= _LONGEST_PATH and value.isprintable():
            yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            yield from _texts(inner)


class LoadedModules:
    """Modules of the user's own that this process has imported, by the content of their files.

    A file is read when its module is first asked for.
    """

    def __init__(self) -> None:
        self._seen: set[str] = set()
        self._own: dict[str, str] = {}
        self._digests: dict[str, str | None] = {}

    def digests(self) -> Mapping[str, str]:
        """The beginning of the SHA-256 of each by name, without what is installed."""
        if len(sys.modules) != len(self._seen):
            for name in sys.modules.keys() - self._seen:
                if _is_own(name) and (digest := self.digest_of(name)) is not None:
                    self._own[name] = digest
            self._seen = set(sys.modules)
        return self._own

    def digest_of(self, name: str) -> str | None:
        """That of one module; ``None`` if this process has not imported it from a file."""
        if name not in self._digests and name in sys.modules:
            file = module_file(name)
            self._digests[name] = None if file is None else digest_of_file(file)
        return self._digests.get(name)


def changed_meanwhile(modules: LoadedModules, sources: Sources, root: Path) -> list[str]:
    """Name the modules of this process whose files differ from the sources of the session.

    Args:
        modules: Those of this process.
        sources: Of the session, as they were at its beginning.
        root: The project's root directory.
    """
    return [
        name
        for module, digest in modules.digests().items()
        if (file := module_file(module)) is not None
        and sources.files.get(name := recorded_path(file, root), digest) != digest
    ]


def _is_own(module: str) -> bool:
    top = module.partition(".")[0]
    if top in (_OURS, *_NAMED_DIFFERENTLY) or top in sys.stdlib_module_names:
        return False
    named = getattr(sys.modules.get(module), "__file__", None)
    # Most are installed, which needs no look at the file.
    return bool(named) and not is_installed(str(named)) and module_file(module) is not None
