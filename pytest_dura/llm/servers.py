"""Servers of models: what a session asks, and what it knows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.endpoint import MODEL, retries_of
from pytest_dura.llm.port import ONCE, Answer, Repeats, Request


@dataclass(frozen=True)
class ModelDescription:
    """Description of a model and its server, as plain data that holds no secret.

    Args:
        model: Name of the model.
        base_url: Of the server, without user, password and query.
        fingerprint: Digest that differs between servers and models.
        capabilities: See :class:`pytest_dura.llm.capabilities.Capabilities`.
        tool: Version of pytest-dura that probed the server.
        created: Time, in ISO 8601.
        about: Words on the model, of ``DURA_LLM_ABOUT``; may be empty.
    """

    model: str
    base_url: str
    fingerprint: str
    capabilities: Mapping[str, Any]
    tool: str
    created: str
    about: str = ""

    @property
    def spoken_of(self) -> str:
        """Words on the model, or else its name."""
        return self.about or self.model

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def latest_descriptions(known: Sequence[ModelDescription]) -> list[ModelDescription]:
    """The last description of each model, by name: the answers of that server came last."""
    by_name = {each.model: each for each in known}
    return [by_name[name] for name in sorted(by_name)]


def choose_description(
    known: Sequence[ModelDescription], model: str | None, usual: str | None, file: str
) -> ModelDescription:
    """The description of a model in a cassette.

    Of several descriptions the last one counts: the answers of that server came last.

    Args:
        known: All descriptions of the cassette, in their order.
        model: Name of the model; by default the only one there is, or the usual one.
        usual: The model of the environment.
        file: The cassette, for messages.

    Raises:
        ConfigurationError: If there is none, or it is not clear which.
    """
    names = sorted({description.model for description in known})
    name = model or (names[0] if len(names) == 1 else usual)
    descriptions = [description for description in known if description.model == name]
    if descriptions:
        return descriptions[-1]
    problem = f"the cassette knows no model {name!r}"
    if not names:
        problem = "the cassette knows no model at all"
    elif name is None:
        problem = "the cassette knows several models, and none of them is named"
    raise ConfigurationError(
        problem,
        file=file,
        key="--dura-cassette",
        found=name,
        expected=", ".join(names[:10]) or "a cassette that --dura-llm=record wrote",
        remedy="name another model, or record it with --dura-llm=record",
    )


_PROBE_BUDGET = 60.0
"""Seconds for each request of a probe; a server may load its model at the first one."""


class ModelServer(Protocol):
    """Server of one model."""

    model: str
    base_url: str
    """Without user, password and query."""

    def ask(self, request: Request, budget: float, repeats: Repeats = ONCE) -> Answer:
        """Make one call within so many seconds; a failure is an answer."""

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        """Probe its fingerprint, and its capabilities as plain data.

        Raises:
            ConfigurationError: If it cannot be used at all.
        """

    def scrub(self, text: str) -> str:
        """The text without the key."""


class Connect(Protocol):
    """Maker of connections to servers."""

    def __call__(self, environ: Mapping[str, str], model: str | None) -> ModelServer:
        """Connect to the server that an environment names.

        Args:
            environ: The environment.
            model: Of this model, instead of the environment's.

        Raises:
            ConfigurationError: If it names none.
        """


class OpenAiServer:
    """Server that speaks the API of OpenAI.

    Args:
        environ: Names it; see :class:`pytest_dura.llm.endpoint.Endpoint`.
        model: Of this model, instead of the environment's.

    Raises:
        ConfigurationError: If the environment names none, or the extra ``llm`` is not installed.
    """

    def __init__(self, environ: Mapping[str, str], model: str | None) -> None:
        from pytest_dura.llm.client import OpenAiClient
        from pytest_dura.llm.endpoint import Endpoint

        chosen = environ if model is None else {**environ, MODEL: model}
        self.endpoint = Endpoint.from_environment(chosen)
        self.model, self.base_url = self.endpoint.model, self.endpoint.public
        self.client = OpenAiClient(self.endpoint)
        self._retries = retries_of(environ)

    def ask(self, request: Request, budget: float, repeats: Repeats = ONCE) -> Answer:
        """See :class:`ModelServer`."""
        return self.client.ask(request, budget, repeats=repeats)

    def probe(self) -> tuple[str, Mapping[str, Any]]:
        """See :class:`ModelServer`."""
        from pytest_dura.llm.capabilities import probe

        capabilities = probe(self.client, self.endpoint, _PROBE_BUDGET, retries=self._retries)
        return capabilities.fingerprint, capabilities.to_json()

    def scrub(self, text: str) -> str:
        """See :class:`ModelServer`."""
        return self.endpoint.scrub(text)
