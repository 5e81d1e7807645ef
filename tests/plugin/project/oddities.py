"""Parts of the corridor that fail, lie or do harm, each in one way."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, ClassVar

from corridor import Careful, Corridor, Watch

from pytest_dura import (
    Assessed,
    Assessment,
    FaultInjector,
    Injection,
    Recovery,
    RecoveryPlanner,
    SafetyMonitor,
)
from pytest_dura.faults import FaultEffect


class Stumbles(Careful):
    """Fails at its third proposal, and at no other."""

    calls = 0

    def reset(self, context):
        self.calls = 0

    def propose(self, view):
        self.calls += 1
        return self.fails() if self.calls == 3 else super().propose(view)


class RaisesOnce(Stumbles):
    def fails(self):
        raise ValueError("out of ideas")


class HangsOnce(Stumbles):
    def fails(self):
        time.sleep(60)


class ReturnsNoneOnce(Stumbles):
    def fails(self):
        return None


class TurnsNaN(Corridor):
    """A simulator whose signals are no numbers from the third tick on."""

    def step(self, action):
        tick = super().step(action)
        if self.index >= 2:
            tick = replace(tick, truth={**tick.truth, "x": math.nan, "gap": math.nan})
        return tick


class Abrupt(Corridor):
    """It ends at a contact."""

    def _tick(self):
        tick = super()._tick()
        return replace(tick, critical="contact") if tick.truth["gap"] <= 0 else tick


class EndsByItself(Corridor):
    """A plant with a time limit of its own, which refuses to be stepped after it."""

    def step(self, action):
        if self.index >= 5:
            raise RuntimeError("stepped after its end")
        return replace(super().step(action), truncated=self.index == 5)


class Fragile(Corridor):
    """Breaks as the wall is touched, and before that can be seen."""

    def step(self, action):
        if self.x + float(action) * self.time_step >= self.wall:
            raise RuntimeError("the wall gave way")
        return super().step(action)


class BrokenSafetyMonitor(Watch):
    def run(self, view):
        if view.percept["gap"] < 3.9:
            raise RuntimeError("no opinion")
        return super().run(view)


class NaNSafetyMonitor(Watch):
    def run(self, view):
        found = super().run(view)
        return replace(found, score=math.nan) if view.percept["gap"] < 3.9 else found


class LateNaN(Watch):
    """Fails once the wall is touched."""

    def run(self, view):
        found = super().run(view)
        return replace(found, score=math.nan) if view.percept["gap"] <= 0 else found


class Early(SafetyMonitor):
    """Calls for recovery long before there is a need."""

    def run(self, view):
        gap = view.percept["gap"]
        return Assessment(Assessed.UNSAFE if gap < 3.5 else Assessed.SAFE, score=gap)


class Push(RecoveryPlanner):
    """A recovery that does harm: it runs into the wall."""

    def run(self, view):
        return Recovery(20.0, "push")


class Nudge(FaultInjector):
    """Adds a millimetre to the gap that is perceived, once the planned fault's time is past."""

    def reset(self, context):
        self.faults = context.faults

    def run(self, view):
        return Injection()

    def corrupt(self, channels, time):
        due = [fault.id for fault in self.faults if time > fault.activation["at"] + 1e-9]
        if not due:
            return channels, {}
        return {**channels, "gap": channels["gap"] + 0.001}, {"gap": tuple(due)}


class Drizzle(FaultEffect):
    """A fault that is there by chance, and never is."""

    acts_on: ClassVar[str] = "any"
    default_target: ClassVar[str] = "gap"

    @classmethod
    def example(cls) -> dict[str, Any]:
        return {"activation": {"at": 0.0}}

    @property
    def hits_by_chance(self) -> bool:
        return True

    def apply(self, memory, value, moment):
        return value
