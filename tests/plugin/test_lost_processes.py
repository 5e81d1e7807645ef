"""Processes that are lost, and what is left: no endless wait, no lost episode, no false pass."""

from __future__ import annotations

import shutil

import pytest
from corridors import scenario
from outputs import output
from pool_calls import KilledStarts

from pytest_dura.evidence import verify_bundle
from pytest_dura.execution import MAX_STARTS

EXECUTOR = "auto"

COUNTED = """
import os, signal, time
from pathlib import Path
from corridor import Careful, Watch

class Counts:
    def reset(self, context):
        super().reset(context)
        with Path("log").open("a") as log:
            log.write(f"{context.seed}\\n")
        seeds, kills = Path("log").read_text().split(), Path("kills")
        seed, times = kills.read_text().split() if kills.exists() else ("", 0)
        if seed == str(context.seed) and seeds.count(seed) <= int(times):
            os.kill(os.getpid(), signal.SIGKILL)

class Counted(Counts, Careful):
    pass

class Watches(Counts, Watch):
    pass
"""
CLOSES = """
import os
from corridor import Careful

class Closes(Careful):
    def propose(self, view):
        if view.index == 2:
            {deed}
        return super().propose(view)
"""


def simulations(project):
    return (project.path / "log").read_text().split()


def digests(project):
    return sorted((one.id, one.digest) for one in project.evidence().episodes)


@pytest.fixture(params=[{"generator": "counted:Counted"}], ids=[""])
def counted(project, made_once, request):
    """A case, a role of which notes each simulation, what it comes to, and its third seed."""

    def run():
        project.write("counted.py", COUNTED)
        scenario(project, runs=5, requirements="[GAP-1]", **request.param)
        assert project.run("corridor/it", "--dura-executor=in-process").ret == 0
        third = simulations(project)[2]
        (project.path / "log").unlink()
        return digests(project), third

    return project, *made_once(project, str(request.param), run)


def check_whole(project, whole, result, simulated, repeats=1):
    """The session is whole, and the episodes were simulated so many times in all.

    Args:
        project: Its directory.
        whole: The digests of a session that nothing happened to.
        result: What the session came to.
        simulated: How often an episode was simulated, beside the repeats.
        repeats: How often sessions repeated the first episode: once in each whose item ended.
    """
    assert result.ret == 0, output(result)
    assert digests(project) == whole
    seeds = simulations(project)
    assert len(seeds) == simulated + repeats
    assert seeds.count(seeds[0]) == 1 + repeats
    (case,) = project.evidence().cases
    assert (case.repeat.episode, case.repeat.result) == ("corridor/it#0", "equal")
    assert project.evidence().gate.result == "passed"
    assert not (project.path / "dura-evidence/.episodes").exists()
    bundle = project.path / "dura-evidence"
    assert verify_bundle(bundle).problems == []
    episode = f".episodes/00/{'0' * 64}.episode"
    project.write(f"dura-evidence/{episode}", "")
    assert verify_bundle(bundle).problems == [f"{episode}: not in the manifest"]
    shutil.rmtree(bundle / ".episodes")
    again = project.run("corridor/it", "--dura-resume")
    assert again.ret == pytest.ExitCode.USAGE_ERROR
    assert "there is nothing to resume" in output(again)


def check_kept_episodes_are_no_difference(bundle):
    assert verify_bundle(bundle).problems == []
    (stranger := bundle / ".episodes/more").touch()
    assert verify_bundle(bundle).problems == [".episodes/more: not in the manifest"]
    stranger.unlink()


WORKER = ["-n", "1", "--dura-executor=in-process"]
"""A worker of pytest-xdist that simulates itself."""


def test_a_session_that_lost_a_worker_keeps_its_episodes_and_goes_on(counted):
    project, whole, third = counted
    project.write("kills", f"{third} 1")
    result = project.run("corridor/it", *WORKER)
    assert result.ret == 1
    record = project.evidence()
    assert (record.status, record.gate.result) == ("complete", "failed")
    assert f"to go on: pytest corridor/it {' '.join(WORKER)} --dura-resume" in output(result)
    check_kept_episodes_are_no_difference(project.path / "dura-evidence")
    result = project.run("corridor/it", *WORKER, "--dura-resume")
    assert "dura: resuming: 2 episodes of the session of 20" in output(result)
    check_whole(project, whole, result, 6)


def test_a_session_that_is_not_resumed_says_what_it_drops_of_a_lost_worker(counted):
    project, _, third = counted
    project.write("kills", f"{third} 1")
    project.run("corridor/it", *WORKER)
    result = project.run("corridor/it")
    assert result.ret == 0
    assert "dura: dropped: 2 episodes of the session of 20" in output(result)


def test_a_process_that_is_killed_while_it_starts_costs_no_campaign(counted, monkeypatch):
    project, whole, _ = counted
    starts = KilledStarts(monkeypatch, project.path, MAX_STARTS - 1)
    result = project.run("corridor/it", "--dura-executor=processes:1")
    assert starts.count == MAX_STARTS
    check_whole(project, whole, result, 5)


def test_a_session_that_could_start_no_process_goes_on(counted, monkeypatch):
    project, whole, _ = counted
    with monkeypatch.context() as patched:
        KilledStarts(patched, project.path, 1000)
        result = project.run("corridor/it", "--dura-executor=processes:1")
    assert result.ret == 1
    assert "a process that simulates did not start: it was ended by SIGKILL" in output(result)
    assert project.verdict("GAP-1").verdict == "undecided"
    result = project.run("corridor/it", "--dura-executor=processes:1", "--dura-resume")
    check_whole(project, whole, result, 5)


@pytest.mark.parametrize("counted", [{"monitor": "counted:Watches"}], indirect=True, ids=[""])
def test_an_episode_that_is_missing_is_had_by_resuming(counted):
    project, whole, third = counted
    project.write("kills", f"{third} 2")
    result = project.run("corridor/it", "--dura-executor=processes:1")
    assert result.ret == 1
    assert "1 of 5 episodes are missing" in project.verdict("GAP-1").reason
    assert "was ended by SIGKILL in a call of the safety_monitor at tick 0" in output(result)
    result = project.run("corridor/it", "--dura-executor=processes:1", "--dura-resume")
    assert "dura: resuming: 5 episodes of the session of 20" in output(result)
    check_whole(project, whole, result, 7, repeats=2)


def test_a_run_that_the_component_ended_counts_and_there_is_nothing_to_resume(counted):
    project, _, third = counted
    project.write("kills", f"{third} 9")
    result = project.run("corridor/it", "--dura-executor=processes:1")
    assert result.ret == 1
    assert project.verdict("GAP-1").verdict == "undecided"
    assert simulations(project).count(third) == 2, "a signal may have come from outside"
    result = project.run("corridor/it", "--dura-resume")
    assert "there is nothing to resume" in output(result)


def test_a_component_that_closes_the_sessions_files_ends_it_without_a_pass(project):
    project.write("closes.py", CLOSES.format(deed="os.closerange(3, 256)"))
    scenario(project, generator="closes:Closes", requirements="[GAP-1]")
    scenario(project, "well", requirements="[GAP-1]")
    result = project.run_apart("corridor/it", "corridor/well", "--dura-executor=in-process")
    assert result.ret != 0
    record = project.evidence()
    assert (record.status != "complete", record.gate.result) == (True, "incomplete")
    assert {one.verdict for one in record.verdicts} <= {"undecided"}
    (project.path / "closes.py").write_text(CLOSES.format(deed="pass"))
    result = project.run("corridor/it", "corridor/well", "--dura-resume")
    assert result.ret == 0
