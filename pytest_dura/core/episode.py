"""EpisodeSpec: all that determines an episode, as plain data. Episode: its result.

A fault propagates if the proposals of an episode differ from those of its fault-free twin, the
episode of the same seed without any fault; see :class:`Divergence`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.clock import Clock
from pytest_dura.core.codec import (
    LEFT_OUT,
    Count,
    Limit,
    Positive,
    PositiveNumber,
    fields_as_data,
)
from pytest_dura.core.display import LONGEST_REPR, Shown, short_repr
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.fault import Fault
from pytest_dura.core.measures import Measure, MeasureInfo, Value
from pytest_dura.core.metrics import (
    DependabilityMetrics,
    FaultRecord,
    OutcomeStatus,
    PropagationStatus,
)
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.simulator import Recording
from pytest_dura.core.state import Event
from pytest_dura.core.text import one_line

if TYPE_CHECKING:
    from typing_extensions import Self

Validity = Literal["valid", "invalid", "missing"]

POLICY_PATTERN = r"^(recover|halt|log_only|refine\([1-9][0-9]*\))$"


def _require_positive(key: str, value: float, unit: str) -> None:
    if not 0 < value < math.inf:
        raise ConfigurationError(
            f"{key} is a positive, finite number of {unit}",
            key=key,
            found=value,
            expected="a number above 0",
        )


def _no_policy(found: object) -> ConfigurationError:
    return ConfigurationError(
        "there is no such policy",
        key="policy",
        found=found,
        expected="recover, halt, log_only, or refine(k) with k of at least 1",
    )


class Policy(str):
    """Policy for a refused proposal: ``recover``, ``halt``, ``log_only`` or ``refine(k)``.

    ``refine`` asks for another proposal at most ``attempts`` times.

    Raises:
        ConfigurationError: For anything else.
    """

    __slots__ = ()

    def __new__(cls, name: str = "recover", attempts: int = 0) -> Self:
        """Make it of its text, or of a name and a number of attempts."""
        text = f"{name}({attempts})" if attempts else name
        if not isinstance(text, str) or not re.fullmatch(POLICY_PATTERN, text):
            raise _no_policy(text)
        return super().__new__(cls, text)

    @classmethod
    def parse(cls, text: str) -> Policy:
        """Read a text; the same as calling the class."""
        return cls(text)

    @property
    def name(self) -> str:
        """What it does."""
        return self.partition("(")[0]

    @property
    def attempts(self) -> int:
        """How often another proposal is asked for, at most."""
        return int(self.partition("(")[2][:-1] or 0)


RECOVER = Policy()


@dataclass(frozen=True)
class Termination:
    """When an episode ends, besides a critical failure and an end of the plant's own."""

    time_limit: PositiveNumber = 30.0
    """Simulated seconds; the first tick at or past it is the last one."""
    goal: bool = True
    """Whether reaching the goal ends it."""
    violation: bool = False
    """Whether a violation ends it, once every requirement is decided."""
    iterations: Positive | None = None
    """Decisions at most."""
    decided: bool = field(default=False, metadata=LEFT_OUT)
    """Whether it ends once every requirement of its case is decided, violated or not, and every
    planned fault has manifested; absent if not."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _require_positive("time_limit", self.time_limit, "seconds")
        if self.iterations is not None:
            _require_positive("iterations", self.iterations, "decisions")

    def last_index(self, time_step: float) -> int:
        """Index of the tick at which the time limit is reached.

        Ticks are counted, since a sum of float time steps would miss the limit by one; and the
        tolerance keeps 5.1 s / 0.1 s, which is a hair below 51 in floats, at 51 ticks.
        """
        return math.ceil(self.time_limit / time_step * (1.0 - 1e-9))


_SCENARIO_KEYS = ("name", "duration", "iterations", "world")


def check_scenario_keys(scenario: Mapping[str, Any], elsewhere: Iterable[str] = ()) -> None:
    """Refuse a key of a scenario that no scenario file could give to a simulator.

    Args:
        scenario: As the simulator and the roles read it.
        elsewhere: Parameters beside the scenario, which are easily taken for a key of it.

    Raises:
        ConfigurationError: With the key.
    """
    for key in scenario:
        if key in _SCENARIO_KEYS:
            continue
        raise ConfigurationError(
            f"a scenario has no key {key!r}, and nothing would read it",
            key=f"scenario.{key}",
            found=key,
            expected=f"one of {', '.join(_SCENARIO_KEYS)}",
            remedy=f"give it as the parameter {key}=... beside the scenario"
            if key in elsewhere
            else did_you_mean(str(key), _SCENARIO_KEYS, "put what the simulator reads in `world`"),
        )


@dataclass(frozen=True)
class EpisodeSpec:
    """All that determines an episode: from it, it can be run again on any machine, in any order."""

    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    run: Count
    """Number of the run within the case, from 0."""
    seed: Count
    """Seed of every stream in the episode."""
    simulator: RoleSpec
    """How to build the simulator."""
    roles: Mapping[str, RoleSpec]
    """How to build each role, by its name."""
    scenario: Mapping[str, Any] = field(default_factory=dict)
    """The scenario as the simulator and the roles read it, with the values that were drawn; the
    world is the user's own."""
    faults: tuple[Fault, ...] = ()
    """The planned faults, with the values that were drawn."""
    policy: Annotated[Policy, Limit(pattern=POLICY_PATTERN)] = RECOVER
    """What follows a refused proposal."""
    termination: Termination = Termination()
    """When it ends."""
    time_step: PositiveNumber = 0.1
    """Simulated seconds per tick."""
    time_budget: PositiveNumber | None = 5.0
    """Seconds for one proposal: declared latency, or wall-clock time as a guard against a component
    that hangs; null waits for ever."""
    timeouts: tuple[Annotated[int, Limit(ge=-1)], ...] | None = None
    """Recorded calls in which the component overran its budget: number of the proposal, -1 for the
    reset. Given, they are applied instead of the clock, so that a replay is exact."""
    clock: Clock = field(default=Clock(), metadata=LEFT_OUT)
    """What thinking costs in the world; absent where the world waits for the component."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_scenario_keys(self.scenario, self.__dataclass_fields__)
        _require_positive("time_step", self.time_step, "seconds")
        if self.time_budget is not None:
            _require_positive("time_budget", self.time_budget, "seconds")
        if self.clock.is_timed and self.policy.name == "refine":
            raise ConfigurationError(
                "a component whose thinking takes time cannot propose anew within a tick",
                key="policy",
                found=str(self.policy),
                expected="recover, halt or log_only with this clock",
                remedy="change the policy, or leave `clock` and `latency` out",
            )

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Measures that the simulator's class declares.

        Raises:
            ConfigurationError: If the class cannot be imported.
        """
        simulator = self.simulator
        factory = type(simulator.instance) if simulator.opaque else simulator.resolve()
        return tuple(getattr(factory, "measures", ()))

    @property
    def id(self) -> str:
        """``case#run``."""
        return f"{self.case}#{self.run}"

    @property
    def component(self) -> str:
        """Name of the component under test."""
        generator = self.roles.get("generator")
        return generator.label if generator else "none"

    def to_json(self) -> dict[str, Any]:
        """Plain data for another process, from which :meth:`from_json` makes an equal spec.

        Other than :func:`~pytest_dura.core.codec.encode`, it leaves infinities in parameters as
        they are.
        """
        return {
            **fields_as_data(self),
            "simulator": fields_as_data(self.simulator),
            "roles": {name: fields_as_data(role) for name, role in sorted(self.roles.items())},
            "scenario": dict(self.scenario),
            "faults": [fault.plain() for fault in self.faults],
            "policy": str(self.policy),
            "termination": fields_as_data(self.termination),
            "timeouts": None if self.timeouts is None else list(self.timeouts),
        } | ({} if self.clock == Clock() else {"clock": fields_as_data(self.clock)})

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EpisodeSpec:
        """Invert :meth:`to_json`.

        Raises:
            ConfigurationError: Where a role or the simulator was a bare instance.
        """
        spec = cls(
            **{
                **data,
                "simulator": RoleSpec(**data["simulator"]),
                "roles": {name: RoleSpec(**role) for name, role in data["roles"].items()},
                "faults": tuple(map(Fault.of, data["faults"])),
                "policy": Policy(data["policy"]),
                "termination": Termination(**data["termination"]),
                "clock": Clock(**data.get("clock", {})),
                "timeouts": None if data["timeouts"] is None else tuple(data["timeouts"]),
            }
        )
        spec.check_rebuildable()
        return spec

    @property
    def scenario_name(self) -> str:
        """Name of its scenario; empty where none was given."""
        return str(self.scenario.get("name", ""))

    def check_rebuildable(self) -> None:
        """Refuse a spec that another process cannot build again.

        Raises:
            ConfigurationError: Where a role or the simulator was a bare instance.
        """
        for role in (self.simulator, *self.roles.values()):
            role.check_rebuildable()

    @cached_property
    def key(self) -> str:
        """SHA-256 of all that determines the trace; equal for an episode and its replay."""
        data = {key: value for key, value in vars(self).items() if key in _DETERMINING}
        if self.clock == Clock():
            del data["clock"]  # as other keys of data that have their default
        return hashlib.sha256(canonical(data)).hexdigest()


RECORDED = "recorded"
"""Termination of an episode that was recorded and not run: what it does not show stays open."""
LOST = "lost"
"""Termination of an episode whose process a call of the component ended."""
_DETERMINING = {part.name for part in fields(EpisodeSpec)} - {"timeouts"}
"""Fields of a spec on which the trace depends."""


@dataclass(repr=False)
class Episode(Shown):
    """One closed-loop run.

    Args:
        spec: Its spec.
        time: Simulated seconds of each tick, shape ``(ticks,)``.
        signals: Ground-truth signals by name, and percept signals as ``percept.name``;
            each of shape ``(ticks,)``.
        decisions: Columns of shape ``(ticks - 1,)``, one row for each state but the last:
            ``verdict`` (0 safe, 1 warning, 2 unsafe), ``source`` (proposal, recovery,
            fallback), ``proposed`` and ``executed`` (texts), ``attempts`` (re-proposals).
        events: In the order in which they happened.
        faults: One record per planned fault.
        termination: ``goal``, ``time``, ``critical``, ``violation``, ``decided``, ``iterations``,
            ``truncated`` (the plant ended by itself), ``recorded`` (it was not run), ``halt``,
            ``lost`` (a call of the component ended the process, and the trace with it) or
            ``infrastructure``.
        failure: The message of the infrastructure error, if there was one.
        timeouts: Calls in which the component overran its wall-clock budget: the number of the
            proposal, counted from 0 (the tick, unless the policy refines), or -1 for ``reset``. A
            call that could not be stopped stands there as often as it takes to give up on it.
        metrics: Its dependability metrics.
        recording: Data for viewers, if it was recorded. It is no part of the digest.
        drawn: Whether any random number was drawn from a stream of its seed. It is no part of the
            digest.
    """

    spec: EpisodeSpec
    time: NDArray[np.float64]
    signals: dict[str, NDArray[np.float64]]
    decisions: dict[str, NDArray[Any]]
    events: tuple[Event, ...]
    faults: tuple[FaultRecord, ...]
    termination: str
    metrics: DependabilityMetrics
    failure: str | None = None
    timeouts: tuple[int, ...] = ()
    recording: Recording | None = None
    drawn: bool = False
    searched: ClassVar[bool] = False
    """Whether a search chose it, so that no rate can rest on it."""

    @property
    def id(self) -> str:
        """``case#run``."""
        return self.spec.id

    def __repr__(self) -> str:
        """Describe the episode in a line: pytest shows the arguments of a test that fails."""
        attributes = vars(self)
        end = f", {attributes['termination']} after {len(attributes['time'])} ticks>"
        return f"<episode {one_line(self.id, LONGEST_REPR - len(end) - 9)}{end}"

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "episode", self.id
        yield "component", self.spec.component
        yield "seed", str(self.spec.seed)
        end = self.time[-1] if self.ticks else 0.0
        yield "end", f"{self.termination} after {end:g} s, {self.ticks} ticks"
        yield "validity", self.validity
        yield "reason", self.failure or self.invalid_reason
        yield "faults", [fault.id for fault in self.faults] or None
        yield "events", [f"{event.time:g} s: {event.kind}" for event in self.events] or None
        yield "digest", self.digest

    @property
    def ticks(self) -> int:
        """Number of states, the initial one included."""
        return len(self.time)

    @property
    def validity(self) -> Validity:
        """``missing`` after an infrastructure error; ``invalid`` if a fault never manifested.

        A violation of an invalid episode fails the gate all the same.
        """
        if self.failure is not None:
            return "missing"
        return "valid" if self.invalid_reason is None else "invalid"

    @property
    def invalid_reason(self) -> str | None:
        """Text with the planned faults that never manifested; ``None`` without any."""
        if self.termination == LOST:
            return None  # what happened to its faults is not known
        missed = [f.id for f in self.faults if f.manifested_at is None and not f.by_chance]
        return f"never manifested: {', '.join(missed)}" if missed else None

    @property
    def not_manifested(self) -> tuple[str, ...]:
        """Ids of the faults that never manifested, also of those whose hits are drawn."""
        return tuple(fault.id for fault in self.faults if fault.manifested_at is None)

    @property
    def read_by(self) -> dict[str, tuple[str, ...]]:
        """Names of the roles that read what a fault changed, by fault."""
        return {fault.id: fault.read_by for fault in self.faults}

    @property
    def ended_early(self) -> bool:
        """Whether it ended before its time, by a violation or once all was decided."""
        return self.termination in ("violation", "decided")

    def ever(self, signal: str) -> bool:
        """Whether a signal was above 0.5 at any tick."""
        return bool((self.signal(signal) > 0.5).any())

    def signal(self, name: str) -> NDArray[np.float64]:
        """Return one signal's column.

        Raises:
            ConfigurationError: For an unknown name.
        """
        try:
            return self.signals[name]
        except KeyError:
            raise ConfigurationError(
                f"this episode has no signal {name!r}",
                found=name,
                expected="one of " + ", ".join(sorted(self.signals)),
            ) from None

    @property
    def described_measures(self) -> list[MeasureInfo]:
        """Description of its measures, in the order of tables."""
        return [measure.info(place) for place, measure in enumerate(self.spec.measures)]

    # Hidden from type checkers, which then find a measure that is misspelt: the measures of a
    # domain are attributes of an episode of its own, which users name in annotations.
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Value:
            """Return a measure that the simulator declares, such as ``collided``.

            Raises:
                ConfigurationError: If the episode lacks a signal that the measure needs.
                AttributeError: For a measure that its simulator does not declare.
            """
            spec = None if name.startswith("_") else vars(self).get("spec")
            measures: tuple[Measure, ...] = () if spec is None else spec.measures
            for measure in measures:
                if measure.name == name:
                    for signal in measure.signals:
                        self.signal(signal)
                    return measure.value(self)
            text = f"{type(self).__name__!r} object has no attribute {name!r}"
            if spec is not None:
                names = ", ".join(measure.name for measure in measures) or "none"
                text += f"; the measures of its simulator {spec.simulator.label}: {names}"
            raise AttributeError(text)

    @property
    def flagged(self) -> bool:
        """Whether any proposal was judged unsafe."""
        return self.termination == "halt" or bool((self.decisions["verdict"] == 2).any())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything but wall-clock timings; equal for equal specs on one platform."""
        state = hashlib.sha256(self.spec.key.encode())
        self._add_columns(state, self.signals)
        events = [
            replace(event, traceback="") if event.traceback else event
            for event in self.events
            if not event.wall_clock
        ]
        faults = [asdict(fault) for fault in self.faults]
        for fault in faults:
            del fault["read_by"]
        measured = self.metrics.deterministic()
        rest = [events, faults, self.termination, measured, self.timeouts, self.failure is not None]
        state.update(canonical(rest))
        return state.hexdigest()

    @cached_property
    def trajectory(self) -> str:
        """SHA-256 of the course of the run: equal for runs that differ by their seeds alone.

        It covers time, the signals of truth and percept, the decisions, and the end. Signals that
        come from the component's accounts or the loop are left out: they make no other situation.
        """
        state = hashlib.sha256()
        derived = ("proposal.", "loop.")
        signals = {
            name: signal for name, signal in self.signals.items() if not name.startswith(derived)
        }
        self._add_columns(state, signals)
        state.update(canonical([self.termination, self.validity]))
        return state.hexdigest()

    def _add_columns(
        self, state: hashlib._Hash, signals: Mapping[str, NDArray[np.float64]]
    ) -> None:
        columns = {"time": self.time}
        columns |= {f"signals.{name}": column for name, column in signals.items()}
        columns |= {f"decisions.{name}": column for name, column in self.decisions.items()}
        for name in sorted(columns):
            column = np.ascontiguousarray(columns[name])
            state.update(f"|{name}|{column.dtype.str}|{column.shape}|".encode())
            state.update(column.tobytes())


@dataclass(frozen=True)
class Propagation:
    """Effect of one manifested fault on the proposals.

    Args:
        status: ``propagated`` if a proposal differs from that of the fault-free twin, ``contained``
            if none does, ``unknown`` if the twins cannot tell.
        at: Simulated seconds of the first proposal that differs.
        reason: Why it is unknown.
    """

    status: PropagationStatus
    at: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Divergence:
    """First difference between an episode and its fault-free twin.

    Args:
        at: Simulated seconds of the first differing proposal; ``None`` if there is none in the
            ticks that both have.
        doubt: Why the difference cannot be attributed to the faults; empty if it can.
        until: Simulated seconds of the last proposal that both have, where one of them ended
            before the other; ``None`` where that does not matter.
    """

    at: float | None = None
    doubt: str = ""
    until: float | None = None

    @classmethod
    def of(
        cls, episode: Episode, twin: Episode, second: Callable[[], Episode] | None = None
    ) -> Divergence:
        """Compare the proposals of an episode with those of its twin.

        A component whose proposals differ between two fault-free runs would seem to be reached by
        every fault; from the first such difference on, nothing is attributed.

        Args:
            episode: The episode with faults.
            twin: The episode of the same seed without any fault.
            second: Runs the twin once more; called if the proposals differ.
        """
        for run in (episode, twin):
            if run.failure is not None:
                return cls(doubt=f"{run.id} is missing")
        first = _first_difference(episode, twin)
        if first is None:
            for run in (episode, twin):
                if run.termination == "decided":
                    end = run.time[-1]
                    return cls(doubt=f"{run.id} ended at {end:.2f} s, once all was decided")
            return cls(until=_common_end(episode, twin))
        if second is not None:
            other = second()
            if other.failure is not None:
                return cls(doubt=f"{other.id} is missing")
            between_twins = _first_difference(twin, other)
            if between_twins is not None and between_twins <= first:
                time = twin.time[between_twins]
                return cls(doubt=f"two runs without faults differ from {time:.2f} s on")
        return cls(at=float(episode.time[first]))

    def of_fault(self, fault: FaultRecord) -> Propagation | None:
        """Propagation of one fault; ``None`` if the fault never manifested.

        A difference is attributed to all faults that had manifested by then.
        """
        if fault.manifested_at is None:
            return None
        if self.doubt:
            return Propagation("unknown", reason=self.doubt)
        if self.at is None and self.until is not None and fault.manifested_at > self.until + 1e-9:
            reason = f"one of the runs has no proposal after {self.until:.2f} s to compare"
            return Propagation("unknown", reason=reason)
        if self.at is None:
            return Propagation("contained")
        if fault.manifested_at <= self.at + 1e-9:
            return Propagation("propagated", self.at)
        reason = f"proposals differed already from {self.at:.2f} s on, through another fault"
        return Propagation("unknown", reason=reason)


def outcome_of(
    fault: FaultRecord,
    propagation: str | None,
    violated: Collection[str],
    violated_without: Collection[str] | None,
    *,
    missing: bool,
) -> OutcomeStatus:
    """Outcome of a fault in one episode.

    ``idle`` (never active), ``masked`` (active, never manifested), ``contained`` (it changed no
    proposal), ``tolerated`` (it may have, and nothing was violated), ``violated``, ``violated also
    without it`` (all that was violated is violated without any fault, too), or ``missing`` (the
    episode cannot tell).

    Args:
        fault: Its record.
        propagation: Its propagation, if that is known.
        violated: Requirements that were violated from its manifestation on.
        violated_without: Those among them that the fault-free twin violates, too; ``None`` without
            a twin.
        missing: Whether an infrastructure error ended the episode.
    """
    if violated:
        own = set(violated).difference(violated_without or ())
        return "violated" if own else "violated also without it"
    if missing:
        return "missing"
    if fault.activated_at is None and fault.manifested_at is None:
        return "idle"
    if fault.manifested_at is None:
        return "masked"
    return "contained" if propagation == "contained" else "tolerated"


def _common_end(episode: Episode, other: Episode) -> float | None:
    """Time of the last proposal that both have; ``None`` if both have equally many."""
    left, right = len(episode.decisions["proposed"]), len(other.decisions["proposed"])
    ticks = min(left, right)
    if left == right:
        return None
    return float(episode.time[ticks - 1]) if ticks else -math.inf


def _first_difference(episode: Episode, other: Episode) -> int | None:
    """First tick at which the proposals of both differ."""
    left, right = episode.decisions["proposed"], other.decisions["proposed"]
    ticks = min(len(left), len(right))
    differing = np.flatnonzero(left[:ticks] != right[:ticks])
    return int(differing[0]) if len(differing) else None


def canonical(data: Any) -> bytes:
    """Encode data as JSON with sorted keys and no blanks: equal data give equal bytes."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), default=plain_value).encode()


def plain_value(value: Any) -> Any:
    """Convert arrays and numbers of numpy, mappings and dataclasses: a ``default`` of JSON."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if is_dataclass(value) and not isinstance(value, type):
        return fields_as_data(value)
    raise TypeError(f"{type(value).__name__} is not plain data")
