"""The FaultInjector: activates what is planned or directed and applies it to the channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import FaultInjector, Injection, RoleContext
from pytest_dura.core.state import NOTHING, RoleView
from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.catalogue import load_fault
from pytest_dura.faults.life import NEVER, NOW, Life
from pytest_dura.faults.sameness import same


class CampaignInjector(FaultInjector):
    """Applies the faults of the episode in declared order, each with random streams of its own.

    What is due at time t is in the percept at t, and in the command at t. What the
    SecurityAssessor directs takes effect at the next percept, or in the command at once; that
    counts towards the fault's greatest number of activations, and one that is active or spent
    stays as it is.
    """

    def reset(self, context: RoleContext) -> None:
        """Load the faults of the episode.

        Raises:
            ConfigurationError: For two faults of one id.
        """
        self._lives: dict[str, Life] = {}
        for one in context.faults:
            fault = load_fault(one)
            if fault.id in self._lives:
                raise ConfigurationError(
                    f"two faults have the id {fault.id!r}",
                    key="faults",
                    found=fault.id,
                    expected="an id of its own for each fault",
                    remedy="give one of them another `id`",
                )
            self._lives[fault.id] = Life(fault, context.seed, context.dt)
        self._sensors: list[Life] = []
        self._commands: list[Life] = []
        self._messages: list[Life] = []
        self._followers: dict[tuple[str, str], list[Life]] = {}
        for life in self._lives.values():
            self._acting_where(life).append(life)
            after = life.fault.activation.after
            if after is not None and not life.fault.activation.directed:
                self._followers.setdefault((after.fault, after.event), []).append(life)
        self._directed: set[str] = set()
        self._started: list[str] = []
        self._ended: list[str] = []
        self._channels: Mapping[str, Any] = NOTHING
        self._unchecked = True
        self._keeping = any(life.keeps for life in self._sensors)
        self._wake = self._next()

    def run(self, view: RoleView) -> Injection:
        """Take the SecurityAssessor's directives; say what has begun and ended at this tick.

        Raises:
            ValueError: For a directive that names no fault of an episode that has faults.
        """
        if not self._lives:
            return _IDLE
        directed = getattr(view.outputs.get("security_assessor"), "directives", ())
        if directed:
            self._direct(directed, view.time)
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
        if self._unchecked:
            self._check(channels)
        self._channels = channels
        if time < self._wake - TOLERANCE:
            return channels, NOTHING
        self._advance(channels, time)
        return self._apply(channels, time)

    def corrupt_command(self, action: Any, time: float) -> tuple[Any, tuple[str, ...]]:
        """Apply the active command faults, in declared order."""
        return self._changed(self._commands, action, time)

    def corrupt_message(
        self, channel: str, message: Any, time: float
    ) -> tuple[Any, tuple[str, ...]]:
        """Apply the active faults of a channel of messages, in declared order."""
        lives = [life for life in self._messages if life.target.channel == channel]
        return self._changed(lives, message, time)

    def _changed(
        self, lives: Sequence[Life], value: Any, time: float
    ) -> tuple[Any, tuple[str, ...]]:
        """A value on its way after the faults that act on it, and the ids of those that did."""
        if not lives:
            return value, ()
        sent, tampered = value, list[str]()
        for life in lives:
            if not life.acts_now:
                continue
            before = value
            value = life.act(before, time, self._channels)
            if value is not before:
                tampered.append(life.fault.id)
        if len(tampered) > 1 and same(sent, value):
            return sent, ()
        return value, tuple(tampered)

    def _acting_where(self, life: Life) -> list[Life]:
        """The faults that act at the same point of the loop."""
        if life.target.is_command:
            return self._commands
        return self._messages if life.target.is_message else self._sensors

    def manifested(self, faults: Sequence[str], time: float) -> None:
        """Faults that the orchestrator saw reach the component or the plant."""
        for name in faults:
            self._chain("manifested", name, time)

    def _advance(self, channels: Mapping[str, Any], time: float) -> None:
        """Begin and end what is due."""
        for name, life in self._lives.items():
            directed = name in self._directed
            if time < life.wake - TOLERANCE and not directed:
                continue
            ended = life.ends(time, channels)
            begins = life.begins(time, channels)
            if begins or (directed and life.activate(time)):
                self._tell("activated", name, time)  # at its end anew: that is no end
            elif ended:
                self._tell("deactivated", name, time)
        self._directed.clear()
        self._wake = self._next()

    def _apply(
        self, channels: Mapping[str, Any], time: float
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """The channels after the active sensor faults, and which faults changed them."""
        acting = [life for life in self._sensors if life.acts_now]
        if not acting:
            return channels, NOTHING
        changed = dict(channels)
        tampered: dict[str, tuple[str, ...]] = {}
        for life in acting:
            channel = life.target.channel
            before = life.target.channel_of(changed)
            changed[channel] = life.act(before, time, changed)
            if changed[channel] is not before:
                tampered[channel] = (*tampered.get(channel, ()), life.fault.id)
        for channel in [name for name, faults in tampered.items() if len(faults) > 1]:
            if same(channels[channel], changed[channel]):  # they cancel each other
                changed[channel] = channels[channel]
                del tampered[channel]
        if not tampered:
            return channels, NOTHING
        self._channels = changed
        return changed, tampered

    def _check(self, channels: Mapping[str, Any]) -> None:
        """At the first tick: a misspelt target shows before anything has moved."""
        for life in self._lives.values():
            life.check(channels)
        self._unchecked = False

    def _direct(self, names: Sequence[str], time: float) -> None:
        for name in names:
            life = self._lives.get(name)
            if life is None:
                known = ", ".join(self._lives)
                raise ValueError(
                    f"the security_assessor directs {name!r}, which is no fault of this episode;"
                    f" there are: {known}"
                )
            if not life.target.is_command:
                self._directed.add(name)
            elif life.activate(time):
                if name in self._ended:  # at its end anew: that is no end
                    self._ended.remove(name)
                self._tell("activated", name, time)
        self._wake = self._next()

    def _tell(self, event: str, name: str, time: float) -> None:
        (self._started if event == "activated" else self._ended).append(name)
        self._chain(event, name, time)

    def _chain(self, event: str, name: str, time: float) -> None:
        for follower in self._followers.get((name, event), ()):
            follower.follow(time)
            self._wake = min(self._wake, follower.wake)

    def _next(self) -> float:
        """The time before which there is nothing to do, in s."""
        if self._directed:
            return NOW
        if self._keeping:
            return NOW
        return min((life.wake for life in self._lives.values()), default=NEVER)


_IDLE = Injection()
