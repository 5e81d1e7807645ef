"""Where a session ran: Python, platform, packages, commit; and what was under test."""

from __future__ import annotations

import hashlib
import inspect
import platform
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = (
    "pytest-dura", "pytest", "pytest-xdist", "hypothesis", "highway-env", "gymnasium", "rtamt",
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
        "packages": {name: version for name in PACKAGES if (version := _version(name))},
        "git": _git(root, evidence),
    }


def describe_component(
    path: str, factory: Callable[..., Any], params: Mapping[str, Any], file: Path | None = None
) -> dict[str, Any]:
    """Import path, version of its distribution and SHA-256 of the file that defines it.

    Args:
        path: The component's import path.
        factory: Its class, or the function that makes it.
        params: The parameters it is made with.
        file: The file that defines it, where the factory does not tell.
    """
    digest = None
    if file is None:
        try:
            file = Path(inspect.getsourcefile(factory) or "")
        except TypeError:  # built in, or written in C
            file = Path()
    if file.is_file():
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
    module = path.partition(":")[0]
    return {
        "path": path,
        "params": dict(params),
        "version": _version_of_module(module.partition(".")[0]),
        "digest": digest,
    }


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


@cache
def _version_of_module(top: str) -> str | None:
    owners = metadata.packages_distributions().get(top)
    return _version(owners[0]) if owners else None


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
