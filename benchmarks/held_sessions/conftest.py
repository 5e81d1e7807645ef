"""A metric of the project's own, and property tests that draw the same in each session."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest
from corridor import last

hypothesis.settings.register_profile(
    "held", derandomize=True, max_examples=4, deadline=None, database=None
)
hypothesis.settings.load_profile("held")


@pytest.fixture(scope="session")
def dura_metrics():
    return {"last": last}


@pytest.fixture
def fails_first(request):
    """Whether this test runs for the first time."""
    file = Path(f".ran-{request.node.originalname}-{os.environ['HELD']}")
    if file.exists():
        return False
    file.touch()
    return True
