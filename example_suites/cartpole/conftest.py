"""The suite's one scenario: balance for five seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cartpole_mutants  # noqa: F401 - registers the defects that --dura-qualify seeds
import pytest

from pytest_dura import Episode, EpisodeSpec, Orchestrator, Policy, RoleSpec, Termination

PARTS = "cartpole_parts"

SIMULATOR = RoleSpec(
    "pytest_dura.adapters.gymnasium:GymnasiumSimulator",
    {
        "env": "CartPole-v1",
        "time_step": 0.02,
        "time_step_attribute": "tau",
        "signals": f"{PARTS}:signals",
        "sensors": f"{PARTS}:sensors",
        "scene": f"{PARTS}:scene",
    },
)

SPEC = EpisodeSpec(
    case="cartpole/balance",
    run=0,
    seed=0,
    simulator=SIMULATOR,
    roles={
        "generator": RoleSpec(f"{PARTS}:Balancer"),
        "safety_monitor": RoleSpec(f"{PARTS}:AngleMonitor"),
        "fault_injector": RoleSpec(f"{PARTS}:StuckSensor"),
        "recovery_planner": RoleSpec(f"{PARTS}:CatchThePole"),
        "drift_watch": RoleSpec(f"{PARTS}:DriftWatch"),
    },
    scenario={"world": {"low": -0.05, "high": 0.05}},  # options of CartPole's reset
    termination=Termination(time_limit=5.0),
    time_step=0.02,
)

Run = Callable[..., Episode]


@pytest.fixture(scope="session")
def spec() -> EpisodeSpec:
    return SPEC


@pytest.fixture(scope="session")
def run() -> Run:
    def run_episode(seed: int = 0, policy: str = "recover", **changes: Any) -> Episode:
        roles = SPEC.roles | changes.pop("roles", {})
        kept = {name: role for name, role in roles.items() if role is not None}
        spec = replace(SPEC, seed=seed, policy=Policy.parse(policy), roles=kept, **changes)
        return Orchestrator.build(spec).run(spec)

    return run_episode
