"""Server: the server of the environment, behind the little that a session needs of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from pytest_dura.llm.port import Answer, Request

PROBE_BUDGET = 60.0
"""Seconds for each request of a probe; a server may load its model at the first one."""


class Server(Protocol):
    """A server, and one model of it."""

    model: str
    base_url: str
    """Without user, password and query."""

    def ask(self, request: Request, budget: float) -> Answer:
        """One call within so many seconds; a failure is an answer."""

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        """Its fingerprint, and what it can do as plain data.

        Raises:
            ConfigurationError: If it cannot be used at all.
        """

    def scrub(self, text: str) -> str:
        """The text without the key."""


class Connect(Protocol):
    """How a server is found."""

    def __call__(self, environ: Mapping[str, str], model: str | None) -> Server:
        """The server that an environment names.

        Args:
            environ: The environment.
            model: Of this model, instead of the environment's.

        Raises:
            ConfigurationError: If it names none.
        """


PROBING = 60.0
"""Seconds for each request of the probe: a server may load its model at the first one."""


class OpenAiServer:
    """A server that speaks the API of OpenAI.

    Args:
        environ: Names it; see :class:`pytest_dura.llm.endpoint.Endpoint`.
        model: Of this model, instead of the environment's.

    Raises:
        ConfigurationError: If the environment names none, or the extra ``llm`` is not installed.
    """

    def __init__(self, environ: Mapping[str, str], model: str | None) -> None:
        from pytest_dura.llm.client import OpenAiClient
        from pytest_dura.llm.endpoint import MODEL, Endpoint

        chosen = environ if model is None else {**environ, MODEL: model}
        self.endpoint = Endpoint.from_environment(chosen)
        self.model, self.base_url = self.endpoint.model, self.endpoint.public
        self.client = OpenAiClient(self.endpoint)

    def ask(self, request: Request, budget: float) -> Answer:
        """See :class:`Server`."""
        return self.client.ask(request, budget)

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        """See :class:`Server`."""
        from pytest_dura.llm.capabilities.probe import probe

        found = probe(self.client, self.endpoint, PROBING).to_json()
        return str(found["fingerprint"]), found

    def scrub(self, text: str) -> str:
        """See :class:`Server`."""
        return self.endpoint.scrub(text)


def connect(environ: Mapping[str, str], model: str | None) -> Server:
    """The server that the environment names; see :class:`Connect`."""
    return OpenAiServer(environ, model)
