"""A room that may end the process that simulates it, block it, or take its time."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil
from thermostat import Thermostat

from pytest_dura import EpisodeSpec, JudgedEpisode, RoleSpec, Tick
from pytest_dura.core import NOTHING
from pytest_dura.execution import EpisodeTask


class ShakyRoom(Thermostat):
    """Leaves a file in ``log`` for each episode, and does to the one with a seed what is said."""

    def __init__(
        self, log: str | None = None, deeds: Mapping[str, str] = NOTHING, seconds: float = 0.0
    ) -> None:
        self.log, self.deeds, self.seconds = log, deeds, seconds

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """A room at its start temperature, if it comes to that."""
        if self.log is not None:
            Path(self.log, f"{seed}.{os.getpid()}.{time.monotonic_ns()}").touch()
        sys.stdout.write("a simulator that prints")
        sys.stdout.flush()
        os.system("echo and what it starts")
        match self.deeds.get(str(seed)):
            case "ends":
                os.kill(os.getpid(), signal.SIGKILL)
            case "ends its worker":  # as a machine does that has no memory left
                os.kill(psutil.Process(os.getppid()).ppid(), signal.SIGKILL)
                time.sleep(60.0)
            case "blocks":
                while True:
                    time.sleep(1.0)
        time.sleep(self.seconds)
        return super().reset(scenario, seed)


def is_warm(episode: JudgedEpisode) -> bool:
    """Check that the room is warm in the end."""
    return bool(episode.signals["temperature"][-1] > 10.0)


def begun(log: Path) -> list[int]:
    """The seeds of the episodes that were begun, each as often as it was."""
    return sorted(int(one.name.partition(".")[0]) for one in log.iterdir())


def shaky(seed: int, log: Path | None = None, **params: Any) -> EpisodeTask:
    """The task of an episode in a shaky room."""
    told = params if log is None else {"log": str(log), **params}
    return EpisodeTask(
        EpisodeSpec(
            "room/shaky",
            seed,
            seed,
            RoleSpec("shaky:ShakyRoom", told),
            {"generator": RoleSpec("thermostat:Controller")},
            {"world": {"start": 15.0}},
            time_budget=None,
        )
    )
