"""Ini setting dura_stl_engine: rtamt evaluates formulas too, and a difference fails the gate."""

import sys

import pytest
from corridors import requirement, scenario

from pytest_dura.__main__ import main
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.program import plan_of

BOTH = "-o", "dura_stl_engine=both"
UNTIL = "(gap > -1000) until[0:0.5] (gap < 100)"
EPISODE_TEST = """
import contextlib

import pytest

@pytest.mark.dura(scenario="corridor/free", runs=1)
@pytest.mark.requirement("GAP-1")
def test_it(episode):
    assert not episode.collided
    with contextlib.suppress(Exception):
        episode.robustness("{check}")
    assert {asserts}
"""
pytestmark = pytest.mark.skipif(
    sys.version_info >= (3, 13), reason="rtamt's ANTLR 4.7 cannot be imported from Python 3.13 on"
)


def compared_line(result):
    (line,) = [line for line in result.outlines if line.startswith("formulas: ")]
    return line


@pytest.mark.parametrize("mode", ["n2"], indirect=True)
def test_all_verdicts_are_compared_in_every_process(project, mode):
    result = project.scenarios(*BOTH, *mode)
    assert result.ret == 0
    line = compared_line(result)
    assert line.startswith("formulas: 8 verdicts also evaluated by rtamt 0.4"), line
    assert line[len("formulas: ") :] in (project.path / "dura-evidence/summary.md").read_text()
    engine = project.evidence().second_engine.to_json()
    assert engine.pop("version").startswith("0.4")
    assert engine == {"engine": "rtamt", "compared": 8, "not_compared": {}}
    assert main(["verify", str(project.path / "dura-evidence")]) == 0


def test_counts_of_shards_are_added_up(project, capsys):
    requirement(project, "checks:touches_nothing", name="BY-1")
    scenario(project, requirements="[GAP-1, BY-1]")
    for shard in "12":
        arguments = *BOTH, f"--dura-shard={shard}/2", f"--dura-evidence=part-{shard}"
        assert project.scenarios(*arguments).ret == 0
    parts = [project.evidence(f"part-{shard}").second_engine for shard in "12"]
    folders = [str(project.path / f"part-{shard}") for shard in "12"]
    assert main(["merge", *folders, "--output", str(project.path / "whole")]) == 0
    whole = project.evidence("whole").second_engine
    assert whole.compared == sum(part.compared for part in parts) == 10
    assert whole.not_compared == {"the check is a function": 2}
    assert project.scenarios("--dura-shard=2/2", "--dura-evidence=part-2").ret == 0
    assert main(["merge", *folders, "--output", str(project.path / "other")]) != 0
    assert "second_engine.version" in capsys.readouterr().err


def test_without_it_nothing_is_compared(project):
    result = project.scenarios()
    assert result.ret == 0
    assert "rtamt" not in result.stdout.str()
    assert project.evidence().second_engine is None


@pytest.fixture
def until_ends_early(monkeypatch):
    right = windows.until

    def until(left, right_side, first=0, last=None):
        return right(left, right_side, first, None if last is None else max(first, last - 1))

    monkeypatch.setattr(windows, "until", until)
    plan_of.cache_clear()  # plans hold the functions of their operators
    yield
    plan_of.cache_clear()


def test_a_difference_fails_the_gate_and_names_the_requirement(project, until_ends_early):
    requirement(project, UNTIL, name="NEAR-1", kind="safety")
    scenario(project, requirements="[NEAR-1]")
    own = project.scenarios(select="corridor/it")
    assert own.ret == 0
    result = project.scenarios(*BOTH, select="corridor/it")
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        [
            "infrastructure: the STL engines disagree on NEAR-1, episode corridor/it#0: *ours is*",
            "undecided: safety on corridor/it (Careful) *",
            "  A run is missing, since a role or the simulator failed: the STL engines disagree *",
        ]
    )
    assert project.verdict("NEAR-1").verdict == "undecided"
    gate = project.evidence().gate
    assert gate.result == "failed"
    assert any("the STL engines disagree on `" in reason for reason in gate.reasons)


@pytest.mark.parametrize("asserts", [f"episode.satisfies('{UNTIL}')", "True"])
def test_a_test_that_asks_an_episode_fails_too(project, until_ends_early, asserts):
    project.write("test_it.py", EPISODE_TEST.format(check=UNTIL, asserts=asserts))
    assert project.run("test_it.py").ret == 0
    result = project.run("test_it.py", *BOTH)
    assert result.ret == 1
    assert "the STL engines disagree on" in result.stdout.str()
    gate = project.evidence().gate
    assert any("the STL engines disagree on" in reason for reason in gate.reasons)


def test_another_engine_is_refused(project):
    result = project.scenarios("-o", "dura_stl_engine=rtamt")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*dura_stl_engine names no engine*", "*expected: own or both"])


def test_both_without_rtamt_is_refused(project, monkeypatch):
    monkeypatch.setitem(sys.modules, "rtamt", None)
    project.write("test_it.py", EPISODE_TEST.format(check=UNTIL, asserts="True"))
    for result in (project.scenarios(*BOTH), project.run("test_it.py", *BOTH)):
        assert result.ret == 4
        result.stderr.fnmatch_lines(["*needs rtamt, which cannot be imported*", "*below 3.13*"])
        assert "INTERNALERROR" not in result.stderr.str()
