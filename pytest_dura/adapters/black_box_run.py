"""Run of a black box as a simulator, and what stands for its component in the loop."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.component import plain_copy
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ActionError, ConfigurationError
from pytest_dura.core.metrics import DependabilityMetrics
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Generator
from pytest_dura.core.simulator import Recording, Simulator
from pytest_dura.core.state import GeneratorView, Proposal, Tick

Floats: TypeAlias = NDArray[np.float64]
PLAYED = "next sample"
"""The only action: a black box is not steered while it runs."""


class Box(Protocol):
    """What a run needs of a black box."""

    @property
    def is_log(self) -> bool:
        """Whether it is a recorded log."""

    def columns(self, world: Mapping[str, Any], time: Floats) -> dict[str, Floats]:
        """Simulate one run."""


@dataclass
class BlackBoxRun(Simulator):
    """Simulates all of an episode when it begins, and returns it sample by sample."""

    box: Box
    _columns: dict[str, Floats] = field(default_factory=dict)
    _index: int = 0

    def recorded_episode(self, spec: EpisodeSpec) -> Episode | None:
        """Make the whole episode at once, where nothing looks at it before it is over.

        It is the one that the loop makes, to the last bit: without other roles and faults each
        decision is the only action. The time that these take is not measured.
        """
        end = spec.termination
        last = end.last_index(spec.time_step)
        steps = last if end.iterations is None else min(last, end.iterations)
        if not _is_alone(spec):
            return None
        self.set_time_step(spec.time_step)
        self.reset(plain_copy(spec.scenario), spec.seed)
        if steps >= len(next(iter(self._columns.values()))):
            return None  # the loop says where the run is over
        empty = ("",) * steps
        return Episode(
            spec=spec,
            time=np.arange(steps + 1, dtype=np.float64) * self.time_step,
            signals={name: column[: steps + 1].copy() for name, column in self._columns.items()},
            decisions={
                "verdict": np.zeros(steps, np.int8),
                "source": np.full(steps, "proposal"),
                "proposed": np.full(steps, PLAYED),
                "executed": np.full(steps, PLAYED),
                "attempts": np.zeros(steps, np.int16),
            },
            events=(),
            faults=(),
            termination="time" if steps == last else "iterations",
            metrics=DependabilityMetrics(proposals=steps, valid_proposals=steps),
            recording=Recording(empty, empty, empty),
        )

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - nothing is drawn
        """Simulate the run."""
        duration = scenario.get("duration")
        if duration is None:
            raise ConfigurationError(
                "a black box needs to know how long it runs",
                key="duration",
                found="a scenario without a duration",
                expected="seconds",
            )
        if self.box.is_log and scenario.get("iterations") is not None:
            # A log is held against what is judged of it.
            duration = min(duration, scenario["iterations"] * self.time_step)
        last = math.ceil(duration / self.time_step * (1.0 - 1e-9))
        time = np.arange(last + 1) * self.time_step
        self._columns = self.box.columns(scenario.get("world") or {}, time)
        self._index = 0
        return self._tick()

    def step(self, action: Any) -> Tick:  # noqa: ARG002 - its inputs are the scenario's
        """Return the next sample."""
        self._index += 1
        return self._tick()

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Floats]:
        """Return inputs and signals."""
        return {name: column[: len(ticks)].copy() for name, column in self._columns.items()}

    def check_action(self, action: Any) -> Any:
        """Refuse actions of a component: its inputs come from the scenario.

        Raises:
            ActionError: For any other action than that of the component that it brings.
        """
        if action != PLAYED:
            raise ActionError("a black box takes no action: its inputs are those of the scenario")
        return action

    def fallback_action(self) -> str:
        """Return the only action."""
        return PLAYED

    def snapshot(self) -> object:
        """Return the place within the run, which does not change any more."""
        return self._columns, self._index

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot."""
        self._columns, self._index = snapshot

    def _tick(self) -> Tick:
        if self._index >= len(next(iter(self._columns.values()))):
            raise ValueError("the run of the black box is over")
        values = {name: float(column[self._index]) for name, column in self._columns.items()}
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth=MappingProxyType(values),
            channels=NOTHING,
        )


class Playback(Generator):
    """Stands for the black box in the loop, which has already run."""

    def propose(self, view: GeneratorView) -> Proposal:  # noqa: ARG002 - nothing is decided
        """Go on to the next sample."""
        return Proposal(PLAYED, "")


def _is_alone(spec: EpisodeSpec) -> bool:
    """Whether the loop of this episode has the black box alone, and cannot end early.

    The usual injector of faults is in each loop; without faults it is not run.
    """
    # A module that makes a black box runs no episode, and need not import this.
    from pytest_dura.faults.injector import CampaignInjector

    component, end = spec.roles.get("generator"), spec.termination
    others = {name: role for name, role in spec.roles.items() if name != "generator"}
    return (
        component is not None
        and component.path == spec.simulator.path
        and component.params.get("component") is True
        and others in ({}, {"fault_injector": RoleSpec.of(CampaignInjector)})
        and not (spec.faults or spec.timeouts or spec.clock.is_timed)
        and not (end.violation or end.decided)
    )
