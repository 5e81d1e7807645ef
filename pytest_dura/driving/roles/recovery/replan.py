"""Replan: the best of the maneuvers, by short rollouts in a predicted world."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pytest_dura.core.roles import Assessed, Recovery, RecoveryPlanner, RoleContext
from pytest_dura.core.state import RoleView
from pytest_dura.driving.maneuvers import Command, Maneuver, acceleration_for
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.roles.recovery.outlook import SecondOpinion, observed
from pytest_dura.driving.scene import Scene


class Replan(RecoveryPlanner):
    """Rolls out each maneuver for a few seconds and takes the one that ends best.

    What the SeparationMonitor would refuse again comes last. Of the rest, the least predicted
    separation from anybody decides, in steps of 0.1 m and up to ``enough``; then the way made, or
    where contact is predicted whatever it does, the way not made. The ego follows its route and the
    maneuver's own law of speed; others keep the speed and yaw rate that two successive percepts
    show. They do not react, and who turns is seen to turn for ever, so that the end of a rollout
    says less than its beginning. It believes its percept: away from an object that is not there, it
    may well accelerate. Each call rolls out six maneuvers over ``horizon / STEP`` instants,
    whatever the traffic; the cost is in ``benchmarks/README.md``.

    Args:
        horizon: Seconds of a rollout.
        enough: Predicted separation in m beyond which more is not better.
        monitor: Parameters of the SeparationMonitor whose judgement it asks; give those of the
            scenario's own monitor, if it has any.
    """

    STEP = 0.25
    """Seconds between two instants of a rollout."""

    def __init__(
        self,
        horizon: float = 4.0,
        enough: float = 2.0,
        monitor: Mapping[str, float] | None = None,
    ) -> None:
        self.horizon, self.enough = horizon, enough
        self._predictor = Predictor(horizon, self.STEP)
        self._opinion = SecondOpinion(monitor)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()
        self._opinion.reset(context)

    def run(self, view: RoleView) -> Recovery:
        """The best maneuver."""
        scene = observed(self._predictor, view)
        driven = np.array([self._rollout(scene, Command(one)) for one in Maneuver])
        apart, _ = self._predictor.along(scene, driven, view.dt)
        least = apart.min(axis=(1, 2), initial=self.enough)
        scores = []
        for maneuver, gap, way in zip(
            Maneuver, least.tolist(), driven[:, -1].tolist(), strict=True
        ):
            refused = self._opinion.judge(view, Command(maneuver)).verdict is Assessed.UNSAFE
            kept = max(round(gap, 1), 0.0)  # of contact there is no more or less
            scores.append((not refused, kept, way if kept > 0.0 else -way))
        best = max(range(len(scores)), key=scores.__getitem__)  # the first of equal ones
        maneuver, (_, gap, way) = list(Maneuver)[best], scores[best]
        reasons = "; ".join(view.reasons)
        why = f"predicts a gap of {gap:.1f} m and {abs(way):.0f} m of way ({reasons})"
        return Recovery(Command(maneuver), "replan", f"{maneuver}: {why}")

    def _rollout(self, scene: Scene, command: Command) -> list[float]:
        """Metres driven at each instant."""
        speed, way, driven = scene.speed, 0.0, []
        for _ in self._predictor.times:
            acceleration = acceleration_for(command, speed, scene.to_stop_line - way)
            reached = max(speed + acceleration * self.STEP, 0.0)
            way += (speed + reached) / 2.0 * self.STEP
            speed = reached
            driven.append(way)
        return driven
