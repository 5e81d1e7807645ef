"""How the component reacts to what looks like an attack."""

from __future__ import annotations

from pytest_dura.core.metrics import REACTIONS
from pytest_dura.core.state import RoleView
from pytest_dura.driving.ego import ego_of
from pytest_dura.driving.maneuvers import acceleration_for
from pytest_dura.driving.plausible import own_speed

UNAFFECTED, ERRATIC, FROZEN, FOLLOWS = REACTIONS

BRAKING = -1.0
"""m/s2; a command below it brakes."""
PROMPT = 1.5
"""Seconds after the suspicion's start within which braking is taken to answer it."""
AFTERMATH = 3.0
"""Seconds after the suspicion's end at which the reaction is classed."""
FLIPS_PER_SECOND = 2.0
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
        if view.time - self._last_suspicion < AFTERMATH:
            return None
        return self._classify(view.time)

    def _classify(self, now: float) -> str:
        assert self._since is not None
        lasted, self._since = now - self._since, None
        if self._flips > FLIPS_PER_SECOND * lasted:
            return ERRATIC
        if not self._moved_after:
            return FROZEN
        return FOLLOWS if self._answered else UNAFFECTED

    @staticmethod
    def _brakes(view: RoleView) -> bool:
        if view.proposal is None:
            return False
        ego = ego_of(view.percept)
        return acceleration_for(view.proposal.action, ego.speed, ego.to_stop_line) < BRAKING
