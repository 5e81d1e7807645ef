"""What recovery planners look at: the scene with its motion, and the monitor's own judgement."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.core.roles import Assessment, Proposal, RoleContext
from pytest_dura.core.state import NOTHING, Percept, RoleView
from pytest_dura.driving.bodies import BodyList
from pytest_dura.driving.maneuvers import Command
from pytest_dura.driving.plausible import objects
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.roles.safety import SeparationMonitor
from pytest_dura.driving.scene import Scene

Perceived = Callable[[Percept], BodyList]
"""Which objects of a percept count."""


def lidar(percept: Percept) -> BodyList:
    """All objects, just as lidar reports them."""
    bodies: BodyList = percept["lidar"]
    return bodies


def observed(predictor: Predictor, view: RoleView) -> Scene:
    """The scene of this tick; the predictor has seen the tick before as well.

    A planner is asked at some ticks only, and yaw rates need two in a row.
    """
    if view.index and len(view.percepts) > 1:
        predictor.observe(view.index - 1, objects(view.percepts[-2]))
    scene = Scene.of(view.percept)
    predictor.observe(view.index, scene.bodies)
    return scene


class SecondOpinion:
    """The SeparationMonitor's judgement of any action, on all objects or on those that count.

    Args:
        params: The monitor's parameters: those of the scenario's own monitor, if it has any.
    """

    def __init__(self, params: Mapping[str, float] | None = None) -> None:
        self._monitor = SeparationMonitor(**(params or NOTHING))

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._monitor.reset(context)

    def judge(self, view: RoleView, action: Command, seen: Perceived = lidar) -> Assessment:
        """What the monitor says of an action at this tick."""
        if view.index and len(view.percepts) > 1:
            before = _percept(view.percepts[-2], seen)
            self._monitor.run(replace(view, index=view.index - 1, percept=before, proposal=None))
        now = _percept(view.percept, seen)
        return self._monitor.run(replace(view, percept=now, proposal=Proposal(action)))


def _percept(percept: Percept, seen: Perceived) -> Percept:
    """The channels that the monitor reads; the others, such as pictures, are not made for it."""
    channels: dict[str, Any] = {name: percept[name] for name in ("localisation", "odometry", "map")}
    return Percept({**channels, "lidar": seen(percept)})
