"""Trust: checks of an import path from a file or a record before it is imported or called.

Scenario files, requirement files and evidence may come from strangers. What they name is imported
from installed packages and the session's own project alone, and called only if it is a subclass of
a known base or a function that :func:`factory` marks. A check or a measure is an ordinary function,
and has to be the project's own. Of an installed package, files name what it registers by an entry
point, or other parts of a package that registers something.
"""

from __future__ import annotations

import os
import pkgutil
import re
import sys
import sysconfig
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import distributions
from importlib.util import find_spec
from inspect import isclass
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.errors import ConfigurationError, import_error

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
    return (
        tuple(sys.path) if "" not in sys.path else (_working_directory(), *filter(None, sys.path))
    )


def _working_directory() -> str:
    """Return the working directory; a path object of it is dear where a grid has thousands."""
    return os.getcwd()  # noqa: PTH109


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

    def to_json(self) -> dict[str, Any]:
        """Plain data, for another process."""
        own, foreign = [*map(str, self.own)], [*map(str, self.foreign)]
        return {"own": own, "foreign": foreign, "trusting": self.trusting}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Places:
        """Invert :meth:`to_json`."""
        own, foreign = (tuple(map(Path, data[key])) for key in ("own", "foreign"))
        return cls(own, foreign, bool(data["trusting"]))

    def foreign_folder(self, file: Path) -> Path | None:
        """Folder of strangers that a file lies in, if it does; a link lies in both its places."""
        for path in (Path(os.path.abspath(file)), file.resolve()):  # noqa: PTH100 - keeps links
            for folder in (path, *path.parents) if self.foreign else ():
                # Of a folder that is both, the strangers' files make it foreign.
                foreign = next((each for each in self.foreign if _is_same(folder, each)), None)
                if foreign is not None:
                    return foreign
                if any(_is_same(folder, each) for each in self.own):
                    break
        return None

    def check_import(self, path: str) -> None:
        """Refuse an import path, see :func:`check_import`."""
        module = path.partition(":")[0]
        if module in self._importable:
            return
        is_loaded = module in sys.modules
        # Importing a module imports the packages around it; one that is loaded is only looked up.
        for spec in _specs(module)[-1:] if is_loaded else _specs(module):
            if _is_standard(spec):
                raise ConfigurationError(
                    f"{path!r} leads into Python's standard library",
                    found=path,
                    expected="a class or function of your project, or of an installed package",
                    remedy="write a role, simulator or function of your own, and name that",
                )
            file = _file(spec)
            folder = None if file is None else self.foreign_folder(file)
            if folder is not None:
                raise ConfigurationError(
                    f"{path!r} would be imported from {file}, beside files that name it",
                    found=path,
                    expected="a module of your project, or of an installed package",
                    remedy=f"read the code in {folder}, and if it is to be run, add "
                    "--dura-trust-code",
                )
        if is_loaded:  # until then, what a package does to its own path may lead elsewhere
            self._importable.add(module)

    def check_registered(self, path: str) -> None:
        """Refuse an import path, see :func:`check_registered`."""
        package = self._unregistered(path.partition(":")[0])
        if package is not None:
            raise ConfigurationError(
                f"{path!r} is of an installed package that registers nothing for pytest-dura",
                found=path,
                expected="a registered name, a class of your project, or of a package with an "
                f"entry point in a group {_ENTRY_POINTS}.*",
                remedy="derive a class of your project from it and name that, register it in the "
                "package, or add --dura-trust-code",
            )

    def _unregistered(self, module: str) -> str | None:
        """Return the installed package of a module if it registers nothing, else ``None``."""
        specs = _specs(module)
        # A folder without code of its own may hold packages of several distributions.
        package = next((spec for spec in specs if _file(spec) is not None), None)
        if self.trusting or package is None or self.is_own(package.name):
            return None
        if _is_standard(package):
            return None  # as what is missing or a stranger's, refused where it is imported
        if any(file and self.foreign_folder(file) for file in map(_file, specs)):
            return None
        return None if any(_offers_of(package.name)) else package.name

    def check_name(self, text: str, packages: Collection[str]) -> None:
        """Refuse a text by which a library might import, see :func:`check_names`."""
        module, colon, inner = text.partition(":")
        specs = _specs(module) if colon or "." in module else []
        if self.trusting or not any(map(_file, specs)):
            return  # there is no such module, and so nothing is run
        refusal = self._refusal(module, packages)
        if refusal is None:
            target: Any = _import_named(text, specs[-1].name)
            rest = module[len(specs[-1].name) :].split(".")[1:]
            for part in [*rest, *inner.split(".")] if colon else rest:
                target = getattr(target, part, None)
            if callable(target):
                # What a module of the project has imported from elsewhere is not the project's.
                home = str(getattr(target, "__module__", None) or "builtins")
                refusal = self._refusal(home, packages)
        if refusal is not None:
            raise ConfigurationError(
                f"{text!r} in a configuration {refusal}",
                found=text,
                expected="names of your project, of a package that registers something for "
                f"pytest-dura, or of {', '.join(sorted(packages)) or 'none'}",
                remedy="derive a class of your project from it and name that; write the name of a "
                "file with its folder (./name); or add --dura-trust-code",
            )

    def _refusal(self, module: str, packages: Collection[str]) -> str | None:
        """Return why a library must not import a module by name, ``None`` if it may."""
        specs = _specs(module)
        if any(map(_is_standard, specs)):
            return "leads into Python's standard library"
        for file in filter(None, map(_file, specs)):
            folder = self.foreign_folder(file)
            if folder is not None:
                return f"would be imported from {file}, beside files that name it"
        package = self._unregistered(module)
        if package is None or any(f"{package}.".startswith(f"{each}.") for each in packages):
            return None
        return f"is of the package {package}, which registers nothing for pytest-dura"

    def is_own(self, module: str) -> bool:
        """Whether functions that a module defines may be called by name."""
        if module not in self._own_modules:
            own = self._find_own(module)
            if module not in sys.modules:
                return own
            self._own_modules[module] = own
        return self._own_modules[module]

    def _find_own(self, module: str) -> bool:
        if module.partition(".")[0] == _OURS or module == "__main__":
            return True
        specs = _specs(module)
        file = _file(specs[-1]) if specs and specs[-1].name == module else None
        if file is None or _is_standard(specs[-1]) or self.foreign_folder(file):
            return False
        is_installed = set(_PACKAGES) & {*file.parts, *file.resolve().parts}
        return not is_installed or _ENTRY_POINTS in _offers_of(module)


_places = Places()
"""Of the whole process, not of a context: in a thread whose context is empty, a default of "no
folder is foreign" would let strangers' code in."""


def use_places(places: Places) -> Places:
    """Set where code may come from in this process; returns the places that held before."""
    global _places
    before, _places = _places, places
    return before


def current_places() -> Places:
    """Return where code may come from in this process."""
    return _places


def check_import(path: str) -> None:
    """Refuse an import path that leads into the standard library, or to strangers.

    Nothing is imported. What counts is the file that each module on the way would come from.

    Args:
        path: ``package.module`` or ``package.module:Name``.

    Raises:
        ConfigurationError: For a module of Python itself, and one in a folder of strangers.
    """
    _places.check_import(path)


def import_checked(path: str) -> ModuleType:
    """Import the module of an import path that :func:`check_import` lets pass.

    Raises:
        ConfigurationError: See :func:`check_import`.
        BaseException: Whatever the module raises.
    """
    module = path.partition(":")[0]
    for package in list(_names(module))[:-1] if module not in sys.modules else ():
        check_import(path)
        import_module(package)  # which may change where its modules are looked for
    check_import(path)
    return import_module(module)


def source_of(module: str) -> Path | None:
    """Return the file that a module comes from, without an import of it or of its packages."""
    specs = _specs(module)
    file = _file(specs[-1]) if specs and specs[-1].name == module else None
    return file if file is not None and file.is_file() else None


def check_registered(path: str) -> None:
    """Refuse an import path in a file or a record that leads to a package without any registration.

    Nothing is imported. What the project itself defines needs no registration.

    Args:
        path: ``package.module:Name``.

    Raises:
        ConfigurationError: For a module of an installed package that registers nothing.
    """
    _places.check_registered(path)


def _offers_of(module: str) -> Iterator[str]:
    """Yield the groups in which the distribution of a module offers something."""
    specs = _specs(module)
    package = next((spec.name for spec in specs if _file(spec) is not None), module)
    for group, names in _offers(_import_path()).items():
        for points in names.values():
            if any(
                f"{point.path.partition(':')[0]}.".startswith(f"{package}.") for point in points
            ):
                yield group


def check_names(config: object, packages: Collection[str] = ()) -> None:
    """Refuse names in a configuration that is handed to a library which imports by name.

    Every text counts that has the form of an import path, ``a.b.C`` or ``a.b:C``, and leads to a
    module that is there: which of them the library resolves is its own affair.

    Args:
        config: Plain data: texts, also within mappings and lists.
        packages: Packages that it may name beside those that files may name, such as the library's.

    Raises:
        ConfigurationError: For a module of Python itself, of strangers, and of an installed package
            that registers nothing and is none of these; and for what such a module defines.
    """
    for text in _texts(config):
        _places.check_name(text, packages)


def _texts(value: object) -> Iterator[str]:
    """Yield the texts in plain data, keys as well."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        yield from _texts([*value.keys(), *value.values()])
    elif isinstance(value, (list, tuple, set, frozenset)):
        for each in value:
            yield from _texts(each)


def _import_named(text: str, module: str) -> ModuleType:
    """Import a module that a configuration names and that may be imported.

    Raises:
        ConfigurationError: If it cannot be imported.
    """
    try:
        return import_checked(module)
    except BaseException as error:  # a module runs its author's code when it is imported
        let_pass(error)
        raise import_error(
            error,
            f"{text!r} in a configuration cannot be imported",
            module=module,
            found=text,
            expected="a module that can be imported",
            remedy="correct the module, or write the name of a file with its folder (./name)",
        ) from error


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
        raise _not_own_error(path, target)


def check_own(path: str) -> None:
    """Refuse an import path of a function before its module is imported.

    Raises:
        ConfigurationError: For a module that is there and whose functions must not be called, see
            :func:`check_function`.
    """
    _places.check_import(path)
    specs = _specs(path.partition(":")[0])
    last = next((spec.name for spec in reversed(specs) if _file(spec) is not None), None)
    if last is not None and not _places.is_own(last):  # importing it says what is missing
        raise _not_own_error(path, path)


def _not_own_error(path: str, found: object) -> ConfigurationError:
    return ConfigurationError(
        f"{path!r} is no function of this project",
        found=found,
        expected="a function that your project defines, or one of an installed package with an "
        f"entry point in the group {_ENTRY_POINTS!r}",
        remedy="define a function in your project that calls it, and name that",
    )


def _specs(module: str) -> list[ModuleSpec]:
    """Find the specs of a module and of the packages around it, the outermost first.

    Nothing is imported. The list ends before the first one that is not found; of a loaded module
    whose packages are not found, it holds the module alone.
    """
    specs: list[ModuleSpec] = []
    places: Iterable[str] | None = None
    for name in _names(module):
        spec = _loaded_spec(name) if name in sys.modules else _find_spec(name, places)
        if spec is None:
            break
        specs.append(spec)
        places = getattr(sys.modules.get(name), "__path__", spec.submodule_search_locations) or ()
    if not specs or specs[-1].name != module:
        loaded = _loaded_spec(module)
        return specs if loaded is None else [loaded]
    return specs


def _names(module: str) -> Iterator[str]:
    """Iterate over the names of the packages around a module, the outermost first, and its own."""
    return accumulate(module.split("."), "{}.{}".format)


def _loaded_spec(name: str) -> ModuleSpec | None:
    """Spec of a module that is imported, under the name that it is imported by."""
    module = sys.modules.get(name)
    spec: ModuleSpec | None = getattr(module, "__spec__", None)
    origin = getattr(module, "__file__", None) if spec is None else spec.origin
    if module is None or (spec is None and origin is None):
        return None
    # `os.path` is imported by another name; a conftest.py may have no spec.
    named = ModuleSpec(name, None if spec is None else spec.loader, origin=origin)
    named.submodule_search_locations = getattr(module, "__path__", None)
    return named


def _find_spec(name: str, places: Iterable[str] | None) -> ModuleSpec | None:
    """Spec of a module that is not imported, as Python would find it.

    Args:
        name: Its full name.
        places: Where the package around it looks for modules; ``None`` for a top-level module.
    """
    try:
        if places is None:
            return find_spec(name)
        found = (_found_by(finder, name, list(places)) for finder in sys.meta_path)
        return next((spec for spec in found if spec is not None), None)
    except (ImportError, ValueError):
        return None


def _found_by(finder: Any, name: str, places: list[str]) -> ModuleSpec | None:
    if finder is PathFinder or not hasattr(finder, "find_spec"):
        return _found_in(name, places) if finder is PathFinder else None
    try:
        spec: ModuleSpec | None = finder.find_spec(name, places)
    except KeyError:
        # It asks Python's own finder, which makes no spec of a folder without code as long as the
        # package around it is not imported.
        return None
    return spec


def _found_in(name: str, places: list[str]) -> ModuleSpec | None:
    """Find a module in folders and archives as ``PathFinder`` does, its package not imported."""
    portions: list[str] = []
    for place in places:
        finder = pkgutil.get_importer(place)
        spec = None if finder is None else finder.find_spec(name)
        if spec is not None and spec.loader is not None:
            return spec
        if spec is not None:
            portions += spec.submodule_search_locations or ()
    if not portions:
        return None
    namespace = ModuleSpec(name, None, is_package=True)
    namespace.submodule_search_locations = portions
    return namespace


def _is_standard(spec: ModuleSpec) -> bool:
    if spec.origin in ("built-in", "frozen"):
        return True
    file = _file(spec)
    return file is not None and any(
        path.is_relative_to(folder) and not set(_PACKAGES) & set(path.relative_to(folder).parts)
        for path in (file.resolve(),)
        for folder in _standard()
    )


@cache
def _standard() -> tuple[Path, ...]:
    names = ("stdlib", "platstdlib")
    return tuple({Path(path).resolve() for name in names if (path := sysconfig.get_path(name))})


def _file(spec: ModuleSpec) -> Path | None:
    """File whose code a module runs; ``None`` for a folder without code of its own."""
    is_folder = spec.origin is None or spec.origin == "namespace"
    return None if is_folder else Path(str(spec.origin))


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one == other or one.samefile(other)  # also where the case of letters is ignored
    except OSError:
        return False
