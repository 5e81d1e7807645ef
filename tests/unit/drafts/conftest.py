"""What the tests of drafts share."""

from __future__ import annotations

import pytest

from pytest_dura.llm import session


@pytest.fixture(autouse=True)
def _no_session_stays():
    """What a test puts to use answers in no later test of the process."""
    before = session.use(None)
    yield
    session.use(before)
