"""Activation and duration of faults: times, conditions on the channels, how long a fault acts.

The FaultInjector activates faults by it; an :class:`AttackPlan` says when a SecurityAssessor
directs its attacks.
"""

from __future__ import annotations

import math
import operator
import re
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Injection
from pytest_dura.core.state import Lazy, RoleView
from pytest_dura.faults.parts import (
    PROPOSAL,
    AbsentRowError,
    FaultPart,
    NotNegative,
    Positive,
    RefusedError,
    Share,
    Target,
)

_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
_TERM = re.compile(
    r"\s*(?P<abs>abs\(\s*)?(?P<path>[A-Za-z_]\w*(?:\.\w+)*)(?(abs)\s*\))"
    r"\s*(?P<sign>>=|<=|>|<)\s*(?P<bound>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\Z"
)
TIME = "time"
COUNT = "count"
"""Field of every channel that has a length: its number of entries."""


class _Term(NamedTuple):
    target: Target
    absolute: bool
    holds: Callable[[float, float], bool]
    bound: float


@dataclass(frozen=True, slots=True)
class Condition:
    """Comparisons of numbers in channels, joined by "and"; see :func:`parse_condition`."""

    text: str
    terms: tuple[_Term, ...]

    @property
    def targets(self) -> tuple[Target, ...]:
        """Channels and fields that it reads, without ``time``."""
        return tuple(term.target for term in self.terms if term.target.channel != TIME)

    def check(self, channels: Mapping[str, Any]) -> None:
        """Refuse channels that lack a target of the condition.

        Raises:
            ConfigurationError: For a channel or field that is not there, or is not a number.
        """
        for target in self.targets:
            with suppress(AbsentRowError):
                _number(target, channels)

    def holds(self, channels: Mapping[str, Any], time: float) -> bool:
        """Whether it holds for the channels at this simulated time, in s.

        It does not hold for a row that an array or list does not have at this tick, nor for NaN.

        Raises:
            ConfigurationError: For a channel or field that is not there, or is not a number.
        """
        try:
            for target, absolute, holds, bound in self.terms:
                value = time if target.channel == TIME else _number(target, channels)
                if not holds(abs(value) if absolute else value, bound):
                    return False
        except AbsentRowError:
            return False
        return True


@lru_cache(maxsize=256)
def parse_condition(text: str) -> Condition:
    """A condition from ``path cmp number``, joined by ``and``.

    A path is ``channel.field``, ``channel.count`` (its number of entries), ``abs(channel.field)``
    or ``time``; ``cmp`` is one of ``> >= < <=``.

    Raises:
        RefusedError: For anything else, with the part that is not understood.
    """
    terms = []
    for part in re.split(r"\band\b", text):
        match = _TERM.match(part)
        if match is None:
            raise RefusedError(
                f"{part.strip()!r} is not a comparison such as 'odometry.speed > 5'",
                f"a path, one of {' '.join(_COMPARISONS)}, and a number; several are joined by"
                " 'and'",
                "correct the condition",
            )
        target = Target.parse(match["path"])
        if (target.channel == TIME) == bool(target.field):
            raise RefusedError(
                f"{match['path']!r} is no number",
                f"channel.field, channel.{COUNT}, abs(channel.field) or {TIME}",
                "say which number of the channel is meant",
            )
        sign, bound = _COMPARISONS[match["sign"]], float(match["bound"])
        if not math.isfinite(bound):
            raise RefusedError(
                f"{match['bound']} in {part.strip()!r} is not a finite number", "a finite number"
            )
        terms.append(_Term(target, bool(match["abs"]), sign, bound))
    return Condition(text, tuple(terms))


_CHANNEL = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?=\.)")
"""The channel of a path in the text of a condition."""


def by_channels(data: Mapping[str, Any], aliases: Mapping[str, str]) -> dict[str, Any]:
    """Copy a fault's plain data, in which channels have their own names instead of second ones.

    Those of the target and of conditions are replaced; what is malformed stays as it is.

    Args:
        data: As in a scenario file.
        aliases: Second names of channels, to their own.
    """
    named = {**data}
    target = data.get("target")
    if isinstance(target, str):
        channel, dot, field = target.partition(".")
        named["target"] = f"{aliases.get(channel, channel)}{dot}{field}"
    for part, key in (("activation", "when"), ("duration", "until")):
        inner = data.get(part)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            text = _CHANNEL.sub(lambda match: aliases.get(match[0], match[0]), inner[key])
            named[part] = {**inner, key: text}
    return named


def _number(target: Target, channels: Mapping[str, Any]) -> float:
    value = target.channel_of(channels)
    names = value if isinstance(value, Mapping) else getattr(type(value), "_fields", ())
    if target.field == COUNT and COUNT not in names:
        value = value.get() if type(value) is Lazy else value
        if hasattr(value, "__len__"):
            return float(len(value))
    else:
        value = target.read(channels)
        if isinstance(value, (int, float, np.number, np.bool_)):
            return float(value)
    raise ConfigurationError(
        f"a condition cannot read {str(target)!r}, which is not a number",
        found=type(value).__name__,
        expected=f"a field that holds a number, or {COUNT} of what has entries",
        remedy="compare a number",
    )


TOLERANCE = 1e-9
"""s; two simulated times nearer than this are the same."""


class After(FaultPart):
    """Another fault of the same campaign whose event activates this one."""

    fault: str = Field(min_length=1, description="Id of the other fault.")
    event: Literal["activated", "manifested", "deactivated"] = Field(
        "activated",
        description="`manifested`: a value that a role read, or the command, was changed.",
    )
    delay: NotNegative = Field(
        0.0, description="Seconds from that event; at 0 it is the tick that follows."
    )


class Activation(FaultPart):
    """When a fault becomes active, and who says so.

    One of ``at``, ``when``, ``probability``, ``rate`` and ``after`` says when. All of them are
    decided on the channels as they are without any fault, so that faults do not shift each other.
    What falls due while the fault is active is lost. ``when`` activates it where its condition
    begins to hold within the window, and again only after it has not held.

    Attacks that the SecurityAssessor directs are decided on what that role perceives, and on the
    component's proposal: a fault on a sensor begins at the next percept.
    """

    at: NotNegative | None = Field(None, description="Simulated time of the activation, in s.")
    every: Positive | None = Field(None, description="With `at`: again after this period, in s.")
    when: str | None = Field(
        None,
        description="A condition on the channels, such as `odometry.speed > 5`; for the"
        " `security_assessor` also on the proposal: `proposal.acceleration > 1`.",
    )
    probability: Share | None = Field(
        None, description="Of an activation at each tick at which it is inactive."
    )
    rate: Positive | None = Field(
        None, description="Activations per second while inactive (a Poisson process), in 1/s."
    )
    after: After | None = Field(None, description="An event of another fault.")
    not_before: NotNegative = Field(
        0.0, description="Earliest time of `when`, `probability` and `rate`, in s."
    )
    not_after: Positive | None = Field(
        None, description="Latest time of `when`, `probability` and `rate`, in s."
    )
    times: Annotated[int, Field(ge=1)] | None = Field(
        None,
        description="At most so often, however it is activated. Default: once for `at`, `when` and"
        " `after`, else no limit.",
    )
    by: Literal["fault_injector", "security_assessor"] = Field(
        "fault_injector",
        description="Planned in the injector, or an attack that the SecurityAssessor directs.",
    )

    @field_validator("when")
    @classmethod
    def _condition(cls, text: str | None) -> str | None:
        if text is not None:
            parse_condition(text)
        return text

    @model_validator(mode="after")
    def _check_trigger(self) -> Activation:
        given = [name for name in TRIGGERS if getattr(self, name) is not None]
        directed = self.by == "security_assessor"
        if len(given) > 1:
            raise RefusedError(
                f"{' and '.join(given)} contradict each other",
                f"only one of {', '.join(TRIGGERS)}",
                "keep one of them; a window is given by not_before and not_after",
            )
        if not given and not directed:
            raise RefusedError(
                "nothing activates it",
                f"one of {', '.join(TRIGGERS)}",
                "add one of them, such as `at: 2.0`",
            )
        if directed:
            self._check_directed(given)
        self._check_repetition()
        self._check_window(given)
        return self

    def _check_directed(self, given: list[str]) -> None:
        if given and given[0] in ("probability", "rate"):
            raise RefusedError(
                f"the security_assessor does not direct by {given[0]!r}",
                "`at`, `when`, `after`, or nothing, which leaves it to that role",
                f"remove {given[0]!r}, or leave the fault to the fault_injector",
            )
        if self.after is not None and self.after.event == "manifested":
            raise RefusedError(
                "the security_assessor does not see whether a fault manifested",
                "the event `activated` or `deactivated`",
                "wait for another event, or leave the fault to the fault_injector",
            )

    def _check_repetition(self) -> None:
        if self.every is not None and self.at is None:
            raise RefusedError("`every` repeats `at`, which is not given", "`at` beside `every`")
        if self.at is not None and self.every is None and (self.times or 1) > 1:
            raise RefusedError(
                f"`at` alone happens once, not {self.times} times",
                "`every` beside `at` and `times`",
                "add `every`, or remove `times`",
            )

    def _check_window(self, given: list[str]) -> None:
        if self.not_after is not None and self.not_after < self.not_before:
            raise RefusedError(
                f"the window is empty: not_after ({self.not_after:g} s) is before not_before"
                f" ({self.not_before:g} s)",
                "not_before <= not_after",
                "exchange them, or remove one",
            )
        windowed = given and given[0] in ("when", "probability", "rate")
        if not windowed and (self.not_after is not None or self.not_before):
            raise RefusedError(
                f"a window does not bound {given[0] if given else 'a directive'!r}",
                "not_before and not_after beside `when`, `probability` or `rate`",
                "remove the window",
            )

    @property
    def by_chance(self) -> bool:
        """Whether chance decides if the fault becomes active at all."""
        drawn = self.probability is not None and 0.0 < self.probability < 1.0
        return drawn or self.rate is not None

    @property
    def limit(self) -> int | None:
        """Greatest number of activations; ``None`` for no limit."""
        if self.times is not None:
            return self.times
        repeated = self.every is not None or self.probability is not None or self.rate is not None
        triggered = self.when is not None or self.after is not None
        directed = self.by == "security_assessor" and not triggered
        return None if repeated or directed else 1

    @property
    def directed(self) -> bool:
        """Whether the SecurityAssessor, not the injector, decides when it begins."""
        return self.by == "security_assessor"

    def due(self, time: float, since: float) -> bool:
        """Whether an activation by ``at`` and ``every`` falls into ``(since, time]``."""
        return self.next_planned(since) <= time + TOLERANCE

    def next_planned(self, since: float) -> float:
        """First time after ``since`` of an activation by ``at`` and ``every``; or infinity."""
        if self.at is None:
            return math.inf
        if since < self.at - TOLERANCE:
            return self.at
        if self.every is None:
            return math.inf
        passed = math.floor((since - self.at + TOLERANCE) / self.every)
        return self.at + (max(passed, 0) + 1) * self.every


TRIGGERS = ("at", "when", "probability", "rate", "after")


def planned_at(activation: Any) -> float | None:
    """Planned time of an activation in plain data, if it has one."""
    return (activation or {}).get("at")


class Sampled(FaultPart):
    """Drawn uniformly from an interval, anew for each activation."""

    min: Positive = Field(description="Shortest, in s.")
    max: Positive = Field(description="Longest, in s.")

    @model_validator(mode="after")
    def _ordered(self) -> Sampled:
        if self.min > self.max:
            raise RefusedError(
                f"min is above max ({self.min:g} > {self.max:g})",
                "a shortest duration that is no longer than the longest",
                "exchange them",
            )
        return self


class Until(FaultPart):
    """Until a condition on the channels holds, as they are without any fault.

    It is looked at from the tick after the activation on.
    """

    until: str = Field(description="A condition on the channels, such as `odometry.speed < 1`.")
    at_most: Positive | None = Field(None, description="In s; null for no limit.")

    @field_validator("until")
    @classmethod
    def _condition(cls, text: str) -> str:
        parse_condition(text)
        return text


class Intermittent(FaultPart):
    """On and off by turns, on first: the duty cycle is ``on / (on + off)``."""

    on: Positive = Field(description="Seconds for which it acts.")
    off: Positive = Field(description="Seconds for which it then rests.")
    lasting: Positive | None = Field(
        None, description="Of all turns together, in s; null: for good."
    )

    def acts(self, elapsed: float) -> bool:
        """Whether it acts this many seconds after its activation."""
        period = self.on + self.off
        within = elapsed - math.floor(elapsed / period + TOLERANCE) * period
        return within < self.on - TOLERANCE


def _kind(value: object) -> str:
    if value == "once":
        return "<once>"
    if isinstance(value, FaultPart):
        return f"<{type(value).__name__.lower()}>"
    if isinstance(value, Mapping):
        if "until" in value or "at_most" in value:
            return "<until>"
        return "<intermittent>" if {"on", "off", "lasting"} & set(value) else "<sampled>"
    return "<seconds>"


Duration: TypeAlias = Annotated[
    Annotated[Positive, Tag("<seconds>")]
    | Annotated[Literal["once"], Tag("<once>")]
    | Annotated[Sampled, Tag("<sampled>")]
    | Annotated[Until, Tag("<until>")]
    | Annotated[Intermittent, Tag("<intermittent>")],
    Discriminator(_kind),
]
"""Seconds; ``once`` (one tick); ``{min, max}``; ``{until, at_most}``; or ``{on, off, lasting}``."""

DURATIONS = "seconds above 0, once, {min, max}, {until, at_most}, {on, off, lasting}, or null"
"""Forms of a duration, for messages."""


class Lifetime:
    """Duration of one activation, drawn at its beginning; at least one tick."""

    __slots__ = ("_duration", "_limit", "_until", "since")

    def __init__(self, duration: Any, since: float, dt: float, rng: np.random.Generator) -> None:
        self.since = since
        self._duration = duration
        self._until = parse_condition(duration.until) if isinstance(duration, Until) else None
        self._limit: float | None
        if duration == "once":
            self._limit = dt
        elif isinstance(duration, Sampled):
            self._limit = float(rng.uniform(duration.min, duration.max))
        elif isinstance(duration, Until):
            self._limit = duration.at_most
        elif isinstance(duration, Intermittent):
            self._limit = duration.lasting
        else:
            self._limit = duration

    def over(self, time: float, channels: Mapping[str, Any]) -> bool:
        """Whether it has ended by this time."""
        if self._limit is not None and time >= self.since + self._limit - TOLERANCE:
            return True
        return self._until is not None and self._until.holds(channels, time)

    def acts(self, time: float) -> bool:
        """Whether the fault acts at this time, which an intermittent one does by turns."""
        if isinstance(self._duration, Intermittent):
            return self._duration.acts(time - self.since)
        return True


class AttackPlan:
    """Plan of the faults of an episode with ``by: security_assessor``.

    An assessor calls :meth:`due` once per tick and returns the ids as its directives. Faults on
    sensors take effect at the next percept, those on the command at once. The plan depends on the
    assessor's own view: simulated time (``at``, ``every``), the percept and the component's
    proposal (``when``), and the FaultInjector's outputs so far (``after``).

    Args:
        faults: All faults of the episode, as in ``RoleContext.faults``.
        role: Name of the assessor's role.
    """

    def __init__(self, faults: Sequence[Mapping[str, Any]], role: str) -> None:
        self._attacks = [_Attack(fault) for fault in faults if fault["activation"]["by"] == role]
        self._unchecked = True

    def due(self, view: RoleView, proposal: Callable[[], Mapping[str, float]]) -> tuple[str, ...]:
        """Ids of the faults to activate, in planned order.

        Args:
            view: The assessor's view of this tick.
            proposal: Returns the numbers of the component's proposal by name, which conditions
                read as ``proposal.<name>``; called if one does and there is a valid proposal.

        Raises:
            ConfigurationError: At the first tick, if a condition reads what no channel has.
        """
        if not self._attacks:
            return ()
        if self._unchecked:
            for attack in self._attacks:
                attack.check(view.percept)
            self._unchecked = False
        channels: Mapping[str, Any] = view.percept
        if view.proposal is not None and any(attack.reads_proposal for attack in self._attacks):
            # A chain, since a copy would read every channel of the percept.
            channels = ChainMap({PROPOSAL: proposal()}, view.percept)  # type: ignore[arg-type]
        return tuple(attack.id for attack in self._attacks if attack.due(view, channels))


class _Attack:
    def __init__(self, fault: Mapping[str, Any]) -> None:
        self.id: str = fault["id"]
        self.activation = Activation.model_validate(fault["activation"])
        when = self.activation.when
        self.condition: Condition | None = parse_condition(when) if when else None
        targets = self.condition.targets if self.condition else ()
        self.reads_proposal = any(target.channel == PROPOSAL for target in targets)
        self._on_command = Target.parse(fault["target"]).is_command
        self._last = -1.0
        self._held = False
        self._pending: list[float] = []
        self._reports = 0

    def check(self, percept: Mapping[str, Any]) -> None:
        """Refuse a condition before anything has moved, also one whose window comes later."""
        if self.condition is None or self.reads_proposal:
            return
        try:
            self.condition.check(percept)
        except ConfigurationError as error:
            raise ConfigurationError(
                f"the fault {self.id!r} cannot be used: {error.problem}",
                key="activation.when",
                found=self.activation.when,
                expected=error.expected,
                remedy=error.remedy,
            ) from None

    def due(self, view: RoleView, channels: Mapping[str, Any]) -> bool:
        effect = view.time if self._on_command else view.time + view.dt
        since, self._last = self._last, effect
        activation = self.activation
        if activation.after is not None:
            self._follow(view)
            waiting = [time for time in self._pending if time > effect + TOLERANCE]
            is_due, self._pending = len(waiting) < len(self._pending), waiting
            return is_due
        if self.condition is not None:
            last = math.inf if activation.not_after is None else activation.not_after
            held = self._held
            self._held = (
                (view.proposal is not None or not self.reads_proposal)
                and activation.not_before - TOLERANCE <= view.time <= last + TOLERANCE
                and self.condition.holds(channels, view.time)
            )
            return self._held and not held
        return activation.due(effect, since)

    def _follow(self, view: RoleView) -> None:
        """Schedule activations after the events that the injector reported since the last tick."""
        after = self.activation.after
        reports = view.history.get("fault_injector", ())
        for time, report in reports[self._reports :]:
            if after is not None and isinstance(report, Injection):
                names = report.activated if after.event == "activated" else report.deactivated
                if after.fault in names:
                    self._pending.append(time + after.delay)
        self._reports = len(reports)
