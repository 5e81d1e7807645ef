"""Episodes of an interrupted session: taken over where all they rest on is equal, or named."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections import Counter

import psutil
import pytest
from corridors import scenario
from outputs import output

from pytest_dura.core import derive_seed
from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.session_model import OutdatedEpisodes

WAIT = 60.0
"""Seconds that a session may take on a busy machine."""

COUNTS = """
import os, time
from pathlib import Path
from corridor import Careful

class {name}(Careful):
    def reset(self, context):
        with Path("log").open("a") as log:
            log.write(f"{name} {{context.seed}} {{os.getpid()}}\\n")
        asked = Path("do-sleep")
        try:
            if len(Path("log").read_text().splitlines()) < int(asked.read_text()):
                return
            asked.unlink()
        except FileNotFoundError:  # nothing is asked, or another process does it already
            return
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
NUMBERED = """
import os
from pathlib import Path

def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        Path("controller").write_text(str(os.getpid()))
"""
VOLATILE = ("processing_us", "processing_seconds")


def counting(project, name="it", component="Planner", runs=6):
    """A scenario whose component notes each simulation, in a module of its own."""
    module = component.lower()
    project.write(f"{module}.py", COUNTS.format(name=component))
    scenario(project, name, runs=runs, generator=f"{module}:{component}", requirements="[GAP-1]")
    # One that waits for the session's end is not to be ended by its own budget.
    file = project.path / f"scenarios/corridor/{name}.yaml"
    file.write_text(file.read_text().replace("time_budget: 30.0", "time_budget: 300"))


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


def started(project, *arguments):
    """A session in a process of its own, which writes its number into `controller`."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    project.write("conftest.py", NUMBERED)
    return subprocess.Popen(
        project.workers.command("-m", "pytest", "-p", "no:cacheprovider", *arguments),
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


def resumed(project, folder="dura-evidence"):
    return project.evidence(folder).resume


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
    while len([*(project.path / "dura-evidence/.episodes").rglob("*.episode")]) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    workers = {int(line.split()[2]) for line in (project.path / "log").read_text().splitlines()}
    os.kill(int((project.path / "controller").read_text()), signal.SIGKILL)
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

    result = project.run("corridor/it", "--dura-resume", *mode)
    assert result.ret == 0
    taken = resumed(project).taken_over
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
    assert resumed(project).resumed
    check_intact(project)
    assert not (project.path / "dura-evidence/.episodes").exists()


def interrupt(project, *arguments):
    """A session of two components that `-x` ended after their campaigns."""
    counting(project, "a", "PlanA", 3)
    counting(project, "b", "PlanB", 2)
    project.write("test_it.py", TWO)
    project.write("broken", "")
    result = project.run("test_it.py", "-x", *arguments)
    assert result.ret == 1
    assert project.evidence().status == "interrupted"
    (project.path / "broken").unlink()
    return result


@pytest.fixture
def interrupted(project, made_once):
    return project, made_once(project, "interrupted", lambda: interrupt(project))


def longer(project):
    """Change the scenario of one of the two components."""
    file = project.path / "scenarios/corridor/b.yaml"
    file.write_text(file.read_text().replace("duration: 0.5", "duration: 0.6"))


def edit(project, name):
    """Change a file of Python, or make one, in a way that changes nothing but its content."""
    file = project.path / name
    project.write(name, (file.read_text() if file.exists() else "") + "# changed\n")


def test_an_edited_component_is_named_and_all_is_simulated_anew(interrupted):
    project, result = interrupted
    assert "to go on: pytest test_it.py -x --dura-resume" in output(result)
    before = resumed(project)
    assert not before.resumed
    assert before.sources.files == 5
    edit(project, "planb.py")
    result = project.run("test_it.py", "-x", "--dura-resume")
    assert result.ret == 0
    assert "dura: resuming: 5 episodes of the interrupted session of 20" in output(result)
    assert "dura: 5 episodes are simulated anew: planb.py changed since" in output(result)
    assert "0 episodes taken over, 5 simulated" in output(result)
    assert "5 episodes simulated again: planb.py changed" in output(result)
    found = resumed(project)
    assert (found.resumed, found.taken_over, found.sessions) == (True, 0, [])
    assert found.outdated == [OutdatedEpisodes(changed=["planb.py"], episodes=5)]
    assert found.sources.files == before.sources.files
    assert found.sources.digest != before.sources.digest
    for one in project.evidence().episodes:
        assert one.origin.to_json() == {"session": None, "changed": ["planb.py"]}
    assert set(simulations(project, repeats=2).values()) == {2}
    check_intact(project)
    for page in ("summary.md", "report.html"):
        text = (project.path / "dura-evidence" / page).read_text().replace("\\", "")
        assert "0 episodes taken over, 5 simulated." in text
        assert "5 episodes simulated again: planb.py changed." in text


CHANGES = {
    "nothing": ([], 5, ""),
    "a conftest": (["conftest.py"], 0, "conftest.py"),
    "a module that nothing imports": (["tools/other.py"], 0, "tools/other.py"),
    "many modules": ([f"tools/m{n}.py" for n in range(9)], 0,
                     "tools/m0.py, tools/m1.py, tools/m2.py, 6 others"),
    "a test module": (["tests/test_more.py"], 5, ""),
    "a folder that pytest does not look into": (["build/made.py", ".cache/x.py"], 5, ""),
    "a virtual environment": (["env/pyvenv.cfg", "env/lib/any.py"], 5, ""),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_edited_decides_what_is_taken_over(interrupted, change):
    project, _ = interrupted
    files, taken, names = CHANGES[change]
    for name in files:
        edit(project, name)
    result = project.run("test_it.py", "--dura-resume")
    assert result.ret == 0
    assert resumed(project).taken_over == taken
    line = f"dura: 5 episodes are simulated anew: {names} changed since\n"
    assert (line in output(result)) == bool(names)
    assert set(simulations(project, repeats=2).values()) == {1 if taken else 2}


def test_another_version_of_a_package_is_named(interrupted, monkeypatch):
    project, _ = interrupted
    for number, versions in enumerate([["moved-1.0"], ["moved-2.0", "more-3.0"]]):
        for name in versions:
            (project.path / f"place{number}/{name}.dist-info").mkdir(parents=True)
    with monkeypatch.context() as patched:
        patched.syspath_prepend(project.path / "place0")
        project.write("broken", "")
        project.run("test_it.py", "-x")
        (project.path / "broken").unlink()
    monkeypatch.syspath_prepend(project.path / "place1")
    result = project.run("test_it.py", "--dura-resume")
    assert result.ret == 0
    names = "more (none before, 3.0 now), moved (1.0 before, 2.0 now)"
    assert f"5 episodes are simulated anew: {names} changed since" in output(result)
    assert resumed(project).taken_over == 0


def test_an_edited_assertion_is_judged_anew_on_the_same_episodes(interrupted):
    project, _ = interrupted
    text = (project.path / "test_it.py").read_text()
    project.write("test_it.py", text.replace("gap > 0", "gap > 1000"))
    result = project.run("test_it.py", "--dura-resume")
    assert result.ret == 1
    assert resumed(project).taken_over == 5
    assert set(simulations(project, repeats=2).values()) == {1}
    assert "gate: failed, 2 violated" in output(result)
    assert "always (gap > 1000)" in output(result)


@pytest.mark.parametrize("own", [True, False], ids=["with its planner", "with assertions alone"])
def test_a_test_module_counts_where_a_component_is_defined_in_it(project, own):
    counting(project, runs=3)
    planner = (project.path / "planner.py").read_text()
    test = (
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def generator():\n    return Planner\n"
        "def test_it(orchestrator):\n"
        "    orchestrator.campaign('corridor/it').require('always (gap > 0)')\n"
        "def test_last():\n    assert not Path('broken').exists()\n"
    )
    head = planner if own else "from pathlib import Path\nfrom planner import Planner\n"
    project.write("test_it.py", head + test)
    project.write("broken", "")
    assert project.run("test_it.py", "-x").ret == 1
    (project.path / "broken").unlink()
    edit(project, "test_it.py")
    result = project.run("test_it.py", "--dura-resume")
    assert result.ret == 0
    assert resumed(project).taken_over == (0 if own else 3)
    assert ("3 episodes simulated again: test_it.py changed" in output(result)) == own


def test_a_scenario_and_a_file_that_it_names_concern_their_own_episodes(interrupted):
    project, _ = interrupted
    file = project.path / "scenarios/corridor/a.yaml"
    plain = file.read_text()
    project.write("weights.bin", "1")
    project.write("broken", "")
    file.write_text(plain.replace("world: {}", "world: {weights: weights.bin}"))
    assert project.run("test_it.py", "-x").ret == 1
    (project.path / "broken").unlink()
    project.write("weights.bin", "2")
    result = project.run("test_it.py", "-x", "--dura-resume")
    assert "3 episodes simulated again: weights.bin changed" in output(result)
    assert resumed(project).taken_over == 2
    assert "are simulated anew" not in output(result)


B = "test_it.py::test_it[corridor/b]"


@pytest.mark.parametrize(
    "first, then, taken",
    [
        (["--dura-runs=2"], ["--dura-runs=4"], 4),
        (["--dura-runs=4"], ["--dura-runs=2"], 4),
        ([f"--deselect={B}"], [], 3),
        ([], [f"--deselect={B}"], 3),
    ],
)
def test_other_runs_and_other_tests_use_the_episodes_that_are_there(
    project, made_once, first, then, taken
):
    made_once(project, " ".join(["interrupted", *first]), lambda: interrupt(project, *first))
    assert project.run("test_it.py", "--dura-resume", *then).ret == 0
    assert resumed(project).taken_over == taken


def test_a_project_that_was_copied_elsewhere_goes_on_there(interrupted, monkeypatch):
    project, _ = interrupted
    place = project.path.parent / f"copy-of-{project.path.name}"
    shutil.copytree(project.path, place)
    monkeypatch.chdir(place)
    result = project.run("test_it.py", "--dura-resume", f"--rootdir={place}")
    assert result.ret == 0
    record = json.loads((place / "dura-evidence/evidence.json").read_text())
    assert record["resume"]["taken_over"] == 5


def test_processes_go_on_with_what_this_process_simulated_and_the_other_way_round(interrupted):
    project, _ = interrupted
    project.write("broken", "")
    for executor in ("processes:2", "in-process"):
        result = project.run_apart("test_it.py", "--dura-resume", f"--dura-executor={executor}")
        assert resumed(project).taken_over == 5, output(result)


@pytest.mark.parametrize("damage", [b"", b"{}", None], ids=["empty", "other data", "missing"])
def test_without_the_list_of_its_files_nothing_of_a_session_is_taken_over(interrupted, damage):
    project, _ = interrupted
    (file,) = (project.path / "dura-evidence/.episodes").glob("*.sources")
    file.unlink()
    if damage is not None:
        file.write_bytes(damage)
    result = project.run("test_it.py", "--dura-resume")
    line = "5 episodes are simulated anew: the list of its files changed since"
    assert line in output(result)
    assert resumed(project).taken_over == 0


def test_why_nothing_is_kept_is_said(project):
    counting(project, runs=2)
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def dura_metrics():\n    return {'peak': lambda episode: 1.0}\n",
    )
    project.write("test_it.py", TWO.replace('["corridor/a", "corridor/b"]', '["corridor/it"]'))
    project.write("broken", "")
    result = project.run("test_it.py", "-x")
    why = (
        "episodes of Planner are not kept for --dura-resume: the metric peak is a lambda, or "
        "stands within a function or class"
    )
    assert why in " ".join(output(result).split())
    assert resumed(project).problems == [why]


def test_the_same_is_told_where_two_workers_use_the_episodes(interrupted):
    project, _ = interrupted
    longer(project)
    result = project.run("test_it.py", "--dura-resume", "-n", "2", "--dist", "each")
    assert result.ret == 0
    found = resumed(project)
    assert found.taken_over == 3
    assert [one.episodes for one in found.outdated] == [2]
    check_intact(project)


def test_a_session_that_is_not_resumed_says_what_it_drops(interrupted):
    project, _ = interrupted
    result = project.run("test_it.py")
    assert result.ret == 0
    line = "dropped: 5 episodes of the interrupted session of 20"
    assert line in output(result)
    assert "--dura-resume would have taken them over" in output(result)
    assert set(simulations(project, repeats=2).values()) == {2}
    assert resumed(project).taken_over == 0
    assert line not in output(project.run("test_it.py"))


@pytest.mark.parametrize(
    "change, told",
    [
        (
            lambda record: record["resume"].update(taken_over=4),
            "/resume/taken_over: found 4, expected 3",
        ),
        (
            lambda record: record["episodes"][0]["origin"].update(session=None),
            "/resume/taken_over: found 3, expected 2",
        ),
        (
            lambda record: record["resume"].update(resumed=False),
            "resume: episodes of earlier sessions, though none was resumed",
        ),
        (
            lambda record: record["resume"].update(
                session=record["resume"]["sessions"][0]["session"]
            ),
            "resume: the session took over episodes from itself",
        ),
    ],
)  # fmt: skip
def test_verify_counts_again_what_was_taken_over(project, made_once, change, told):
    def partly_taken_over():
        interrupt(project)
        longer(project)
        project.run("test_it.py", "--dura-resume")

    made_once(project, "partly taken over", partly_taken_over)
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


SEARCHES = """
import pytest
from pathlib import Path
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

def test_last():
    assert not Path("broken").exists()
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
    project.write("broken", "")
    given = ["test_it.py", "--dura-generator=fast:Fast", "--maxfail=2", "-n", "2"]
    given.append("--dura-executor=in-process")  # which begins nothing that no search asks for

    def session(*arguments):
        (project.path / "log").write_text("")
        result = project.run(*given, *arguments)
        count = len((project.path / "log").read_text().splitlines())
        (search,) = project.evidence().searches
        assert search.outcomes[0].status == "falsified"
        searched = resumed(project).searched
        return result, count, searched

    _, all_of_them, searched = session()
    assert searched is None, "no earlier session was asked"
    result, replays, searched = session("--dura-resume")
    assert replays == 1, "a replay of an earlier session confirms nothing in this one"
    assert searched.taken_over == all_of_them - 1
    assert [one.episodes for one in searched.sessions] == [all_of_them - 1]
    line = f"{searched.taken_over} runs of searches taken over*{replays} simulated"
    result.stdout.fnmatch_lines([line])
    edit(project, "fast.py")
    (project.path / "broken").unlink()
    result, count, searched = session("--dura-resume")
    check_intact(project)
    assert (searched.taken_over, count) == (0, all_of_them)
    expected = OutdatedEpisodes(changed=["fast.py"], episodes=all_of_them - 1)
    assert searched.outdated == [expected]
    result.stdout.fnmatch_lines(["* of searches simulated again: fast.py changed"])
    record = json.loads((project.path / "dura-evidence/evidence.json").read_text())
    record["resume"]["searched"]["taken_over"] = 3
    (project.path / "dura-evidence/evidence.json").write_text(json.dumps(record))
    told = verify_bundle(project.path / "dura-evidence").problems
    assert any("resume: 3 runs of searches, and their sessions say 0" in one for one in told)


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
    assert "all worker processes have ended" in output(result)
    assert project.evidence().status == "interrupted"
    assert project.evidence().gate.result == "incomplete"
    (project.path / "gone").unlink()
    result = project.run_apart(*names, *mode, "--dura-resume")
    assert result.ret == 0
    assert resumed(project).taken_over >= 1


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
    assert project.evidence().resume.taken_over == 0
    check_intact(project)


def test_a_directory_that_is_not_there_is_not_made_by_a_resume(project):
    counting(project)
    for _ in range(2):
        result = project.run("corridor/it", "--dura-resume", "--dura-evidence=mispelt")
        assert result.ret == 4
        assert "there is no evidence here" in output(result)
        assert not (project.path / "mispelt").exists()
