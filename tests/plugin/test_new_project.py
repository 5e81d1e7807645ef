"""``python -m pytest_dura init``: a project that is green at once, and judges its own planner."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from pytest_dura.__main__ import main

FILES = {
    ".github/workflows/dura.yml", ".gitignore", "README.md", "conftest.py", "planner.py",
    "pyproject.toml", "scenarios/crossing.yaml", "scenarios/requirements.yaml",
}  # fmt: skip
PAGE = Path(__file__).parents[2] / "docs" / "init.md"
BREAKS = [
    ("if crosses and not has_passed", "if False"),
    ('Proposal("proceed", "nobody comes")', 'Proposal("wait", "stays")'),
]
GREEN = "gate: passed, 1 supported"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a new project, which nothing was run in."""
    folder = tmp_path_factory.mktemp("new") / "My first Planner"
    assert main(["init", str(folder)]) == 0
    return folder


@pytest.fixture
def new_project(project, made):
    """A copy of the new project, to run sessions in."""
    for held in list(project.path.iterdir()):
        shutil.rmtree(held) if held.is_dir() else held.unlink()
    for name in FILES:
        project.write(name, (made / name).read_text("utf-8"))
    return project


def change_planner(project, old, new):
    text = (project.path / "planner.py").read_text("utf-8")
    assert text.count(old) == 1
    project.write("planner.py", text.replace(old, new))


def test_a_new_project_is_green_and_judges_its_own_planner(new_project):
    result = new_project.run_apart()
    assert result.ret == 0, result.stdout.str()
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*fixture `generator` in conftest.py*", GREEN])
    record = new_project.evidence()
    assert [case.component for case in record.cases] == ["Planner"]
    assert new_project.verdicts() == {("crossing/traffic", "CROSS-1"): "supported"}
    assert main(["verify", str(new_project.path / "dura-evidence")]) == 0


@pytest.mark.parametrize("old, new", BREAKS, ids=["looks at nobody", "never goes"])
def test_a_planner_that_is_broken_turns_it_red(new_project, old, new):
    change_planner(new_project, old, new)
    result = new_project.run_apart()
    assert result.ret == 1
    result.stdout.fnmatch_lines(["gate: failed, 1 violated"])
    violations = new_project.verdict("CROSS-1", "crossing/traffic").violations
    assert violations == 10 or f"{violations} of 10 runs\ncollide" in PAGE.read_text("utf-8")


def test_the_page_names_every_file_and_what_breaks_the_planner(made):
    page = PAGE.read_text("utf-8")
    assert all(f"`{name}`" in page for name in FILES)
    (old, new), _ = BREAKS
    assert f"`{old}` becomes `{new}`" in page
    assert old in (made / "planner.py").read_text("utf-8")


def test_what_is_made_is_named_and_nothing_else_is(made, tmp_path, capsys):
    assert main(["init", str(tmp_path / "a" / "b")]) == 0
    folder = tmp_path / "a" / "b"
    names = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    assert names == FILES
    *written, last = capsys.readouterr().out.splitlines()
    assert set(written) == {f"written: {folder / name}" for name in FILES}
    assert last == "run `pytest` there"


def test_a_project_of_a_system_of_one_s_own_is_green_and_turns_red(project, tmp_path):
    folder = tmp_path / "tank"
    assert main(["init", "--domain", str(folder)]) == 0
    for held in list(project.path.iterdir()):
        shutil.rmtree(held) if held.is_dir() else held.unlink()
    shutil.copytree(folder, project.path, dirs_exist_ok=True)
    result = project.run_apart(".")
    assert result.ret == 0, result.stdout.str()
    assert project.verdicts() == {
        ("tank/filling", "LEVEL-1"): "supported",
        ("tank/filling", "LEVEL-2"): "supported",
        ("tank/filling+bias", "LEVEL-1"): "supported",
    }
    assert [case.component for case in project.evidence().cases][:1] == ["Controller"]
    page = PAGE.read_text("utf-8")
    files = [file.relative_to(folder) for file in folder.rglob("*") if file.is_file()]
    assert all(f"`{file.as_posix()}`" in page for file in files)
    scenario = (folder / "scenarios/filling.yaml").read_text("utf-8")
    project.write("scenarios/filling.yaml", scenario.replace("offset: -0.1", "offset: -0.5"))
    result = project.run_apart("--dura-select=tank/filling")
    assert result.ret == 0  # the case of this name alone
    assert project.verdicts() == {("tank/filling", "LEVEL-1"): "supported"}
    result = project.run_apart()
    assert result.ret == 1
    assert project.verdicts()["tank/filling+bias", "LEVEL-1"] == "violated"


def test_the_scripts_of_the_page_run_judge_and_plot(tmp_path, forked_workers):
    folder = tmp_path / "tank"
    assert main(["init", "--domain", str(folder)]) == 0
    scripts = [
        block.partition("```")[0]
        for block in PAGE.read_text("utf-8").partition("## From a script")[2].split("```python")[1:]
    ]
    ends = ["satisfied 0.35", "violated True"]
    assert len(scripts) == len(ends)
    for number, (script, end) in enumerate(zip(scripts, ends, strict=True)):
        assert len([line for line in script.splitlines() if line and "import" not in line]) <= 5
        (folder / f"script_{number}.py").write_text(script)
        done = subprocess.run(
            forked_workers.command(f"script_{number}.py"),
            cwd=folder, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(end)
    assert {file.name for file in folder.glob("*.svg")} == {"level.svg", "gap.svg"}


def test_the_project_is_a_package_of_its_folders_name(made, tmp_path):
    build = ["-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path), str(made)]
    done = subprocess.run(
        [sys.executable, *build], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (archive,) = tmp_path.glob("*.tar.gz")
    assert archive.name == "my_first_planner-0.1.0.tar.gz"
    with tarfile.open(archive) as opened:
        assert any(name.endswith("/planner.py") for name in opened.getnames())


def test_an_empty_folder_is_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "."]) == 0
    assert {file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("*.*")} >= FILES


def test_a_folder_that_holds_something_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "planner.py").write_text("mine")
    assert main(["init", str(tmp_path)]) == 2
    assert [file.name for file in tmp_path.iterdir()] == ["planner.py"]
    assert (tmp_path / "planner.py").read_text() == "mine"
    error = capsys.readouterr().err
    assert "this directory is not empty" in error
    assert "found:    'planner.py'" in error


@pytest.mark.parametrize("name", ["file", "file/below"])
def test_what_is_no_folder_is_one_error(tmp_path, capsys, name):
    (tmp_path / "file").write_text("")
    assert main(["init", str(tmp_path / name)]) == 2
    error = capsys.readouterr().err
    assert "the project cannot be written: Not a directory" in error
    assert "Traceback" not in error
