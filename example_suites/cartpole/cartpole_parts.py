"""A pole on a cart: what is true, what the sensors report, and the roles around its controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura import (
    Assessed,
    Assessment,
    FaultInjector,
    Generator,
    GeneratorView,
    Injection,
    Line,
    Percept,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    RoleContext,
    RoleView,
    SafetyMonitor,
    Scene,
    Tick,
    Tracks,
)

LEFT, RIGHT = 0, 1
FALLEN = radians(12.0)
"""CartPole terminates here."""
STEEP = radians(3.0)
"""Beyond this the monitor refuses a push that makes it steeper."""
TRACK = 2.4
"""m from the middle to the end of the track."""
POLE = 1.0
"""m from the cart to the tip."""


class Pole(NamedTuple):
    """What the angle sensor reports: rad from upright, positive to the right, and rad/s."""

    angle: float
    rate: float


def signals(observation: Any, info: Mapping[str, Any], reward: float) -> dict[str, float]:
    """Ground truth: position in m, angle in rad, and the margins to the end of both."""
    position, _, angle, _ = map(float, observation)
    return {
        "position": position,
        "angle": angle,
        "upright": FALLEN - abs(angle),
        "room": TRACK - abs(position),
    }


def sensors(observation: Any, info: Mapping[str, Any]) -> dict[str, Any]:
    """Channels: the pole and the cart's position (m) and speed (m/s)."""
    position, speed, angle, rate = map(float, observation)
    return {"pole": Pole(angle, rate), "position": position, "speed": speed}


def scene(ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
    """What the report's player shows, seen from the side: the track, the cart and the pole."""
    true = [(tick.truth["position"], tick.truth["angle"]) for tick in ticks]
    believed = [(percept["position"], percept["pole"].angle) for percept in percepts]
    track = Line("edge", np.array([(-TRACK, 0.0), (TRACK, 0.0)], np.float32))
    return Scene((track,), _tracks(true), _tracks(believed), ego="cart")


def _tracks(states: Sequence[tuple[float, float]]) -> Tracks:
    """Cart and pole, from the cart's position in m and the pole's angle in rad."""
    x, angle = np.array(states).T
    poses: NDArray[np.float32] = np.zeros((len(states), 2, 6), np.float32)
    poses[:, 0, 0] = x
    poses[:, 0, 4:] = 0.5, 0.3
    # In a scene y points downwards and angles turn clockwise: upright is -pi / 2.
    poses[:, 1, 0] = x + POLE / 2 * np.sin(angle)
    poses[:, 1, 1] = -POLE / 2 * np.cos(angle)
    poses[:, 1, 2] = angle - np.pi / 2
    poses[:, 1, 4:] = POLE, 0.06
    return Tracks(("cart", "pole"), poses)


class Balancer(Generator):
    """The component under test: a PD controller on the angle that also minds the position."""

    def __init__(self, damping: float = 0.4, centring: float = 0.04) -> None:
        self.damping, self.centring = damping, centring

    def propose(self, view: GeneratorView) -> Proposal:
        """Push to the side to which the pole falls."""
        pole, percept = view.percept["pole"], view.percept
        lean = pole.angle + self.damping * pole.rate
        lean += self.centring * (percept["position"] + 2.0 * percept["speed"])
        return Proposal(RIGHT if lean > 0.0 else LEFT, f"lean {lean:+.3f}")


class Stubborn(Generator):
    """A component that always pushes right."""

    def propose(self, view: GeneratorView) -> Proposal:
        """Right, whatever the pole does."""
        return Proposal(RIGHT, f"angle {view.percept['pole'].angle:+.3f}")


class AngleMonitor(SafetyMonitor):
    """Refuses to push a steep pole further over; the score is the margin to falling, in rad."""

    def run(self, view: RoleView) -> Assessment:
        """Unsafe where the pole is steep, falls on, and the cart would be pushed the wrong way."""
        assert view.proposal is not None
        angle, rate = view.percept["pole"]
        margin = FALLEN - abs(angle)
        side = RIGHT if angle > 0.0 else LEFT
        falls_on = angle * rate > 0.0
        if abs(angle) > STEEP and falls_on and view.proposal.action != side:
            return Assessment(Assessed.UNSAFE, margin, (f"{angle:+.3f} rad and falling on",))
        return Assessment(Assessed.WARNING if abs(angle) > STEEP else Assessed.SAFE, margin)


class CatchThePole(RecoveryPlanner):
    """Pushes the cart under the pole."""

    def run(self, view: RoleView) -> Recovery:
        """To the side to which it falls."""
        side = RIGHT if view.percept["pole"].angle > 0.0 else LEFT
        return Recovery(side, "catch", "; ".join(view.reasons))


class StuckSensor(FaultInjector):
    """While a planned fault lasts, the angle sensor goes on reporting its last value."""

    def reset(self, context: RoleContext) -> None:
        """Read the plan."""
        self._plan = {
            fault.id: (fault.activation["at"], fault.duration) for fault in context.faults
        }
        self._held: dict[str, Pole] = {}
        self._active: tuple[str, ...] = ()
        self._last: Pole | None = None

    def run(self, view: RoleView) -> Injection:
        """Activate and deactivate by time; takes effect at the next update."""
        ahead = view.time + view.dt + 1e-9
        active = tuple(name for name, (at, lasts) in self._plan.items() if at <= ahead < at + lasts)
        started = tuple(name for name in active if name not in self._active)
        ended = tuple(name for name in self._active if name not in active)
        self._active = active
        return Injection(started, ended)

    def corrupt(self, channels: Mapping[str, Any], time: float) -> Any:
        """The pole as it was when the sensor got stuck."""
        if not self._active or self._last is None:
            self._last = channels["pole"]
            return channels, {}
        return {**channels, "pole": self._last}, {"pole": self._active}


class DriftWatch(Role):
    """A role of our own: once a second, after the monitor, how far the cart has drifted."""

    name = "drift_watch"
    after = ("safety_monitor",)

    def __init__(self, every: float = 1.0) -> None:
        self.every = every

    def reset(self, context: RoleContext) -> None:
        """Look for the first time at once."""
        self._next = 0.0

    def trigger(self, view: RoleView) -> bool:
        """Whether the time has come."""
        return view.time >= self._next - 1e-9

    def run(self, view: RoleView) -> dict[str, float]:
        """The drift in m, beside the monitor's margin of this very tick."""
        self._next = view.time + self.every
        margin = view.outputs["safety_monitor"].score
        return {"drift": view.percept["position"], "margin": margin}
