"""The files for forges and containers: their schemas, and what of them can be run here."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
import yaml
from check_jsonschema import main as check_jsonschema
from click.testing import CliRunner

from pytest_dura.__main__ import main

REPOSITORY = Path(__file__).parents[2]
TEMPLATE = "pytest_dura/project_template/dot_github/workflows/dura.yml.in"
SCHEMAS = {
    ".github/workflows/docs.yml": "github-workflows",
    ".github/workflows/release.yml": "github-workflows",
    ".github/workflows/tests.yml": "github-workflows",
    TEMPLATE: "github-workflows",
    ".github/ISSUE_TEMPLATE/bug.yml": "github-issue-forms",
    ".github/ISSUE_TEMPLATE/idea.yml": "github-issue-forms",
    ".github/ISSUE_TEMPLATE/config.yml": "github-issue-config",
    ".github/dependabot.yml": "dependabot",
    "action.yml": "github-actions",
    "CITATION.cff": "citation-file-format",
}
PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]


def read(name: str) -> dict:
    return yaml.safe_load((REPOSITORY / name).read_text("utf-8"))


@pytest.mark.parametrize("file", SCHEMAS)
def test_a_file_agrees_with_the_schema_of_its_forge(file):
    command = ["--default-filetype", "yaml", "--builtin-schema", f"vendor.{SCHEMAS[file]}"]
    result = CliRunner().invoke(check_jsonschema, [*command, str(REPOSITORY / file)])
    assert result.exit_code == 0, result.output


def test_a_file_that_breaks_its_schema_is_noticed(tmp_path):
    text = (REPOSITORY / "action.yml").read_text()
    (tmp_path / "action.yml").write_text(text.replace("using: composite", "used: composite"))
    command = ["--builtin-schema", "vendor.github-actions", str(tmp_path / "action.yml")]
    assert CliRunner().invoke(check_jsonschema, command).exit_code == 1


def test_every_file_for_a_forge_has_a_schema():
    folder = REPOSITORY / ".github"
    files = {file.relative_to(REPOSITORY).as_posix() for file in folder.rglob("*.y*ml")}
    assert files == {name for name in SCHEMAS if name.startswith(".github")}


@pytest.mark.parametrize("name", [name for name in SCHEMAS if "workflows" in name])
def test_a_workflow_may_do_little_for_a_limited_time_with_actions_of_one_version(name):
    workflow = read(name)
    assert workflow["permissions"] == {"contents": "read"}
    for job_name, job in workflow["jobs"].items():
        assert job["timeout-minutes"] <= 60
        rights = job.get("permissions", {})
        assert rights == ({"id-token": "write"} if job_name == "publish" else {})
        used = [step["uses"] for step in job["steps"] if "uses" in step]
        assert all(re.search(r"@(v\d+|release/v1)$", each) for each in used)


def test_the_matrices_have_the_pythons_of_nox():
    declared = re.search(r"PYTHONS = (\[.*\])", (REPOSITORY / "noxfile.py").read_text())[1]
    assert json.loads(declared) == PYTHONS
    jobs = read(".github/workflows/tests.yml")["jobs"]
    for job in ("pythons", "package"):
        assert jobs[job]["strategy"]["matrix"]["python"] == PYTHONS
        assert jobs[job]["strategy"]["fail-fast"] is False


def test_the_release_is_published_without_a_stored_secret():
    text = (REPOSITORY / ".github/workflows/release.yml").read_text()
    assert "secrets." not in text
    assert "password" not in text
    publish = read(".github/workflows/release.yml")["jobs"]["publish"]
    assert publish["environment"] == "release"
    assert publish["needs"] == "build"


class Action:
    """The shell steps of the composite action, run as a forge would run them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.steps = {
            step["name"]: step for step in read("action.yml")["runs"]["steps"] if "run" in step
        }

    def run(self, name: str, path: Path | str, **env: str) -> int:
        step = self.steps[name]
        assert set(step["env"]) == set(env)
        assert step["shell"] == "bash"
        script = self.folder.parent / "step.sh"
        script.write_text(step["run"])
        for file in ("output", "summary"):
            (self.folder.parent / file).write_text("")
        kept = {key: value for key, value in os.environ.items() if "PYTEST" not in key}
        self.done = subprocess.run(
            ["/bin/bash", "--noprofile", "--norc", "-eo", "pipefail", str(script)],
            cwd=self.folder, capture_output=True, text=True, check=False, timeout=120,
            env={
                **kept, **env, "PATH": f"{path}{os.pathsep}{os.environ['PATH']}",
                "GITHUB_OUTPUT": str(self.folder.parent / "output"),
                "GITHUB_STEP_SUMMARY": str(self.folder.parent / "summary"),
            },
        )  # fmt: skip
        return self.done.returncode

    def written(self, file: str) -> str:
        return (self.folder.parent / file).read_text()


@pytest.fixture
def action(tmp_path):
    assert main(["init", str(tmp_path / "project")]) == 0
    return Action(tmp_path / "project")


def test_the_action_gates_a_project_and_shows_its_summary(action):
    given = {"ARGUMENTS": "--dura-runs=1 -p no:cacheprovider", "EVIDENCE": "kept"}
    assert action.run("Run the scenarios", Path(sys.executable).parent, **given) == 0, action.done
    assert action.written("output").splitlines()[-1] == "gate=passed"
    assert action.written("summary") == (action.folder / "kept" / "summary.md").read_text()
    assert action.done.stdout.splitlines()[-1] == "intact"


def test_the_action_fails_with_the_gate_and_shows_its_summary_all_the_same(action):
    planner = action.folder / "planner.py"
    planner.write_text(planner.read_text().replace('"proceed", "nobody', '"wait", "nobody'))
    given = {"ARGUMENTS": "--dura-runs=1", "EVIDENCE": "dura-evidence"}
    assert action.run("Run the scenarios", Path(sys.executable).parent, **given) == 1, action.done
    assert action.written("output") == "gate=failed\n"
    assert "failed" in action.written("summary")


def test_the_action_installs_itself_and_what_the_project_asks_for(action, tmp_path):
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "python").write_text('#!/bin/sh\nfor each; do echo "<$each>"; done\n')
    (programs / "python").chmod(0o755)
    assert action.run("Install", programs, OWN="-e .", DURA="here/the action") == 0
    shown = action.done.stdout.split("\n")
    assert shown == ["<-m>", "<pip>", "<install>", "<here/the action>", "<-e>", "<.>", ""]
    assert action.run("Install", programs, OWN="", DURA="pytest-dura") == 0
    assert action.done.stdout.splitlines()[-1] == "<pytest-dura>"


def test_every_input_of_the_action_is_used_and_described():
    read_action = read("action.yml")
    text = (REPOSITORY / "action.yml").read_text()
    page = (REPOSITORY / "docs" / "how-to" / "ci.md").read_text("utf-8")
    for name in read_action["inputs"]:
        assert f"inputs.{name}" in text
        assert f"`{name}`" in page


def test_the_container_recipe_copies_what_the_wheel_is_built_from(tmp_path):
    """No container is run here: this is its build step, on what `.dockerignore` lets through."""
    lines = (REPOSITORY / ".dockerignore").read_text().splitlines()
    assert lines[0] == "*"
    context = tmp_path / "context"
    context.mkdir()
    for name in (line[1:] for line in lines if line.startswith("!")):
        source = REPOSITORY / name
        if source.is_dir():
            shutil.copytree(source, context / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, context)
    build = ["-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(context)]
    done = subprocess.run(
        [sys.executable, *build], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    names = ZipFile(wheel).namelist()
    assert "pytest_dura/scenarios/requirements.yaml" in names
    assert "pytest_dura/project_template/planner.py.in" in names


def test_the_container_does_not_run_as_root():
    recipe = (REPOSITORY / "Containerfile").read_text().splitlines()
    *_, user = (line for line in recipe if line.startswith("USER "))
    (made,) = (line for line in recipe if "useradd" in line)
    assert user.removeprefix("USER ") in made.split()
    assert not any(line.startswith("RUN") for line in recipe[recipe.index(user) :])


def test_the_development_container_is_set_up_as_contributing_says():
    container = json.loads((REPOSITORY / ".devcontainer" / "devcontainer.json").read_text())
    (line,) = re.findall(
        r"^(python3 -m venv .*)$", (REPOSITORY / "CONTRIBUTING.md").read_text(), re.MULTILINE
    )
    made, _, installed, _ = line.split(" && ")
    assert container["postCreateCommand"] == f"{made} && .venv/bin/{installed}"
