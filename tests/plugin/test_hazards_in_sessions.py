"""A session with a hazards file: its record and what is rendered, and what it refuses."""

from __future__ import annotations

import json
import re

import pytest
import yaml
from corridors import scenario

from pytest_dura.evidence import file_entry, manifest_text, verify_bundle

HAZARDS = """
hazards:
  - id: H-1
    text: The ego is nearer to the wall than it can stop.
    loss: "L-1: the wall"
    severity: S2
    operating_condition: At full speed.
    triggering_condition: The gap reads too great.
    source: STPA
    acceptance_criterion: The mayor's risk
    at_most: 0.001
  - {id: H-2, text: The ego stands., loss: "L-2: time", severity: S0}
  - {id: H-3, text: Nobody thought of it., loss: "L-1: the wall", severity: S3}
"""
TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("T-1", text="It stays away.", mitigates={mitigates})
def test_it(campaign):
    campaign.require("always (gap > 0)")
"""


def with_hazards(project, hazards=HAZARDS):
    project.write("scenarios/hazards.yaml", hazards)
    file = project.path / "scenarios/requirements.yaml"
    file.write_text(
        file.read_text()
        .replace("kind: safety\n", "kind: safety\n    mitigates: [H-1]\n")
        .replace("kind: performance\n", "kind: performance\n    mitigates: [H-1, H-2]\n")
    )


def test_a_session_answers_for_each_hazard_of_the_user(project):
    with_hazards(project)
    result = project.scenarios("-n", "2", "--dura-export=needs")
    assert result.ret == 0
    folder = project.path / "dura-evidence"
    record = project.evidence()
    assert [hazard.id for hazard in record.hazards] == ["H-1", "H-2", "H-3"]
    first = record.hazards[0]
    assert (first.severity, first.operating_condition) == ("S2", "At full speed.")
    assert {each.id: each.mitigates for each in record.requirements} == {
        "GAP-1": ("H-1",), "GO-1": ("H-1", "H-2"),
    }  # fmt: skip
    assert ("scenarios/hazards.yaml", "hazards") in [(e.path, e.kind) for e in record.inputs]
    assert "hazards without evidence: 1 of 3: H-3 (S3)" in result.outlines
    assert sum("hazards without" in line for line in result.outlines) == 1
    sentence = (
        "1 of 3 hazards without evidence, since no requirement of the session names it: H-3 (S3)."
    )
    summary = (folder / "summary.md").read_text()
    assert summary.partition("**Not shown**\n\n- ")[2].startswith(sentence)
    page = (folder / "report.html").read_text()
    assert sentence in page
    view = re.search('<section id="hazards".*?</section>', page, re.DOTALL)[0]
    assert re.findall(r'<th scope="row">(H-\d)</th>', view) == ["H-3", "H-1", "H-2"]
    assert "no ASIL follows" in view
    assert "each case at most 0.1 % of the runs violate a requirement on it" in view
    argument = yaml.safe_load((folder / "assurance-case.gsn.yaml").read_text())
    aliases = {node.get("alias"): node for node in argument.values()}
    assert "hazard:H-3" not in aliases
    assert "no requirement of the session names H-3." in aliases["not-shown:hazards"]["text"]
    assert "The mayor's risk" in aliases["accepted:H-1"]["text"]
    assert aliases["accepted:H-1"]["undeveloped"]
    assert aliases["hazard:H-2"]["supportedBy"] == ["G-GO-1"]
    needs = json.loads((folder / "needs.json").read_text())["versions"]["1.0"]["needs"]
    assert needs["REQUIREMENT-GO-1"]["links"] == ["HAZARD-H-1", "HAZARD-H-2"]
    assert needs["HAZARD-H-2"]["status"] == "supported"
    manifest = json.loads((folder / "manifest.json").read_text())
    assert "needs.json" in manifest["files"]
    assert verify_bundle(folder).problems == []


def test_verify_finds_needs_that_are_not_those_of_the_record(project):
    with_hazards(project)
    project.scenarios("--dura-export=needs")
    folder = project.path / "dura-evidence"
    file, manifest = folder / "needs.json", folder / "manifest.json"
    file.write_text(file.read_text().replace("no requirement", "supported"))
    problems = verify_bundle(folder).problems
    assert problems
    assert all(problem.startswith("needs.json: ") for problem in problems)
    # Nor with a manifest that was made to fit.
    entries = json.loads(manifest.read_text())["files"] | {"needs.json": file_entry(file)}
    manifest.write_text(manifest_text(entries))
    assert [problem.partition(":")[0] for problem in verify_bundle(folder).problems] == [
        "needs.json"
    ]


def test_hazards_are_recorded_where_nothing_came_of_their_items(project):
    with_hazards(project)
    project.write("conftest.py", "def pytest_runtest_setup(item): raise RuntimeError('broken')\n")
    assert project.scenarios().ret == 1
    assert [hazard.id for hazard in project.evidence().hazards] == ["H-1", "H-2", "H-3"]
    summary = (project.path / "dura-evidence/summary.md").read_text()
    assert "no verdict supports the mitigation of them: H-1 (S2), H-2 (S0)." in summary


def test_a_marker_names_the_hazards_of_its_requirement(project):
    with_hazards(project)
    project.write("test_it.py", TEST.format(mitigates='["H-3"]'))
    project.run("test_it.py").assert_outcomes(passed=1)
    record = project.evidence()
    assert ("T-1", ("H-3",)) in [(each.id, each.mitigates) for each in record.requirements]
    summary = (project.path / "dura-evidence/summary.md").read_text()
    # The requirements of its scenario are recorded, and no test was asked to judge them.
    assert "nothing was judged that is to mitigate them: H-1 (S2), H-2 (S0)." in summary
    assert [hazard.id for hazard in record.hazards] == ["H-1", "H-2", "H-3"]


@pytest.mark.parametrize(
    "mitigates, words",
    [
        ('["H-4"]', ["unknown hazard 'H-4'", "pytest.mark.requirement", "did you mean 'H-"]),
        ('"H-3"', ["`mitigates` is a list of ids of hazards", 'a list such as ["H-1"]']),
    ],
)
def test_a_marker_with_a_hazard_that_is_none_is_refused(project, mitigates, words):
    with_hazards(project)
    project.write("test_it.py", TEST.format(mitigates=mitigates))
    result = project.run("test_it.py")
    assert result.ret != 0
    for word in words:
        assert word in result.stdout.str()


def test_a_marker_may_not_name_other_hazards_than_the_file(project):
    with_hazards(project)
    project.write("test_it.py", TEST.format(mitigates='["H-3"]').replace("T-1", "GAP-1"))
    result = project.run("test_it.py")
    assert "another meaning than a requirement file" in result.stdout.str()


def test_a_file_that_cannot_be_used_is_an_error_before_anything_runs(project):
    with_hazards(project, HAZARDS.replace("severity: S2", "severity: fatal"))
    result = project.scenarios()
    assert result.ret != 0
    text = result.stdout.str() + result.stderr.str()
    assert "hazards.yaml:6" in text
    assert "hazards.0.severity" in text
    assert "Traceback" not in text


def test_secrets_in_hazards_are_redacted(project, monkeypatch):
    monkeypatch.setenv("SITE_PASSWORD", "correct-horse-battery")
    with_hazards(project, HAZARDS.replace("At full speed.", "With correct-horse-battery."))
    project.scenarios("--dura-export=needs")
    folder = project.path / "dura-evidence"
    assert "correct-horse" not in project.evidence().hazards[0].operating_condition
    for name in ("evidence.json", "needs.json", "report.html", "assurance-case.gsn.yaml"):
        assert "correct-horse" not in (folder / name).read_text()


def test_a_session_without_hazards_says_nothing_of_them(project):
    result = project.scenarios()
    folder = project.path / "dura-evidence"
    assert project.evidence().hazards is None
    assert "hazards without" not in result.stdout.str()
    assert '"hazards"' not in (folder / "evidence.json").read_text()


def test_built_in_hazards_are_recorded_as_far_as_a_requirement_names_them(project):
    scenario(project, requirements="[SAF-1, REC-2]")
    project.scenarios(select="corridor/it")
    assert [hazard.id for hazard in project.evidence().hazards] == ["H-INT-1", "H-INT-6"]
