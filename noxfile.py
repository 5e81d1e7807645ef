"""What is checked, by `nox` or by `nox --session NAME`; `.ci/run` and the workflows call the same.

Each session makes an environment of its own; `nox --no-venv --no-install` takes the one that nox
runs in, which then has the extra `dev`.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import nox
from packaging.requirements import Requirement

nox.needs_version = ">=2024.4.15"
nox.options.sessions = ["lint", "types", "tests"]
nox.options.error_on_missing_interpreters = False

PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]
EVIDENCE = "dura-evidence"
EXTRAS = ["dask", "dds", "fmi", "jsbsim", "llm", "signing", "sumo"]
"""What users may install beside the package."""
LOWEST_TESTS = [
    "tests/plugin/test_what_counts.py",
    "tests/plugin/test_scenario_items.py",
    "tests/properties/test_campaign_laws.py",
    "tests/properties/test_episode_codec.py",
    "tests/unit/adapters/test_fmi.py",
    "tests/unit/llm/test_answers.py",
]
"""Sessions with and without workers, laws, and what rests on an extra; some two minutes."""


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run the tests on every core; what follows `--` is handed on to pytest."""
    session.install("-e", ".[dev]")
    session.run("pytest", "-n", "auto", "--dist", "worksteal", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Look at style, form and the directions of imports."""
    session.install("-e", ".[dev]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports")


@nox.session
def types(session: nox.Session) -> None:
    """Check the types."""
    session.install("-e", ".[dev]")
    session.run("mypy")


@nox.session
def gate(session: nox.Session) -> None:
    """Run the built-in scenarios with two engines for formulas, and verify their evidence.

    This checkout has no others: its folder `scenarios` is that of the built-in ones.
    """
    session.install("-e", ".[dev]")
    session.run("pytest", "--dura-scenarios", "-o", "dura_stl_engine=both", *session.posargs)
    session.run("python", "-m", "pytest_dura", "verify", EVIDENCE)


@nox.session
def house(session: nox.Session) -> None:
    """Run the tests of the package without its guests: driving, llm, adapters and the like."""
    session.install("-e", ".[dev]")
    session.run("python", "tests/support/house.py", "-n", "auto", *session.posargs)


@nox.session
def lowest(session: nox.Session) -> None:
    """Run a part of the tests with the lowest version that is stated of each dependency.

    It takes Python 3.10 or 3.11, for which those versions have wheels; pip finds them where it
    finds all others.
    """
    with tempfile.TemporaryDirectory() as folder:
        python = _fresh_python(session, Path(folder).resolve())
        floors = Path(folder, "floors.txt")
        floors.write_text("\n".join(_floors()))
        install = ["-m", "pip", "install", "--quiet", "--constraint", str(floors)]
        own = ["--editable", f".[{','.join(EXTRAS)}]", "psutil", "pythonfmu", "pythonfmu3"]
        session.run(python, *install, *own, external=True)
        session.run(python, "-m", "pytest", *(session.posargs or LOWEST_TESTS), external=True)


def _floors() -> list[str]:
    """State the lowest version that is allowed of each dependency and extra, as constraints."""
    project = nox.project.load_toml("pyproject.toml")["project"]
    extras = project["optional-dependencies"]
    texts = [*project["dependencies"], *(text for extra in EXTRAS for text in extras[extra])]
    floors = []
    for requirement in map(Requirement, texts):
        (floor,) = (bound.version for bound in requirement.specifier if bound.operator == ">=")
        marker = "" if requirement.marker is None else f"; {requirement.marker}"
        floors.append(f"{requirement.name}=={floor}{marker}")
    return floors


@nox.session
def docs(session: nox.Session) -> None:
    """Build the site; a broken link or reference is an error."""
    session.install("-e", ".[docs]")
    session.run("mkdocs", "build", "--strict", *session.posargs)


@nox.session
def figures(session: nox.Session) -> None:
    """Measure the marked figures of the documentation anew, for hours; `-- against_gym` a part."""
    session.install("-e", ".[dev]")
    session.run("python", "docs/figures.py", *session.posargs)


@nox.session
def package(session: nox.Session) -> None:
    """Build into `dist`, and use the wheel in an environment that has nothing else."""
    session.install("build", "twine")
    shutil.rmtree("dist", ignore_errors=True)
    session.run("python", "-m", "build")
    built = sorted(Path("dist").resolve().iterdir())
    session.run("twine", "check", "--strict", *map(str, built))
    (wheel,) = (file for file in built if file.suffix == ".whl")

    # Elsewhere, since pytest finds the settings of any folder above.
    with tempfile.TemporaryDirectory() as folder:
        _use(session, wheel, Path(folder).resolve())


def _use(session: nox.Session, wheel: Path, folder: Path) -> None:
    """Install a wheel where nothing else is, run the built-in scenarios, and begin a project."""
    python = _fresh_python(session, folder)

    def run(*arguments: str) -> None:
        session.run(python, "-m", *arguments, external=True)

    run("pip", "install", "--quiet", str(wheel))
    with session.chdir(folder):
        run("pytest", "--dura-scenarios")
        run("pytest_dura", "verify", EVIDENCE)
        run("pytest_dura", "init", "project")
    with session.chdir(folder / "project"):
        run("pytest")


def _fresh_python(session: nox.Session, folder: Path) -> str:
    """Make an environment that has nothing, and return its interpreter."""
    session.run("python", "-m", "venv", str(folder / "venv"))
    scripts = "Scripts" if (folder / "venv" / "Scripts").is_dir() else "bin"
    return str(folder / "venv" / scripts / "python")


@nox.session
def benchmarks(session: nox.Session) -> None:
    """Run each benchmark in its smallest setting, or the one named, such as `-- loop_cost.py`."""
    session.install("-e", ".[dev]")
    if session.posargs:
        script, *options = session.posargs
        session.run("python", f"benchmarks/{script}", *options)
    else:
        session.run("pytest", "-n", "auto", "tests/benchmarks")
