"""The component under test: the small driver, with prompts of few words."""

from __future__ import annotations

import pytest

from pytest_dura import RoleSpec

PLANNER = RoleSpec(
    "pytest_dura.llm.driving.planner:LlmPlanner",
    {
        "templates": "templates",  # beside this file; run pytest in its folder
        "decide_every": 10,  # one decision per simulated second
        "history": 0,
        "samples": 2,
        # Not `reformatted`: it was taught these templates' two wordings, and no other format.
        "beside": ("reordered", "paraphrased", "neutral", "injected", "unhardened", "conflict"),
        "beside_every": 10,
    },
)


@pytest.fixture(scope="session")
def generator() -> RoleSpec:
    return PLANNER
