"""Fixtures of servers for a conftest to import: a null model's and a scripted one."""

from __future__ import annotations

import os

import null_model
import pytest
import scripted_server as scripted

from pytest_dura.llm import Endpoint, OpenAiClient

KEY = "sk-0123456789abcdef"
"""Of the clients that the fixture `client` makes."""


@pytest.fixture(scope="session")
def null_server(tmp_path_factory):
    """The null model's server (:class:`null_model.NullServer`), once per session and worker.

    Skips where the wheels are missing, or fails with ``DURA_REQUIRE_LLM=1``, as in CI.
    """
    require_null_model()
    with null_model.null_model_server(tmp_path_factory.mktemp("null-model")) as server:
        yield server


def require_null_model(reason=None):
    """Skips, or fails where it is required, when the null model's server cannot run here."""
    reason = reason or null_model.missing()
    if reason and os.environ.get("DURA_REQUIRE_LLM") == "1":
        pytest.fail(f"DURA_REQUIRE_LLM=1, but {reason}")
    if reason:
        pytest.skip(reason)


@pytest.fixture
def client(scripted_server):
    """``client(*behaviours)`` is a client of a new server, which stands in ``client.server``."""

    def start(*behaviours, **options):
        server = scripted_server(*behaviours, **options)
        found = OpenAiClient(Endpoint(server.base_url, "m1", KEY))
        found.server = server
        return found

    return start


@pytest.fixture
def scripted_server():
    """``scripted_server(*behaviours, otherwise=...)`` starts a server, until the test ends."""
    started = []

    def start(*behaviours, **options):
        started.append(scripted.ScriptedServer(*behaviours, **options))
        return started[-1]

    yield start
    for server in started:
        server.close()
    assert [server.unscripted for server in started if server.unscripted] == []
