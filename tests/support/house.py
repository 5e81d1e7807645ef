"""The house alone: pytest-dura without the packages that are its guests, and the tests of it.

    python tests/support/house.py [ARGUMENTS OF PYTEST]

It copies the checkout without the guests, makes an environment with this one's dependencies and the
copy, and runs there the tests that import no guest and are not marked ``of_guest``, and those of
the domain of ``tests/third_party``.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
GUESTS = ("adapters", "drafts", "driving", "llm", "logs", "qualification")
"""Folders of the package that the house does without."""
TESTS = ("tests/unit", "tests/properties", "tests/packaging/test_third_party.py")
_OF_A_GUEST = re.compile(rf"pytest_dura\.(?:{'|'.join(GUESTS)})\b")


def copy_house(folder: Path) -> Path:
    """Copy package, scenarios, tests and settings without guests; return the copy's root."""
    root = folder / "house"
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("pytest_dura", "scenarios", "tests", "benchmarks"):
        shutil.copytree(ROOT / name, root / name, ignore=ignored)
    for guest in GUESTS:
        shutil.rmtree(root / "pytest_dura" / guest)
    # The built-in scenarios and requirements are of driving; their schemas are of the house.
    shutil.rmtree(root / "scenarios" / "intersection")
    (root / "scenarios" / "requirements.yaml").unlink()
    (root / "scenarios" / "hazards.yaml").unlink()
    for own in (root / "tests" / "unit").iterdir():
        if own.name in GUESTS:
            shutil.rmtree(own)
    settings = (ROOT / "pyproject.toml").read_text("utf-8").splitlines(keepends=True)
    kept = [line for line in settings if not re.search(rf"= \"{_OF_A_GUEST.pattern}", line)]
    (root / "pyproject.toml").write_text("".join(kept), "utf-8")
    return root


def make_environment(folder: Path, root: Path) -> Path:
    """Make an environment that has the house and all dependencies.

    Returns:
        Its interpreter.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    (site,) = (folder / "venv").rglob("site-packages")
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if "pytest_dura" not in entry.name:
            (site / entry.name).symlink_to(entry)
    _install(root, "pytest_dura", site)
    (site / "pytest_dura" / "scenarios").symlink_to(root / "scenarios")
    return Path(folder / "venv" / "bin" / "python")


def _install(project: Path, package: str, site: Path) -> None:
    """Put a package of a project into ``site-packages``, with its entry points."""
    (site / package).symlink_to(project / package)
    settings = tomllib.loads((project / "pyproject.toml").read_text("utf-8"))["project"]
    version = settings.get("version", "0")
    info = site / f"{package}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {settings['name']}\nVersion: {version}\n"
    )
    groups = settings["entry-points"].items()
    lines = [
        line
        for group, points in groups
        for line in [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))


def tests_with_guests(root: Path) -> Iterator[str]:
    """Yield the test modules that import a guest, by their paths from the root."""
    for module in sorted((root / "tests").rglob("test_*.py")):
        fixtures = (folder / "conftest.py" for folder in module.parents if root in folder.parents)
        if any(_uses_guest(file) for file in (module, *fixtures) if file.is_file()):
            yield module.relative_to(root).as_posix()


@cache
def _uses_guest(module: Path) -> bool:
    """Whether a module, or a helper of tests or benchmarks that it imports, imports a guest."""
    root = next(folder for folder in module.parents if (folder / "pyproject.toml").is_file())
    for name in _imported(module):
        if _OF_A_GUEST.match(name) or name in _names_of_guests(root):
            return True
        helpers = (root / folder / f"{name}.py" for folder in ("tests/support", "benchmarks"))
        beside = module.with_name(f"{name}.py")
        if any(file.is_file() and _uses_guest(file) for file in (*helpers, beside)):
            return True
    return False


@cache
def _names_of_guests(root: Path) -> frozenset[str]:
    """Names that the package exports from a guest."""
    tree = ast.parse((root / "pytest_dura" / "__init__.pyi").read_text("utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return frozenset(
        f"pytest_dura.{alias.name}"
        for node in imports
        if node.module and node.module.split(".")[0] in GUESTS
        for alias in node.names
    )


def _imported(module: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def main(arguments: list[str]) -> int:
    """Run the tests of the house; the exit code is pytest's."""
    with tempfile.TemporaryDirectory() as folder:
        root = copy_house(Path(folder).resolve())
        python = make_environment(root.parent, root)
        left_out = sorted(set(tests_with_guests(root)))
        print(f"{len(left_out)} modules of tests import a guest and are left out", flush=True)  # noqa: T201
        ignored = [f"--ignore={module}" for module in left_out]
        kept = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
        chosen = ["-m", "not of_guest", *TESTS, *ignored]
        return subprocess.run(
            [str(python), "-m", "pytest", "-q", *chosen, *arguments],
            cwd=root,
            env={**kept, "PYTHONPATH": ""},
            check=False,
        ).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
