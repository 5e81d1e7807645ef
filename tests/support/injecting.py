"""Faults in tests: two plain types, and an injector run tick by tick without a loop around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from pytest_dura.core import Fault, Percept, RoleContext, SecurityAssessment, StateManager, Tick
from pytest_dura.faults import (
    CampaignInjector,
    FaultEffect,
    FaultPart,
    Finite,
    Kind,
    Moment,
    parse_fault,
)

DT = 0.1


class AddParameters(FaultPart):
    """What is added."""

    amount: Finite = 1.0
    factor: Finite = 1.0
    sigma: Finite = 0.0


class Add(FaultEffect):
    """``factor * value + amount``, plus noise, so that the order of two of them shows."""

    parameters: AddParameters = AddParameters()
    acts_on: ClassVar[Kind] = "number"

    @classmethod
    def example(cls) -> dict[str, Any]:
        """One second into the episode, for one second."""
        return {"activation": {"at": 1.0}, "duration": 1.0}

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:
        """The new number."""
        changed = self.parameters.factor * value + self.parameters.amount
        if self.parameters.sigma:
            changed += float(moment.rng.normal(0.0, self.parameters.sigma))
        return changed


class DrawingParameters(FaultPart):
    """Whose draws they are."""

    of: str = ""


class Drawing(Add):
    """Adds a number that it draws, and notes each draw as ``(of, tick, number)``."""

    parameters: DrawingParameters = DrawingParameters()  # type: ignore[assignment]
    noted: ClassVar[list[tuple[str, int, float]]] = []

    def begin(self, value: Any, moment: Moment) -> Any:
        """A number that stays."""
        return self._draw(moment)

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:
        """The sum."""
        return float(value + memory + self._draw(moment))

    def _draw(self, moment: Moment) -> float:
        number = float(moment.rng.random())
        self.noted.append((self.parameters.of, round(moment.time / moment.dt), number))
        return number


class Recall(FaultEffect):
    """Shows what stood there half a second ago; waits until there is that much."""

    acts_on: ClassVar[Kind] = "any"

    @classmethod
    def example(cls) -> dict[str, Any]:
        """One second into the episode, for one second."""
        return {"activation": {"at": 1.0}, "duration": 1.0}

    @property
    def memory(self) -> float:
        """Half a second."""
        return 0.5

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:
        """The oldest value of the history."""
        return moment.history[0][1]


def fault(id: str = "f", /, **fields: Any) -> Fault:  # noqa: A002 - as in a file
    """A planned fault; activation's keys may stand beside its own."""
    keys = ("at", "every", "when", "probability", "rate", "after", "not_before", "not_after")
    activation = {key: fields.pop(key) for key in (*keys, "times", "by") if key in fields}
    data = {"type": "injecting:Add", "id": id, "target": "gauge", "duration": 0.3}
    if fields.get("type") == "injecting:Drawing":
        fields["parameters"] = {"of": id}
    return parse_fault({**data, "activation": activation, **fields})


def constant(index: int) -> dict[str, Any]:
    """A gauge at 10 and a clock."""
    return {"gauge": 10.0, "clock": {"ticks": index}}


class Bench:
    """An injector over channels that are a function of the tick."""

    def __init__(
        self,
        *faults: Fault,
        channels: Callable[[int], dict[str, Any]] = constant,
        seed: int = 3,
        dt: float = DT,
        injector: type[CampaignInjector] = CampaignInjector,
    ) -> None:
        self.injector, self.channels, self.dt = injector(), channels, dt
        self.injector.reset(RoleContext(seed, dt, {}, faults))
        self.state = StateManager(dt)
        self.seen: list[Mapping[str, Any]] = []
        self.sent: list[Any] = []
        self.acted: list[tuple[str, ...]] = []
        self.activated: list[tuple[int, str]] = []
        self.ended: list[tuple[int, str]] = []

    def tick(self, *directives: str, action: Any = 0.0) -> None:
        """One tick, as the orchestrator would have it."""
        index = len(self.state.ticks)
        time, raw = index * self.dt, self.channels(index)
        channels, tampered = self.injector.corrupt(raw, time)
        self.state.update(Tick(index, time, {}, raw), Percept(channels, tampered))
        self.state.outputs["security_assessor"] = SecurityAssessment(directives=directives)
        output = self.injector.run(self.state.role_view())
        self.activated += [(index, name) for name in output.activated]
        self.ended += [(index, name) for name in output.deactivated]
        sent, late = self.injector.corrupt_command(action, time)
        ids = tuple(name for names in tampered.values() for name in names) + late
        fresh = tuple(name for name in ids if not any(name in before for before in self.acted[-1:]))
        if fresh:
            self.injector.manifested(fresh, time)
        self.seen.append(channels)
        self.sent.append(sent)
        self.acted.append(ids)

    def ticks(self, count: int) -> Bench:
        """Some ticks without directives."""
        for _ in range(count):
            self.tick()
        return self

    def when(self, name: str = "f") -> list[int]:
        """The ticks at which a fault changed something."""
        return [index for index, names in enumerate(self.acted) if name in names]

    def begun(self, name: str = "f") -> list[int]:
        """The ticks at which a fault was activated."""
        return [index for index, one in self.activated if one == name]
