"""Trust: checks of an import path from a file or a record before it is imported or called.

Scenario files, requirement files and evidence may come from strangers. What they name is imported
from installed packages and the session's own project alone, and called only if it is a subclass of
a known base or a function that :func:`factory` marks. A check or a measure is an ordinary function,
and has to be the project's own. Of an installed package, files name what it registers by an entry
point, or other parts of a package that registers something.
"""

from __future__ import annotations

import re
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.machinery import ModuleSpec
from importlib.metadata import distributions
from importlib.util import find_spec
from inspect import isclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pytest_dura.core.errors import ConfigurationError

_ENTRY_POINTS = "pytest_dura"
"""Group of entry points with which an installed package offers its functions as checks; the groups
of registries begin with it and a dot."""
_OURS = "pytest_dura"
_MARK = "__dura_factory__"
_PACKAGES = ("site-packages", "dist-packages")

F = TypeVar("F", bound=Callable[..., Any])


class Offer(NamedTuple):
    """Entry point of an installed package: its import path, and what provides it."""

    path: str
    distribution: str
    provider: str


Offers = Mapping[str, Mapping[str, tuple[Offer, ...]]]


def offers(group: str) -> Mapping[str, tuple[Offer, ...]]:
    """Map the names in a group of entry points to what installed packages offer under them."""
    return _offers(_import_path()).get(group, {})


def _import_path() -> tuple[str, ...]:
    return tuple(sys.path) if "" not in sys.path else (str(Path.cwd()), *filter(None, sys.path))


@lru_cache(maxsize=64)
def _offers(path: tuple[str, ...]) -> Offers:
    """Merge the entry points of each place on the import path; of a distribution the first counts.

    Args:
        path: Folders and archives; what one of them holds is read once in a process.
    """
    seen: set[str] = set()
    groups: dict[str, dict[str, tuple[Offer, ...]]] = {}
    for place in path:
        own = [entry for entry in _offers_in(place) if entry[2].distribution not in seen]
        seen.update(offer.distribution for _, _, offer in own)
        for group, name, offer in own:
            known = groups.setdefault(group, {})
            known[name] = (*known.get(name, ()), offer)
    return groups


@cache
def _offers_in(place: str) -> list[tuple[str, str, Offer]]:
    """Read group, name and offer of the entry points that are ours, in one place."""
    found: list[tuple[str, str, Offer]] = []
    for installed in distributions(path=[place]):
        points = [p for p in installed.entry_points if p.group.partition(".")[0] == _ENTRY_POINTS]
        if points:  # the rest of the metadata takes a hundred times as long to read
            metadata = installed.metadata
            name = re.sub(r"[-_.]+", "-", str(metadata["Name"])).lower()
            provider = f"{name} {metadata['Version']}"
            found += [
                (point.group, point.name, Offer(point.value.split(" ")[0], name, provider))
                for point in points
            ]
    return found


def factory(function: F) -> F:
    """Mark a function as one that builds a role or a simulator, so that files may name it.

    Args:
        function: Takes the parameters of a role or simulator, and returns a fresh one.
    """
    setattr(function, _MARK, True)
    return function


@dataclass(frozen=True)
class Places:
    """Folders of the session's own code, and of files that strangers may have written.

    Args:
        own: Folders of the session's own project.
        foreign: Folders of strangers' files. Of two folders that contain a module, the inner one
            counts.
        trusting: Whether files may name any installed package.
    """

    own: tuple[Path, ...] = ()
    foreign: tuple[Path, ...] = ()
    trusting: bool = False
    _importable: set[str] = field(default_factory=set, init=False, repr=False, compare=False)
    _own_modules: dict[str, bool] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, own: Iterable[Path], foreign: Iterable[Path], *, trusting: bool = False) -> Places:
        """Make them of paths that may be links."""
        return cls(tuple(map(Path.resolve, own)), tuple(map(Path.resolve, foreign)), trusting)

    def foreign_folder(self, file: Path) -> Path | None:
        """Folder of strangers that a file lies in, if it does."""
        # Of a folder that is both, the strangers' files make it foreign.
        around = [path for path in (*self.foreign, *self.own) if file.is_relative_to(path)]
        inner = max(around, key=lambda path: len(path.parts), default=None)
        return inner if inner in self.foreign else None

    def check_import(self, path: str) -> None:
        """Refuse an import path, see :func:`check_import`."""
        top = path.partition(":")[0].partition(".")[0]
        if top in self._importable:
            return
        spec = _spec(top)
        if spec is None:  # importing it says so
            return
        if _is_standard(spec):
            raise ConfigurationError(
                f"{path!r} leads into Python's standard library",
                found=path,
                expected="a class or function of your project, or of an installed package",
                remedy="write a role, simulator or function of your own, and name that",
            )
        for file in _files(spec):
            folder = self.foreign_folder(file)
            if folder is not None:
                raise ConfigurationError(
                    f"{path!r} would be imported from {file}, beside files that name it",
                    found=path,
                    expected="a module of your project, or of an installed package",
                    remedy=f"read the code in {folder}, and if it is to be run, add "
                    "--dura-trust-code",
                )
        self._importable.add(top)

    def check_registered(self, path: str) -> None:
        """Refuse an import path, see :func:`check_registered`."""
        top = path.partition(":")[0].partition(".")[0]
        spec = _spec(top)
        if self.trusting or spec is None or self.is_own(top) or _is_standard(spec):
            return  # what is missing or of Python itself is refused where it is imported
        if any(self.foreign_folder(file) for file in _files(spec)):
            return  # likewise
        if not any(_offers_of(top)):
            raise ConfigurationError(
                f"{path!r} is of an installed package that registers nothing for pytest-dura",
                found=path,
                expected="a registered name, a class of your project, or of a package with an "
                f"entry point in a group {_ENTRY_POINTS}.*",
                remedy="derive a class of your project from it and name that, register it in the "
                "package, or add --dura-trust-code",
            )

    def is_own(self, module: str) -> bool:
        """Whether functions that a module defines may be called by name."""
        if module not in self._own_modules:
            self._own_modules[module] = self._find_own(module.partition(".")[0])
        return self._own_modules[module]

    def _find_own(self, top: str) -> bool:
        if top in (_OURS, "__main__"):
            return True
        spec = _spec(top)
        if spec is None or _is_standard(spec):
            return False
        files = _files(spec)
        if any(self.foreign_folder(file) for file in files):
            return False
        if not any(part in _PACKAGES for file in files for part in file.parts):
            return True
        return _ENTRY_POINTS in _offers_of(top)


_places = Places()
"""Of the whole process, not of a context: in a thread whose context is empty, a default of "no
folder is foreign" would let strangers' code in."""


def use_places(places: Places) -> Places:
    """Set where code may come from in this process; returns the places that held before."""
    global _places
    before, _places = _places, places
    return before


def check_import(path: str) -> None:
    """Refuse an import path that leads into the standard library, or to strangers.

    Nothing is imported.

    Args:
        path: ``package.module`` or ``package.module:Name``.

    Raises:
        ConfigurationError: For a module of Python itself, and one in a folder of strangers.
    """
    _places.check_import(path)


def check_registered(path: str) -> None:
    """Refuse an import path in a file or a record that leads to a package without any registration.

    Nothing is imported. What the project itself defines needs no registration.

    Args:
        path: ``package.module:Name``.

    Raises:
        ConfigurationError: For a module of an installed package that registers nothing.
    """
    _places.check_registered(path)


def _offers_of(top: str) -> Iterator[str]:
    """Yield the groups in which a top-level module offers something."""
    for group, names in _offers(_import_path()).items():
        for points in names.values():
            if any(re.split(r"[:.]", point.path)[0] == top for point in points):
                yield group


def check_buildable(path: str, target: object, kinds: tuple[type, ...]) -> None:
    """Refuse to build anything but a known kind of part.

    Args:
        path: The import path that led to it.
        target: What it led to.
        kinds: Base classes, of which it has to be a subclass unless it is a marked factory.

    Raises:
        ConfigurationError: For any other class, function or object.
    """
    if isclass(target) and issubclass(target, kinds):
        return
    if callable(target) and getattr(target, _MARK, None) is True:
        return
    bases = " or ".join(kind.__name__ for kind in kinds)
    raise ConfigurationError(
        f"{path!r} is neither a class nor a factory of {bases}",
        found=target,
        expected=f"a subclass of {bases}, or a function with the decorator @pytest_dura.factory",
        remedy="derive it from its base class, or decorate the function that returns it",
    )


def check_function(path: str, target: object) -> None:
    """Refuse to call anything but a function of the project's own, or one that is offered.

    Args:
        path: The import path that led to it.
        target: What it led to.

    Raises:
        ConfigurationError: For what is built into Python, of the standard library, or of an
            installed package that does not offer its functions.
    """
    if not callable(target):
        raise ConfigurationError(
            f"{path!r} is not a function",
            found=target,
            expected="a function",
        )
    home = getattr(target, "__module__", None)
    if not isinstance(home, str) or not all(map(_places.is_own, (home, path.partition(":")[0]))):
        raise ConfigurationError(
            f"{path!r} is no function of this project",
            found=target,
            expected="a function that your project defines, or one of an installed package with an "
            f"entry point in the group {_ENTRY_POINTS!r}",
            remedy="define a function in your project that calls it, and name that",
        )


def _spec(top: str) -> ModuleSpec | None:
    """Spec of a top-level module, imported or not, without importing it."""
    loaded = sys.modules.get(top)
    spec = getattr(loaded, "__spec__", None)
    if loaded is None:
        try:
            return find_spec(top)
        except (ImportError, ValueError):
            return None
    if spec is None and getattr(loaded, "__file__", None):  # a conftest.py, for example
        return ModuleSpec(top, None, origin=loaded.__file__)
    return spec


def _is_standard(spec: ModuleSpec) -> bool:
    if spec.origin in ("built-in", "frozen"):
        return True
    return any(
        file.is_relative_to(folder) and not set(_PACKAGES) & set(file.relative_to(folder).parts)
        for file in _files(spec)
        for folder in _standard()
    )


@cache
def _standard() -> tuple[Path, ...]:
    names = ("stdlib", "platstdlib")
    return tuple({Path(path).resolve() for name in names if (path := sysconfig.get_path(name))})


def _files(spec: ModuleSpec) -> list[Path]:
    """Files and folders that a module is made of."""
    origin = [spec.origin] if spec.origin not in (None, "namespace") else []
    paths = (*origin, *(spec.submodule_search_locations or ()))
    return [Path(path).resolve() for path in paths if path]
