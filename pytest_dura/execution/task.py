"""EpisodeTask: an episode to be simulated, and whether another process can simulate it."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pytest_dura import guests
from pytest_dura.core.boundary import Boundary, SessionWanted
from pytest_dura.core.calls import current_calls
from pytest_dura.core.codec import decode, encode
from pytest_dura.core.collector import rare_collections
from pytest_dura.core.episode import LOST, RECORDED, Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.simulator_process import simulating
from pytest_dura.core.state import Event
from pytest_dura.core.time_limits import ROLE_TIMEOUT
from pytest_dura.execution.replies import ProcessLostError
from pytest_dura.library.roles import LocalRole, local_object, local_role
from pytest_dura.library.scenario import simulator_class
from pytest_dura.requirements.checks import RequirementJudge, load_function
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_by_check
from pytest_dura.requirements.judgements import RECOVERY_ROLE
from pytest_dura.requirements.model import Requirement


def reason_not_portable(task: EpisodeTask, *, to_copy: bool = False) -> str | None:
    """Reason why no other process can simulate an episode; ``None`` if one can.

    Args:
        task: Its task.
        to_copy: Whether the other process is a copy of this one, which knows its classes.
    """
    if reason := reason_to_stay(task):
        return reason
    for name, part in () if to_copy else task.parts.items():
        if isinstance(part, LocalRole) and is_named(part.target):
            return f"the class of its {name} is in a conftest.py"
        if isinstance(part, LocalRole) or part.path.partition(":")[0] in _PRIVATE:
            return f"no import path leads to the class of its {name}"
    for name, part in task.parts.items():
        if not _is_plain(part.params):
            return f"the parameters of its {name} are no plain data"
    for name, metric in task.metrics.items():
        if not _is_importable(metric):
            return f"no import path leads to the metric {name}"
    return None


def reason_to_stay(task: EpisodeTask) -> str | None:
    """Reason why an episode is simulated in the session's own process, if it has to be.

    A component stays where a guest counts or records what it does, a simulator of which one exists
    in one process, and a bare instance where the test sees it.
    """
    for name, part in task.parts.items():
        if part.opaque:
            return f"its {name} is a bare instance"
        if reason := guests.reason_to_stay(part):
            return f"its {name} {reason}"
    return None if task.single is None else f"one instance of its {task.single} exists"


def draws_reason(spec: EpisodeSpec) -> str:
    """Name what declares that equal seeds may give other episodes; empty if nothing does.

    Raises:
        ConfigurationError: If the class of the simulator or of the component cannot be imported.
    """
    if spec.clock.not_repeatable:
        return spec.clock.not_repeatable
    parts = {"component": spec.roles.get("generator"), "simulator": spec.simulator}
    for kind, part in parts.items():
        if part is None:
            continue
        declaring = part.resolve() if part.instance is None else part.instance
        if not getattr(declaring, "repeatable", True):
            return f"the {kind} {part.label} declares repeatable = False"
    return guests.reason_to_differ(spec.roles.values())


def is_named(function: Callable[..., Any]) -> bool:
    """Whether a function or class stands at the top of its module, and closes over nothing."""
    name = getattr(function, "__qualname__", "<")
    is_plain = inspect.isclass(function) or inspect.isfunction(function)
    return is_plain and "<" not in name and getattr(function, "__closure__", None) is None


def _is_importable(function: Callable[..., Any]) -> bool:
    """Whether an import path leads to it, in any process."""
    if not is_named(function) or function.__module__ in _PRIVATE:
        return False
    try:
        return RoleSpec.of(function).resolve() is function
    except Exception:  # importing runs the user's code: whatever it raises, it is not importable
        return False


def _is_plain(params: Mapping[str, Any]) -> bool:
    """Whether they are the same once they have been JSON: a tuple would come back as a list."""
    try:
        return bool(json.loads(json.dumps(dict(params))) == dict(params))
    except (TypeError, ValueError, RecursionError):
        return False


def is_same_elsewhere(check: str) -> bool:
    """Whether a function that checks is the same in another process that imports the same files.

    This process imports it as well: it knows the secrets that a module puts into the environment.
    """
    try:
        function = load_function(check)
    except ConfigurationError:  # raised again where a verdict is asked for
        return False
    modules = check.strip().partition(":")[0], getattr(function, "__module__", None)
    return not set(modules) & set(_PRIVATE)


_PRIVATE = ("conftest", "__main__")
"""Modules that are others in another process."""
Metrics = Mapping[str, Callable[[Episode], float]]
Data = dict[str, Any]


@dataclass(frozen=True)
class EpisodeTask:
    """One episode to be simulated.

    Args:
        spec: What it is run from.
        judging: The requirements that may end it before its time; empty where none may.
        metrics: User-defined metrics by name.
        recorded: Whether to keep what a viewer shows of it.
        again: Number of the repetition, of an episode that is compared with itself.
        role_timeout: Seconds for one call into a role or the simulator; see :class:`Orchestrator`.
            No part of an episode's address: one that it ends is missing, and not taken over.
        checks: What the requirements of its case check, which is judged where it is simulated.
        with_recovery: Of a run without recovery: the task of the same run with it.
        beside: Worlds of the runs that a search asks for at once, its own among them, where the
            simulator may simulate them together. No part of an episode's address: it is the same.
    """

    spec: EpisodeSpec
    judging: tuple[Requirement, ...] = ()
    metrics: Metrics = field(default=NOTHING, compare=False)
    recorded: bool = False
    again: int = 0
    role_timeout: float | None = field(default=ROLE_TIMEOUT, compare=False)
    checks: tuple[str, ...] = field(default=(), compare=False)
    with_recovery: EpisodeTask | None = field(default=None, compare=False)
    beside: tuple[Mapping[str, Any], ...] = field(default=(), compare=False)

    def run(self) -> JudgedEpisode:
        """Simulate the episode in this process, and judge it by the checks.

        A check that cannot be judged is left to the test that asks for its verdict: it may be one
        that another process can import.

        Raises:
            ConfigurationError: If a part cannot be built.
        """
        judge = RequirementJudge(self.judging) if self.judging else None
        if self.beside:
            simulator_class(self.spec.simulator).announce(self.beside)
        simulated = run_episode(
            self.spec,
            judge,
            self.metrics,
            recorded=self.recorded,
            role_timeout=self.role_timeout,
        )
        episode = JudgedEpisode.of(simulated)
        for check in self.checks:
            with suppress(ConfigurationError), current_calls().calling(f"check {check}"):
                judge_by_check(check, episode)
        return episode

    def repeated(self) -> EpisodeTask:
        """The next repetition, to be compared with the first; its verdicts do not count."""
        return replace(self, again=self.again + 1, checks=(), with_recovery=None, beside=())

    def unaided(self, first: JudgedEpisode) -> JudgedEpisode | None:
        """The episode of a run without recovery, if recovery was not asked in the one with it.

        Both are the same run then, which is not simulated twice. Whatever may differ between two
        runs of equal specs is left to a simulation.

        Args:
            first: The episode of :attr:`with_recovery`.
        """
        if first.failure is not None or first.termination in (LOST, RECORDED) or first.timeouts:
            return None
        if first.flagged or first.decisions["attempts"].any():
            return None
        if self.metrics or not self.portable_to_copy or draws_reason(self.spec):
            return None
        roles = {name: role for name, role in first.spec.roles.items() if name != RECOVERY_ROLE}
        case, policy = self.spec.case, self.spec.policy  # a policy is for refused proposals
        if replace(first.spec, roles=roles, case=case, policy=policy) != self.spec:
            return None
        episode = JudgedEpisode.of(replace(first, spec=self.spec))
        episode.check_verdicts.update(first.check_verdicts)
        return episode

    @property
    def parts(self) -> dict[str, RoleSpec]:
        """The simulator and the roles, by name."""
        return {"simulator": self.spec.simulator, **dict(sorted(self.spec.roles.items()))}

    @cached_property
    def local(self) -> tuple[Any, ...]:
        """Objects that exist in this process only: bare instances, classes of a function."""
        # A name leads to a class at the top of a conftest.
        parts = [
            part
            for part in self.parts.values()
            if not (isinstance(part, LocalRole) and is_named(part.target))
        ]
        targets = (target for part in parts if (target := local_object(part)) is not None)
        return (*targets, *(metric for metric in self.metrics.values() if not is_named(metric)))

    @cached_property
    def waits(self) -> bool:
        """Whether a role stays for what a guest says, and waits for others most of the time."""
        return any(guests.reason_to_stay(role) for role in self.spec.roles.values())

    @cached_property
    def single(self) -> str | None:
        """Which part one instance exists of, so that one process must simulate."""
        parts = {"simulator": self.spec.simulator, "component": self.spec.roles.get("generator")}
        for name, part in parts.items():
            if part is None:
                continue
            try:
                factory = simulator_class(part)
            except ConfigurationError:  # it is refused where it is built
                continue
            if getattr(factory, "instances", "many") == "one":
                return name
        return None

    @cached_property
    def portable(self) -> bool:
        """Whether plain data holds all of it, so that another process can simulate it."""
        return reason_not_portable(self) is None

    @cached_property
    def portable_to_copy(self) -> bool:
        """Whether a process can that has the classes of this one."""
        return self.portable or reason_not_portable(self, to_copy=True) is None

    @cached_property
    def stays(self) -> bool:
        """Whether the session's own process simulates it, see :func:`reason_to_stay`."""
        return reason_to_stay(self) is not None

    def to_json(self) -> Data:
        """Plain data of a portable task, from which :meth:`from_json` makes an equal one."""
        paths = {
            name: f"{metric.__module__}:{metric.__qualname__}"
            for name, metric in self.metrics.items()
        }
        return {
            "spec": self.spec.to_json(),
            "judging": encode(self.judging),
            "metrics": paths,
            "recorded": self.recorded,
            "again": self.again,
            "role_timeout": self.role_timeout,
            "checks": list(self.checks),
            "beside": list(self.beside),
            "local": {
                name: id(part.target)
                for name, part in self.parts.items()
                if isinstance(part, LocalRole)
            },
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EpisodeTask:
        """The inverse of :meth:`to_json`.

        Raises:
            ConfigurationError: If a metric cannot be imported here.
            SessionWanted: If a class is younger than this copy of the session's process.
        """
        spec = EpisodeSpec.from_json(data["spec"])
        parts = {"simulator": spec.simulator, **spec.roles}
        for name, identity in data["local"].items():
            known = local_role(parts[name], identity)
            if known is None:
                raise SessionWanted(f"the class of its {name} is younger than this process")
            parts[name] = known
        simulator = parts.pop("simulator")
        return cls(
            replace(spec, simulator=simulator, roles=parts),
            decode(tuple[Requirement, ...], data["judging"]),
            {name: RoleSpec(path).resolve() for name, path in data["metrics"].items()},
            data["recorded"],
            data["again"],
            data["role_timeout"],
            tuple(data["checks"]),
            beside=tuple(data["beside"]),
        )


def run_episode(
    spec: EpisodeSpec,
    judge: RequirementJudge | None = None,
    metrics: Metrics = NOTHING,
    *,
    recorded: bool = False,
    role_timeout: float | None = ROLE_TIMEOUT,
) -> Episode:
    """Run the episode of a spec: the same spec gives the same trace, on any machine, in any order.

    Args:
        spec: What determines it.
        judge: What ends it at a violation, or once all is decided, where the spec says so.
        metrics: User-defined metrics by name.
        recorded: Whether to keep what a viewer shows of it.
        role_timeout: Seconds for one call into a role or the simulator; see :class:`Orchestrator`.

    Raises:
        ConfigurationError: If a part cannot be built.
    """
    # What an episode leaves is gone before Python looks for cycles as often as usual again.
    with Boundary(), simulating(simulator_class(spec.simulator)), rare_collections():
        orchestrator = Orchestrator.build(
            spec, judge, metrics, recorded=recorded, role_timeout=role_timeout
        )
        try:
            episode = orchestrator.run(spec)
        except BaseException:  # also on ctrl-C; it is raised again
            if not spec.simulator.opaque:
                orchestrator.simulator.close()
            raise
        if not spec.simulator.opaque:
            orchestrator.close(episode)
        del orchestrator
        return episode


class UpcomingTasks:
    """Tasks step by step; each is made once, when the iteration first gets there.

    Args:
        steps: How many steps there are.
        make: The tasks of a step, counted from 0.
    """

    def __init__(self, steps: int, make: Callable[[int], Sequence[EpisodeTask]]) -> None:
        self._steps, self._make = steps, make
        self._tasks: dict[int, Sequence[EpisodeTask]] = {}
        self._at = 0

    def reach(self, step: int) -> None:
        """Begin with this step from now on."""
        for passed in range(self._at, step):
            self._tasks.pop(passed, None)
        self._at = step

    def __iter__(self) -> Iterator[EpisodeTask]:
        """The tasks from the present step on."""
        for step in range(self._at, self._steps):
            if step not in self._tasks:
                self._tasks[step] = self._make(step)
            yield from self._tasks[step]


def lost_episode(spec: EpisodeSpec, error: ProcessLostError) -> JudgedEpisode:
    """Make the episode of a process that ended in the middle: all that is known of it.

    It is open for every requirement where the component was being called, and missing otherwise.

    Args:
        spec: What it was run from.
        error: How the process ended.
    """
    death = error.death
    if death is None or not death.is_of_component:
        return missing_episode(spec, str(error))
    detail = f"its process {death.how}"
    event = Event(
        death.tick, death.tick * spec.time_step, "component_failure", spec.component, detail
    )
    return _without_ticks(spec, event, LOST)


def missing_episode(spec: EpisodeSpec, cause: str) -> JudgedEpisode:
    """Make an episode without a single tick, whose validity is missing.

    Args:
        spec: What it would have been run from.
        cause: Why it was not run.
    """
    event = Event(0, 0.0, "infrastructure", "process", cause)
    return _without_ticks(spec, event, "infrastructure", f"infrastructure: {cause}")


def _without_ticks(
    spec: EpisodeSpec, event: Event, termination: str, failure: str | None = None
) -> JudgedEpisode:
    faults = tuple(map(FaultRecord.of, spec.faults))
    episode = Episode(
        spec=spec,
        time=np.zeros(0),
        signals={},
        decisions={
            "verdict": np.zeros(0, np.int8),
            "source": np.zeros(0, "<U1"),
            "proposed": np.zeros(0, "<U1"),
            "executed": np.zeros(0, "<U1"),
            "attempts": np.zeros(0, np.int16),
        },
        events=(event,),
        faults=faults,
        termination=termination,
        metrics=DependabilityMetrics(faults={fault.id: fault for fault in faults}),
        failure=failure,
    )
    return JudgedEpisode.of(episode)
