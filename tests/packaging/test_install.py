"""The package as users get it: from a wheel, and from an editable install of this tree."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import venv
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import pytest

REPOSITORY = Path(__file__).parents[2]
SCENARIOS = sorted(file.stem for file in (REPOSITORY / "scenarios" / "intersection").glob("*.yaml"))
PROMPTS = REPOSITORY / "pytest_dura" / "llm" / "driving" / "templates"
TEMPLATES = sorted(
    file.relative_to(PROMPTS).as_posix() for file in PROMPTS.rglob("*") if file.is_file()
)
PACKAGE = REPOSITORY / "pytest_dura"
PROJECT_FILES = sorted(
    file.relative_to(PACKAGE).as_posix()
    for file in PACKAGE.glob("project_template*/**/*")
    if file.is_file()
)
TEST = """
def test_by_hand(orchestrator):
    assert orchestrator.run("intersection/nominal", seed=1).ever("cleared")
"""


@dataclass(frozen=True)
class Installation:
    """A virtual environment with the package in it, and what it is run from."""

    kind: str
    python: Path
    folder: Path

    def run(self, *arguments: str) -> str:
        return run(self.python, *arguments, cwd=self.folder)


def run(python: Path | str, *arguments: str, cwd: Path) -> str:
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "PYTEST", "COV_"))
    }
    done = subprocess.run(
        [str(python), *arguments],
        cwd=cwd,
        env=kept,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module", params=["wheel", "editable"])
def installation(request, tmp_path_factory):
    """The package alone is installed; its dependencies come from the environment of this test."""
    home = tmp_path_factory.mktemp(request.param)
    venv.create(home / "venv", with_pip=False, symlinks=os.name != "nt")
    scripts = "Scripts" if os.name == "nt" else "bin"
    python = home / "venv" / scripts / ("python.exe" if os.name == "nt" else "python")
    outside = home / "outside"
    outside.mkdir()
    (own,) = run(
        python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=outside
    ).splitlines()
    dependencies = [path for path in sys.path if Path(path).name.endswith("-packages")]
    Path(own, "zz_dependencies.pth").write_text("\n".join(dependencies))
    what = (
        [str(request.getfixturevalue("wheel"))]
        if request.param == "wheel"
        else ["--no-build-isolation", "--editable", str(REPOSITORY)]
    )
    pip = ["-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", *what]
    run(sys.executable, *pip, cwd=outside)
    return Installation(request.param, python, outside)


def test_the_wheel_holds_what_users_need_and_nothing_else(wheel: Path) -> None:
    names = set(ZipFile(wheel).namelist())
    (metadata,) = {name.split("/")[0] for name in names if name.endswith("/METADATA")}
    needed = {
        "pytest_dura/py.typed",
        "pytest_dura/scenarios/scenario.schema.json",
        "pytest_dura/scenarios/hazards.schema.json",
        "pytest_dura/scenarios/hazards.yaml",
        "pytest_dura/scenarios/requirements.yaml",
        *(f"pytest_dura/scenarios/intersection/{name}.yaml" for name in SCENARIOS),
        *(f"pytest_dura/llm/driving/templates/{name}" for name in TEMPLATES),
        *(f"pytest_dura/{name}" for name in PROJECT_FILES),
        f"{metadata}/licenses/LICENSE",
        f"{metadata}/entry_points.txt",
    }
    assert len(SCENARIOS) >= 6
    assert {
        "project_template/dot_github/workflows/dura.yml.in",
        "project_template_domain/tank.py.in",
    } <= set(PROJECT_FILES)
    assert {"system.j2", "few_shot.yaml", "paraphrased/system.j2"} <= set(TEMPLATES)
    assert needed <= names
    assert {name.split("/")[0] for name in names} == {"pytest_dura", metadata}
    modules = {
        file.relative_to(REPOSITORY).as_posix()
        for file in (REPOSITORY / "pytest_dura").rglob("*.py")
    }
    assert modules == {name for name in names if name.endswith(".py")}


def test_the_source_distribution_holds_the_example_suites_and_their_cassettes(tmp_path) -> None:
    build = ["-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path)]
    run(sys.executable, *build, str(REPOSITORY), cwd=tmp_path)
    (found,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(found) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    folder = "example_suites/llm_planner"
    assert {f"{folder}/null-model.sqlite", f"{folder}/conftest.py"} <= names
    assert "example_suites/paper/train/corpus.jsonl.gz" in names


def test_the_built_in_scenarios_are_those_of_this_installation(installation: Installation) -> None:
    code = (
        "import pytest_dura\n"
        "from pytest_dura.library.loading import builtin_paths\n"
        "print(pytest_dura.__file__)\n"
        "print(*builtin_paths())"
    )
    package, scenarios = map(Path, installation.run("-c", code).splitlines())
    in_environment = installation.folder.parent / "venv" in package.parents
    assert in_environment == (installation.kind == "wheel")
    home = package.parent if installation.kind == "wheel" else REPOSITORY
    assert scenarios == home / "scenarios"


def test_pytest_lists_the_built_in_scenarios(installation: Installation) -> None:
    listed = installation.run("-m", "pytest", "--dura-list")
    for name in SCENARIOS:
        assert f"intersection/{name}" in listed


def test_pytest_runs_an_episode(installation: Installation) -> None:
    (installation.folder / "test_by_hand.py").write_text(TEST)
    assert "1 passed" in installation.run("-m", "pytest", "-q", "test_by_hand.py")
