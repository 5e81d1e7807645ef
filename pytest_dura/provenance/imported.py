"""The user's own code that a piece of code rests on: its package, and what that imports."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.provenance.places import is_installed
from pytest_dura.provenance.sources import python_files, top_package
from pytest_dura.provenance.variables import variables_in

MOST = 5000
"""Files that are read of one package; nothing is known of one that has more."""
_OURS = "pytest_dura"
_IMPORT = re.compile(
    r"""\b(?:
        from[ \t]*\.[\w. \t]*\bimport\b  # of its own package, all of which counts anyway
        | from[ \t]+([^\W\d][\w.]*)[ \t]+import\b
        | import[ \t]+([^\W\d][\w., \t]*)
        | (?:import_module|__import__)\(\s*["']([^\W\d][\w.]*)
    )""",
    re.VERBOSE,
)
_CONTINUED = re.compile(r"\\\r?\n")


@dataclass(frozen=True)
class OwnCode:
    """The user's own code that something rests on.

    Args:
        digest: SHA-256 over names and digests of all files.
        files: The files, sorted.
        variables: Names of the environment variables that they read by name.
    """

    digest: str
    files: tuple[Path, ...]
    variables: frozenset[str]


def own_code(file: Path, module: str) -> OwnCode | None:
    """The code that something rests on, or ``None`` if it cannot be told.

    That is the top-level package that defines it, and in turn the packages and modules that any of
    their files imports by name, as far as they are not installed: the versions of installed
    packages are told elsewhere. Imports are looked for in the text, so that also those within a
    function count. What is imported by a computed name is not found, nor are data files.

    Args:
        file: The file that defines it.
        module: The dotted name of that file's module.
    """
    found = _Found()
    try:
        found.add(file, module)
    except OSError:  # gone, or not for us to read
        return None
    return found.told()


class _Found:
    """Files, and the names that they have on any machine."""

    def __init__(self) -> None:
        self._files: dict[Path, tuple[str, str]] = {}
        self._looked_for: set[str] = set()
        self._variables: set[str] = set()

    def told(self) -> OwnCode | None:
        """What was found; ``None`` if there are too many files."""
        if len(self._files) > MOST:
            return None
        state = hashlib.sha256()
        for name, sha256 in sorted(self._files.values()):
            state.update(f"{name}\0{sha256}\n".encode("utf-8", "surrogateescape"))
        return OwnCode(state.hexdigest(), tuple(sorted(self._files)), frozenset(self._variables))

    def add(self, file: Path, module: str) -> None:
        """A file with the rest of its package, and whatever they import.

        Raises:
            OSError: If one of them cannot be read.
        """
        package = top_package(file, module)
        self._looked_for.add(module.partition(".")[0])
        files = [] if package is None else list(python_files(package, MOST))
        if package is None or file not in files:
            self._read(file, file.parent)
        for one in files:
            self._read(one, (package or one).parent)

    def _read(self, file: Path, base: Path) -> None:
        if file in self._files or len(self._files) > MOST:
            return
        data = file.read_bytes()
        name = file.relative_to(base).as_posix()
        self._files[file] = name, hashlib.sha256(data).hexdigest()
        if file.suffix != ".py":
            return
        # Another encoding than UTF-8 spoils letters of names that are not ASCII, and nothing else.
        text = _CONTINUED.sub(" ", data.decode(errors="replace"))
        self._variables |= variables_in(text)
        for top in _imported(text):
            if top not in self._looked_for:
                self._looked_for.add(top)
                for origin in _origins(top, file.parent):
                    if not is_installed(origin):
                        self.add(origin, top)


def _imported(text: str) -> Iterator[str]:
    """The first parts of the names that a file imports; those of its own package apart."""
    for match in _IMPORT.finditer(text):
        for names in match.groups(""):
            for name in names.split(","):
                top = name.split(" as ")[0].strip().partition(".")[0]
                if top.isidentifier() and top != _OURS and top not in sys.stdlib_module_names:
                    yield top


def _origins(top: str, beside: Path) -> Iterator[Path]:
    """The files that define a top-level module; every file of a package without an own one."""
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError, AttributeError):  # a module that was made by hand
        spec = None
    if spec is None:
        # Some ways to import tests leave their folder out of the path.
        found = [beside / f"{top}.py", beside / top / "__init__.py"]
        yield from (one for one in found if one.is_file())
    elif spec.origin is not None and Path(spec.origin).is_file():
        yield Path(spec.origin).absolute()
    else:
        for folder in spec.submodule_search_locations or ():
            yield from python_files(Path(folder), MOST)
