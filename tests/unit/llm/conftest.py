"""What the tests of language models share."""

from __future__ import annotations

import pytest
from llm_servers import client, null_server, scripted_server

from pytest_dura.llm import session

__all__ = ["client", "null_server", "scripted_server"]


@pytest.fixture(autouse=True)
def _no_session_stays():
    """What a test puts to use answers in no later test of the process."""
    before = session.use(None)
    yield
    session.use(before)
