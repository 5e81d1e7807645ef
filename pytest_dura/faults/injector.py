"""The FaultInjector: activates what is planned or directed and applies it to the channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.core.roles import FaultInjector, Injection, RoleContext
from pytest_dura.core.state import NOTHING, RoleView
from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.catalogue import load_fault
from pytest_dura.faults.life import Life


class CampaignInjector(FaultInjector):
    """Applies the faults of the episode in declared order, each with random streams of its own.

    What is due at time t is in the percept at t, and in the command at t. What the
    SecurityAssessor directs takes effect at the next percept, or in the command at once.
    """

    def reset(self, context: RoleContext) -> None:
        """Load the faults of the episode."""
        self._lives = {
            one["id"]: Life(load_fault(one), context.seed, context.dt) for one in context.faults
        }
        self._sensors: list[Life] = []
        self._commands: list[Life] = []
        self._followers: dict[tuple[str, str], list[Life]] = {}
        for life in self._lives.values():
            (self._commands if life.target.is_command else self._sensors).append(life)
            after = life.fault.activation.after
            if after is not None:
                self._followers.setdefault((after.fault, after.event), []).append(life)
        self._directed: set[str] = set()
        self._started: list[str] = []
        self._ended: list[str] = []
        self._channels: Mapping[str, Any] = NOTHING
        self._wake = self._next()

    def run(self, view: RoleView) -> Injection:
        """Take the SecurityAssessor's directives; say what has begun and ended at this tick."""
        if not self._lives:
            return _IDLE
        directed = getattr(view.outputs.get("security_assessor"), "directives", ())
        for name in directed:
            life = self._lives.get(name)
            if life is None:
                known = ", ".join(self._lives)
                raise ValueError(
                    f"the security_assessor directs {name!r}, which is no fault of this episode;"
                    f" there are: {known}"
                )
            if life.target.is_command:
                if life.activate(view.time):
                    self._tell("activated", name, view.time)
            else:
                self._directed.add(name)
        if directed:
            self._wake = self._next()
        if not self._started and not self._ended:
            return _IDLE
        told = Injection(tuple(self._started), tuple(self._ended))
        self._started.clear()
        self._ended.clear()
        return told

    def corrupt(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """Begin and end what is due, then apply the active sensor faults, in declared order."""
        if time < self._wake - TOLERANCE:
            self._channels = channels
            return channels, NOTHING
        for name, life in self._lives.items():
            ended = life.ends(time, channels)
            begins = life.begins(time, channels)
            if begins or (name in self._directed and life.activate(time)):
                self._tell("activated", name, time)  # at its end anew: that is no end
            elif ended:
                self._tell("deactivated", name, time)
        self._directed.clear()
        self._wake = self._next()
        changed: dict[str, Any] = dict(channels)
        tampered: dict[str, tuple[str, ...]] = {}
        for life in self._sensors:
            if not life.acts_now:
                continue
            channel = life.target.channel
            before = life.target.read(changed)
            after = life.act(before, time, changed)
            if after is not before:
                changed[channel] = life.target.written(changed[channel], after)
                tampered[channel] = (*tampered.get(channel, ()), life.fault.id)
        self._channels = changed
        return changed, tampered

    def corrupt_command(self, action: Any, time: float) -> tuple[Any, tuple[str, ...]]:
        """Apply the active command faults, in declared order."""
        tampered: tuple[str, ...] = ()
        for life in self._commands:
            if not life.acts_now:
                continue
            field = life.target.field
            before = life.target.read({life.target.channel: action}) if field else action
            after = life.act(before, time, self._channels)
            if after is not before:
                action = life.target.written(action, after)
                tampered = (*tampered, life.fault.id)
        return action, tampered

    def manifested(self, faults: Sequence[str], time: float) -> None:
        """Faults that the orchestrator saw reach the component or the plant."""
        for name in faults:
            self._chain("manifested", name, time)

    def _tell(self, event: str, name: str, time: float) -> None:
        (self._started if event == "activated" else self._ended).append(name)
        self._chain(event, name, time)

    def _chain(self, event: str, name: str, time: float) -> None:
        for follower in self._followers.get((name, event), ()):
            follower.follow(time)
            self._wake = -1.0

    def _next(self) -> float:
        """The time before which there is nothing to do, in s."""
        if self._directed or any(life.active for life in self._lives.values()):
            return -1.0
        return min((life.next_by_plan() for life in self._lives.values()), default=float("inf"))


_IDLE = Injection()
