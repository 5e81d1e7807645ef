"""Activation and duration of faults: what triggers a fault, and how long it acts.

A :class:`Trigger` decides when a fault is due, for the FaultInjector and for an
:class:`AttackPlan`, which says when a SecurityAssessor directs its attacks.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.fault import Fault
from pytest_dura.core.roles import Injection
from pytest_dura.core.seeding import stream
from pytest_dura.core.state import RoleView
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.parts import (
    PROPOSAL,
    FaultPart,
    NotNegative,
    Positive,
    RefusedError,
    Share,
    Target,
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


BLOCK = 256
"""Ticks that are drawn at once."""


class Chance:
    """Hits of a probability, one draw per tick from one stream, made in advance.

    Whether a tick is hit depends on its index alone, not on the ticks of the calls.

    Args:
        probability: Probability of a hit at a tick.
        rng: The stream, for these draws alone.
    """

    __slots__ = ("_drawn", "_hits", "_probability", "_rng")

    def __init__(self, probability: float, rng: np.random.Generator) -> None:
        self._probability, self._rng = probability, rng
        self._hits: list[int] = []
        self._drawn = 0

    def hits(self, tick: int) -> bool:
        """Whether this tick, counted from 0, is hit."""
        return self.next(tick) == tick

    def next(self, tick: int) -> int:
        """First tick from this one on that is hit, or that is not drawn yet."""
        while self._drawn <= tick:
            hits = np.flatnonzero(self._rng.random(BLOCK) < self._probability)
            self._hits += (hits + self._drawn).tolist()
            self._drawn += BLOCK
        place = bisect_left(self._hits, tick)
        return self._hits[place] if place < len(self._hits) else self._drawn


NEVER, NOW = math.inf, -math.inf


class Trigger:
    """Decides at which ticks of an episode a fault falls due, whether or not it can begin then.

    Args:
        activation: What triggers it.
        fault: Id of the fault.
        dt: Seconds per tick.
        seed: Seed of the episode; all draws come from a stream of the fault's own, so that adding
            or removing another fault shifts none of them.
    """

    def __init__(self, activation: Activation, fault: str, dt: float, seed: int = 0) -> None:
        self.activation, self._dt = activation, dt
        self.condition = parse_condition(activation.when) if activation.when else None
        self.final = NEVER if activation.not_after is None else activation.not_after + TOLERANCE
        self._first = activation.not_before - TOLERANCE
        probability = activation.probability
        if activation.rate is not None:
            probability = -math.expm1(-activation.rate * dt)
        self._chance: Chance | None = None
        if probability is not None:
            self._chance = Chance(probability, stream(seed, f"fault:activation:{fault}"))
        self._last = -1.0
        self._held = False
        self._pending: list[float] = []

    def follow(self, time: float) -> None:
        """Fall due at this time, after an event of another fault."""
        self._pending.append(time)

    def due(
        self, time: float, channels: Mapping[str, Any] | None, effect: float | None = None
    ) -> bool:
        """Whether it falls due at this tick. Call it at each tick at which it may.

        Args:
            time: Simulated time, at which a condition is read.
            channels: What a condition reads; without any, it does not hold.
            effect: When the fault would take effect, if that is not at this time.
        """
        effect = time if effect is None else effect
        since, self._last = self._last, effect
        if self._chance is not None:
            return self._in_window(time) and self._chance.hits(round(time / self._dt))
        if self.condition is not None:
            held = self._held
            self._held = (
                channels is not None
                and self._in_window(time)
                and self.condition.holds(channels, time)
            )
            return self._held and not held
        if self._pending:
            waiting = [at for at in self._pending if at > effect + TOLERANCE]
            reached, self._pending = len(waiting) < len(self._pending), waiting
            return reached
        return self.activation.due(effect, since)

    def next_due(self) -> float:
        """Time before which it does not fall due, unless an event that it follows happens."""
        if self._pending:
            return min(self._pending)
        if self._chance is None and self.condition is None:
            return self.activation.next_planned(self._last)
        following = max(self._first, self._last + self._dt / 2)
        if self._chance is not None:
            index = math.ceil(following / self._dt - TOLERANCE)
            following = self._chance.next(max(index, 0)) * self._dt
        return following if following <= self.final else NEVER

    def _in_window(self, time: float) -> bool:
        return self._first <= time <= self.final


@contextmanager
def refusing(fault: str, key: str, found: object = None) -> Iterator[None]:
    """Name the fault and its key in an error of what it reads.

    Args:
        fault: Id of the fault.
        key: The key of the fault that names what it reads.
        found: What is found there; by default what the error has found.
    """
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(
            f"the fault {fault!r} cannot be used: {error.problem}",
            key=key,
            found=error.found if found is None else found,
            expected=error.expected,
            remedy=error.remedy,
        ) from None


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

    def __init__(self, faults: Sequence[Fault], role: str) -> None:
        self._attacks = [_Attack(fault) for fault in faults if fault.activation["by"] == role]
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
    def __init__(self, fault: Fault) -> None:
        self.id = fault.id
        activation = Activation.model_validate(fault.activation)
        self._after = activation.after
        # Nothing that a SecurityAssessor directs by is drawn, and so neither dt nor seed matters.
        self.trigger = Trigger(activation, fault.id, 0.0)
        condition = self.trigger.condition
        targets = condition.targets if condition else ()
        self.reads_proposal = any(target.channel == PROPOSAL for target in targets)
        self._on_command = Target.parse(fault.target).is_command
        self._reports = 0

    def check(self, percept: Mapping[str, Any]) -> None:
        """Refuse a condition before anything has moved, also one whose window comes later."""
        condition = self.trigger.condition
        if condition is not None and not self.reads_proposal:
            with refusing(self.id, "activation.when", condition.text):
                condition.check(percept)

    def due(self, view: RoleView, channels: Mapping[str, Any]) -> bool:
        """Whether it is to be directed at this tick."""
        if self._after is not None:
            self._follow(view, self._after)
        readable = view.proposal is not None or not self.reads_proposal
        effect = view.time if self._on_command else view.time + view.dt
        return self.trigger.due(view.time, channels if readable else None, effect)

    def _follow(self, view: RoleView, after: After) -> None:
        """Schedule activations after the events that the injector reported since the last tick."""
        reports = view.history.get("fault_injector", ())
        for time, report in reports[self._reports :]:
            if isinstance(report, Injection):
                names = report.activated if after.event == "activated" else report.deactivated
                if after.fault in names:
                    self.trigger.follow(time + after.delay)
        self._reports = len(reports)
