"""State of an episode: Tick, the StateManager, and the views that roles get."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import FrozenInstanceError, dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pytest_dura.core.codec import LEFT_OUT, Count, Number
from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import LONGEST_TEXT, cut
from pytest_dura.core.percepts import (
    NOTHING,
    History,
    Percept,
    PerceptView,
    TamperedReads,
    perceived,
)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one tick: a failure, an alert, a fault's activation, ..."""

    tick: Count
    """Number of the tick, from 0."""
    time: Number
    """Simulated seconds."""
    kind: str
    """Such as `alert`, `unsafe`, `recovery`, `fault_activated`."""
    subject: str
    """Who or what it is about."""
    detail: str = ""
    """In words."""
    data: Mapping[str, Any] = NOTHING
    """Further values."""
    wall_clock: bool = field(default=False, metadata=LEFT_OUT)
    """Whether it depends on the machine's speed, and is no part of the digest; absent if not."""
    traceback: str = field(default="", metadata=LEFT_OUT)
    """Whole traceback of what was raised, in bounded length. It names files of this machine and is
    no part of the digest; absent without one, and from the fifth failure of an episode on."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Cut long texts: an episode has many events."""
        if len(f"{self.kind}{self.subject}{self.detail}") <= LONGEST_TEXT:
            return
        for name in ("kind", "subject", "detail"):
            text = getattr(self, name)
            if isinstance(text, str) and len(text) > LONGEST_TEXT:
                object.__setattr__(self, name, cut(text))


# Without type parameters the truth is a mapping of anything, and an action is anything. Python has
# defaults of type parameters from 3.13 on; type checkers alone need them.
if TYPE_CHECKING:
    from typing_extensions import TypeVar as Parameter

    TruthT = Parameter("TruthT", default=Mapping[str, Any])
    TruthT_co = Parameter("TruthT_co", default=Mapping[str, Any], covariant=True)
    ReadingsT = Parameter("ReadingsT", default=Percept)
    ReadingsT_co = Parameter("ReadingsT_co", default=Percept, covariant=True)
    ActionT = Parameter("ActionT", default=Any)
    ActionT_co = Parameter("ActionT_co", default=Any, covariant=True)
else:
    TruthT, ReadingsT, ActionT = map(TypeVar, ("TruthT", "ReadingsT", "ActionT"))
    TruthT_co = TypeVar("TruthT_co", covariant=True)
    ReadingsT_co = TypeVar("ReadingsT_co", covariant=True)
    ActionT_co = TypeVar("ActionT_co", covariant=True)


def refuses_changes(cls: type[T]) -> type[T]:
    """Let a frozen class with slots say ``FrozenInstanceError`` for any name.

    Its own method fails by ``TypeError`` for a name that is no field, since it looks for the class
    as it was without slots. `Proposal[Action](...)` sets such a name, and takes an
    ``AttributeError`` for an answer.
    """

    def refuse(_self: T, name: str, _value: object) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}")

    cls.__setattr__ = refuse  # type: ignore[method-assign,assignment]
    return cls


@refuses_changes
@dataclass(frozen=True, slots=True)
class Proposal(Generic[ActionT_co]):
    """Output of the Generator.

    Args:
        action: The proposed action. May be ``None`` with a ``failure``.
        explanation: The reason for it, as the component states it.
        latency: The component's own response time in seconds, if it is modelled or known; it is
            compared with the time budget, and is deterministic where wall-clock time is not.
        failure: Why the component came to no decision of its own, if so. ``action`` is then that
            of its own fallback. It is assessed and carried out like any other, and counts as a
            failed proposal.
        account: The component's account of how it came to the proposal, as plain data with texts
            as keys; see :meth:`pytest_dura.Simulator.account_measures`.
    """

    action: ActionT_co
    explanation: str = ""
    latency: float | None = None
    failure: str = ""
    account: Mapping[str, Any] = NOTHING

    __repr__ = short_repr

    def with_action(self, action: Any) -> Proposal[Any]:
        """Copy with another action; quicker than ``replace``, since it happens at each tick."""
        return Proposal(action, self.explanation, self.latency, self.failure, self.account)


@dataclass(frozen=True, slots=True)
class Alert:
    """Suspicion about the percept or the component: the pattern of the attack, and its subject."""

    pattern: str
    subject: str
    detail: str = ""

    __repr__ = short_repr


@refuses_changes
@dataclass(frozen=True, slots=True)
class Tick(Generic[TruthT_co]):
    """State of the simulator at one instant.

    Args:
        index: Zero for the state after reset, then one per step.
        time: Simulated seconds since reset.
        truth: Ground truth by name, for requirements only; arrays are read-only.
        channels: Sensor channels by name, before any fault.
        goal: Whether the component's task is done.
        critical: Why the episode cannot go on (a collision of the ego), if so.
        events: Events of the step, as ``(kind, subject, detail)``.
        truncated: Whether the plant ended by itself and cannot be stepped on, at a time limit of
            its own for example. A breakdown is ``critical`` instead. Where the goal ends episodes,
            a tick with ``goal`` ends by it.
    """

    index: int
    time: float
    truth: TruthT_co
    channels: Mapping[str, Any]
    goal: bool = False
    critical: str | None = None
    events: tuple[tuple[str, str, str], ...] = ()
    truncated: bool = False

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class PastDecision:
    """Proposal and decision of an earlier tick.

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
"""Sends a message on a channel of the component's own, and returns the message that arrives."""


def _undisturbed(channel: str, message: Any) -> Any:  # noqa: ARG001 - as Transmit has it
    return message


@refuses_changes
@dataclass(frozen=True, slots=True)
class GeneratorView(Generic[ReadingsT_co]):
    """View of the component under test. It has no ground truth.

    ``feedback`` says why this tick's earlier proposal was refused (policy ``refine``). ``past``
    are the decisions of the earlier ticks, oldest first. A component that talks to another
    program, such as a server, does so by ``transmit(channel, message)``,
    which returns the message as it arrives, after active faults of that channel.
    """

    index: int
    time: float
    dt: float
    percept: ReadingsT_co
    feedback: tuple[str, ...] = ()
    past: Sequence[PastDecision] = ()
    transmit: Transmit = _undisturbed

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class RoleView:
    """View of every other role: the percept, the proposal, and the outputs of other roles.

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

    __repr__ = short_repr


@dataclass(slots=True)
class StateManager:
    """State that roles share: written by the orchestrator, read through views.

    ``readers`` names, by fault, the roles beside the Generator that read at this tick what the
    fault changed in this percept, and ``late_readers`` those that read it in an earlier percept.
    """

    dt: float
    ticks: list[Tick] = field(default_factory=list)
    percepts: list[Percept] = field(default_factory=list)
    outputs: dict[str, Any] = field(default_factory=dict)
    proposal: Proposal | None = None
    command: Any = None
    alerts: list[tuple[float, Alert]] = field(default_factory=list)
    generator_reads: set[str] = field(default_factory=set)
    generator_seconds: float = 0.0
    message_faults: set[str] = field(default_factory=set)
    readers: dict[str, set[str]] = field(default_factory=dict)
    late_readers: dict[str, set[str]] = field(default_factory=dict)
    _read_now: set[str] = field(default_factory=set)
    _read_late: set[str] = field(default_factory=set)
    _tampered_reads: TamperedReads | None = None
    _role_reads: set[str] = field(default_factory=set)
    _role_percepts: list[Percept] = field(default_factory=list)
    _channels: Mapping[str, Any] = NOTHING
    _unchanged: dict[str, Any] = field(default_factory=dict)
    _decisions: list[tuple[float, Any, str, Any, str]] = field(default_factory=list)
    _windows: tuple[History, History, History] = field(init=False)
    _tables: tuple[Mapping[str, Any], Mapping[str, History]] = field(init=False)
    _past_outputs: dict[str, list[tuple[float, Any]]] = field(default_factory=dict)
    _histories: dict[str, History] = field(default_factory=dict)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Make the views of growing lists, which serve all ticks."""
        # Made when they are read, since most components read none.
        past = History(self._decisions, lambda parts: PastDecision(*parts))
        self._windows = past, History(self._role_percepts), History(self.alerts)
        self._tables = MappingProxyType(self.outputs), MappingProxyType(self._histories)

    @property
    def tick(self) -> Tick:
        """The current tick."""
        return self.ticks[-1]

    @property
    def percept(self) -> Percept:
        """The current percept."""
        return self.percepts[-1]

    @property
    def past(self) -> Sequence[PastDecision]:
        """The decisions so far, oldest first."""
        return self._windows[0]

    def update(self, tick: Tick, percept: Percept) -> None:
        """Begin a tick with its true state and its percept."""
        self.ticks.append(tick)
        self.perceive(percept)

    def perceive(self, percept: Percept) -> None:
        """Set the percept of the newest tick, and make the views of it."""
        self.percepts.append(percept)
        # Sealed or copied, since all roles and requirements read the same objects.
        own, same = {}, self._unchanged
        for name, value in percept._channels.items():  # noqa: SLF001 - lazy stays lazy
            if same.get(name) is value:
                own[name] = value
            else:
                own[name] = perceived(value)
                if isinstance(value, tuple) and own[name] is value:
                    same[name] = value  # such as a map, which is the same at every tick
        self._channels = MappingProxyType(own)
        if self._tampered_reads is not None:  # of the percept before, which is history now
            self._tampered_reads.faults, self._tampered_reads = self._read_late, None
        reads: set[str] | TamperedReads = self._role_reads
        if percept.tampered is not NOTHING:
            reads = self._tampered_reads = TamperedReads(percept.tampered, self._read_now)
        self._role_percepts.append(PerceptView(self._channels, reads, percept.aliases))
        if self.readers or self.late_readers:
            self.readers, self.late_readers = {}, {}
        if self.message_faults:
            self.message_faults = set()
        self.proposal = None
        self.generator_reads = set()
        self.generator_seconds = 0.0

    def has_read(self, role: str | None) -> None:
        """Attribute what was read since the last call to a role; to none for ``None``."""
        if not self._read_now and not self._read_late:
            return
        for faults, readers in (
            (self._read_now, self.readers),
            (self._read_late, self.late_readers),
        ):
            if faults:
                for fault in faults if role is not None else ():
                    readers.setdefault(fault, set()).add(str(role))
                faults.clear()

    def put(self, role: str, output: Any) -> None:
        """Store the output of a role at this tick, as its latest and in its history."""
        self.outputs[role] = output
        past = self._past_outputs.get(role)
        if past is None:
            past = self._past_outputs[role] = []
            self._histories[role] = History(past)
        past.append((self.ticks[-1].time, output))

    def hold(self, role: str, output: Any) -> None:
        """Store an output that a role has at each tick, without being run."""
        self.outputs[role] = output
        self._histories[role] = History(self.ticks, lambda tick: (tick.time, output))

    def decide(self, executed: Any, source: str) -> None:
        """Store the action that is carried out at this tick, and its source."""
        self.command = executed
        proposed, why = None, ""
        if self.proposal is not None:
            proposed, why = self.proposal.action, self.proposal.explanation
        self._decisions.append((self.ticks[-1].time, proposed, why, executed, source))

    def generator_view(
        self, feedback: tuple[str, ...] = (), transmit: Transmit = _undisturbed
    ) -> GeneratorView:
        """Make the Generator's view of this tick, which records the channels read."""
        percept = PerceptView(self._channels, self.generator_reads, self.percepts[-1].aliases)
        tick = self.ticks[-1]
        return GeneratorView(
            tick.index, tick.time, self.dt, percept, feedback, self._windows[0], transmit
        )

    def role_view(self, reasons: tuple[str, ...] = ()) -> RoleView:
        """Make the view of this tick for the roles other than the Generator."""
        tick = self.ticks[-1]
        return RoleView(
            tick.index,
            tick.time,
            self.dt,
            self._role_percepts[-1],
            self._windows[1],
            self.proposal,
            self._tables[0],
            self.generator_seconds,
            reasons,
            self.command,
            self._windows[2],
            self._tables[1],
        )
