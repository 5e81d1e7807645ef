"""What the loop knows: Tick, Percept, the StateManager and the read-only views that roles get."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from pytest_dura.core.errors import LONGEST_TEXT, cut
from pytest_dura.core.percepts import (
    NOTHING as NOTHING,
)
from pytest_dura.core.percepts import (
    History as History,
)
from pytest_dura.core.percepts import (
    Lazy as Lazy,
)
from pytest_dura.core.percepts import (
    Percept as Percept,
)
from pytest_dura.core.percepts import (
    PerceptView as PerceptView,
)
from pytest_dura.core.percepts import (
    sealed_parts,
)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one tick: a failure, an alert, a fault's activation, ...

    ``wall_clock`` marks what depends on the machine's speed; the episode's digest leaves it out.
    """

    tick: int
    time: float
    kind: str
    subject: str
    detail: str = ""
    data: Mapping[str, Any] = NOTHING
    wall_clock: bool = False

    def __post_init__(self) -> None:
        """Bound the texts, whoever wrote them: an episode has many events."""
        for name in ("kind", "subject", "detail"):
            text = getattr(self, name)
            if isinstance(text, str) and len(text) > LONGEST_TEXT:  # as hardly any
                object.__setattr__(self, name, cut(text))

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        plain = {"tick": self.tick, "time": self.time, "kind": self.kind, "subject": self.subject}
        return plain | {"detail": self.detail, "data": dict(self.data)}


@dataclass(frozen=True, slots=True)
class Proposal:
    """The Generator's output.

    Args:
        action: What it wants done. ``None`` where ``failure`` says that there is nothing.
        explanation: Why, in the component's own words.
        latency: The component's own response time in seconds, where it is modelled or known;
            it is held against the time budget, and is deterministic where wall-clock time is not.
        failure: Why the component came to no decision of its own, if so. ``action`` is what its
            own fallback does instead. It is assessed and carried out like any other, and counts as
            a failed proposal.
        account: What the component tells of how it came to the proposal, as plain data with texts
            as keys; see :meth:`pytest_dura.Simulator.account_measures`.
    """

    action: Any
    explanation: str = ""
    latency: float | None = None
    failure: str = ""
    account: Mapping[str, Any] = NOTHING

    def with_action(self, action: Any) -> Proposal:
        """The same with another action; at each tick, so without the cost of ``replace``."""
        return Proposal(action, self.explanation, self.latency, self.failure, self.account)


@dataclass(frozen=True, slots=True)
class Alert:
    """A suspicion about the percept or the component: which pattern, about whom."""

    pattern: str
    subject: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Tick:
    """What the simulator says of one instant.

    Args:
        index: Zero for the state after reset, then one per step.
        time: Simulated seconds since reset.
        truth: Ground truth by name, for requirements only; arrays are read-only.
        channels: Sensor channels by name, before any fault.
        goal: Whether the component's task is done.
        critical: Why the episode cannot go on (a collision of the ego), if so.
        events: What happened during the step, as ``(kind, subject, detail)``.
    """

    index: int
    time: float
    truth: Mapping[str, Any]
    channels: Mapping[str, Any]
    goal: bool = False
    critical: str | None = None
    events: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class PastDecision:
    """What became of one tick's proposal.

    Args:
        time: Simulated seconds.
        proposed: The proposed action; ``None`` without a valid one.
        explanation: The component's explanation of it.
        executed: The action that was decided on, proposal or recovery, before any command fault.
        source: ``proposal``, ``recovery`` or ``fallback``.
    """

    time: float
    proposed: Any
    explanation: str
    executed: Any
    source: str


Transmit = Callable[[str, Any], Any]
"""Sends a message on a channel of the component's own, and returns what arrives."""


def _undisturbed(channel: str, message: Any) -> Any:  # noqa: ARG001 - as Transmit has it
    return message


@dataclass(frozen=True, slots=True)
class GeneratorView:
    """All that the component under test may see. It has no ground truth.

    ``feedback`` says why this tick's earlier proposal was refused (policy ``refine``). ``past``
    are the decisions of the ticks before, oldest first. ``transmit(channel, message)`` lets a
    component that talks to something outside, such as the server of a language model, do so
    through the loop: it returns the message as it arrives, after active faults of that channel.
    """

    index: int
    time: float
    dt: float
    percept: Percept
    feedback: tuple[str, ...] = ()
    past: Sequence[PastDecision] = ()
    transmit: Transmit = _undisturbed


@dataclass(frozen=True, slots=True)
class RoleView:
    """What every other role sees: the percept, the proposal, and what other roles have said.

    ``outputs`` maps a role's name to its latest output, from this tick if it ran already and from
    an earlier one otherwise; ``percepts`` is the history, the current percept last. ``command`` is
    the action that was decided on at the tick before, proposal or recovery, before any command
    fault; ``None`` at the first tick. ``alerts`` are all that SecurityAssessors have raised so far,
    as ``(time, alert)``, oldest first. ``history`` maps a role's name to all its outputs so far,
    as ``(time, output)``, oldest first; a role that ran again for a refined proposal has several
    of one tick.
    """

    index: int
    time: float
    dt: float
    percept: Percept
    percepts: Sequence[Percept]
    proposal: Proposal | None
    outputs: Mapping[str, Any]
    generator_seconds: float = 0.0
    reasons: tuple[str, ...] = ()
    command: Any = None
    alerts: Sequence[tuple[float, Alert]] = ()
    history: Mapping[str, Sequence[tuple[float, Any]]] = NOTHING


@dataclass(slots=True)
class StateManager:
    """The one place where roles meet: written by the orchestrator, read through views."""

    dt: float
    ticks: list[Tick] = field(default_factory=list)
    percepts: list[Percept] = field(default_factory=list)
    outputs: dict[str, Any] = field(default_factory=dict)
    proposal: Proposal | None = None
    command: Any = None
    alerts: list[tuple[float, Alert]] = field(default_factory=list)
    generator_reads: set[str] = field(default_factory=set)
    generator_seconds: float = 0.0
    past: list[PastDecision] = field(default_factory=list)
    message_faults: set[str] = field(default_factory=set)
    _role_reads: set[str] = field(default_factory=set)
    _role_percepts: list[Percept] = field(default_factory=list)
    _channels: Mapping[str, Any] = NOTHING
    _same: dict[str, Any] = field(default_factory=dict)
    _windows: tuple[History, History, History] = field(init=False)
    _past_outputs: dict[str, list[tuple[float, Any]]] = field(default_factory=dict)
    _histories: dict[str, History] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """The windows on what grows are the same at all ticks."""
        self._windows = History(self.past), History(self._role_percepts), History(self.alerts)

    @property
    def tick(self) -> Tick:
        """The current tick."""
        return self.ticks[-1]

    @property
    def percept(self) -> Percept:
        """The current percept."""
        return self.percepts[-1]

    def update(self, tick: Tick, percept: Percept) -> None:
        """Begin a tick: the world as it is and as it is perceived."""
        self.ticks.append(tick)
        self.perceive(percept)

    def perceive(self, percept: Percept) -> None:
        """How the newest tick is perceived, which opens it for the roles."""
        self.percepts.append(percept)
        # What a role could write to, all others would read, and requirements as well.
        own, same = {}, self._same
        for name, value in percept._channels.items():  # noqa: SLF001 - lazy stays lazy
            if same.get(name) is value:
                own[name] = value
            else:
                own[name] = sealed_parts(value)
                if isinstance(value, tuple) and own[name] is value:
                    same[name] = value  # such as a map, which is the same at every tick
        self._channels = MappingProxyType(own)
        self._role_percepts.append(PerceptView(self._channels, self._role_reads))
        self.proposal = None
        self.generator_reads = set()
        self.message_faults = set()
        self.generator_seconds = 0.0

    def put(self, role: str, output: Any) -> None:
        """The output of a role at this tick: its latest, and one more of its history."""
        self.outputs[role] = output
        past = self._past_outputs.get(role)
        if past is None:
            past = self._past_outputs[role] = []
            self._histories[role] = History(past)
        past.append((self.ticks[-1].time, output))

    def decide(self, executed: Any, source: str) -> None:
        """What is carried out at this tick, and where it comes from."""
        self.command = executed
        proposed, why = None, ""
        if self.proposal is not None:
            proposed, why = self.proposal.action, self.proposal.explanation
        self.past.append(PastDecision(self.tick.time, proposed, why, executed, source))

    def generator_view(
        self, feedback: tuple[str, ...] = (), transmit: Transmit = _undisturbed
    ) -> GeneratorView:
        """The Generator's view of this tick; reading a channel through it is remembered."""
        percept = PerceptView(self._channels, self.generator_reads)
        tick = self.ticks[-1]
        return GeneratorView(
            tick.index, tick.time, self.dt, percept, feedback, self._windows[0], transmit
        )

    def role_view(self, reasons: tuple[str, ...] = ()) -> RoleView:
        """The view of this tick that every role but the Generator gets."""
        tick = self.ticks[-1]
        return RoleView(
            tick.index,
            tick.time,
            self.dt,
            self._role_percepts[-1],
            self._windows[1],
            self.proposal,
            MappingProxyType(self.outputs),
            self.generator_seconds,
            reasons,
            self.command,
            self._windows[2],
            MappingProxyType(self._histories),
        )
