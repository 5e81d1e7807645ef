"""Mutations of the fault injector and of the simulator's adapter."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import NOTHING, Percept
from pytest_dura.core.roles import FaultInjector, Injection, RoleContext
from pytest_dura.core.simulator import Scene, Simulator
from pytest_dura.core.state import RoleView, Tick
from pytest_dura.qualification.mutant import Mutation, Parameter

Channels = Mapping[str, Any]
Ids = tuple[str, ...]


class InjectorMutation(Mutation[FaultInjector], FaultInjector):
    """A fault injector with a defect."""

    def run(self, view: RoleView) -> Injection:
        """Activate as the injector does."""
        return self.part.run(view)

    def corrupt(self, channels: Channels, time: float) -> tuple[Channels, Mapping[str, Ids]]:
        """Change channels as the injector does."""
        return self.part.corrupt(channels, time)

    def corrupt_command(self, action: Any, time: float) -> tuple[Any, Ids]:
        """Change the command as the injector does."""
        return self.part.corrupt_command(action, time)

    def corrupt_message(self, channel: str, message: Any, time: float) -> tuple[Any, Ids]:
        """Change a message as the injector does."""
        return self.part.corrupt_message(channel, message, time)

    def manifested(self, faults: Ids, time: float) -> None:
        """Pass it on."""
        self.part.manifested(faults, time)


class Inert(InjectorMutation):
    """Injects nothing."""

    about = "says that faults are active, and changes nothing"

    def corrupt(self, channels: Channels, time: float) -> tuple[Channels, Mapping[str, Ids]]:
        """Leave the channels as they are."""
        self.part.corrupt(channels, time)
        return channels, NOTHING

    def corrupt_command(self, action: Any, time: float) -> tuple[Any, Ids]:
        """Leave the command as it is."""
        self.part.corrupt_command(action, time)
        return action, ()

    def corrupt_message(self, channel: str, message: Any, time: float) -> tuple[Any, Ids]:
        """Leave the message as it is."""
        self.part.corrupt_message(channel, message, time)
        return message, ()


class Delayed(InjectorMutation):
    """Injects at the wrong time."""

    about = "activates faults some seconds after their time"
    parameters: ClassVar = (Parameter("seconds", (5.0,), "s"),)
    seconds: float

    def reset(self, context: RoleContext) -> None:
        """Plan each fault that has a time for later."""
        later = []
        for fault in context.faults:
            at = fault.activation.get("at")
            if isinstance(at, (int, float)):
                activation = {**fault.activation, "at": at + self.seconds}
                later.append(replace(fault, activation=activation))
            else:
                later.append(fault)
        super().reset(replace(context, faults=tuple(later)))


class SimulatorMutation(Mutation[Simulator], Simulator):
    """A simulator's adapter with a defect."""

    _PASSED_ON = ("measure_kinds", "hindsight", "channel_aliases", "deterministic", "tolerances",
                  "repeatable", "time_step")  # fmt: skip

    def __init__(self, **wraps: Any) -> None:
        super().__init__(**wraps)
        for name in self._PASSED_ON:
            setattr(self, name, getattr(self.part, name))

    def set_time_step(self, seconds: float) -> None:
        """Set it in the simulator as well."""
        super().set_time_step(seconds)
        self.part.set_time_step(seconds)

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # type: ignore[override]
        """Begin an episode."""
        return self.part.reset(scenario, seed)

    def step(self, action: Any) -> Tick:
        """Advance it."""
        return self.part.step(action)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Compute the signals as the adapter does."""
        return self.part.signals(ticks)

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, NDArray[np.float64]]:
        """Compute them as the adapter does."""
        return self.part.percept_signals(percepts)

    def account_measures(
        self, ticks: Sequence[Tick], percepts: Sequence[Percept], accounts: Sequence[Channels]
    ) -> dict[str, NDArray[np.float64]]:
        """Compute them as the adapter does."""
        return self.part.account_measures(ticks, percepts, accounts)

    def account_signals(
        self, ticks: Sequence[Tick], percepts: Sequence[Percept], accounts: Sequence[Channels]
    ) -> dict[str, NDArray[np.float64]]:
        """Compute them as the adapter does."""
        return self.part.account_signals(ticks, percepts, accounts)

    def found_events(self, ticks: Sequence[Tick]) -> Sequence[tuple[int, str, str, str]]:
        """Return those that the adapter finds."""
        return self.part.found_events(ticks)

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene | None:
        """Return the adapter's."""
        return self.part.scene(ticks, percepts)

    def check_action(self, action: Any) -> Any:
        """Check it as the adapter does."""
        return self.part.check_action(action)

    def fallback_action(self) -> Any:
        """Return the adapter's."""
        return self.part.fallback_action()

    def actuation(self, action: Any) -> Any:
        """Return the adapter's."""
        return self.part.actuation(action)

    def describe_action(self, action: Any) -> str:
        """Describe it as the adapter does."""
        return self.part.describe_action(action)

    def close(self) -> None:
        """Close the simulator."""
        self.part.close()


class _OfSignal(SimulatorMutation):
    """One signal of the ground truth is reported wrong."""

    signal: str

    def wrong(self, column: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the wrong column."""
        raise NotImplementedError

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Report the signal wrong where there is one of that name."""
        columns = dict(self.part.signals(ticks))
        if self.signal in columns:
            columns[self.signal] = self.wrong(np.asarray(columns[self.signal], float))
        return columns

    @classmethod
    def choices(cls, signals: Collection[str]) -> Iterator[Mapping[str, Any]]:
        """Yield each signal of the ground truth that requirements read."""
        yield from ({"signal": name} for name in sorted(signals) if "." not in name)


class SignalTooLarge(_OfSignal):
    """A signal is half as large again as it should be."""

    about = "reports a signal of the ground truth 1.5 times as large"

    def wrong(self, column: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scale it."""
        return 1.5 * column


class SignFlipped(_OfSignal):
    """A signal has the wrong sign."""

    about = "reports a signal of the ground truth with the opposite sign"

    def wrong(self, column: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mirror it."""
        return -column


class ClockOff(SimulatorMutation):
    """Its clock is off."""

    about = "simulates more time for each tick than it says"
    parameters: ClassVar = (Parameter("factor", (1.2,)),)
    factor: float

    def set_time_step(self, seconds: float) -> None:
        """Let the simulator take longer steps."""
        super().set_time_step(seconds)
        self.part.set_time_step(seconds * self.factor)

    def step(self, action: Any) -> Tick:
        """Advance it, with the time that should have passed."""
        tick = self.part.step(action)
        return replace(tick, time=tick.index * self.time_step)
