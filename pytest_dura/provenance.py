"""Provenance of a result: files, code and its digests, packages, platform, commit."""

from __future__ import annotations

import ast
import csv
import hashlib
import importlib.util
import inspect
import json
import os
import platform
import re
import subprocess
import sys
import sysconfig
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import import_module, metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any


def recorded_path(file: Path, root: Path, known: Mapping[Path, str] | None = None) -> str:
    """Name a file for the record, with ``/`` between its parts.

    Within an installed package it is ``package/...``, below the project's root the path from
    there, and anywhere else the file's name with its folder's.

    Args:
        file: The file.
        root: The project's root.
        known: Folders that have a name of their own.
    """
    absolute = _absolute(file)
    own: list[tuple[Path, Path | str]] = [
        (folder, "") for folder in (_absolute(root), _resolved(root))
    ]
    for path in dict.fromkeys((absolute, _resolved(absolute))):
        packages = _packages_around(path)
        places = own if packages is None else [(packages, ""), *own]
        for folder, name in [*places, *(known or {}).items()]:
            if path.is_relative_to(folder):
                return (Path(name) / path.relative_to(folder)).as_posix()
    return f"{absolute.parent.name}/{absolute.name}".lstrip("/")


_PACKAGE_FOLDERS = ("site-packages", "dist-packages")


def is_installed(file: Path | str) -> bool:
    """Whether a file belongs to an installed package, or to Python itself.

    Packages lie in any folder that is called ``site-packages`` or ``dist-packages``, which may be
    the system's, the user's, or one that a ``.pth`` file or ``PYTHONPATH`` adds. In any other
    folder of the import path, the files count that a distribution there recorded.
    """
    text = os.path.abspath(file)  # noqa: PTH100 - see below
    # Asked of a thousand modules in a few folders: the file itself matters only if it is a link.
    if _lies_in_packages(os.path.dirname(text)) and not os.path.islink(text):  # noqa: PTH114, PTH120
        return True
    absolute = Path(text)
    return _packages_around(_resolved(absolute)) is not None or (
        # A link into a cache of packages; other links are a way to develop in place.
        _recording_folder(absolute) is not None
    )


@cache
def _lies_in_packages(folder: str) -> bool:
    """Whether a folder is one of packages or of Python's modules, or lies in one."""
    return _named_packages_around(_resolved(Path(folder)) / "module") is not None


def _packages_around(path: Path) -> Path | None:
    """Find the folder of installed packages, or of Python's modules, that a path lies in."""
    return _named_packages_around(path) or _recording_folder(path)


def _named_packages_around(path: Path) -> Path | None:
    inner = path.parts[:-1]
    for i in range(len(inner), 0, -1):
        if inner[i - 1] in _PACKAGE_FOLDERS:
            return Path(*inner[:i])
    text = os.fspath(path)
    folders = installed_folders()
    return next((each for each in folders if _below(text, os.fspath(each)) is not None), None)


def _recording_folder(path: Path) -> Path | None:
    """Find the folder on the import path whose distributions recorded a file."""
    text = os.fspath(path)
    for entry in sys.path:
        folder = os.path.abspath(entry)  # noqa: PTH100 - asked of each file for each entry
        name = _below(text, folder)
        if name is not None and name.replace(os.sep, "/") in _recorded(folder):
            return Path(folder)
    return None


def _below(path: str, folder: str) -> str | None:
    """Name a path relative to a folder that it lies in, or is; ``None`` elsewhere."""
    start = os.path.join(folder, "")  # noqa: PTH118 - ten times as quick as to make paths
    inside = os.path.normcase(os.path.join(path, "")).startswith(os.path.normcase(start))  # noqa: PTH118
    return path[len(start) :] if inside else None


@cache
def _recorded(folder: str) -> frozenset[str]:
    """Read which files the distributions in a folder say that they installed there.

    Editable ones are left out, and so are those without a ``RECORD``, such as the ``.egg-info``
    that builds leave beside sources.
    """
    return frozenset(
        row[0]
        for distribution in metadata.distributions(path=[folder])
        if not _is_editable(distribution)
        for row in csv.reader((distribution.read_text("RECORD") or "").splitlines())
        if row
    )


def _is_editable(distribution: metadata.Distribution) -> bool:
    source = json.loads(distribution.read_text("direct_url.json") or "{}")
    return bool(source.get("dir_info", {}).get("editable"))


@cache
def installed_folders() -> tuple[Path, ...]:
    """List the folders of installed packages and of Python's modules, the innermost first."""
    names = ("purelib", "platlib", "stdlib", "platstdlib")
    folders = {_resolved(Path(path)) for name in names if (path := sysconfig.get_path(name))}
    return tuple(sorted(folders, key=lambda folder: (-len(folder.parts), folder)))


def _absolute(path: Path) -> Path:
    # Links keep their names, which are those that the user knows.
    return Path(os.path.abspath(path))  # noqa: PTH100 - Path.absolute() would leave `..` in it


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a loop of links
        return path


MAX_LISTED_FILES = 50
"""Number of files up to which all are listed; of more, the defining one is."""
_MAX_COMPONENT_FILES = 1000
"""Number of files up to which all are read; of more, the defining one is."""
_NO_SOURCES = {"__pycache__", "node_modules", *_PACKAGE_FOLDERS}


@dataclass(frozen=True)
class Sources:
    """Source files of a component.

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


def sources_of(
    file: Path, module: str, root: Path, *, most: int = _MAX_COMPONENT_FILES
) -> Sources | None:
    """Read all Python files of the top-level package that defines a component.

    What it imports from other packages is not part of it, nor are data files. ``None`` if a file
    cannot be read.

    Args:
        file: The file that defines it.
        module: The dotted name of that file's module.
        root: The project's root, to which names are relative.
        most: Number of files up to which all are read.
    """
    package = _top_package(file, module)
    files = sorted(_python_files(package, most)) if package is not None else []
    base = file.parent
    if package is None or not 0 < len(files) <= most or file not in files:
        files = [file]
    elif len(files) > 1:
        base = package.parent
    else:
        base = package
    hashed, named = [], {}
    try:
        for path in files:
            sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
            # Names within the package: it is the same component wherever it is installed.
            named[path.relative_to(base).as_posix()] = sha256
            hashed.append((path, sha256))
    except OSError:  # gone, or not for us to read
        return None
    listed = hashed if len(hashed) <= MAX_LISTED_FILES and not is_installed(file) else []
    listed = listed or [entry for entry in hashed if entry[0] == file]
    return Sources(
        digest=digest_of(named),
        named=named,
        files=[{"path": recorded_path(path, root), "sha256": sha256} for path, sha256 in listed],
        read=tuple(path for path, _ in listed),
    )


def digest_of(named: Mapping[str, str]) -> str:
    """Hash the names and SHA-256 of files, in order of their names."""
    state = hashlib.sha256()
    for name in sorted(named):
        state.update(f"{name}\0{named[name]}\n".encode("utf-8", "surrogatepass"))
    return state.hexdigest()


def _top_package(file: Path, module: str) -> Path | None:
    """Folder of the top-level package, if the path of the file fits its module's name."""
    parts = module.split(".")
    if file.name != "__init__.py":
        parts = parts[:-1]
    if not parts or len(file.parents) < len(parts):
        return None
    package = file.parents[len(parts) - 1]
    return package if package.name == parts[0] else None


def _python_files(package: Path, most: int) -> Iterator[Path]:
    """Yield the files below a package, at most one more than ``most``."""
    count = 0
    for folder, inner, names in os.walk(package):
        inner[:] = [sub for sub in inner if not sub.startswith(".") and sub not in _NO_SOURCES]
        for name in names:
            if name.endswith(".py"):
                yield Path(folder, name)
                count += 1
                if count > most:
                    return


_MAX_PACKAGE_FILES = 5000
"""Files that are read of a package at most."""
_OURS = "pytest_dura"


def imported_files(file: Path, module: str, root: Path | None = None) -> list[Path]:
    """List the user's own files that a component comes with, for the record, sorted.

    That is the top-level package that defines it, and in turn the packages and modules that any of
    their files imports by name, as far as they are not installed. Imports by a computed name are
    not found, nor are data files. Empty if one cannot be read.

    Args:
        file: The file that defines it.
        module: The dotted name of that file's module.
        root: The project's root; without it, all that is not installed is the project's.
    """
    collector = _ImportCollector(root)
    try:
        collector.add(file, module)
    except OSError:  # gone, or not for us to read
        return []
    return sorted(collector.files)


class _ImportCollector:
    """Collects the files that modules of the user's own come with, and what they import.

    Args:
        root: The project's root. What is imported from elsewhere is not searched for imports.
    """

    def __init__(self, root: Path | None) -> None:
        self._root = None if root is None else _resolved(root)
        self.files: set[Path] = set()
        self.looked_for: set[str] = set()
        """Top-level modules that the files import, and their own."""

    def add(self, file: Path, module: str, *, searched: bool = True) -> None:
        """Add a file with the rest of its package, and all that they import.

        Args:
            file: The file.
            module: The dotted name of that file's module.
            searched: Whether they are searched for imports.

        Raises:
            OSError: If one of them cannot be read.
        """
        package = _top_package(file, module)
        self.looked_for.add(module.partition(".")[0])
        files = [] if package is None else list(_python_files(package, _MAX_PACKAGE_FILES))
        for path in files if file in files else [file, *files]:
            self._read(path, searched=searched)

    def _read(self, file: Path, *, searched: bool) -> None:
        if file in self.files or len(self.files) > _MAX_PACKAGE_FILES:
            return
        data = file.read_bytes()
        self.files.add(file)
        if file.suffix != ".py" or not searched:
            return
        for top in _imports_in(data):
            if top not in self.looked_for:
                self.looked_for.add(top)
                for origin in _origins(top, file.parent):
                    if not is_installed(origin):
                        self.add(origin, top, searched=self._is_own(origin))

    def _is_own(self, file: Path) -> bool:
        return self._root is None or _resolved(file).is_relative_to(self._root)


_IMPORTERS = {"import_module", "__import__"}


@lru_cache(maxsize=512)  # each item asks for the code of its roles
def _imports_in(source: bytes) -> tuple[str, ...]:
    """Find the top-level packages that Python code imports by literal names.

    The standard library is left out, and relative imports, which are the code's own package.
    """
    modules: list[str] = []
    for node in ast.walk(_parsed(source)):
        if isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules.append(node.module or "")
        elif isinstance(node, ast.Call) and node.args and _last_name(node.func) in _IMPORTERS:
            modules.append(_literal(node.args[0]))
    tops = dict.fromkeys(module.partition(".")[0] for module in modules)
    ours = {_OURS, *sys.stdlib_module_names}
    return tuple(top for top in tops if top.isidentifier() and top not in ours)


def _parsed(source: bytes) -> ast.AST:
    """Parse a file; one that cannot be parsed is as an empty one."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the code that is read, which is not ours
            return ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ast.Module([], [])


def _last_name(node: ast.AST | None) -> str:
    """Find ``c`` in ``c`` and in ``a.b.c``."""
    return str(getattr(node, "attr", "") or getattr(node, "id", ""))


def _literal(node: ast.AST) -> str:
    """Find the text of a literal; empty for anything else."""
    value = node.value if isinstance(node, ast.Constant) else ""
    return value if isinstance(value, str) else ""


def _origins(top: str, beside: Path) -> Iterator[Path]:
    """Yield the files that define a top-level module; all files of a namespace package."""
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError, AttributeError):  # a module that was made by hand
        spec = None
    if spec is None:
        # Some ways to import tests leave their folder out of the path.
        candidates = [beside / f"{top}.py", beside / top / "__init__.py"]
        yield from (candidate for candidate in candidates if candidate.is_file())
    elif spec.origin is not None and Path(spec.origin).is_file():
        yield Path(spec.origin).absolute()
    else:
        for folder in spec.submodule_search_locations or ():
            yield from _python_files(Path(folder), _MAX_PACKAGE_FILES)


_MAX_OWN_FILES = 5000
"""Greatest number of pytest-dura's own files."""


@cache
def describe_tool() -> dict[str, Any]:
    """Describe pytest-dura: name, version, and the digest of its files at the first call.

    Checkouts and changed installations have the version of a release and another digest. It takes
    some 15 ms, once a process.

    Returns:
        ``name``, ``version``, ``code``: the SHA-256 of :func:`sources_of`, the same wherever it is
        installed, or ``None`` where the files cannot be read, as in a zip file.
    """
    # The package is loaded already; an import by statement would look like a circle.
    package = import_module(_OURS)
    return {"name": "pytest-dura", "version": package.__version__, "code": _digest()}


def tool_code() -> str:
    """Identify the code of pytest-dura, for addresses: by its digest, else by its version."""
    tool = describe_tool()
    return tool["code"] or f"version {tool['version']}"


def _digest() -> str | None:
    file = Path(__file__).absolute().parent / "__init__.py"
    sources = sources_of(file, _OURS, file.parent, most=_MAX_OWN_FILES)
    return None if sources is None else sources.digest


_DISTRIBUTION = "pytest-dura"
_PACKAGES = (
    "pytest-dura", "pytest", "pytest-xdist", "hypothesis", "highway-env", "gymnasium",
    "allure-pytest", "numpy", "scipy", "pydantic", "PyYAML",
)  # fmt: skip


def describe_environment(
    root: Path, evidence: Path, files: Mapping[str, Path] = MappingProxyType({})
) -> dict[str, Any]:
    """Describe versions, platform, and the git repository at ``root``, if it is one.

    Args:
        root: The project's root.
        evidence: The evidence folder, whose files do not make the repository dirty.
        files: Of modules that define simulators and roles, by their dotted names.
    """
    packages = {name: version for name in _packages() if (version := _version(name))}
    return {
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "machine": platform.machine(),
        "byte_order": sys.byteorder,
        **describe_arithmetic(),
        "packages": imported_versions(files, root) | packages,
        "git": _git(root, evidence),
    }


def imported_versions(files: Mapping[str, Path], root: Path | None = None) -> dict[str, str]:
    """Find the versions of the installed packages that modules import, sorted by distribution.

    Of the project's own modules, what their own modules import counts as well; of installed ones
    only what the module itself imports. Imports are read and not carried out.

    Args:
        files: Of the modules, by their dotted names.
        root: The project's root; without it, all that is not installed is the project's.
    """
    tops: set[str] = set()
    for module, file in files.items():
        try:
            if module.partition(".")[0] == _OURS or is_installed(file):
                tops.update((module.partition(".")[0], *_imports_in(file.read_bytes())))
            else:
                collector = _ImportCollector(root)
                collector.add(file, module)
                tops |= collector.looked_for
        except OSError:  # noqa: PERF203 - gone, or not for us to read
            continue
    versions: dict[str, str] = {}
    for top in tops - {_OURS}:
        installed = [origin for origin in _origins(top, Path()) if is_installed(origin)]
        name = _distribution_of(top, installed[0]) if installed else None
        version = None if name is None else _version(name)
        if name is not None and version is not None:
            versions[name] = version
    return dict(sorted(versions.items()))


def describe_arithmetic() -> dict[str, Any]:
    """Describe what the last bit of a sum depends on, and with it every digest.

    ``cpu_features`` are the instruction sets that NumPy uses on this machine, ``blas`` is the
    library that multiplies its matrices; ``None`` where NumPy does not say.
    """
    import numpy as np

    configuration: Any = np.show_config(mode="dicts")
    simd = configuration.get("SIMD Extensions")
    blas = configuration.get("Build Dependencies", {}).get("blas")
    features = None if simd is None else [*simd.get("baseline", []), *simd.get("found", [])]
    library = None if not blas else f"{blas.get('name', '')} {blas.get('version', '')}".strip()
    return {"cpu_features": features, "blas": library}


def describe_hypothesis() -> dict[str, Any] | None:
    """Describe the loaded profile of Hypothesis as far as it determines the examples.

    Tests may have settings of their own. ``None`` if Hypothesis is not imported.
    """
    if "hypothesis" not in sys.modules:
        return None
    from hypothesis import settings

    profile = settings.get_profile(settings.get_current_profile_name())
    return {
        "profile": settings.get_current_profile_name(),
        "max_examples": profile.max_examples,
        "derandomize": profile.derandomize,
        "database": profile.database is not None,
    }


_NUMERIC = ("numpy", "scipy", "highway-env", "gymnasium")
"""Packages whose versions are listed, since most episodes depend on them."""
_TOOLS = ("pytest", "hypothesis", "allure", "execnet", "ruff", "mypy", "pip", "setuptools", "dask",
          "distributed")  # fmt: skip
"""Prefixes of packages that run, distribute or check, and do not affect episodes."""


def describe_packages() -> dict[str, str]:
    """Describe the versions of installed packages that may change an episode.

    Those on which most episodes depend are listed; the others have one digest.
    """
    others = [f"{name}-{version}" for name, version in installed_versions().items()]
    versions = {name: version for name in _NUMERIC if (version := _version(name))}
    digest = hashlib.sha256("\n".join(sorted(others)).encode()).hexdigest()
    return {**versions, "other packages": digest}


def installed_versions() -> dict[str, str]:
    """List the versions of installed packages that may change an episode.

    Components may depend on any package; the names of the metadata folders on the path give all
    versions without reading them. Of two packages of a name the first on the path counts.
    """
    versions: dict[str, str] = {}
    for folder in _metadata_folders(*_import_path()):
        name, _, version = folder.stem.partition("-")
        if not name.lower().startswith((*_TOOLS, _OURS)):
            versions.setdefault(name, version)
    return versions


def installed_in_place() -> Iterator[tuple[str, Path]]:
    """Yield name and folder of the packages whose files stay where they are developed."""
    for folder in _metadata_folders(*_import_path()):
        name = folder.stem.partition("-")[0]
        try:
            source = json.loads((folder / "direct_url.json").read_bytes())
            if name != _OURS and source.get("dir_info", {}).get("editable"):
                from urllib.parse import urlsplit
                from urllib.request import url2pathname

                yield name, Path(url2pathname(urlsplit(source["url"]).path))
        except (OSError, LookupError, TypeError, ValueError, AttributeError):  # installed otherwise
            continue


def _import_path() -> list[Path]:
    return [_absolute(Path(entry)) for entry in sys.path]


@lru_cache(maxsize=8)
def _metadata_folders(*path: Path) -> tuple[Path, ...]:
    """List the folders of metadata on the import path, but for those beside sources."""
    folders: list[Path] = []
    for place in path:
        with suppress(OSError):  # no folder, or not for us to read
            folders += sorted(
                folder
                for folder in place.iterdir()
                if folder.suffix == ".dist-info"
                or (folder.suffix == ".egg-info" and _packages_around(folder) is not None)
            )
    return tuple(folders)


def describe_component(
    path: str,
    factory: Callable[..., Any],
    params: Mapping[str, Any],
    file: Path | None = None,
    root: Path | None = None,
) -> dict[str, Any]:
    """Describe a component: import path, distribution, version, and digests of its sources.

    See :func:`sources_of` for what belongs to a component.

    Args:
        path: The component's import path.
        factory: Its class, or the function that makes it.
        params: The parameters it is made with.
        file: The file that defines it, where the factory does not tell.
        root: The project's root, to which the names of files are relative; default: the folder
            that the process works in.
    """
    module = path.partition(":")[0]
    inner = getattr(factory, "__module__", None) or module
    if file is None:
        file = _defining_file(factory)
    else:
        inner = file.stem  # no import path leads to it
    sources = None if file is None else sources_of(file, inner, root or Path.cwd())
    distribution = _distribution_of(module.partition(".")[0], file)
    return {
        "path": path,
        "params": dict(params),
        "distribution": distribution,
        "version": None if distribution is None else _version(distribution),
        "digest": None if sources is None else sources.digest,
        "file_count": 0 if sources is None else len(sources.named),
        "files": [] if sources is None else sources.files,
        "sources": {} if sources is None else sources.named,
    }


def _defining_file(factory: Callable[..., Any]) -> Path | None:
    try:
        name = inspect.getsourcefile(factory)
    except TypeError:  # built in, or written in C
        return None
    return Path(name).absolute() if name and Path(name).is_file() else None


def _packages() -> list[str]:
    """List packages that may change results, and all that pytest-dura requires."""
    try:
        required = metadata.requires(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError:  # run from its sources
        required = []
    names = {name.lower(): name for name in _PACKAGES}
    for requirement in required:
        name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
        if "extra ==" not in requirement:
            names.setdefault(name.lower(), name)
    return list(names.values())


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _distribution_of(top: str, file: Path | None) -> str | None:
    """Find the distribution that a top-level module is installed from."""
    within = file is not None and is_installed(file)
    try:
        likely = metadata.distribution(top.replace("_", "-"))
    except (metadata.PackageNotFoundError, ValueError):
        # Slow: all distributions are read, so only if one of them has the file.
        return _owners().get(top, [None])[0] if within else None
    # A module of the user's own may be called like a distribution that has nothing to do with it.
    editable = likely.read_text("direct_url.json") is not None
    name: str = likely.metadata["Name"]
    return name if within or editable else None


@cache
def _owners() -> Mapping[str, list[str]]:
    """Distributions by the packages and modules that they bring."""
    owners = metadata.packages_distributions()
    if sys.version_info < (3, 11):
        # Python 3.10 reads top_level.txt alone, which few of today's build tools write.
        owners = {package: list(names) for package, names in owners.items()}
        for distribution in metadata.distributions():
            if distribution.read_text("top_level.txt"):
                continue
            for package in {
                file.parts[0] if len(file.parts) > 1 else file.stem
                for file in distribution.files or ()
                if file.suffix == ".py"
            }:
                owners.setdefault(package, []).append(distribution.metadata["Name"])
    return owners


def _git(root: Path, evidence: Path) -> dict[str, Any]:
    """Describe the commit and whether files differ from it; ``None`` outside a repository."""
    # To start git in vain takes longer than all the rest: it looks in the same places.
    may_be_one = "GIT_DIR" in os.environ or any(
        (folder / name).exists()
        for folder in {root, *root.parents, *_resolved(root).parents, _resolved(root)}
        for name in (".git", "HEAD")  # the latter in a bare one
    )
    commit = _ask_git(root, "rev-parse", "HEAD") if may_be_one else None
    if commit is None:
        return {"commit": None, "dirty": None}
    places = ["."]
    if root in evidence.parents:
        places.append(f":(exclude){evidence.relative_to(root).as_posix()}")
    changes = _ask_git(root, "status", "--porcelain", "--", *places)
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _ask_git(root: Path, *command: str) -> str | None:
    try:
        completed = subprocess.run(
            ["git", *command], cwd=root, capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):  # no git here
        return None
    return completed.stdout.strip() if completed.returncode == 0 else None
