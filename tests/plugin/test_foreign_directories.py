"""No session writes over what is none of its own, and no text makes a bundle of any size."""

from __future__ import annotations

import json

import pytest

LOUD = """
from corridor import Careful
class Loud(Careful):
    def propose(self, view):
        raise RuntimeError("x" * 5_000_000)
class Verbose(Careful):
    def propose(self, view):
        found = super().propose(view)
        return type(found)(found.action, "y" * 5_000_000)
"""


def refused(project, name, *arguments):
    """A session whose evidence directory holds a file that is not its to replace."""
    before = {one: one.read_bytes() for one in (project.path / "dura-evidence").rglob("*")
              if one.is_file()}  # fmt: skip
    result = project.run("corridor/free", *arguments)
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        ["ERROR: *dura-evidence: *", f"  found:    '{name}'", "  remedy: *"]
    )
    after = {one: one.read_bytes() for one in (project.path / "dura-evidence").rglob("*")
             if one.is_file()}  # fmt: skip
    assert after == before


@pytest.mark.parametrize("name", ["notes.txt", "summary.md", "episodes/mine.txt", "sub/a.yaml"])
def test_a_directory_with_other_files_is_refused(project, name):
    project.write(f"dura-evidence/{name}", "mine\n")
    refused(project, name)


@pytest.mark.parametrize("text", ["{}", "", '{"tool": {"name": "other"}}', "[1, 2"])
def test_a_record_of_another_tool_is_refused(project, text):
    project.write("dura-evidence/evidence.json", text)
    refused(project, "evidence.json")


def test_a_file_that_the_manifest_does_not_list_is_refused(project):
    assert project.run("corridor/free").ret == 0
    project.write("dura-evidence/notes.txt", "mine\n")
    refused(project, "notes.txt")
    (project.path / "dura-evidence/notes.txt").unlink()
    assert project.run("corridor/free").ret == 0


def test_evidence_goes_through_no_link(project):
    (project.path / "elsewhere").mkdir()
    try:
        (project.path / "dura-evidence").symlink_to("elsewhere")
    except OSError:
        pytest.skip("the system has no symbolic links")
    result = project.run("corridor/free")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: *: the evidence directory is a symbolic link"])
    assert list((project.path / "elsewhere").iterdir()) == []


def test_what_a_killed_session_left_is_replaced(project):
    assert project.run("corridor/free", "--dura-evidence-level=all").ret == 0
    evidence = project.path / "dura-evidence"
    record = json.loads((evidence / "evidence.json").read_text())
    (evidence / "evidence.json").write_text(json.dumps({**record, "status": "running"}))
    (evidence / "manifest.json").unlink()
    project.write("dura-evidence/.evidence.json-abc", "{")
    project.write("dura-evidence/.episodes/ab/ab12.episode", "")
    assert project.run("corridor/free").ret == 0


@pytest.mark.parametrize("name, word", [("Loud", "x"), ("Verbose", "y")])
def test_a_long_text_of_a_component_is_cut_where_it_enters(project, name, word):
    project.write("loud.py", LOUD)
    project.run("corridor/tight", f"--dura-generator=loud:{name}", "--dura-evidence-level=all")
    evidence = project.path / "dura-evidence"
    size = sum(one.stat().st_size for one in evidence.rglob("*") if one.is_file())
    assert size < 20_000_000
    events = [one.detail for one in project.evidence().episodes[0].events]
    assert name == "Verbose" or any("… (4990000 characters cut)" in one for one in events)


def test_a_file_with_many_unknown_keys_lists_some(project):
    keys = "".join(f"key_{number}: 1\n" for number in range(300))
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    project.write("scenarios/corridor/tight.yaml", text + keys)
    result = project.run("corridor/tight")
    assert result.ret == 4
    shown = result.stderr.str()
    assert shown.count("unknown key") == 20
    assert "  and 280 more" in shown
