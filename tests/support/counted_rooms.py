"""Episodes of the heated room that leave a trace of each simulation, for several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from thermostat import Controller

from pytest_dura.core import EpisodeSpec, RoleSpec, Termination
from pytest_dura.execution import EpisodeCache, EpisodeStore, EpisodeTask

FORKS = multiprocessing.get_context("fork") if hasattr(os, "fork") else None


class Counted(Controller):
    """Writes the number of the run when an episode begins.

    Args:
        folder: In which ``log`` grows by a line for each simulation. A file ``deadly`` there names
            the run that kills the process.
    """

    def __init__(self, folder: str) -> None:
        super().__init__()
        self.folder = Path(folder)

    def reset(self, context: Any) -> None:
        """Note the simulation, and do what is asked for."""
        run = str(context.scenario["world"]["run"])
        with (self.folder / "log").open("a") as log:
            log.write(f"{run}\n")
        deadly = self.folder / "deadly"
        if deadly.exists() and deadly.read_text() == run:
            os.kill(os.getpid(), signal.SIGKILL)


def counted_task(folder: Path, run: int) -> EpisodeTask:
    """An episode of 0.3 s."""
    generator = RoleSpec("counted_rooms:Counted", {"folder": str(folder)})
    spec = EpisodeSpec(
        "room/counted", run, 100 + run, RoleSpec("thermostat:Thermostat"),
        {"generator": generator}, scenario={"world": {"run": run}}, termination=Termination(0.3),
    )  # fmt: skip
    return EpisodeTask(spec)


def counted_store(folder: Path, session: str = "s", *, earlier: bool = False) -> EpisodeStore:
    """A store whose episodes are kept in the folder."""
    return EpisodeStore(EpisodeCache(folder / "shelf", session, earlier=earlier))


def simulated(folder: Path) -> Counter[int]:
    """How often each run was simulated."""
    file = folder / "log"
    return Counter(map(int, file.read_text().split())) if file.exists() else Counter()


def in_processes(work: Sequence[Callable[[], None]]) -> list[int]:
    """Do the work in a process each, at the same time; their exit codes."""
    assert FORKS is not None
    processes = [FORKS.Process(target=one) for one in work]
    for one in processes:
        one.start()
    for one in processes:
        one.join(60.0)
    return [one.exitcode for one in processes]
