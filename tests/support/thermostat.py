"""A second domain, in pure Python: a heated room. The loop needs to know nothing of it."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura import (
    ActionError,
    Alert,
    Assessed,
    Assessment,
    FaultInjector,
    Generator,
    Injection,
    Percept,
    PerformanceAssessment,
    PerformanceOracle,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    RoleContext,
    RoleView,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
    Simulator,
    Tick,
    stream,
)
from pytest_dura.core import NOTHING, GeneratorView, Lazy

LIMIT = 30.0
"""°C above which a room is too hot."""


class Thermostat(Simulator):
    """A room with a heater. The action is the heating power from 0 to 1.

    The scenario's ``world`` may give ``start`` (°C), ``outside`` (°C), ``goal`` (°C, reached when
    the room is that warm) and ``fuse`` (°C at which the fuse blows: critical).
    """

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """A room at its start temperature."""
        world = scenario.get("world", {})
        self._temperature = float(world.get("start", 15.0))
        self._outside = float(world.get("outside", 5.0))
        self._goal, self._fuse = world.get("goal"), world.get("fuse", 60.0)
        self._weather = stream(seed, "weather")
        self._index, self._power = 0, 0.0
        return self._tick(())

    def step(self, action: Any) -> Tick:
        """Heat and lose heat."""
        gust = float(self._weather.normal(0.0, 0.2))
        loss = 0.1 * (self._temperature - self._outside) + gust
        self._temperature += (8.0 * action - loss) * self.time_step
        self._index += 1
        switched, self._power = (action > 0.0) != (self._power > 0.0), action
        return self._tick((("switched", "heater", "on" if action else "off"),) if switched else ())

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """``temperature`` in °C, ``power`` from 0 to 1, and ``headroom`` in °C below the limit."""
        temperature = np.array([tick.truth["temperature"] for tick in ticks])
        power = np.array([tick.truth["power"] for tick in ticks])
        return {"temperature": temperature, "power": power, "headroom": LIMIT - temperature}

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, NDArray[np.float64]]:
        """``temperature`` as measured."""
        return {"temperature": np.array([float(p["thermometer"]) for p in percepts])}

    def check_action(self, action: Any) -> float:
        """A power from 0 to 1."""
        number = isinstance(action, (int, float)) and not isinstance(action, bool)
        if not number or not 0.0 <= action <= 1.0:
            raise ActionError(f"{action!r} is not a heating power from 0 to 1")
        return float(action)

    def describe_action(self, action: Any) -> str:
        """The power in percent."""
        return f"{action:.0%}"

    def fallback_action(self) -> float:
        """Without a command the heater is off."""
        return 0.0

    def render(self) -> NDArray[np.uint8]:
        """A picture that is the redder the hotter it is."""
        picture = np.full((4, 6, 3), 64, dtype=np.uint8)
        picture[..., 0] = int(np.clip(self._temperature * 4.0, 1.0, 255.0))
        return picture

    def snapshot(self) -> object:
        """All attributes, copied."""
        return copy.deepcopy(vars(self))

    def restore(self, snapshot: object) -> None:
        """Return to a snapshot."""
        vars(self).update(copy.deepcopy(snapshot))  # type: ignore[call-overload]

    def _tick(self, events: tuple[tuple[str, str, str], ...]) -> Tick:
        temperature = self._temperature
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth={"temperature": temperature, "power": self._power},
            channels={
                "thermometer": temperature,
                "clock": self._index * self.time_step,
                "thermal_camera": Lazy(lambda: round(temperature)),
            },
            goal=self._goal is not None and temperature >= self._goal,
            critical="the fuse has blown" if temperature >= self._fuse else None,
            events=events,
        )


class Controller(Generator):
    """Heats below a set point."""

    def __init__(self, target: float = 20.0) -> None:
        self.target = target

    def propose(self, view: GeneratorView) -> Proposal:
        """Full power below the target, none above."""
        return Proposal(1.0 if view.percept["thermometer"] < self.target else 0.0, "on or off")


class Overheater(Generator):
    """Always heats."""

    def propose(self, view: GeneratorView) -> Proposal:
        """Full power."""
        view.percept["thermometer"]
        return Proposal(1.0, "more")


class HeatMonitor(SafetyMonitor):
    """Refuses to heat a room that is measured to be too hot."""

    def __init__(self, limit: float = LIMIT) -> None:
        self.limit = limit

    def run(self, view: RoleView) -> Assessment:
        """The margin is the distance to the limit in °C."""
        assert view.proposal is not None
        margin = self.limit - view.percept["thermometer"]
        if margin < 0.0 and view.proposal.action > 0.0:
            return Assessment(Assessed.UNSAFE, margin, ("heating above the limit",))
        verdict = Assessed.WARNING if margin < 2.0 else Assessed.SAFE
        return Assessment(verdict, margin, ("close to the limit",) if margin < 2.0 else ())


class JumpWatch(SecurityAssessor):
    """Alerts where the measured temperature jumps."""

    def reset(self, context: RoleContext) -> None:
        """No measurement yet."""
        self._last: float | None = None

    def run(self, view: RoleView) -> SecurityAssessment:
        """One alert per jump of more than 3 °C."""
        now, before = view.percept["thermometer"], self._last
        self._last = now
        if before is None or abs(now - before) < 3.0:
            return SecurityAssessment(reaction="unaffected")
        alert = Alert("jump", "thermometer", f"{now - before:+.1f}")
        return SecurityAssessment(alerts=(alert,), reaction="follows the fake")


class Bias(FaultInjector):
    """Adds a bias to the thermometer while a planned fault is active."""

    def __init__(self, bias: float = -10.0) -> None:
        self.bias = bias

    def reset(self, context: RoleContext) -> None:
        """Read the plan."""
        self._plan = {fault.id: fault for fault in context.faults}
        self._active: set[str] = set()
        self._told: set[str] = set()

    def run(self, view: RoleView) -> Injection:
        """Which of them have begun and ended at this tick."""
        on, off = self._active - self._told, self._told - self._active
        self._told = set(self._active)
        return Injection(tuple(sorted(on)), tuple(sorted(off)))

    def corrupt(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """The target channel plus the bias of each fault that is active at this time."""
        now = time + 1e-9
        self._active = {
            name
            for name, fault in self._plan.items()
            if (start := fault.activation["at"]) <= now < start + fault.duration
        }
        if not self._active:
            return channels, NOTHING
        changed, tampered = dict(channels), {}
        for name in sorted(self._active):
            target = self._plan[name].target
            changed[target] = changed[target] + self.bias
            tampered[target] = (*tampered.get(target, ()), name)
        return changed, tampered


class Meter(PerformanceOracle):
    """Sums up energy; fails above one unit."""

    def reset(self, context: RoleContext) -> None:
        """Nothing used yet."""
        self._energy = 0.0

    def run(self, view: RoleView) -> PerformanceAssessment:
        """Energy so far, and the Generator's wall-clock time."""
        if view.proposal is not None:
            self._energy += view.proposal.action * view.dt
        return PerformanceAssessment(
            {"energy": self._energy},
            {"response_s": view.generator_seconds},
            ("energy",) if self._energy > 1.0 else (),
        )


class SwitchOff(RecoveryPlanner):
    """Switches the heater off."""

    def run(self, view: RoleView) -> Recovery:
        """No power."""
        return Recovery(0.0, "switch_off", "; ".join(view.reasons))


class NightWatch(Role):
    """A user's own role with a trigger of its own: looks on every fifth tick, after the monitor."""

    name = "night_watch"
    after = ("safety_monitor",)

    def trigger(self, view: RoleView) -> bool:
        """Every fifth tick."""
        return view.index % 5 == 0

    def run(self, view: RoleView) -> tuple[int, Any]:
        """The tick, and what the monitor has just said."""
        return view.index, view.outputs.get("safety_monitor")
