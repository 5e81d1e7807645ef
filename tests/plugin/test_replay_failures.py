"""``--dura-replay-failures``: whether violations are systematic or come by chance."""

from __future__ import annotations

import pytest
from outputs import output

from pytest_dura.plugin.commands.failures import FailureReplays

MOODY = """
from corridor import Careful
from pytest_dura import Proposal

class Moody(Careful):
    repeatable = False
    count = {start}

    def reset(self, context):
        super().reset(context)
        type(self).count += 1
        self.bad = self.count % {every} == 0

    def propose(self, view):
        return Proposal(90.0 + self.count / 1000) if self.bad else super().propose(view)

class Blind(Careful):
    def propose(self, view):
        return Proposal(9.0)
"""


@pytest.fixture
def moody(project):
    """Runs the component in a session, then its failures again."""

    def run(component, every=1, start=0, times=4):
        project.write("moody.py", MOODY.format(every=every, start=start))
        given = [f"--dura-generator=moody:{component}", "--dura-executor=in-process"]
        project.run("corridor/free", "--dura-runs=1", *given)
        return project.run("--dura-replay-failures", f"--dura-runs={times}")

    return run


def test_a_violation_that_repeats_itself_is_systematic(moody):
    result = moody("Blind")
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "corridor/free#0 (Blind)",
            "  GAP-1: systematic: violated in 4 of 4 replays, all equal to the record",
        ]
    )


def test_a_violation_of_every_second_run_comes_by_chance_with_its_interval(moody):
    # The replays begin to count anew: one of them is the run of the record.
    result = moody("Moody", every=2, start=1, times=10)
    assert result.ret == 1
    text = output(result)
    assert "GAP-1: by chance: violated in 5 of 10 replays" in text
    assert "(95 % interval 19 to 81 %), 1 equal to the record" in text


def test_a_violation_that_is_mended_does_not_come_up_again(project, moody):
    moody("Blind")
    source = MOODY.format(every=1, start=0).replace("Proposal(9.0)", "super().propose(view)")
    project.write("moody.py", source)
    result = project.run("--dura-replay-failures", "--dura-runs=3")
    assert result.ret == 1
    text = output(result)
    assert "did not come up again: violated in 0 of 3 replays (95 % interval 0 to 71 %)" in text


def test_evidence_without_a_failure_is_refused(project):
    project.run("corridor/free")
    result = project.run("--dura-replay-failures")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "the evidence has no failure that could be replayed" in output(result)


def test_a_bundle_that_was_altered_is_refused(project, moody):
    moody("Blind")
    file = project.path / "dura-evidence/evidence.json"
    file.write_text(file.read_text() + "\n")
    result = project.run("--dura-replay-failures")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "this bundle is not as it was written" in output(result)


@pytest.mark.parametrize("value", ["0", "-1", "two"])
def test_a_number_of_replays_that_makes_no_sense_is_refused(project, value):
    result = project.run("--dura-replay-failures", f"--dura-runs={value}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "--dura-runs takes a whole number" in output(result)


@pytest.mark.parametrize(
    "violated, undecided, nature",
    [
        (5, 0, "systematic"), (3, 0, "by chance"), (0, 0, "did not come up again"),
        (0, 5, "not known"), (0, 2, "not known"), (3, 2, "by chance"),
    ],
)  # fmt: skip
def test_the_word_follows_from_the_counts(violated, undecided, nature):
    assert FailureReplays("GAP-1", 5, violated, undecided, 0).nature == nature


def test_a_single_replay_that_differs_from_the_record_shows_nothing():
    assert FailureReplays("GAP-1", 1, 1, 0, 0).nature == "not known"
    assert FailureReplays("GAP-1", 1, 1, 0, 1).nature == "systematic"
