"""Sessions with a drafted requirement: it supports nothing until a person has signed it."""

from __future__ import annotations

import yaml
from corridors import expect, scenario

from pytest_dura.__main__ import main
from pytest_dura.evidence import verify_bundle

MADE = "drafted, not reviewed: a model, server 0123, prompt sha256:00; catches 1 of 2"
REVIEW = "who: A. Person, safety engineer\nwhen: 2026-01-02\nwhat: bound and reason\ndecision: {}\n"


def drafted(project, check="always (gap > 0)", source=MADE):
    entry = {"id": "R-1", "text": "As it should be.", "kind": "safety", "source": source,
             "check": check, "reason": "So."}  # fmt: skip
    project.write("scenarios/requirements_R.yaml", yaml.safe_dump({"requirements": [entry]}))


def decide(project, decision):
    project.write("review.yaml", REVIEW.format(decision))
    file = project.path / "scenarios" / "requirements_R.yaml"
    return main(["review", str(file), str(project.path / "review.yaml")])


def test_an_unsigned_draft_keeps_the_gate_from_passing(project):
    scenario(project, requirements="[GAP-1, R-1]")
    drafted(project)
    for given in ([], ["--dura-undecided=warn"]):
        result = project.scenarios("--dura-select=corridor/it", *given)
        expect(project, result, "undecided", "it is a draft that no person has signed")
    assert project.verdict("GAP-1").verdict == "supported"
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_a_draft_that_a_person_signed_decides_until_it_is_changed(project):
    scenario(project, requirements="[R-1]")
    drafted(project)
    assert decide(project, "accepted") == 0
    result = project.scenarios("--dura-select=corridor/it")
    expect(project, result, "supported")
    assert verify_bundle(project.path / "dura-evidence").problems == []
    (known,) = [each for each in project.evidence().requirements if each.id == "R-1"]
    assert "by A. Person, safety engineer on 2026-01-02: bound and reason" in known.source
    assert known.source.endswith(MADE.partition(": ")[2])
    drafted(project, "always (gap > -1)", known.source)
    result = project.scenarios("--dura-select=corridor/it")
    expect(project, result, "undecided", "changed after a person signed it")


def test_a_draft_that_a_person_rejected_stays_undecided_and_its_violation_counts(project):
    scenario(project, requirements="[R-1]")
    drafted(project)
    assert decide(project, "rejected") == 0
    result = project.scenarios("--dura-select=corridor/it")
    expect(project, result, "undecided", "a person rejected")
    drafted(project, "always (gap > 9.9)")
    result = project.scenarios("--dura-select=corridor/it")
    expect(project, result, "violated")


def test_a_review_of_nothing_and_of_an_unknown_draft_is_refused(project, capsys):
    drafted(project, source="a contract")
    assert decide(project, "accepted") == 2
    assert "no such draft" in capsys.readouterr().err
    drafted(project)
    project.write("review.yaml", REVIEW.format("accepted"))
    file = project.path / "scenarios" / "requirements_R.yaml"
    before = file.read_text()
    assert main(["review", str(file), str(project.path / "review.yaml"), "--only=R-2"]) == 2
    assert file.read_text() == before
    assert decide(project, "accepted") == 0
    assert decide(project, "accepted") == 2  # nothing waits for a person any more


def test_a_test_that_passes_supports_no_unsigned_draft_either(project):
    scenario(project, requirements="[GAP-1]")
    drafted(project)
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/it')\n"
        "@pytest.mark.requirement('R-1')\n"
        "def test_it(episode):\n"
        "    assert episode.robustness('always (gap > 0)') > 0\n",
    )
    given = ("test_it.py", "--dura-path=scenarios")
    assert project.run(*given).ret != 0
    verdict = project.verdict("R-1")
    assert verdict.verdict == "undecided"
    assert "no person has signed" in verdict.reason
    file = project.path / "test_it.py"
    file.write_text(file.read_text().replace("'R-1'", "'R-1', source='a contract'"))
    result = project.run(*given)
    assert (result.ret, project.verdicts()) == (1, {})
    result.stdout.fnmatch_lines(["*gives the requirement 'R-1' another meaning*"])
