"""Which channels a component reads: what it does not read, no fault can reach it through."""

from __future__ import annotations

from collections.abc import Mapping

from pytest_dura.core import Orchestrator, RoleContext, RoleSpec, StateManager
from pytest_dura.library import expand_cases, load_library


def channels_read(scenario: str, generator: RoleSpec, seed: int) -> set[str]:
    """The channels that the component reads in a scenario's first run without faults.

    A fresh component is shown the percepts of that run once more, and its view notes what it reads.
    """
    roles: Mapping[str, RoleSpec] = {"generator": generator}
    (case,) = expand_cases([load_library([]).scenarios[scenario]], ["none"])
    spec = case.spec(0, seed, roles)
    orchestrator = Orchestrator.build(spec)
    orchestrator.run(spec)
    component = generator.create()
    component.reset(RoleContext(0, spec.time_step, spec.scenario))
    again, read = StateManager(spec.time_step), set()
    for tick, percept in zip(orchestrator.state.ticks, orchestrator.state.percepts, strict=True):
        again.update(tick, percept)
        component.propose(again.generator_view())
        read |= again.generator_reads
    return read


def can_reach(target: str, read: set[str]) -> bool:
    """Whether a fault at this target can manifest: commands always can."""
    channel = target.partition(".")[0]
    return channel == "command" or channel in read
