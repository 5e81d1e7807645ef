"""EpisodeTask: one episode to be had, with all that its result depends on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from pytest_dura.campaign.components import LocalRole, local_object
from pytest_dura.campaign.episodes.portability import is_named, why_here
from pytest_dura.core.boundary import Boundary
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.state import NOTHING
from pytest_dura.core.watchdog import ROLE_TIMEOUT
from pytest_dura.requirements.judge import RequirementJudge
from pytest_dura.requirements.model import Requirement

Metrics = Mapping[str, Callable[[Episode], float]]
Data = dict[str, Any]


@dataclass(frozen=True)
class EpisodeTask:
    """One episode to be had.

    Args:
        spec: What it is run from.
        judging: The requirements that may end it before its time; empty where none may.
        metrics: User-defined metrics by name.
        recorded: Whether to keep what a viewer shows of it.
        again: Number of the repetition, of an episode that is compared with itself.
        role_timeout: Seconds for one call into a role or the simulator; see :class:`Orchestrator`.
            No part of an episode's address: one that it ends is missing, and not taken over.
    """

    spec: EpisodeSpec
    judging: tuple[Requirement, ...] = ()
    metrics: Metrics = field(default=NOTHING, compare=False)
    recorded: bool = False
    again: int = 0
    role_timeout: float | None = field(default=ROLE_TIMEOUT, compare=False)

    def run(self) -> Episode:
        """The episode, simulated here and now.

        Raises:
            ConfigurationError: If a part cannot be built.
        """
        judge = RequirementJudge(self.judging) if self.judging else None
        return run_episode(
            self.spec,
            judge,
            self.metrics,
            recorded=self.recorded,
            role_timeout=self.role_timeout,
        )

    def repeated(self) -> EpisodeTask:
        """The same once more, to be compared with the first."""
        return replace(self, again=self.again + 1)

    @property
    def parts(self) -> dict[str, RoleSpec]:
        """The simulator and the roles, by name."""
        return {"simulator": self.spec.simulator, **dict(sorted(self.spec.roles.items()))}

    @cached_property
    def local(self) -> tuple[Any, ...]:
        """What gives it a meaning in this process only: bare instances, classes of a function."""
        found = [one for part in self.parts.values() if (one := _unnamed(part)) is not None]
        return (*found, *(one for one in self.metrics.values() if not is_named(one)))

    @cached_property
    def portable(self) -> bool:
        """Whether plain data says all, so that another process can simulate it."""
        return why_here(self) is None

    def to_json(self) -> Data:
        """Plain data of a portable task, from which :meth:`from_json` makes an equal one."""
        paths = {name: f"{one.__module__}:{one.__qualname__}" for name, one in self.metrics.items()}
        return {
            "spec": self.spec.to_json(),
            "judging": [one.to_json() for one in self.judging],
            "metrics": paths,
            "recorded": self.recorded,
            "again": self.again,
            "role_timeout": self.role_timeout,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EpisodeTask:
        """The inverse of :meth:`to_json`.

        Raises:
            ConfigurationError: If a metric cannot be imported here.
        """
        return cls(
            EpisodeSpec.from_json(data["spec"]),
            tuple(Requirement.from_json(one) for one in data["judging"]),
            {name: RoleSpec(path).resolve() for name, path in data["metrics"].items()},
            data["recorded"],
            data["again"],
            data["role_timeout"],
        )


def run_episode(
    spec: EpisodeSpec,
    judge: RequirementJudge | None = None,
    metrics: Metrics = NOTHING,
    *,
    recorded: bool = False,
    role_timeout: float | None = ROLE_TIMEOUT,
) -> Episode:
    """The episode of a spec: the same spec gives the same trace, on any machine, in any order.

    Args:
        spec: What determines it.
        judge: What ends it at a violation, or once all is decided, where the spec says so.
        metrics: User-defined metrics by name.
        recorded: Whether to keep what a viewer shows of it.
        role_timeout: Seconds for one call into a role or the simulator; see :class:`Orchestrator`.

    Raises:
        ConfigurationError: If a part cannot be built.
    """
    with Boundary():
        orchestrator = Orchestrator.build(
            spec, judge, metrics, recorded=recorded, role_timeout=role_timeout
        )
        try:
            episode = orchestrator.run(spec)
        except BaseException:  # also on ctrl-C; it is raised again
            if not spec.simulator.opaque:
                orchestrator.simulator.close()
            raise
        return episode if spec.simulator.opaque else orchestrator.close(episode)


def _unnamed(part: RoleSpec) -> Any:
    """What makes a part mean something here only; a class at the top of a conftest does not."""
    found = local_object(part)
    named = isinstance(part, LocalRole) and is_named(part.target)
    return None if named else found
