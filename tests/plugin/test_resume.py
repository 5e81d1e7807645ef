"""Episodes of earlier sessions: taken over where nothing changed, told, and counted once."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter

import psutil
import pytest
from corridors import scenario
from outputs import output

from pytest_dura.core import derive_seed
from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.session_model import EarlierSession, OutdatedEpisodes

WAIT = 60.0
"""Seconds that a session may take on a busy machine."""

COUNTS = """
import os, signal, time
from pathlib import Path
from corridor import Careful

class {name}(Careful):
    def reset(self, context):
        with Path("log").open("a") as log:
            log.write(f"{name} {{context.seed}} {{os.getpid()}}\\n")
        for deed in Path(".").glob("do-*"):
            if len(Path("log").read_text().splitlines()) == int(deed.read_text()):
                deed.unlink()
                if deed.name == "do-kill":
                    os.kill(os.getpid(), signal.SIGKILL)
                time.sleep(120)
"""
TWO = """
import pytest
from pathlib import Path

@pytest.mark.parametrize("name", ["corridor/a", "corridor/b"])
def test_it(orchestrator, name):
    orchestrator.campaign(name).require("always (gap > 0)")

def test_last():
    assert not Path("broken").exists()
"""
KILLED_EARLY = """
import os, signal
from pathlib import Path
from pytest_dura.evidence.gather import RecordBuilder

if Path("killed-early").exists():
    RecordBuilder.record = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
"""
"""The record of a session that begins is made, and never written."""
VOLATILE = ("processing_us", "processing_seconds")


def counting(project, name="it", component="Planner", runs=6):
    """A scenario whose component notes each simulation, in a module of its own."""
    module = component.lower()
    project.write(f"{module}.py", COUNTS.format(name=component))
    scenario(project, name, runs=runs, generator=f"{module}:{component}", requirements="[GAP-1]")
    # One that waits for the session's end is not to be ended by its own budget.
    file = project.path / f"scenarios/corridor/{name}.yaml"
    file.write_text(file.read_text().replace("time_budget: 1.0", "time_budget: 300"))


FIRST = {
    str(derive_seed(derive_seed(0, f"corridor/{name}", 0), "generator"))
    for name in ("it", "a", "b")
}
"""What components see as the seeds of the first runs, which each session repeats."""


def simulations(project, repeats=0):
    """How often each episode was simulated, by component and seed, beside so many repetitions."""
    lines = (project.path / "log").read_text().splitlines()
    counts = Counter(tuple(line.split()[:2]) for line in lines)
    for key in counts:
        counts[key] -= repeats if key[1] in FIRST else 0
    return counts


def started(project, *arguments, python=(sys.executable,)):
    """A session in a process of its own, as from a shell."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    return subprocess.Popen(
        [*python, "-m", "pytest", "-p", "no:cacheprovider", *arguments],
        cwd=project.path, env=kept, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


def told(project, folder="dura-evidence"):
    """What a session came to, without how fast, and by whom its episodes were simulated."""
    keys = {"status", "gate", "cases", "episodes", "verdicts", "coverage", "totals"}
    record = project.evidence(folder).to_json(include=keys)
    for episode in record["episodes"]:
        del episode["origin"]
        del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
    return record


def reuse(project, folder="dura-evidence"):
    return project.evidence(folder).reuse


def check_intact(project, folder="dura-evidence"):
    assert verify_bundle(project.path / folder).problems == []


@pytest.mark.parametrize("mode", [[], ["-n", "2"]], ids=["plain", "n2"])
def test_a_session_whose_controller_was_killed_goes_on_where_it_was(project, mode):
    counting(project)
    project.run("corridor/it", "--dura-evidence=whole")
    seeds = set(simulations(project))
    (project.path / "log").unlink()
    project.write("do-sleep", "4")
    process = started(project, "corridor/it", *mode)
    deadline = time.monotonic() + WAIT
    while (project.path / "do-sleep").exists():
        assert process.poll() is None, process.communicate()[0].decode()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    workers = {int(line.split()[2]) for line in (project.path / "log").read_text().splitlines()}
    process.send_signal(signal.SIGKILL)
    with process:
        process.wait(WAIT)
    for worker in workers:  # nobody ends them: they see that nobody is there any more
        while psutil.pid_exists(worker) and psutil.Process(worker).status() != "zombie":
            assert time.monotonic() < deadline, f"the worker {worker} stays behind"
            time.sleep(0.02)
    record = project.evidence()
    assert (record.status, record.gate.result) == ("running", "incomplete")
    assert record.gate.exit_code != 0
    before = simulations(project)
    project.write(
        "dura-evidence/.progress/0123456789abcdef.gw0.json", "{}"
    )  # a worker's, if it was slow

    result = project.run("corridor/it", "--dura-resume", *mode)
    assert result.ret == 0
    assert not (project.path / "dura-evidence/.progress").exists()
    taken = reuse(project).taken_over
    assert 3 <= taken <= (5 if not mode else 6)
    assert f"dura: resuming: {taken} episodes of the interrupted session of 20" in output(result)
    assert f"{taken} episodes taken over from 1 earlier session, {6 - taken} simulated" in output(
        result
    )
    assert told(project) == told(project, "whole")
    again = simulations(project) - before
    assert set(simulations(project)) == seeds
    assert sum(again.values()) == 6 - taken + 1, "what was simulated before is not simulated again"
    origins = [one.origin.session for one in project.evidence().episodes]
    assert sum(origin is not None for origin in origins) == taken
    assert reuse(project).mode == "resume"
    check_intact(project)
    assert not (project.path / "dura-evidence/.episodes").exists()


@pytest.fixture
def interrupted(project):
    """A session of two components that `-x` ended after their campaigns."""
    counting(project, "a", "PlanA", 3)
    counting(project, "b", "PlanB", 2)
    project.write("test_it.py", TWO)
    project.write("broken", "")
    result = project.run("test_it.py", "-x")
    assert result.ret == 1
    assert project.evidence().status == "interrupted"
    (project.path / "broken").unlink()
    return project, result


def test_what_changed_is_simulated_again_and_nothing_else(interrupted):
    project, result = interrupted
    assert "to go on: pytest test_it.py -x --dura-resume" in output(result)
    file = project.path / "planb.py"
    file.write_text(file.read_text() + "# changed\n")
    result = project.run("test_it.py", "-x", "--dura-resume")
    assert result.ret == 0
    assert "dura: resuming: 5 episodes of the interrupted session of 20" in output(result)
    assert "3 episodes taken over from 1 earlier session, 2 simulated" in output(result)
    line = "2 episodes simulated again: code of the generator planb:PlanB changed"
    assert line in output(result)
    found = reuse(project)
    assert (found.mode, found.taken_over) == ("resume", 3)
    (earlier,) = found.sessions
    assert earlier.episodes == 3
    assert earlier.session != found.session
    changed = ["code of the generator planb:PlanB"]
    assert found.outdated == [OutdatedEpisodes(changed=changed, episodes=2)]
    for one in project.evidence().episodes:
        expected = {"session": None, "changed": changed}
        if one.component == "PlanA":
            expected = {"session": earlier.session, "changed": None}
        assert one.origin.to_json() == expected
    counts = simulations(project, repeats=2)
    assert {count for (name, _), count in counts.items() if name == "PlanA"} == {1}
    assert {count for (name, _), count in counts.items() if name == "PlanB"} == {2}
    check_intact(project)
    for page in ("summary.md", "report.html"):
        text = (project.path / "dura-evidence" / page).read_text().replace("\\", "")
        assert "3 of 5 episodes were taken over" in text
        assert "2 of 5 episodes were simulated again" in text
        assert "code of the generator planb:PlanB" in text


def test_the_same_is_told_where_two_workers_use_the_episodes(interrupted):
    project, _ = interrupted
    file = project.path / "planb.py"
    file.write_text(file.read_text() + "# changed\n")
    result = project.run("test_it.py", "--dura-resume", "-n", "2", "--dist", "each")
    assert result.ret == 0
    found = reuse(project)
    assert found.taken_over == 3
    assert [one.episodes for one in found.outdated] == [2]
    assert {*simulations(project, repeats=2).values()} == {1, 2}
    check_intact(project)


def test_a_session_that_is_not_resumed_says_what_it_drops(interrupted):
    project, _ = interrupted
    result = project.run("test_it.py")
    assert result.ret == 0
    line = "dropped: 5 episodes of the interrupted session of 20"
    assert line in output(result)
    assert "--dura-resume would have taken them over" in output(result)
    assert set(simulations(project, repeats=2).values()) == {2}
    assert reuse(project).taken_over == 0
    assert line not in output(project.run("test_it.py"))


@pytest.mark.parametrize(
    "change, told",
    [
        (
            lambda record: record["reuse"].update(taken_over=4),
            "/reuse/taken_over: found 4, expected 3",
        ),
        (
            lambda record: record["episodes"][0]["origin"].update(session=None),
            "/reuse/taken_over: found 3, expected 2",
        ),
        (
            lambda record: record["reuse"].update(mode="none"),
            "reuse: episodes of earlier sessions, though none was asked for",
        ),
        (
            lambda record: record["reuse"].update(
                session=record["reuse"]["sessions"][0]["session"]
            ),
            "reuse: the session took over episodes from itself",
        ),
    ],
)  # fmt: skip
def test_verify_counts_again_what_was_taken_over(interrupted, change, told):
    project, _ = interrupted
    file = project.path / "planb.py"
    file.write_text(file.read_text() + "# changed\n")
    project.run("test_it.py", "--dura-resume")
    record = project.evidence().to_json()
    change(record)
    (project.path / "dura-evidence/evidence.json").write_text(json.dumps(record))
    problems = verify_bundle(project.path / "dura-evidence").problems
    assert f"evidence.json: {told}" in problems


def test_there_is_nothing_to_resume_without_an_interrupted_session(project):
    counting(project)
    result = project.run("corridor/it", "--dura-resume")
    assert result.ret == 4
    assert "there is no evidence here" in output(result)
    project.run("corridor/it")
    before = project.evidence()
    result = project.run("corridor/it", "--dura-resume")
    assert result.ret == 4
    assert "was not interrupted" in output(result)
    assert project.evidence() == before


def test_episodes_are_kept_from_session_to_session_where_it_is_asked_for(project):
    counting(project, runs=3)
    first = project.run("corridor/it", "--dura-reuse=kept")
    assert "reusing: 0 episodes of earlier sessions in kept" in output(first)
    whole = told(project)
    own = reuse(project)
    assert (own.mode, own.taken_over, own.sessions) == ("reuse", 0, [])
    second = project.run("corridor/it", "--dura-reuse=kept")
    assert "reusing: 3 episodes of earlier sessions in kept" in output(second)
    assert "3 episodes taken over from 1 earlier session, 0 simulated" in output(second)
    assert told(project) == whole
    assert reuse(project).sessions == [EarlierSession(session=own.session, episodes=3)]
    assert set(simulations(project, repeats=2).values()) == {1}
    check_intact(project)
    third = project.run("corridor/it", "--dura-reuse=kept", "--dura-seed=1")
    assert "0 episodes taken over, 3 simulated" in output(third)
    assert "3 episodes simulated again: scenario, seed changed" in output(third) or (
        "3 episodes simulated again: seed changed" in output(third)
    )
    without = project.run("corridor/it")
    assert "taken over" not in output(without)
    assert sorted(simulations(project).values()) == [1, 1, 2, 2, 2, 5]


def test_only_a_variable_that_the_code_reads_makes_other_episodes_of_it(project, monkeypatch):
    counting(project, runs=3)
    file = project.path / "planner.py"
    file.write_text(file.read_text() + 'PACE = os.environ.get("PLANNER_PACE")\n')
    project.run("corridor/it", "--dura-reuse=kept")
    monkeypatch.setenv("UNRELATED_PACE", "fast")
    same = project.run("corridor/it", "--dura-reuse=kept")
    assert "3 episodes taken over from 1 earlier session, 0 simulated" in output(same)
    monkeypatch.setenv("PLANNER_PACE", "fast")
    other = project.run("corridor/it", "--dura-reuse=kept")
    assert "0 episodes taken over, 3 simulated" in output(other)
    line = "3 episodes simulated again: environment variable PLANNER_PACE changed"
    assert line in output(other)
    check_intact(project)


def test_two_sessions_at_once_share_what_they_simulate(project, forked_workers):
    forked = forked_workers.command()
    counting(project, runs=8)
    project.run("corridor/it", "--dura-evidence=whole")
    (project.path / "log").unlink()
    processes = [
        started(
            project, "corridor/it", "--dura-reuse=kept", f"--dura-evidence={name}", python=forked
        )
        for name in ("one", "two")
    ]
    for process in processes:
        text = process.communicate(timeout=WAIT)[0].decode()
        assert process.returncode == 0, text
    assert set(simulations(project, repeats=2).values()) == {1}
    assert len(simulations(project)) == 8
    for name in ("one", "two"):
        assert told(project, name) == told(project, "whole")
        check_intact(project, name)
    both = reuse(project, "one"), reuse(project, "two")
    assert sum(one.taken_over for one in both) == 8
    assert {one.session for one in both[0].sessions} <= {both[1].session}


SEARCHES = """
import pytest
from hypothesis import given, settings
from pytest_dura import strategies

@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
def test_search(campaign):
    campaign.falsify(budget=12, shrink=0)

@pytest.mark.dura(verdict=False)
@settings(max_examples=5, derandomize=True, database=None)
@given(case=strategies.cases("corridor/free"))
def test_property(case, run_episode):
    assert run_episode(case).signals["gap"][0] > 0
"""
FAST = """
from pathlib import Path
from corridor import Reckless

class Fast(Reckless):
    def reset(self, context):
        with Path("log").open("a") as log:
            log.write(f"{context.seed}\\n")
"""


def test_what_searches_take_over_is_told_and_what_they_find_is_replayed_all_the_same(project):
    project.write("fast.py", FAST)
    project.write("test_it.py", SEARCHES)
    given = ["test_it.py", "--dura-generator=fast:Fast", "--dura-reuse=kept"]
    kinds = []
    for change, mode in (("", []), ("", ["-n", "2"]), ("# another comment", [])):
        project.write("fast.py", FAST + change)
        (project.path / "log").write_text("")
        result = project.run(*given, *mode)
        count = len((project.path / "log").read_text().splitlines())
        check_intact(project)
        (search,) = project.evidence().searches
        assert search.outcomes[0].word == "falsified"
        searched = reuse(project).searched
        taken = searched.taken_over
        assert searched.simulations - taken == count
        line = f"{taken} runs of searches taken over*{count} simulated"
        result.stdout.fnmatch_lines([line])
        kinds.append((searched, count, result))
    (first, all_of_them, _), (again, replays, _), (changed, count, result) = kinds
    assert (first.taken_over, first.outdated) == (0, [])
    assert replays == 1, "a replay of an earlier session confirms nothing in this one"
    assert again.taken_over == all_of_them - 1
    assert [one.episodes for one in again.sessions] == [all_of_them - 1]
    assert (changed.taken_over, count) == (0, all_of_them)
    why = ["code of the generator fast:Fast"]
    assert changed.outdated == [OutdatedEpisodes(changed=why, episodes=all_of_them - 1)]
    result.stdout.fnmatch_lines(["* of searches simulated again: code of the generator *changed"])
    record = json.loads((project.path / "dura-evidence/evidence.json").read_text())
    record["reuse"]["searched"]["taken_over"] = 3
    (project.path / "dura-evidence/evidence.json").write_text(json.dumps(record))
    told = verify_bundle(project.path / "dura-evidence").problems
    assert any("reuse: 3 runs of searches, and their sessions say 0" in one for one in told)


@pytest.mark.parametrize("mode", [[], ["-n", "2"]], ids=["plain", "n2"])
def test_a_session_whose_cluster_is_lost_stops_and_goes_on(project, mode):
    counting(project)
    project.write(
        "conftest.py",
        "import pytest\n"
        "from pytest_dura.execution.executors import Execution\n"
        "if __import__('os').path.exists('gone'):\n"
        "    Execution.is_lost = True\n",
    )
    (project.path / "gone").touch()
    names = ["corridor/it::GAP-1", "corridor/free", "corridor/tight"]
    result = project.run_apart(*names, *mode)
    assert result.ret == 2
    assert "nobody is left who simulates" in output(result)
    assert project.evidence().status == "interrupted"
    assert project.evidence().gate.result == "incomplete"
    (project.path / "gone").unlink()
    result = project.run_apart(*names, *mode, "--dura-resume")
    assert result.ret == 0
    assert reuse(project).taken_over >= 1


def test_a_damaged_record_is_refused_by_name(project):
    project.scenarios()
    file = project.path / "dura-evidence" / "evidence.json"
    file.write_text(file.read_text().replace('"exit_code": 0', '"exit_code": "0"', 1))
    result = project.scenarios("--dura-resume")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert re.search(
        "damaged\n  key:      /gate/exit_code\n  found:    .?string.?\n  expected: integer\n",
        output(result),
    )
    assert "INTERNALERROR" not in output(result)


@pytest.mark.parametrize("earlier", [False, True], ids=["empty", "after a whole session"])
def test_a_session_that_was_killed_before_its_first_record_begins_anew(project, earlier):
    counting(project)
    if earlier:
        project.run("corridor/it")
    project.write("conftest.py", KILLED_EARLY)
    project.write("killed-early", "")
    assert project.run_apart("corridor/it").ret != 0
    (project.path / "killed-early").unlink()
    assert (project.path / "dura-evidence/evidence.json").exists() == earlier
    result = project.run("corridor/it", "--dura-resume")
    assert result.ret == 0, output(result)
    line = "resuming: 0 episodes of a session that was interrupted before it wrote a record"
    assert f"{line}; it begins anew" in output(result)
    assert project.evidence().reuse.taken_over == 0
    check_intact(project)


def test_a_directory_that_is_not_there_is_not_made_by_a_resume(project):
    counting(project)
    for _ in range(2):
        result = project.run("corridor/it", "--dura-resume", "--dura-evidence=mispelt")
        assert result.ret == 4
        assert "there is no evidence here" in output(result)
        assert not (project.path / "mispelt").exists()
