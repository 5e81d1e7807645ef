"""The careful driver: what a competent and careful human could have avoided.

UN Regulation 157 (automated lane keeping systems) asks in paragraph 5.2.5 for the avoidance of
collisions that are reasonably foreseeable and preventable, and its performance model of a competent
and careful human driver says what is preventable: what a driver prevents who begins to brake 0.75 s
after the risk can be perceived, and then brakes with 0.774 g.
"""

from __future__ import annotations

import math

import numpy as np

from pytest_dura.core.roles import RoleContext
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.driving import prediction
from pytest_dura.driving.maneuvers import COMFORT_BRAKING, Command, Maneuver
from pytest_dura.driving.roles.planners import RuleBased
from pytest_dura.driving.scene import Scene

REACTION = 0.75
"""s from when a risk can be perceived to the beginning of braking: UN R157."""
BRAKING = 7.59294
"""m/s2 that the driver brakes with: 0.774 g, UN R157."""
_HORIZON = 4.0
"""s; a stop from the limit of 10 m/s takes the reaction, 1.3 s of braking and its build-up."""
_STEP = 0.1
_APART = 0.0
"""m between discs that cover both bodies, below which a contact is predicted."""


class CarefulDriver(RuleBased):
    """The driver of UN Regulation 157, as a reference for what could have been avoided.

    It drives by the rules of :class:`RuleBased`, as it perceives them, with comfortable braking
    alone. A risk can be perceived from the first tick on at which who is in view and keeps its
    speed and yaw rate would be met within 4 s although it brakes comfortably where the rules ask
    for it. 0.75 s later it brakes with 0.774 g (7.59 m/s2), until the risk is over or the car
    stands; until then it goes on as before.

    Source: UN Regulation 157, paragraph 5.2.5 and its guidance on traffic disturbance critical
    scenarios: a competent and careful human driver with a risk evaluation time of 0.75 s and a
    deceleration of 0.774 g. The regulation's 0.6 s until full braking are the brake's own build-up
    here, 0.2 s.

    Args:
        reaction: Seconds from when a risk can be perceived to the beginning of braking.
        braking: Its braking in m/s2.
    """

    def __init__(self, reaction: float = REACTION, braking: float = BRAKING) -> None:
        super().__init__()
        self.reaction, self.braking = reaction, braking
        self._risks = prediction.Predictor(_HORIZON, _STEP)

    def reset(self, context: RoleContext) -> None:
        """Forget what was seen."""
        super().reset(context)
        self._risks.reset()
        self._perceived_at: float | None = None
        self._before = 0.0
        self._brakes = False

    def propose(self, view: GeneratorView) -> Proposal:
        """The maneuver of this tick, with its acceleration."""
        by_rule = super().propose(view)
        command: Command = by_rule.action
        assert command.acceleration is not None
        wanted = max(command.acceleration, -COMFORT_BRAKING)
        scene = Scene.of(view.percept)
        who = self._risk(view, scene, wanted)
        if who is None or scene.speed <= 0.0:
            self._perceived_at, self._brakes, self._before = None, False, wanted
            if command.maneuver is Maneuver.EMERGENCY_BRAKE:
                command = Command(Maneuver.YIELD)
            return Proposal(Command(command.maneuver, wanted), by_rule.explanation)
        if self._perceived_at is None:
            self._perceived_at = view.time
        if view.time - self._perceived_at < self.reaction - 1e-9 and not self._brakes:
            going_on = min(self._before, 0.0)
            return Proposal(Command(Maneuver.PROCEED, going_on), f"has just seen {who}")
        self._brakes = True
        return Proposal(Command(Maneuver.EMERGENCY_BRAKE, -self.braking), f"brakes for {who}")

    def _risk(self, view: GeneratorView, scene: Scene, wanted: float) -> str | None:
        """Id of whom it would meet if all go on; ``None`` without one."""
        self._risks.observe(view.index, scene.bodies)
        apart, near = self._risks.separations(scene, (wanted,), view.dt)
        if not near.ids:
            return None
        nearest = apart[0].min(axis=0)
        nearest = np.where(np.isnan(nearest), math.inf, nearest)
        row = int(nearest.argmin())
        return near.ids[row] if nearest[row] < _APART else None
