"""What the evidence of the built-in scenarios costs: seconds of the session, and bytes on disk.

Each level of evidence is a session of its own, in which the clock runs in whatever makes evidence
and is held elsewhere, so that each share is a ratio within one run. Time is that of the processor.
Counted are what items tell, recording what a viewer shows, traces, the record, every format and the
manifest. Episodes are simulated in the session's own process, where the clock sees what recording
them takes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from time import process_time
from typing import Any

from machine import machine, table

LEVELS = ("summary", "violations", "all")
GOALS = {"summary": 0.05, "violations": 0.05, "all": 0.15}
"""Share of the session: without traces of every episode, and with all of them."""


class Clock:
    """Seconds spent in some functions, by what they are for; a nested one counts where it is."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = 0.0

    def runs_in(self, owner: Any, name: str, purpose: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)

        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._turn(purpose)
            try:
                return function(*arguments, **named)
            finally:
                self._turn(None)

        setattr(owner, name, timed)

    def _turn(self, purpose: str | None) -> None:
        now = process_time()
        if self._open:
            self.seconds[self._open[-1]] += now - self._since
        self._since = now
        if purpose is None:
            self._open.pop()
        else:
            self._open.append(purpose)


def watch(clock: Clock) -> None:
    """Let the clock run in everything that makes evidence."""
    from pytest_dura.core.log import EpisodeLog
    from pytest_dura.evidence import bundle
    from pytest_dura.plugin.session.evidence import SessionEvidence
    from pytest_dura.plugin.session.recorder import ItemRecorder, TraceKeeper

    clock.runs_in(EpisodeLog, "_recording", "recording")
    for name in ("episode_used", "verdict_reached", "monitors_measured", "faults_traced", "attach"):
        clock.runs_in(ItemRecorder, name, "items")
    for name in ("episode_used", "violated"):
        clock.runs_in(TraceKeeper, name, "traces")
    for name in ("start", "gather", "take", "finish"):
        clock.runs_in(SessionEvidence, name, "record")
    clock.runs_in(bundle, "_write_format", "formats")


def session(level: str, directory: Path, options: list[str]) -> None:
    """One session in this process, which prints its figures as JSON."""
    import pytest

    clock = Clock()

    class Watch:
        """pytest wants to load the plugin itself."""

        def pytest_configure(self) -> None:
            watch(clock)

    begun = process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        code = pytest.main(
            ["--dura-scenarios", f"--dura-evidence={directory}", f"--dura-evidence-level={level}",
             "--dura-executor=in-process", "-p", "no:cacheprovider", "-q", *options],
            plugins=[Watch()],
        )  # fmt: skip
    seconds = process_time() - begun
    print(json.dumps({"code": int(code), "session": seconds, **clock.seconds}))


def measured(level: str, directory: Path, options: list[str]) -> dict[str, float]:
    script = str(Path(__file__).resolve())
    command = [sys.executable, script, "--session", level, str(directory), *options]
    found = subprocess.run(
        command, cwd=directory.parent, stdout=subprocess.PIPE, text=True, check=True
    )
    told: dict[str, float] = json.loads(found.stdout.splitlines()[-1])
    if told.pop("code") > 1:  # a gate that fails for want of runs has all of its evidence, too
        raise SystemExit(f"the session with level {level} failed")
    return told


def size(directory: Path, pattern: str) -> tuple[int, int]:
    files = [file for file in directory.glob(pattern) if file.is_file()]
    return len(files), sum(file.stat().st_size for file in files)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--select", default="*", help="cases, as for --dura-select")
    parser.add_argument("--runs", help="runs per case, as for --dura-runs")
    parser.add_argument("--levels", nargs="+", default=LEVELS, choices=LEVELS)
    given = parser.parse_args()
    options = [f"--dura-select={given.select}"]
    options += [f"--dura-runs={given.runs}", "--dura-undecided=warn"] if given.runs else []
    parts = ("recording", "items", "traces", "record", "formats")
    rows = []
    for level in given.levels:
        with tempfile.TemporaryDirectory() as folder:
            directory = Path(folder) / "evidence"
            told = measured(level, directory, options)
            traces, traced = size(directory, "episodes/*.mcap")
            _, rest = size(directory, "*")
        spent = sum(told.get(part, 0.0) for part in parts)
        share = spent / told["session"]
        rows.append(
            [level, f"{told['session']:.1f}", *(f"{told.get(part, 0.0):.2f}" for part in parts),
             f"{share:.1%}", f"{GOALS[level]:.0%}", f"{rest / 1e6:.1f}", str(traces),
             f"{traced / 1e6:.1f}"]
        )  # fmt: skip
    print(machine())
    print()
    headers = ["level", "session, s", *(f"{part}, s" for part in parts), "share of session",
               "goal", "files, MB", "traces", "traces, MB"]  # fmt: skip
    print(table(headers, rows))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--session"]:
        session(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
    else:
        main()
