"""The digest of our own code: what tells installations of one version apart."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pytest_dura
from pytest_dura import provenance
from pytest_dura.execution import describe_machine

TOLD = "from pytest_dura.provenance import describe_tool; print(describe_tool()['code'])"


def told_by(root: Path) -> str:
    command = [sys.executable, "-c", TOLD]
    return subprocess.run(
        command, env={"PYTHONPATH": str(root)}, cwd=root, capture_output=True, text=True, check=True
    ).stdout.strip()


def test_it_is_the_same_wherever_it_lies_and_another_one_after_a_change(tmp_path: Path) -> None:
    package = Path(pytest_dura.__file__).parent
    shutil.copytree(package, tmp_path / "pytest_dura", ignore=shutil.ignore_patterns("__pycache__"))
    here = provenance.describe_tool()
    assert told_by(tmp_path) == here["code"]
    with (tmp_path / "pytest_dura/core/seeding.py").open("a", encoding="utf-8") as file:
        file.write("# edited\n")
    edited = told_by(tmp_path)
    assert len(edited) == len(here["code"])
    assert edited != here["code"]


def test_addresses_of_episodes_hold_it() -> None:
    assert describe_machine()["code of pytest-dura"] == provenance.describe_tool()["code"]


def test_where_our_files_cannot_be_read_the_version_stands_for_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(provenance, "__file__", "/nowhere/zipped/pytest_dura/provenance/ours.py")
    told = provenance.describe_tool.__wrapped__()
    assert told == {"name": "pytest-dura", "version": pytest_dura.__version__, "code": None}
    monkeypatch.setattr(provenance, "describe_tool", lambda: told)
    assert provenance.tool_code() == f"version {pytest_dura.__version__}"
