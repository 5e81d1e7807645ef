"""What roles, machines and operators do to a session: it is told, and never reads as a pass."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from corridors import scenario
from outputs import output

from pytest_dura.evidence import verify_bundle

DEADLY = """
import contextlib, os, signal
from pathlib import Path
from corridor import Watch

class Deadly(Watch):
    def reset(self, context):
        super().reset(context)
        seed = str(context.seed)
        with Path("log").open("a") as log:
            log.write(seed + "\\n")
        seeds = Path("log").read_text().split()
        if len(set(seeds)) >= 4 and not Path("which").exists():
            Path(seed).write_text(seed)
            with contextlib.suppress(FileExistsError):  # the other process was first
                os.link(seed, "which")
        which = Path("which").read_text() if Path("which").exists() else ""
        if seed == which and seeds.count(seed) <= int(Path("kills").read_text()):
            os.kill(os.getpid(), signal.SIGKILL)
"""
TWICE = """
import pytest

@pytest.mark.parametrize("number", range(2))
@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_it(campaign, number):
    campaign.require()
"""


def simulations(project):
    return Counter((project.path / "log").read_text().split())


@pytest.mark.parametrize("kills, ending", [(1, "another worker"), (2, "given up")])
def test_the_episodes_of_a_killed_worker_are_taken_over_once(project, kills, ending):
    """The same campaign in two workers, one of which is killed in the middle, maybe both."""
    scenario(project, monitor="deadly:Deadly", runs=6, requirements="[GAP-1]")
    project.write("deadly.py", DEADLY)
    project.write("kills", str(kills))
    project.write("test_it.py", TWICE)
    result = project.run("test_it.py", "-n", "2")
    assert result.ret == 1
    assert "crashed" in output(result)
    record = project.evidence()
    assert record.gate.result != "passed"
    counts = simulations(project)
    killer = (project.path / "which").read_text()
    assert counts.pop(killer) == min(2, kills + 1)
    if ending == "another worker":  # which repeats the first episode once it is through
        (case,) = record.cases
        assert (case.repeat.episode, case.repeat.result) == ("corridor/it#0", "equal")
        (first,) = (one.spec for one in record.episodes if one.spec.run == 0)
        counts[str(first.seed)] -= 1
    assert set(counts.values()) == {1}, "episodes of others are simulated once"
    runs = [one.spec.run for one in record.episodes]
    assert len(runs) == len(set(runs)), "and counted once"
    if ending == "another worker":
        assert sorted(runs) == list(range(6))
        assert {one.validity for one in record.episodes} == {"valid"}
    else:
        assert {one.verdict for one in record.verdicts} == {"undecided"}
        missing = [one for one in record.episodes if one["validity"] == "missing"]
        assert all("ended 2 processes that simulated it" in one["failure"] for one in missing)


BLOCKED = """
import time
from corridor import Corridor, Watch

class Stuck(Watch):
    def run(self, view):
        while view.index == 2:
            time.sleep(0.01)
        return super().run(view)

class Hangs(Corridor):
    def step(self, action):
        time.sleep(100)
"""


@pytest.mark.parametrize(
    "roles, who",
    [
        ({"monitor": "blocked:Stuck"}, "safety_monitor at tick 2 (t = 0.2 s)"),
        ({"simulator": "blocked:Hangs"}, "simulator at tick 0 (t = 0.0 s)"),
    ],
    ids=["role", "simulator"],
)
def test_a_role_that_blocks_for_ever_is_named_and_the_session_goes_on(project, roles, who):
    project.write("blocked.py", BLOCKED)
    scenario(project, "it", requirements="[GAP-1]", **roles)
    scenario(project, "well", requirements="[GAP-1]")
    result = project.scenarios("--dura-role-timeout=0.5")
    assert result.ret == 1
    cause = f"infrastructure: {who}: it did not come back within 0.5 s of wall-clock time"
    record = project.evidence()
    ends = {one.failure for one in record.episodes if one.case == "corridor/it"}
    assert ends == {cause}
    assert project.verdict("GAP-1").verdict == "undecided"
    assert project.verdict("GAP-1", "corridor/well").verdict == "supported"
    assert record.gate.result == "failed"
    assert who in output(result)
    assert "--dura-role-timeout=0.5" in output(result), "the rerun has the same limit"
    assert verify_bundle(project.path / "dura-evidence").problems == []


@pytest.mark.parametrize("text", ["0", "-1", "nan", "soon"])
def test_a_limit_that_is_none_is_refused(project, text):
    result = project.scenarios(f"--dura-role-timeout={text}")
    assert result.ret == 4
    assert "--dura-role-timeout takes a number of seconds" in output(result)


LEAKS = """
import os
from corridor import Watch

FULL = os.open("full", os.O_CREAT | os.O_WRONLY)

class Leaky(Watch):
    {kept}
    def run(self, view):
        try:
            while view.index == 3:
                self.kept.append(bytes(1 << 26))  # asked for, never touched: no machine runs out
        except MemoryError:
            os.write(FULL, b"!")
            raise
        return super().run(view)
"""
FOR_AN_EPISODE = "def reset(self, context): super().reset(context); self.kept = []"
FOR_EVER = "kept = []"
SECONDS_TO_END_WITHOUT_MEMORY = 5
only_linux = pytest.mark.skipif(sys.platform != "linux", reason="the limit is Linux's")
LIMITED = """
import resource
from pathlib import Path

def pytest_sessionstart():
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (3 << 29), resource.RLIM_INFINITY))
"""


@pytest.fixture
def without_memory(project):
    """Start a session of two cases, in the first of which a monitor fills the process's memory."""
    started = []

    def start(kept):
        scenario(project, "it", monitor="leaks:Leaky", requirements="[GAP-1]")
        scenario(project, "well", requirements="[GAP-1]")
        project.write("leaks.py", LEAKS.format(kept=kept))
        project.write("conftest.py", LIMITED)
        environment = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "corridor/it",
             "corridor/well"],
            cwd=project.path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@only_linux
def test_a_role_that_leaks_memory_for_an_episode_is_named(project, without_memory):
    process = without_memory(FOR_AN_EPISODE)
    printed = process.communicate(timeout=60)[0].decode()
    record = project.evidence()
    assert (record.status, process.returncode) == ("complete", 1), printed
    assert record.gate.result == "failed"
    ends = {episode.failure for episode in record.episodes if episode.case == "corridor/it"}
    assert len(ends) == 1, printed
    (cause,) = ends
    assert cause.startswith("infrastructure: safety_monitor at tick 3 (t = 0.3 s): MemoryError")
    assert project.verdict("GAP-1").verdict == "undecided"
    assert project.verdict("GAP-1", "corridor/well").verdict == "supported"


@only_linux
def test_a_session_without_any_memory_left_does_not_pass(project, without_memory):
    process = without_memory(FOR_EVER)
    full = project.path / "full"
    end = time.monotonic() + 60
    while process.poll() is None and not (full.exists() and full.stat().st_size):
        assert time.monotonic() < end
        time.sleep(0.05)
    # Where nobody has any memory left, nothing can be promised but that it is no pass.
    with contextlib.suppress(subprocess.TimeoutExpired):
        assert process.wait(SECONDS_TO_END_WITHOUT_MEMORY) != 0
    assert full.read_bytes()
    assert project.evidence().gate.result != "passed"


def test_a_full_disk_costs_nothing_but_the_episodes_for_a_resume(project, monkeypatch):
    scenario(project, runs=5, requirements="[GAP-1]")
    real = Path.write_bytes

    def full(file, data):
        if file.name.endswith(".new"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))
        return real(file, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    result = project.run("corridor/it")
    assert result.ret == 0
    line = "episodes are not kept for --dura-resume: No space left"
    assert output(result).count(line) == 1
    record = project.evidence()
    assert record.resume.problems == [f"{line} on device"]
    assert record.totals.episodes == record.totals.valid == 5
    assert verify_bundle(project.path / "dura-evidence").problems == []
