"""``--dura-baseline``: what the rates of violations did since an earlier session."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest

from pytest_dura.evidence import SCHEMA_VERSION
from pytest_dura.requirements import mcnemar_one_sided

RATE = """
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=20)
@pytest.mark.requirement("OWN-1", text="Rarely touches anything.")
def test_rate(campaign):
    campaign.require("always (gap > 0)", at_most=0.9)
"""
HASTY = """
from pytest_dura import Generator, Proposal

class Hasty(Generator):
    '''Runs into the wall if it starts near it, which is in about half of all runs.'''
    def propose(self, view):
        return Proposal(20.0 if view.percept["gap"] < 10.0 else 0.0)
"""
OLD, NEW = "--dura-generator=corridor:Careful", "--dura-generator=hasty:Hasty"


@pytest.fixture
def rates(project, made_once):
    """A suite on a rate that both components keep, and the baseline of the careful one."""

    def kept():
        project.write("test_rate.py", RATE)
        project.write("hasty.py", HASTY)
        keep(project, OLD)

    made_once(project, "rates", kept)
    return project


def keep(project, *arguments):
    """Run a session and move its evidence to ``old``."""
    assert project.run(*arguments).ret == 0
    shutil.rmtree(project.path / "old", ignore_errors=True)
    shutil.move(project.path / "dura-evidence", project.path / "old")


@pytest.mark.parametrize(
    "choice, code",
    [
        (["--dura-baseline-worse=fail", "-n", "2"], 1),
        (["--dura-baseline-worse=warn"], 0),
        ([], 0),
    ],
    ids=["fail n2", "warn", "default"],
)
def test_a_rate_that_got_worse_fails_the_gate_or_is_told(rates, choice, code):
    result = rates.run("--dura-baseline=old/evidence.json", NEW, *choice)
    result.assert_outcomes(passed=1)
    assert result.ret == code
    evidence = rates.evidence()
    (verdict,), baseline = evidence.verdicts, evidence.baseline
    assert 5 < verdict.violations < 15
    (found,) = baseline.comparisons
    assert (found.status, found.test) == ("worse", "McNemar")
    assert (found.component, found.baseline_component) == ("Hasty", "Careful")
    assert found.only_now == found.violations == verdict.violations
    assert found.p_worse == mcnemar_one_sided(verdict.violations, 0)
    file = rates.path / "old/evidence.json"
    assert baseline.path == "old/evidence.json"
    assert baseline.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert baseline.component["name"] == "Careful"
    assert baseline.created == json.loads(file.read_text())["created"]
    n, p = verdict.violations, f"{found.p_worse:.2g}"
    result.stdout.fnmatch_lines(
        [
            f"dura: compared with the baseline old/evidence.json (Careful, {baseline.created})",
            "baseline old/evidence.json: 1 comparison, 1 worse, 0 better",
            f"OWN-1 on corridor/free  worse*{n}/20*0/20*{p}*{p}*McNemar",
        ]
    )
    # What fails the gate has a card: what got worse, by how much, and how sure that is.
    card = "worse: safety on corridor/free (Hasty) (1 of 1 cause)"
    assert (card in result.outlines) is (code == 1)
    told = f"OWN-1 is violated in {n} of 20 runs, and in 0 of 20 of the baseline: p = {p} by the"
    assert (told in " ".join(result.stdout.str().split())) is (code == 1)


def test_a_rate_that_got_better(rates):
    keep(rates, NEW)
    result = rates.run("--dura-baseline=old", "--dura-baseline-worse=fail", OLD)
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        ["baseline old: 1 comparison, 0 worse, 1 better", "*OWN-1 on *  better *"]
    )


def test_the_last_session_can_be_the_baseline_that_this_one_replaces(rates):
    shutil.move(rates.path / "old", rates.path / "dura-evidence")
    result = rates.run("--dura-baseline=dura-evidence", OLD, "-n", "2")
    assert result.ret == 0
    (found,) = rates.evidence().baseline.comparisons
    assert (found.status, found.p_worse, found.p_better) == (
        "no evidence of a change", 1.0, 1.0,
    )  # fmt: skip
    told = "no evidence of a change, violated in 0/20 now, 0/20 then: OWN-1 on corridor/free"
    result.stdout.fnmatch_lines(["*1 comparison, 0 worse, 0 better", told])


def test_another_base_seed_is_another_sample(rates):
    rates.run("--dura-baseline=old", "--dura-seed=7", NEW)
    (found,) = rates.evidence().baseline.comparisons
    assert (found.status, found.test) == ("worse", "Fisher")


def test_what_cannot_be_compared_is_listed(project):
    keep(project, "--dura-scenarios", "--dura-select=corridor/*")
    file = project.path / "scenarios/requirements.yaml"
    project.write(file, file.read_text().replace("cleared >= 1", "cleared > 0"))
    scenario = project.path / "scenarios/corridor/tight.yaml"
    project.write("scenarios/corridor/new.yaml", scenario.read_text().replace("tight", "new"))
    scenario.unlink()
    result = project.scenarios("--dura-baseline=old", "--dura-baseline-worse=fail")
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "baseline old: 1 comparison, 0 worse, 0 better",
            "no comparison: the check changed from 'eventually (cleared >= 1)' to*",
            "*GO-1 on corridor/free",
            "new: GAP-1 on corridor/new",
            "gone: GAP-1 on corridor/tight",
        ]
    )


def test_a_gate_that_can_compare_nothing_does_not_pass(project):
    keep(project, "corridor/tight")
    arguments = ["corridor/free", "--dura-baseline=old"]
    assert project.run(*arguments).ret == 0
    result = project.run(*arguments, "--dura-baseline-worse=fail")
    assert result.ret == 1
    told = "the gate fails: nothing in this session can be compared with the baseline"
    assert f"  {told}." in result.outlines


def test_nor_does_one_that_ran_no_episode(project):
    keep(project, "corridor/tight")
    project.write("test_plain.py", "def test_plain(): pass\n")
    result = project.run("test_plain.py", "--dura-baseline=old", "--dura-baseline-worse=fail")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  the gate fails: nothing*", "gone: GAP-1 on corridor/tight"])


def test_without_a_baseline_there_is_none_in_the_record(project):
    result = project.run("corridor/tight")
    assert project.evidence().baseline is None
    assert not any(line.startswith("baseline") for line in result.outlines)


def test_printed_commands_leave_the_baseline_out(rates):
    result = rates.run("corridor/tight", "--dura-generator=corridor:Reckless",
                       "--dura-baseline=old")  # fmt: skip
    reruns = [line for line in result.outlines if line.startswith("  re")]
    assert reruns
    assert not any("baseline" in line for line in reruns)


UNUSABLE = {
    "missing": (None, ["*there is no evidence here", "  key:      --dura-baseline",
                       "*expected:*evidence.json*", "*remedy:*"]),
    "cut short": ("{", ["*this is no evidence record (JSONDecodeError)"]),
    "foreign": ("[]", ["*this is no evidence record (TypeError)"]),
    "version": (
        {"schema_version": "0"},
        ["*another version*", "*found:    '0'", f"*expected: {SCHEMA_VERSION}"],
    ),
    "running": ({"status": "running"}, ["*was killed, or is still running", "*'running'"]),
    "damaged": ({"verdicts": [{}]}, ["*this record is damaged*", "*missing key*", "*remedy:*"]),
}  # fmt: skip


def test_a_baseline_that_cannot_be_used_is_one_usage_error(project):
    keep(project, "corridor/tight")
    file = project.path / "old/evidence.json"
    whole = json.loads(file.read_text())
    for name, distributed in (*((name, []) for name in UNUSABLE), ("running", ["-n", "2"])):
        change, lines = UNUSABLE[name]
        file.unlink(missing_ok=True)
        if change is not None:
            file.write_text(change if isinstance(change, str) else json.dumps(whole | change))
        result = project.run("corridor/tight", "--dura-baseline=old", *distributed)
        assert result.ret == 4, name
        result.stderr.fnmatch_lines(["ERROR: *old/evidence.json: *", *lines[1:]])
        result.stderr.fnmatch_lines(lines)
        text = result.stdout.str() + result.stderr.str()
        assert text.count("ERROR") == 1, name
        assert "Traceback" not in text
        assert not (project.path / "dura-evidence").exists()


def test_what_to_do_with_a_baseline_needs_one(project):
    result = project.run("corridor/tight", "--dura-baseline-worse=warn")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: --dura-baseline-worse is about*", "*add --dura-baseline*"])
