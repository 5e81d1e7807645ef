"""A corridor with a wall at its end: the smallest world with gap, collided and cleared."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path

import numpy as np

from pytest_dura import (
    Assessed,
    Assessment,
    FaultInjector,
    Generator,
    Injection,
    Proposal,
    Recovery,
    RecoveryPlanner,
    SafetyMonitor,
    Simulator,
    Tick,
    stream,
)
from pytest_dura.driving import MEASURES

STEPS = []


class Corridor(Simulator):
    """Its runs differ by a breeze, which moves nothing."""

    measures = MEASURES

    def reset(self, scenario, seed):
        STEPS.append(scenario["name"])
        log = os.environ.get("CORRIDOR_LOG")
        if log:
            with Path(log).open("a") as opened:
                opened.write(f"{scenario['name']} {seed}\n")
        self.x, self.index = 0.0, 0
        self.breeze = self.blow(seed)
        self.wall = float(scenario["world"].get("wall", 10.0))
        self.breaks_at = scenario["world"].get("breaks_at")
        self.dies = scenario["world"].get("dies", False)
        return self._tick()

    def blow(self, seed):
        return float(stream(seed, "breeze").random())

    def step(self, action):
        self.index += 1
        if self.dies:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.breaks_at is not None and self.index >= self.breaks_at:
            raise RuntimeError("the corridor collapsed")
        self.x += float(action) * self.time_step
        return self._tick()

    def _tick(self):
        gap = max(0.0, self.wall - self.x)
        state = {"x": self.x, "gap": gap, "breeze": self.breeze}
        return Tick(self.index, self.index * self.time_step, state, {"gap": gap})

    def signals(self, ticks):
        x = np.array([tick.truth["x"] for tick in ticks])
        gap = np.array([tick.truth["gap"] for tick in ticks])
        return {
            "x": x,
            "gap": gap,
            "collided": (gap <= 0).astype(float),
            "cleared": (x >= 1.0).astype(float),
            "breeze": np.array([tick.truth["breeze"] for tick in ticks]),
        }

    def fallback_action(self):
        return 0.0


class Still(Corridor):
    """Nothing in it rests on the seed."""

    def blow(self, seed):
        return 0.0


class Unsteady(Corridor):
    """Not a function of scenario, seed and actions: it breaks the contract."""

    resets = 0

    def reset(self, scenario, seed):
        type(self).resets += 1
        tick = super().reset(scenario, seed)
        self.x = float(os.getpid() % 1000) + type(self).resets
        return tick


class Careful(Generator):
    def propose(self, view):
        return Proposal(1.0 if view.percept["gap"] > 3.0 else 0.0)


class Reckless(Generator):
    def propose(self, view):
        return Proposal(20.0)


class Raises(Generator):
    def propose(self, view):
        raise ValueError("out of ideas")


class ReturnsNaN(Generator):
    def propose(self, view):
        return Proposal(math.nan)


class Hangs(Generator):
    def propose(self, view):
        time.sleep(60)


class NoGenerator:
    pass


class Watch(SafetyMonitor):
    def run(self, view):
        gap = view.percept["gap"]
        verdict = Assessed.UNSAFE if gap < 1.0 else Assessed.SAFE
        return Assessment(verdict, score=gap, reasons=("too near",))


class Broken(SafetyMonitor):
    def run(self, view):
        raise RuntimeError("no opinion")


class Brake(RecoveryPlanner):
    def run(self, view):
        return Recovery(0.0, "brake")


class Idle(FaultInjector):
    """Never activates what is planned."""

    def run(self, view):
        return Injection()
