"""The component under test: the language model that two environment variables name."""

from __future__ import annotations

import pytest

from pytest_dura import RoleSpec

PLANNER = RoleSpec(
    "pytest_dura.llm.driving.planner:LlmPlanner",
    {
        "decide_every": 10,  # one decision per simulated second
        "samples": 3,  # each of those that are looked at closely is asked for three times
        "beside": "all",  # twins of its prompt, the injected text and the negative control
        "beside_every": 5,
        "fallback": "wait",
    },
)


@pytest.fixture(scope="session")
def generator() -> RoleSpec:
    return PLANNER
