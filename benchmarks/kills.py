"""Sessions whose processes are killed, and resumed: nothing lost, doubled or passed, and no wait.

Each trial kills one kind of process at a moment drawn from its seed, waits until nothing of the
session is left, looks at what it says, resumes it unless it was whole all the same, and compares
what comes out with the same session undisturbed.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from machine import machine, table

from pytest_dura.evidence import SessionRecord, open_record

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests/support"))
from dask_clusters import Cluster  # noqa: E402 - it lies there

MOST_WAIT = 300.0
"""Seconds after a kill in which a session has done the rest of its work and is gone: the longest
that docs/executors.md lets it wait for a process."""
RUNS = 10
_POLL = 0.005
_STUCK = 600.0
"""Seconds after which a trial is given up, which is a failure."""

COMPONENT = """
import os, time
from pathlib import Path
from corridor import Careful

class Noted(Careful):
    def reset(self, context):
        with Path("log").open("a") as log:
            log.write(f"{context.seed} {os.getpid()}\\n")
        time.sleep(0.05)
"""
SCENARIO = """
name: kills/{name}
simulator: "corridor:Corridor"
duration: 1.0
runs: {runs}
time_budget: 60
world: {{wall: 10.0}}
variation: {{world.wall: {{min: 9.0, max: 11.0}}}}
roles: {{generator: "noted:Noted", safety_monitor: "corridor:Watch"}}
requirements: [{requirements}]
"""
REQUIREMENTS = """
requirements:
  - {{id: NEAR, text: It touches nothing., kind: safety, check: always (gap > 0)}}
  - {{id: FAST, text: It is not too fast., kind: performance, check: always (x < 5)}}
  - {{id: FAR, text: It stays far away., kind: safety, check: always (gap > 9), at_most: 0.3}}
"""
NAMES = {"held": "NEAR, FAST", "broken": "NEAR, FAR"}
"""Cases, one whose gate passes and one whose gate fails, with their requirements."""


@dataclass(frozen=True)
class Kill:
    """What a trial kills.

    Args:
        name: As the table says.
        modes: Arguments of the session, of which a trial takes one after the other.
    """

    name: str
    modes: tuple[tuple[str, ...], ...]


POOL, XDIST, DASK = ("--dura-executor=processes:2",), ("-n", "2"), ("dask",)
KILLS = (
    Kill("worker of pytest-xdist", (XDIST,)),
    Kill("child, starting", ((), POOL)),
    Kill("child", ((), POOL)),
    Kill("template", ((), POOL)),
    Kill("Dask worker", (DASK,)),
    Kill("Dask scheduler", (DASK,)),
    Kill("controller", ((), XDIST, POOL)),
)


class Project:
    """A project with one case, and the sessions that run it."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.case = folder, f"kills/{name}"
        shutil.copytree(
            ROOT / "tests/plugin/project", folder, ignore=shutil.ignore_patterns("scenarios")
        )
        (folder / "scenarios").mkdir()
        (folder / "noted.py").write_text(COMPONENT)
        (folder / "scenarios/requirements.yaml").write_text(REQUIREMENTS.format())
        text = SCENARIO.format(name=name, runs=RUNS, requirements=NAMES[name])
        (folder / f"scenarios/{name}.yaml").write_text(text)
        self.output = folder / "output"

    def started(self, *arguments: str) -> subprocess.Popen[bytes]:
        """A session in a process of its own."""
        kept = {key: one for key, one in os.environ.items() if not key.startswith("PYTEST")}
        with self.output.open("ab") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", self.case, *arguments],
                cwd=self.folder, env=kept, stdout=output, stderr=output,
            )  # fmt: skip

    def simulations(self) -> list[tuple[str, int]]:
        """Seed and process of each episode that was begun."""
        file = self.folder / "log"
        lines = file.read_text().splitlines() if file.exists() else []
        return [(seed, int(pid)) for seed, pid in map(str.split, lines)]

    def record(self) -> SessionRecord:
        """What the evidence says."""
        return open_record(self.folder / "dura-evidence/evidence.json")

    @property
    def resumable(self) -> bool:
        """Whether the last session was not whole, so that its episodes are kept."""
        kept = (self.folder / "dura-evidence/.episodes").is_dir()
        return kept or self.record().head.status != "complete"


def outcome(record: SessionRecord) -> dict[str, Any]:
    """What two sessions have to agree in: every episode by its digest, and every verdict."""
    keys = ("requirement", "case", "verdict", "episodes", "violations", "missing")
    return {
        "episodes": sorted((one.id, one.digest) for one in record.episodes()),
        "verdicts": [{key: getattr(one, key) for key in keys} for one in record.head.verdicts],
        "gate": record.head.gate.result,
    }


def until(condition: Callable[[], Any], process: subprocess.Popen[bytes]) -> bool:
    """Wait for something to happen in a session; whether it did before the session's end."""
    end = time.monotonic() + _STUCK
    while not condition():
        if process.poll() is not None:
            return False
        if time.monotonic() > end:
            raise SystemExit("a session hangs before anything was killed")
        time.sleep(_POLL)
    return True


def gone(pids: Sequence[int]) -> bool:
    """Whether none of these processes is left."""
    return not any(map(_is_there, pids))


def _is_there(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


class Trial:
    """One session, one kill, and what comes of it.

    Args:
        number: Of the trial, from which its seed follows.
        kill: What is killed.
        mode: Arguments of the session.
        folder: Where the project is made.
    """

    def __init__(self, number: int, kill: Kill, mode: tuple[str, ...], folder: Path) -> None:
        self.number, self.kill, self.mode = number, kill, mode
        self.draw = random.Random(number)  # noqa: S311 - it chooses whom to kill
        self.name = self.draw.choice(list(NAMES))
        self.project = Project(folder, self.name)
        self.cluster: Cluster | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self.problems: list[str] = []

    def run(self, expected: dict[str, Any]) -> list[str]:
        """A row of the table."""
        with ExitStack() as stack:
            process = self._begun(stack)
            when = self._killed(process)
            began = time.monotonic()
            code, wait = self._ended(process, began)
            first = self.project.record()
            if first.head.gate.result == "passed" and outcome(first) != expected:
                self.problems.append("a pass that is none")
            if code == 0 and first.head.gate.result != "passed":
                self.problems.append("exit code 0 without a pass")
            before, resumed, last = len(self.project.simulations()), "whole", code
            if self.project.resumable:
                process = self._begun(stack, "--dura-resume", again=True)
                last = process.wait(_STUCK)
                taken = self.project.record().head.resume.taken_over
                resumed = f"{taken} of {RUNS} taken over"
            self._compare(expected, last)
            twice = sum(Counter(seed for seed, _ in self.project.simulations()).values()) - RUNS
        cells = [self.number, self.kill.name, " ".join(self.mode) or "default", self.name, when]
        cells += [code, f"{wait:.1f}", resumed, last, twice, before]
        return [*map(str, cells[:-1]), "; ".join(self.problems) or "yes"]

    def _begun(
        self, stack: ExitStack, *arguments: str, again: bool = False
    ) -> subprocess.Popen[bytes]:
        mode = self.mode
        if mode == DASK:
            if self.cluster is None or self.cluster.scheduler.poll() is not None:
                folder = self.project.folder / f"dask{int(again)}"
                folder.mkdir()
                self.cluster = Cluster(folder)
                stack.callback(self.cluster.close)
                path = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(self.project.folder)])}
                self.workers = [self.cluster.worker(path) for _ in range(2)]
            mode = (f"--dura-executor=dask://127.0.0.1:{self.cluster.port}",)
        process = self.project.started(*mode, *arguments)
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process

    def _killed(self, process: subprocess.Popen[bytes]) -> str:
        """Kill what is to be killed; when that was, in words."""
        if self.kill.name == "child, starting":
            which = self.draw.randint(1, 2)
            delay = self.draw.uniform(0.0, 0.15)
            seen: list[int] = []

            def appeared() -> bool:
                seen.extend(pid for pid in self._children(process) if pid not in seen)
                return len(seen) >= which

            if until(appeared, process):
                time.sleep(delay)
                # A process forks once to see whether it can, and that copy is gone at once.
                there: list[int] = []
                until(lambda: there.extend(self._children(process)) or there, process)
                there = there or seen
                self._end(there[min(which, len(there)) - 1])
            return f"start {which} + {delay * 1000:.0f} ms"
        episode, delay = self.draw.randint(1, RUNS - 1), self.draw.uniform(0.0, 0.04)
        worker = self.draw.randrange(2)
        if until(lambda: len(self.project.simulations()) >= episode, process):
            time.sleep(delay)
            if self.kill.name == "controller":
                self._end(process.pid)
            elif self.kill.name == "Dask scheduler":
                assert self.cluster is not None
                self.cluster.kill(self.cluster.scheduler)
            elif self.kill.name == "Dask worker":
                assert self.cluster is not None
                self.cluster.kill(self.workers[worker])
            else:
                self._end(self._process_of(process.pid, self.project.simulations()[episode - 1][1]))
        return f"episode {episode} + {delay * 1000:.0f} ms"

    def _process_of(self, controller: int, child: int) -> int:
        """The process to kill of those from the one that simulated up to the session's."""
        try:
            line = [child, *(each.pid for each in psutil.Process(child).parents())]
        except psutil.NoSuchProcess:
            return child
        if self.kill.name == "child" or controller not in line:
            return child
        place = line.index(controller)
        return line[place - 1] if self.kill.name.startswith("worker") else line[1]

    def _children(self, process: subprocess.Popen[bytes]) -> Iterator[int]:
        try:
            for child in psutil.Process(process.pid).children(recursive=True):
                yield child.pid
        except psutil.Error:  # it ended in between
            return

    def _end(self, pid: int) -> None:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            self.problems.append("it was gone before it was killed")

    def _ended(self, process: subprocess.Popen[bytes], began: float) -> tuple[int, float]:
        """Exit code and seconds, once nothing of the session is left."""
        try:
            code = process.wait(_STUCK)
        except subprocess.TimeoutExpired:
            raise SystemExit(f"trial {self.number} hangs") from None
        own = [pid for _, pid in self.project.simulations()]
        while self.mode != DASK and not gone(own) and time.monotonic() - began < _STUCK:
            time.sleep(_POLL)
        wait = time.monotonic() - began
        if wait > MOST_WAIT:
            self.problems.append(f"a wait of more than {MOST_WAIT:g} s")
        return code, wait

    def _compare(self, expected: dict[str, Any], code: int) -> None:
        record = self.project.record()
        if outcome(record) != expected:
            self.problems.append("other episodes or verdicts")
        names = Counter(one.id for one in record.episodes())
        if sorted(names.values()) != [1] * len(expected["episodes"]):
            self.problems.append("an episode is lost or doubled")
        if code != (0 if expected["gate"] == "passed" else 1):
            self.problems.append(f"exit code {code}")
        if self.project.resumable:
            self.problems.append("not whole")


def undisturbed(folder: Path) -> dict[str, dict[str, Any]]:
    """What each case comes to where nothing is killed."""
    found = {}
    for name in NAMES:
        project = Project(folder / name, name)
        project.started().wait(_STUCK)
        found[name] = outcome(project.record())
        if found[name]["gate"] != ("passed" if name == "held" else "failed"):
            raise SystemExit(project.output.read_text())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=30, help="in turn for each kind of process")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--jobs", type=int, default=1, help="trials at the same time")
    parser.add_argument("--only", choices=[one.name for one in KILLS], action="append")
    options = parser.parse_args()
    kills = [one for one in KILLS if options.only is None or one.name in options.only]
    print(f"Measured on: {machine()}\n")
    with (
        tempfile.TemporaryDirectory(prefix="dura-kills-") as name,
        ThreadPoolExecutor(options.jobs) as jobs,
    ):
        expected = undisturbed(Path(name))

        def row(number: int) -> list[str]:
            kill = kills[number % len(kills)]
            mode = kill.modes[number // len(kills) % len(kill.modes)]
            trial = Trial(number, kill, mode, Path(name, str(number)))
            found = trial.run(expected[trial.name])
            print(" ".join(found), file=sys.stderr, flush=True)
            return found

        rows = list(jobs.map(row, range(options.first, options.first + options.trials)))
    headers = ["trial", "killed", "session", "case", "when", "exit code", "wait, s", "resumed"]
    print(table([*headers, "exit code then", "simulated twice", "as undisturbed"], rows))
    waits, bad = max(float(row[6]) for row in rows), sum(row[-1] != "yes" for row in rows)
    print(
        f"\n{len(rows)} trials, {bad} with a difference; longest wait {waits:.1f} s of at most",
        end="",
    )
    print(f" {MOST_WAIT:g} s")
    raise SystemExit(bad > 0)


if __name__ == "__main__":
    main()
