"""Roles of the loop: the abstract base, the six bases with typed outputs, and their order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.fault import Fault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.state import ActionT, Alert, GeneratorView, Proposal, ReadingsT, RoleView


class Assessed(IntEnum):
    """Verdict of a monitor on a proposal; the worst of all monitors wins."""

    SAFE = 0
    WARNING = 1
    UNSAFE = 2


@dataclass(frozen=True, slots=True)
class Assessment:
    """Output of a monitor. ``score`` is its margin: the larger, the safer."""

    verdict: Assessed = Assessed.SAFE
    score: float = 0.0
    reasons: tuple[str, ...] = ()
    critical: bool = False

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class SecurityAssessment(Assessment):
    """Output of a SecurityAssessor: with alerts, faults to activate, and the component's reaction.

    The reaction is its class, given once the suspicion is over: one of
    :data:`pytest_dura.core.metrics.REACTIONS`, or one of the assessor's own.
    """

    alerts: tuple[Alert, ...] = ()
    directives: tuple[str, ...] = ()
    reaction: str | None = None

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class PerformanceAssessment:
    """Values over time. ``wall_clock`` holds those that depend on the machine's speed.

    ``performance_fail`` names the thresholds that were passed at this tick. Performance never
    activates recovery.
    """

    values: Mapping[str, float] = NOTHING
    wall_clock: Mapping[str, float] = NOTHING
    performance_fail: tuple[str, ...] = ()

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Injection:
    """Output of the FaultInjector: ids of the faults that began and ended at this tick."""

    activated: tuple[str, ...] = ()
    deactivated: tuple[str, ...] = ()

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Recovery:
    """Output of the RecoveryPlanner: the action that replaces the proposal."""

    action: Any
    name: str
    explanation: str = ""

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class RoleContext:
    """Context that a role gets before an episode: plain data of its own, never the ground truth.

    ``seed`` with :func:`pytest_dura.core.seeding.stream` and the role's own name gives its draws.
    The Generator's context has a seed of its own and no ``faults``, since a component that knows
    the attacks beforehand is not tested by them. ``time_budget`` is the limit of one proposal, in
    s; ``None`` for no limit.
    """

    seed: int
    dt: float
    scenario: Mapping[str, Any] = NOTHING
    faults: tuple[Fault, ...] = ()
    time_budget: float | None = None

    __repr__ = short_repr


class Role(ABC):
    """One V&V function. Subclass this for a role of your own; it needs ``name`` and ``run``.

    ``after`` names roles that run earlier in the same tick. ``reassess`` says whether the role
    runs again when the Generator refines a refused proposal within a tick. ``repeatable`` says of
    the component under test whether equal seeds give equal episodes: if not, its runs count as
    draws, and reports say so. ``instances`` is ``one`` for a component that exists once, such as a
    controller on a wire: then one process simulates, pytest's own.
    """

    name: ClassVar[str] = ""
    after: ClassVar[tuple[str, ...]] = ()
    reassess: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True
    instances: ClassVar[Literal["many", "one"]] = "many"

    @classmethod  # noqa: B027 - most roles accept all
    def check_params(cls, params: Mapping[str, Any], time_step: float) -> None:
        """Refuse parameters of a scenario file that cannot work, before anything runs.

        Args:
            params: Keyword parameters of the class.
            time_step: Seconds per tick.

        Raises:
            ConfigurationError: For such parameters. The default accepts all.
        """

    @classmethod
    def resolve_parameters(cls, params: Mapping[str, Any]) -> Mapping[str, Any]:
        """Complete the parameters by all that determines the role's behaviour from elsewhere.

        An example is the name of a model that the environment gives. The specs of episodes state
        the result. It is called once per session for the same parameters, before the first episode,
        and must return resolved parameters as they are.

        Args:
            params: Keyword parameters of the class, as they were given.

        Raises:
            ConfigurationError: If they cannot be resolved. The default returns them as they are.
        """
        return params

    def reset(self, context: RoleContext) -> None:  # noqa: B027 - stateless roles need none
        """Begin an episode; forget everything of the previous one."""

    def trigger(self, view: RoleView) -> bool:  # noqa: ARG002 - for those who override it
        """Whether the role runs at this tick."""
        return True

    @abstractmethod
    def run(self, view: RoleView) -> Any:
        """Do the role's work; the StateManager keeps the output under the role's name."""


class Generator(Role, Generic[ReadingsT, ActionT]):
    """The component under test, ``Generator[Readings, Action]`` where a type checker is to know.

    ``Readings`` is what a percept holds, a ``TypedDict`` of the channels for example, and
    ``Action`` what is proposed; without them they are a :class:`Percept` and anything.

    ``requirement_files`` are files of requirements that come with it: they apply to the scenarios
    that their globs match and whose domain has their signals, when the option ``--dura-generator``
    names the component.
    """

    name = "generator"
    requirement_files: ClassVar[tuple[Path, ...]] = ()

    @abstractmethod
    def propose(self, view: GeneratorView[ReadingsT]) -> Proposal[ActionT]:
        """Propose an action for this tick, from the percept alone."""

    def time_limit(self, budget: float | None) -> float | None:
        """Seconds of wall-clock time after which the loop ends a call; ``None`` for never.

        The default is the time budget. Override it for a component that keeps a deadline of its own
        and does more within a call than to decide; its declared latency is compared with the budget
        all the same.
        """
        return budget

    def run(self, view: RoleView) -> Any:
        """Raise: the loop calls :meth:`propose` with the Generator's own view instead."""
        raise NotImplementedError("the loop calls propose() with a GeneratorView")


class SafetyMonitor(Role):
    """Judge of whether a proposal is safe to carry out."""

    name = "safety_monitor"

    def trigger(self, view: RoleView) -> bool:
        """Run if there is a proposal; the lack of a valid one counts as unsafe anyway."""
        return view.proposal is not None

    @abstractmethod
    def run(self, view: RoleView) -> Assessment:
        """Assess ``view.proposal``."""


class SecurityAssessor(Role):
    """Director of planned attacks, and detector of attacks in percept and component."""

    name = "security_assessor"
    after = ("safety_monitor",)

    @abstractmethod
    def run(self, view: RoleView) -> SecurityAssessment:
        """Return alerts, directives and the reaction; ``view.proposal`` may be ``None``."""


class FaultInjector(Role):
    """Activator of faults, which applies them to channels and commands."""

    name = "fault_injector"
    after = ("security_assessor",)
    reassess = False

    @abstractmethod
    def run(self, view: RoleView) -> Injection:
        """Activate and deactivate what is planned or directed."""

    def may_act(self) -> bool:
        """Whether it may change a channel or a command in this episode; asked once after reset.

        One that may not is not run either: its output is an empty :class:`Injection` at each tick.
        """
        return True

    def corrupt(
        self,
        channels: Mapping[str, Any],
        time: float,  # noqa: ARG002 - for those who override it
    ) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, ...]]]:
        """Return the channels after active sensor faults, and by channel what changed it."""
        return channels, NOTHING

    def corrupt_command(
        self,
        action: Any,
        time: float,  # noqa: ARG002 - for those who override it
    ) -> tuple[Any, tuple[str, ...]]:
        """Return the command after active faults, and the ids of the faults that changed it."""
        return action, ()

    def corrupt_message(
        self,
        channel: str,  # noqa: ARG002 - for those who override it
        message: Any,
        time: float,  # noqa: ARG002 - see above
    ) -> tuple[Any, tuple[str, ...]]:
        """Return a message of the component after active faults, and ids of those faults."""
        return message, ()

    def manifested(self, faults: tuple[str, ...], time: float) -> None:
        """Take note of faults that reached a role or the plant for the first time."""


class PerformanceOracle(Role):
    """Measurement of how well and how quickly the task is done."""

    name = "performance_oracle"
    after = ("fault_injector",)
    reassess = False

    @abstractmethod
    def run(self, view: RoleView) -> PerformanceAssessment:
        """Return the values of this tick and the thresholds that they passed."""


class RecoveryPlanner(Role):
    """Planner of the action that replaces a refused proposal."""

    name = "recovery_planner"

    @abstractmethod
    def run(self, view: RoleView) -> Recovery:
        """Return the action that replaces the proposal; ``view.reasons`` say why."""


STANDARD_ROLES: dict[str, type[Role]] = {
    base.name: base
    for base in (
        Generator,
        SafetyMonitor,
        SecurityAssessor,
        FaultInjector,
        PerformanceOracle,
        RecoveryPlanner,
    )
}


_UNSCHEDULED = ("generator", "recovery_planner")
"""Roles with a place of their own in the tick: before and after the assessment."""

_SINGLE_ROLES = (Generator, FaultInjector, RecoveryPlanner)


def schedule(roles: Mapping[str, Role]) -> list[str]:
    """Order the assessing roles by ``after``; the same declarations give the same order.

    A standard role that is switched off may still be named in ``after``, and so may the Generator,
    which runs before all of them anyway.

    Raises:
        ConfigurationError: For an unknown name, and for a cycle.
    """
    names = [name for name in roles if name not in _UNSCHEDULED]
    graph: dict[str, list[str]] = {}
    for name in sorted(names, key=_standard_first):
        after = roles[name].after
        if isinstance(after, str):
            after = (after,)
        for other in after:
            if other not in roles and other not in STANDARD_ROLES:
                raise ConfigurationError(
                    f"role {name!r} runs after {other!r}, which is not a role here",
                    key=f"{name}.after",
                    found=other,
                    expected="one of " + ", ".join(sorted({*roles, *STANDARD_ROLES})),
                    remedy="correct the name, or add that role",
                )
            if other == "recovery_planner":
                raise ConfigurationError(
                    f"role {name!r} runs after 'recovery_planner', which acts on the assessment",
                    key=f"{name}.after",
                    remedy="assessing roles run before recovery; drop it from `after`",
                )
        graph[name] = [other for other in after if other in names]
    try:
        return list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise ConfigurationError(
            "the roles wait for each other in a circle",
            key="after",
            found=" -> ".join(error.args[1]),
            remedy="remove one of these `after` declarations",
        ) from None


def _standard_first(name: str) -> tuple[int, str]:
    order = list(STANDARD_ROLES)
    return (order.index(name) if name in order else len(order), name)


def check_kind(name: str, role: object) -> None:
    """Check that the class of a role fits its name.

    Raises:
        ConfigurationError: If a standard name has a role of another class, if a role that the loop
            has a single place for has another name, or if it is no role at all.
    """
    kind = STANDARD_ROLES.get(name, Role)
    misplaced = next((b for b in _SINGLE_ROLES if isinstance(role, b) and name != b.name), None)
    if isinstance(role, kind) and misplaced is None:
        return
    if misplaced is not None:
        raise ConfigurationError(
            f"a {misplaced.__name__} cannot be the role {name!r}: the loop has one place for it",
            key=name,
            found=type(role).__name__,
            expected=f"the name {misplaced.name!r}",
            remedy=f"put it under {misplaced.name!r}, or derive it from another base",
        )
    raise ConfigurationError(
        f"the role {name!r} must be a {kind.__name__}",
        key=name,
        found="nothing" if role is None else type(role).__name__,
        expected=f"a subclass of pytest_dura.{kind.__name__}",
        remedy=f"derive it from pytest_dura.{kind.__name__}",
    )
