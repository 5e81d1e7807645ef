"""Where a session ran: Python, platform, packages, commit; and what was under test."""

from __future__ import annotations

import hashlib
import inspect
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from pytest_dura.provenance.places import is_installed
from pytest_dura.provenance.sources import sources_of

OURS = "pytest-dura"
PACKAGES = (
    "pytest-dura", "pytest", "pytest-xdist", "hypothesis", "highway-env", "gymnasium",
    "allure-pytest", "numpy", "scipy", "pydantic", "PyYAML",
)  # fmt: skip


def describe_environment(root: Path, evidence: Path) -> dict[str, Any]:
    """Versions and platform, and the state of the git repository at ``root``, if it is one.

    Args:
        root: The project's root.
        evidence: The evidence folder, whose files do not make the repository dirty.
    """
    return {
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "machine": platform.machine(),
        "byte_order": sys.byteorder,
        **describe_arithmetic(),
        "packages": {name: version for name in _packages() if (version := _version(name))},
        "git": _git(root, evidence),
    }


def describe_arithmetic() -> dict[str, Any]:
    """What the last bit of a sum depends on, and with it every digest.

    ``cpu_features`` are the instruction sets that NumPy uses on this machine, ``blas`` is the
    library that multiplies its matrices; ``None`` where NumPy does not tell.
    """
    import numpy as np

    found: Any = np.show_config(mode="dicts")
    simd = found.get("SIMD Extensions")
    blas = found.get("Build Dependencies", {}).get("blas")
    features = None if simd is None else [*simd.get("baseline", []), *simd.get("found", [])]
    told = None if not blas else f"{blas.get('name', '')} {blas.get('version', '')}".strip()
    return {"cpu_features": features, "blas": told}


def describe_hypothesis() -> dict[str, Any] | None:
    """The profile of Hypothesis that is loaded, and what of it says which cases were tried.

    Tests may have settings of their own. ``None`` where nothing has imported Hypothesis.
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


NUMERIC = ("numpy", "scipy", "highway-env", "gymnasium")
"""Packages whose versions are told one by one, since most episodes rest on them."""
_TOOLS = ("pytest", "hypothesis", "allure", "execnet", "ruff", "mypy", "pip", "setuptools", "dask",
          "distributed")  # fmt: skip
"""How the names of packages begin that run, distribute or check, and compute no episode."""


def describe_packages() -> dict[str, str]:
    """The versions of what is installed here and may change an episode.

    Components may rest on any package; the names of the metadata folders on the path say which are
    there, in what versions, without reading them.
    """
    found: set[str] = set()
    for place in sys.path:
        try:
            names = [one.name for one in Path(place or ".").iterdir()]
        except OSError:  # no folder, or not for us to read
            continue
        found.update(Path(one).stem for one in names if one.endswith((".dist-info", ".egg-info")))
    rest = sorted(name for name in found if not name.lower().startswith((*_TOOLS, "pytest_dura")))
    told = {name: version for name in NUMERIC if (version := _version(name))}
    return {**told, "other packages": hashlib.sha256("\n".join(rest).encode()).hexdigest()}


def describe_component(
    path: str,
    factory: Callable[..., Any],
    params: Mapping[str, Any],
    file: Path | None = None,
    root: Path | None = None,
) -> dict[str, Any]:
    """Import path, distribution and version, a digest of the sources, and that of each of them.

    See :func:`pytest_dura.provenance.sources.sources_of` for what belongs to a component.

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
    """What may change results, and whatever else our own distribution requires."""
    try:
        required = metadata.requires(OURS) or []
    except metadata.PackageNotFoundError:  # run from its sources
        required = []
    found = {name.lower(): name for name in PACKAGES}
    for one in required:
        name = re.split(r"[^A-Za-z0-9._-]", one, maxsplit=1)[0]
        if "extra ==" not in one:
            found.setdefault(name.lower(), name)
    return list(found.values())


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _distribution_of(top: str, file: Path | None) -> str | None:
    """The distribution that a top-level module belongs to, if it is installed from one."""
    within = file is not None and is_installed(file)
    try:
        likely = metadata.distribution(top.replace("_", "-"))
    except (metadata.PackageNotFoundError, ValueError):
        # All distributions are looked through only where one of them has the file.
        return _owners().get(top, [None])[0] if within else None
    # A module of the user's own may be called like a distribution that has nothing to do with it.
    editable = likely.read_text("direct_url.json") is not None
    name: str = likely.metadata["Name"]
    return name if within or editable else None


@cache
def _owners() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def _git(root: Path, evidence: Path) -> dict[str, Any]:
    """Commit and whether files differ from it; both ``None`` outside a repository."""
    commit = _ask_git(root, "rev-parse", "HEAD")
    if commit is None:
        return {"commit": None, "dirty": None}
    places = ["."]
    if root in evidence.parents:
        places.append(f":(exclude){evidence.relative_to(root).as_posix()}")
    changes = _ask_git(root, "status", "--porcelain", "--", *places)
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _ask_git(root: Path, *command: str) -> str | None:
    try:
        found = subprocess.run(
            ["git", *command], cwd=root, capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):  # no git here
        return None
    return found.stdout.strip() if found.returncode == 0 else None
