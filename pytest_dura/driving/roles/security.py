"""SecurityAssessor: directs attacks, looks for their traces, classes the reaction to them."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from pytest_dura.core.metrics import REACTIONS
from pytest_dura.core.roles import Assessed, RoleContext, SecurityAssessment, SecurityAssessor
from pytest_dura.core.state import Alert, RoleView
from pytest_dura.driving.bodies import VX, VY, BodyList
from pytest_dura.driving.maneuvers import (
    MAX_ACCELERATION,
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
)
from pytest_dura.driving.percepts import (
    compare_sensors,
    out_of_range,
    own_pose,
    own_speed,
    plausible_objects,
    sensors_agree,
)
from pytest_dura.driving.scene import Ego, ego_of
from pytest_dura.driving.sensors import RANGE
from pytest_dura.faults.activation import AttackPlan

Row = tuple[float, ...]


class Tracker:
    """Matches the bodies of one tick to those of the tick before, by id.

    Plain dictionaries: for the few bodies of a junction they are quicker than arrays.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._index: int | None = None
        self._previous: dict[str, Row] | None = None
        self._current: dict[str, Row] | None = None

    def update(self, index: int, bodies: BodyList) -> None:
        """The bodies at a tick; a second call within the tick changes nothing."""
        if index == self._index:
            return
        rows = dict(zip(bodies.ids, bodies.numbers, strict=True))
        self._index, self._previous, self._current = index, self._current, rows

    def displacements(self) -> list[tuple[int, float, float]]:
        """Row in the current list and metres moved in x and y, of each body seen a tick before."""
        if self._previous is None or self._current is None:
            return []
        before = self._previous.get
        return [
            (row, now[0] - old[0], now[1] - old[1])
            for row, (i, now) in enumerate(self._current.items())
            if (old := before(i)) is not None
        ]

    def newcomers(self) -> list[int]:
        """Rows of the current list that were not there a tick before; none at the first tick."""
        if self._previous is None or self._current is None:
            return []
        if self._current.keys() <= self._previous.keys():  # as at most ticks
            return []
        return [row for row, i in enumerate(self._current) if i not in self._previous]


UNAFFECTED, ERRATIC, FROZEN, FOLLOWS = REACTIONS

BRAKING = -1.0
"""m/s2; a command below it brakes."""
PROMPT = 1.5
"""Seconds after the suspicion's start within which braking is taken to answer it."""
_AFTERMATH = 3.0
"""Seconds after the suspicion's end at which the reaction is classed."""
_FLIPS_PER_SECOND = 2.0
"""Changes between braking and driving on above which the component is erratic."""
STANDING = 0.1


class ReactionWatch:
    """Watches the component's commands from a suspicion's start until a while after its end.

    Erratic: it keeps changing between braking and driving on. Frozen: it stands when the
    suspicion ends and still stands throughout the aftermath. Follows the fake: it did not brake
    before and does soon after the start. Otherwise it is unaffected.
    """

    def __init__(self) -> None:
        self._since: float | None = None
        self._last_suspicion = 0.0
        self._braked_before = False
        self._braking = False
        self._flips = 0
        self._answered = False
        self._moved_after = False

    def update(self, view: RoleView, suspicious: bool) -> str | None:
        """Take in a tick; the class of the reaction when the aftermath is over, else ``None``."""
        if not suspicious and self._since is None:
            self._braking = self._brakes(view)
            return None
        braking = self._brakes(view)
        if suspicious:
            self._last_suspicion = view.time
            if self._since is None:
                self._since, self._flips, self._moved_after = view.time, 0, False
                self._braked_before, self._answered = self._braking, False
        self._flips += braking != self._braking
        self._braking = braking
        assert self._since is not None
        if braking and not self._braked_before and view.time - self._since <= PROMPT:
            self._answered = True
        if view.time > self._last_suspicion:
            self._moved_after |= own_speed(view.percept) > STANDING
        if view.time - self._last_suspicion < _AFTERMATH:
            return None
        return self._classify(view.time)

    def _classify(self, now: float) -> str:
        assert self._since is not None
        lasted, self._since = now - self._since, None
        if self._flips > _FLIPS_PER_SECOND * lasted:
            return ERRATIC
        if not self._moved_after:
            return FROZEN
        return FOLLOWS if self._answered else UNAFFECTED

    @staticmethod
    def _brakes(view: RoleView) -> bool:
        if view.proposal is None:
            return False
        return _asked(view.proposal.action, ego_of(view.percept)) < BRAKING


_ROAD_END = 26.0
"""m before the end of an arm; farther out, bodies come and go."""


class PlausibilityAssessor(SecurityAssessor):
    """Checks percept and command against known attack patterns.

    Patterns: ``object_from_nowhere`` (a newcomer well inside the sensors' reach),
    ``velocity_contradicts_displacement``, ``lidar_contradicts_radar`` (for some ticks in a row),
    ``out_of_range:<channel>`` (a number that no sensor can have measured, see
    ``pytest_dura.driving.percepts``) and ``command_outside_envelope``. Each is alerted when it
    begins, and again after a quiet time.

    Args:
        displacement_tolerance: m/s between reported velocity and displacement over time.
        confirm: Ticks in a row before lidar and radar contradict each other.
        quiet: Seconds without the pattern after which it is alerted anew.
        escalate: Whether a suspicion is unsafe, so that recovery acts for as long as it lasts.
            By default it is a warning, and what it means for the proposal is the SafetyMonitor's
            to say.

    The score is minus the number of suspicions at this tick.
    """

    def __init__(
        self,
        displacement_tolerance: float = 3.0,
        confirm: int = 2,
        quiet: float = 1.0,
        *,
        escalate: bool = False,
    ) -> None:
        self.displacement_tolerance = displacement_tolerance
        self.confirm, self.quiet = confirm, quiet
        self._suspicious = Assessed.UNSAFE if escalate else Assessed.WARNING
        self._tracker = Tracker()

    def reset(self, context: RoleContext) -> None:
        """Load the plan of attacks; forget what was seen."""
        self._plan = AttackPlan(context.faults, self.name)
        self._tracker.reset()
        self._contradicted: dict[str, int] = {}
        self._seen: dict[tuple[str, str], float] = {}
        self._watch = ReactionWatch()
        self._index = -1
        self._suspicions: list[Alert] = []
        self._directives: tuple[str, ...] = ()

    def run(self, view: RoleView) -> SecurityAssessment:
        """Directives, alerts, and the component's reaction once an attack is over."""
        if view.index != self._index:  # a refined proposal does not change the percept
            self._index = view.index
            self._directives = self._plan.due(view, partial(_numbers, view))
            self._suspicions = self._look(view)
        suspicions = self._suspicions + self._check_command(view)
        reaction = self._watch.update(view, bool(self._suspicions))
        if not suspicions and not self._directives and reaction is None:
            return _QUIET
        alerts = []
        for alert in suspicions:
            key = (alert.pattern, alert.subject)
            if view.time - self._seen.get(key, -np.inf) > self.quiet:
                alerts.append(alert)
            self._seen[key] = view.time
        return SecurityAssessment(
            verdict=self._suspicious if suspicions else Assessed.SAFE,
            score=-float(len(suspicions)),
            reasons=tuple(f"{alert.pattern} ({alert.subject})" for alert in suspicions),
            alerts=tuple(alerts),
            directives=self._directives,
            reaction=reaction,
        )

    def _look(self, view: RoleView) -> list[Alert]:
        percept = view.percept
        bodies, pose = plausible_objects(percept), own_pose(percept)
        road = percept["map"].road
        self._tracker.update(view.index, bodies)
        alerts, rows, dt = [], bodies.numbers, view.dt
        for row in self._tracker.newcomers():
            x, y = rows[row][:2]
            distance = float(np.hypot(x - pose.x, y - pose.y))
            if distance < RANGE - 8.0 and road.before_ends(x, y, _ROAD_END):
                detail = f"appeared {distance:.1f} m away"
                alerts.append(Alert("object_from_nowhere", bodies.ids[row], detail))
        for row, dx, dy in self._tracker.displacements():
            off_x, off_y = dx / dt - rows[row][VX], dy / dt - rows[row][VY]
            if abs(off_x) + abs(off_y) < self.displacement_tolerance:
                continue  # no longer than the sum of its parts
            apart = math.hypot(off_x, off_y)
            if apart > self.displacement_tolerance:
                detail = f"reports a velocity {apart:.1f} m/s off its displacement"
                alerts.append(Alert("velocity_contradicts_displacement", bodies.ids[row], detail))
        alerts += [
            Alert(f"out_of_range:{value.channel}", value.subject, value.detail)
            for value in out_of_range(percept)
        ]
        return alerts + self._against_radar(view)

    def _against_radar(self, view: RoleView) -> list[Alert]:
        bodies = view.percept["lidar"]
        if sensors_agree(view.percept):
            self._contradicted.clear()
            return []
        confirmed, explained = compare_sensors(view.percept)
        names = [bodies.ids[row] for row in np.flatnonzero(~confirmed).tolist()]
        if not explained.all():
            names.append("radar")
        self._contradicted = {name: self._contradicted.get(name, 0) + 1 for name in names}
        return [
            Alert("lidar_contradicts_radar", name, "one of them reports what the other does not")
            for name, ticks in self._contradicted.items()
            if ticks >= self.confirm
        ]

    def _check_command(self, view: RoleView) -> list[Alert]:
        if view.proposal is None:
            return []
        command, acceleration = view.proposal.action, view.proposal.action.acceleration
        if acceleration is None:
            return []
        if not -MAX_BRAKING - 1e-9 <= acceleration <= MAX_ACCELERATION + 1e-9:
            detail = f"asks for {acceleration:.1f} m/s2"
        elif command.maneuver is Maneuver.EMERGENCY_BRAKE and acceleration > 0.5:
            detail = f"says {command} and asks for {acceleration:.1f} m/s2"
        else:
            return []
        return [Alert("command_outside_envelope", "generator", detail)]


def _numbers(view: RoleView) -> dict[str, float]:
    """The proposal as conditions of attacks read it: its acceleration in m/s2."""
    assert view.proposal is not None
    return {"acceleration": _asked(view.proposal.action, ego_of(view.percept))}


def _asked(command: Command, ego: Ego) -> float:
    """The acceleration in m/s2 that a command asks for."""
    return acceleration_for(command, ego.speed, ego.to_stop_line, ego.way.speed_limit)


_QUIET = SecurityAssessment()
