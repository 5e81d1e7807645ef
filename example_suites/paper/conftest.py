"""The paper's roles: a language model plans, and an emergency brake is the recovery."""

from __future__ import annotations

import pytest

from pytest_dura import RoleSpec

PLANNER = RoleSpec(
    "pytest_dura.llm.driving.planner:LlmPlanner",
    {
        "templates": "prompts",  # beside this file; run pytest in its folder
        "decide_every": 10,  # one decision per simulated second
        "history": 0,
        "samples": 1,
        "beside": (),
    },
)


@pytest.fixture(scope="session")
def generator() -> RoleSpec:
    return PLANNER


@pytest.fixture(scope="session")
def recovery_planner() -> str:
    return "emergency_brake"
