"""A corridor with a wall at its end, and parts of it that fail, lie or do harm."""

from __future__ import annotations

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


class Corridor(Simulator):
    """Its runs differ by a breeze, which moves nothing."""

    measures = MEASURES

    def reset(self, scenario, seed):
        self.x, self.index = 0.0, 0
        self.breeze = self.blow(seed)
        self.wall = float(scenario["world"].get("wall", 10.0))
        self.breaks_at = scenario["world"].get("breaks_at")
        self.ends_critical = scenario["world"].get("ends_critical", False)
        return self._tick()

    def blow(self, seed):
        return float(stream(seed, "breeze").random())

    def step(self, action):
        self.index += 1
        if self.index == self.breaks_at:
            raise RuntimeError("the corridor collapsed")
        self.x += float(action) * self.time_step
        return self._tick()

    def _tick(self):
        gap = max(0.0, self.wall - self.x)
        critical = "fell down the stairs" if self.ends_critical and self.x > 1.0 else None
        state = {"x": self.x, "gap": gap}
        return Tick(self.index, self.index * self.time_step, state, {"gap": gap}, critical=critical)

    def signals(self, ticks):
        x = np.array([tick.truth["x"] for tick in ticks])
        gap = np.array([tick.truth["gap"] for tick in ticks])
        return {
            "x": x,
            "gap": gap,
            "collided": (gap <= 0).astype(float),
            "cleared": (x >= 1.0).astype(float),
            "breeze": np.full(len(ticks), self.breeze),
        }

    def fallback_action(self):
        return 0.0


class Still(Corridor):
    """Nothing in it rests on the seed."""

    def blow(self, seed):
        return 0.0


class Unsteady(Corridor):
    """Begins elsewhere each time: it breaks the contract."""

    resets = 0

    def reset(self, scenario, seed):
        type(self).resets += 1
        super().reset(scenario, seed)
        self.x = 0.01 * type(self).resets
        return self._tick()


class Careful(Generator):
    def propose(self, view):
        return Proposal(1.0 if view.percept["gap"] > 3.0 else 0.0)


class Reckless(Generator):
    def propose(self, view):
        return Proposal(20.0)


class Stumbles(Careful):
    """Fails at its third proposal, and at no other."""

    def reset(self, context):
        self.calls = 0

    def propose(self, view):
        self.calls += 1
        if self.calls == 3:
            raise ValueError("out of ideas")
        return super().propose(view)


class Hasty(Careful):
    """Blind where the wall is 10.6 to 10.8 m away at first."""

    def reset(self, context):
        self.first = None

    def propose(self, view):
        gap = view.percept["gap"]
        self.first = self.first or gap
        return Proposal(90.0 if 10.6 <= self.first <= 10.8 else 1.0 if gap > 3.0 else 0.0)


class Mortal(Careful):
    """Kills its process as its fourth episode begins, once."""

    resets = 0

    def reset(self, context):
        type(self).resets += 1
        if type(self).resets == 4 and Path("kill").exists():
            Path("kill").unlink()
            time.sleep(2.0)  # until the earlier episodes are on disk
            os.kill(os.getpid(), signal.SIGKILL)


class Watch(SafetyMonitor):
    def run(self, view):
        gap = view.percept["gap"]
        verdict = Assessed.UNSAFE if gap < 1.0 else Assessed.SAFE
        return Assessment(verdict, score=gap, reasons=("too near",))


class Early(SafetyMonitor):
    """Calls for recovery long before there is a need."""

    def run(self, view):
        gap = view.percept["gap"]
        return Assessment(Assessed.UNSAFE if gap < 3.5 else Assessed.SAFE, score=gap)


class Broken(SafetyMonitor):
    def run(self, view):
        if view.percept["gap"] < 9.5:
            raise RuntimeError("no opinion")
        return Assessment(Assessed.SAFE)


class Brake(RecoveryPlanner):
    def run(self, view):
        return Recovery(0.0, "brake")


class Push(RecoveryPlanner):
    """A recovery that does harm: it runs into the wall."""

    def run(self, view):
        return Recovery(20.0, "push")


class Idle(FaultInjector):
    """Never activates what is planned."""

    def run(self, view):
        return Injection()


def last(episode):
    return float(episode.time[-1])


def farthest(episode):
    return episode.signals["x"].max()


def half_a_metre(episode):
    return episode.signals["gap"].min() - 0.5
