"""An executor with a process for each episode, a table, a plot, a panel, and a file of verdicts."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from pytest_dura import ExecutorKind
from pytest_dura.evidence import ConcludedColumn, Table
from pytest_dura.reports.document import Picture, Plot
from pytest_dura.reports.html.panels import Panel
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import Frame, Strip, dots_of, five_numbers, strip_plot

CALL = (
    "import importlib, json, sys; module, name, args = json.load(sys.stdin); "
    "sys.stdout.buffer.write(getattr(importlib.import_module(module), name)(*args))"
)


class FreshProcesses(Executor):
    """Carries out each call at once, in a process of its own."""

    def submit(self, fn: Callable[..., bytes], /, *args: Any, seconds: float) -> Future[bytes]:
        """Return the future of a call that is over."""
        future: Future[bytes] = Future()
        done = subprocess.run(
            [sys.executable, "-c", CALL],
            input=json.dumps([fn.__module__, fn.__name__, args]).encode(),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
            capture_output=True,
            timeout=seconds,
            check=False,
        )
        if done.returncode:
            future.set_exception(RuntimeError(done.stderr.decode()))
        else:
            future.set_result(done.stdout)
        return future


class Fresh(ExecutorKind):
    """``--dura-executor=fresh``."""

    form = "fresh"
    where = "in a fresh process each"

    def start(self) -> FreshProcesses:
        """Make the executor."""
        return FreshProcesses()


def render(record: Any) -> str:
    """Render a row for each verdict."""
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(["case", "requirement", "verdict"])
    for verdict in record.head.verdicts:
        rows.writerow([verdict.case, verdict.requirement, verdict.verdict])
    return table.getvalue()


class Heights(Table):
    """How far each case reached."""

    name = "heights"
    title = "Heights"
    about = "Events of the cabin in each case."
    columns = (ConcludedColumn("case"), ConcludedColumn("episodes", "episodes that were run"),
               ConcludedColumn("time", "simulated time", "s"))  # fmt: skip

    def __init__(self, head: Any) -> None:
        """Begin to count."""
        super().__init__(head)
        self.seconds: dict[str, list[float]] = {}

    def add(self, episode: Any) -> None:
        """Add an episode."""
        self.seconds.setdefault(episode.case, []).append(episode.timings.simulated_seconds)

    def rows(self) -> Any:
        """Return a row for each case."""
        for case, seconds in sorted(self.seconds.items()):
            yield case, len(seconds), sum(seconds)


class Rides(Table):
    """How many rides each process made, as the guest counted them."""

    name = "rides"
    title = "Rides"
    columns = (ConcludedColumn("process"), ConcludedColumn("made"))
    detail = True

    def add(self, episode: Any) -> None:
        """Add nothing: the guest counts."""

    def counts(self) -> dict[str, int]:
        """Return the facts of the record."""
        facts = [fact for fact in self.head.facts or () if fact.table == self.name]
        return {fact.process: fact.data["made"] for fact in facts}

    def rows(self) -> Any:
        """Return a row for each process."""
        return sorted(self.counts().items())

    def lines(self) -> Any:
        """Return the sum."""
        return [f"rides: {sum(self.counts().values())}"]


class Travel(PlotKind):
    """How long the cabin travelled in each case."""

    def __init__(self, head: Any) -> None:
        """Begin to count."""
        super().__init__(head)
        self.seconds: dict[str, list[float]] = {}

    def add(self, episode: Any) -> None:
        """Add an episode."""
        self.seconds.setdefault(episode.case, []).append(episode.timings.simulated_seconds)

    def plots(self) -> Any:
        """Draw a row for each case."""
        rows = sorted(self.seconds.items())
        strips = [Strip(case, five_numbers(times), dots_of(times)) for case, times in rows]
        picture = strip_plot(strips, Frame("travel", "Time of travel by case", "time in s"))
        words = tuple(f"{case}: at most {max(times):.1f} s" for case, times in rows)
        yield Plot("Time of travel", (Picture("All <runs>", picture),), lines=words)


class WayLeft(Panel):
    """How far the cabin still has to go, as its controller has it."""

    script = Path(__file__).with_name("left.js")

    @classmethod
    def data(cls, recording: Any) -> Any:
        """Return the metres at each decision; nothing where no account has them."""
        left = [account["left"] for account in recording.accounts if "left" in account]
        return {"metres": [round(metres, 2) for metres in left]} if left else None
