"""ModelSession: who answers what a session asks of language models: a server, or a cassette."""

from __future__ import annotations

import os
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import version
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Literal, Protocol

from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    ConfigurationError,
    report_environment_error,
)
from pytest_dura.llm.cassette import Cassette, Exchange
from pytest_dura.llm.cassette_miss import CassetteMissError, explain_miss
from pytest_dura.llm.endpoint import model_about
from pytest_dura.llm.port import Answer, Delivery, Request, ServerFault

if TYPE_CHECKING:
    from pytest_dura.llm.client import OpenAiClient


def _scrub_request(request: Request, scrub: Callable[[str], str]) -> Request:
    """The request as it may be sent: the very same unless a text holds the server's key."""
    messages = tuple(replace(message, text=scrub(message.text)) for message in request.messages)
    return request if messages == request.messages else replace(request, messages=messages)


def _inject_fault(request: Request, limit: float, fault: ServerFault) -> Answer:
    """How a request fails at a server that has this fault. No server is asked or needed.

    Args:
        request: What is asked.
        limit: Seconds for the answer.
        fault: How the server fails.

    Raises:
        ConfigurationError: If the extra ``llm`` is not installed.
    """
    # In live and in replay alike: what it says must not depend on which server there is.
    return replace(_offline_client().ask(request, limit, fault), seconds=0.0)


def _deliver(answer: Answer, delay: float, limit: float) -> Answer:
    """The answer as it arrives: later by the delay, and not at all beyond the limit.

    Args:
        answer: What came back.
        delay: Seconds that it takes longer.
        limit: Seconds for the answer.
    """
    seconds = answer.seconds + delay
    if seconds <= limit and delay < limit:
        return answer if delay == 0.0 else replace(answer, seconds=seconds)
    if answer.failure == "timeout":
        return replace(answer, seconds=limit)
    return Answer(failure="timeout", detail=f"no answer within {limit:g} s", seconds=limit)


@cache
def _offline_client() -> OpenAiClient:
    from pytest_dura.llm.client import OpenAiClient
    from pytest_dura.llm.endpoint import Endpoint

    return OpenAiClient(Endpoint("http://127.0.0.1/v1", "none"))


@dataclass(frozen=True)
class ModelDescription:
    """A model and the server behind it, as plain data that holds no secret.

    Args:
        model: Name of the model.
        base_url: Of the server, without user, password and query.
        fingerprint: What tells this server and model from others.
        capabilities: What the server can do, as the probe found it.
        tool: Version of pytest-dura that asked.
        created: When, in ISO 8601.
        about: What the model is, in the words of who named it; empty if nobody says.
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
        """What the model is in words, or else its name."""
        return self.about or self.model

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def _latest_descriptions(known: Sequence[ModelDescription]) -> list[ModelDescription]:
    """The last description of each model, by name: the answers of that server came last."""
    by_name = {each.model: each for each in known}
    return [by_name[name] for name in sorted(by_name)]


def _choose_description(
    known: Sequence[ModelDescription], model: str | None, usual: str | None, file: str
) -> ModelDescription:
    """The description of a model in a cassette.

    Of several descriptions the last one counts: the answers of that server came last.

    Args:
        known: All that the cassette holds, in their order.
        model: Which one is wanted; if nobody says, the only one there is, or the usual one.
        usual: What the environment names.
        file: The cassette, for messages.

    Raises:
        ConfigurationError: If there is none, or it is not clear which.
    """
    names = sorted({description.model for description in known})
    wanted = model or (names[0] if len(names) == 1 else usual)
    descriptions = [description for description in known if description.model == wanted]
    if descriptions:
        return descriptions[-1]
    problem = f"the cassette knows no model {wanted!r}"
    if not names:
        problem = "the cassette knows no model at all"
    elif wanted is None:
        problem = "the cassette knows several models, and none of them is named"
    raise ConfigurationError(
        problem,
        file=file,
        key="--dura-cassette",
        found=wanted,
        expected=", ".join(names[:10]) or "a cassette that --dura-llm=record wrote",
        remedy="name another model, or record it with --dura-llm=record",
    )


_PROBE_BUDGET = 60.0
"""Seconds for each request of a probe; a server may load its model at the first one."""


class ModelServer(Protocol):
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

    def __call__(self, environ: Mapping[str, str], model: str | None) -> ModelServer:
        """The server that an environment names.

        Args:
            environ: The environment.
            model: Of this model, instead of the environment's.

        Raises:
            ConfigurationError: If it names none.
        """


_PROBING = 60.0
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
        from pytest_dura.llm.capabilities import probe

        found = probe(self.client, self.endpoint, _PROBING).to_json()
        return str(found["fingerprint"]), found

    def scrub(self, text: str) -> str:
        """See :class:`Server`."""
        return self.endpoint.scrub(text)


def connect(environ: Mapping[str, str], model: str | None) -> ModelServer:
    """The server that the environment names; see :class:`Connect`."""
    return OpenAiServer(environ, model)


Mode = Literal["live", "record", "replay"]
Scrub = Callable[[Any], Any]

_WITHOUT_LIMIT = 600.0
"""Seconds for an answer where nobody says how long it may take."""


def _unchanged(value: Any) -> Any:
    return value


class ModelSession:
    """What asks, records or replays.

    In mode ``live`` the server of the environment is asked each time. In mode ``record`` an equal
    request is asked once: what the cassette has answers it, so that paired runs and reruns see the
    same. In mode ``replay`` nothing but the cassette answers: no environment is needed, and no
    connection is made.

    Args:
        mode: One of the three.
        cassette: The file, for the last two.
        environ: Names the server; by default the process's environment, when it is first needed.
        session: Id that all processes of one pytest session share: what one of them found out of
            a server holds for the others, and for no later session.
        scrub: Takes secrets out of plain data, beside the key of the server: out of answers before
            they are used, and out of all that is stored.
        connect: Makes the connection to the server of an environment.

    Raises:
        ConfigurationError: If the cassette cannot be used.
    """

    def __init__(
        self,
        mode: Mode = "live",
        cassette: Path | None = None,
        *,
        environ: Mapping[str, str] | None = None,
        session: str = "",
        scrub: Scrub = _unchanged,
        connect: Connect = connect,
    ) -> None:
        self.mode = mode
        self.cassette: Cassette | None = None
        if mode != "live":
            if cassette is None:
                raise ConfigurationError(
                    f"the mode {mode} needs a cassette", key="--dura-cassette", expected="a file"
                )
            self.cassette = Cassette(cassette, writable=mode == "record")
        self.counts: Counter[tuple[str, str, str]] = Counter()
        """How often, by model, fingerprint and what was done: ``asked`` of the server, ``reused``
        from the cassette, ``injected`` as a fault, ``missed``."""
        self._environ = os.environ if environ is None else environ
        self._session = session or secrets.token_hex(8)
        self._scrub, self._connect = scrub, connect
        self._servers: dict[str | None, ModelServer] = {}
        self._described: dict[str | None, ModelDescription | ConfigurationError] = {}
        self._lock = RLock()

    def close(self) -> None:
        """Let go of the cassette."""
        if self.cassette is not None:
            self.cassette.close()

    def describe(self, model: str | None = None) -> ModelDescription:
        """What a model and its server are; found out once per process.

        Args:
            model: Its name; by default the environment's, or the only one of the cassette.

        Raises:
            ConfigurationError: If there is no such model, or its server cannot be used.
        """
        with self._lock:
            if model not in self._described:
                try:
                    replayed = (
                        self._replayed(model) if self.mode == "replay" else self._probed(model)
                    )
                    self._described[model] = self._described[replayed.model] = replayed
                except ConfigurationError as error:
                    self._described[model] = error
            known = self._described[model]
        if isinstance(known, ConfigurationError):
            raise known.with_traceback(None)
        return known

    def know(self, described: Iterable[Mapping[str, Any]]) -> None:
        """Take over what another process of this session found out, instead of asking again."""
        self._described |= {item["model"]: self._description(item) for item in described}

    @property
    def descriptions(self) -> list[ModelDescription]:
        """Every model that was described in this process, by name."""
        found = {
            item.model: item
            for item in self._described.values()
            if isinstance(item, ModelDescription)
        }
        return [found[name] for name in sorted(found)]

    @property
    def replayed(self) -> list[ModelDescription]:
        """In mode ``replay`` the models that the cassette knows, by name; else none.

        Raises:
            ConfigurationError: If the cassette cannot be read.
        """
        return _latest_descriptions(self._recorded()) if self.mode == "replay" else []

    def known(self, model: str, fingerprint: str) -> ModelDescription | None:
        """What was found out of a model at the server with this fingerprint, if anything was.

        Raises:
            ConfigurationError: If the cassette cannot be read.
        """
        found = self._recorded() + self.descriptions
        fitting = (item for item in reversed(found) if item.model == model)
        return next((item for item in fitting if item.fingerprint == fingerprint), None)

    def ask(
        self,
        request: Request,
        budget: float | None,
        delivery: Delivery = Delivery(),  # noqa: B008 - it cannot be changed
        *,
        fingerprint: str | None = None,
    ) -> Answer:
        """What the model answers, or how that fails.

        A fault on the way is injected by the client and never recorded, and takes no time but the
        delay. A delay adds to the seconds that the answer took and is not waited for; an answer
        that is later than the budget allows is none.

        Args:
            request: What is asked.
            budget: Seconds for the answer; ``None`` if nobody says.
            delivery: How the request reaches the model.
            fingerprint: Of the server that is to answer; by default that of :meth:`describe`.

        Raises:
            OutsideError: If nobody can be asked, which says nothing about the component: the
                cassette misses the request (:class:`CassetteMissError`) or cannot be used, or the
                server is another than the given fingerprint says.
        """
        limit = _WITHOUT_LIMIT if budget is None else budget
        try:
            if delivery.fault:
                self._count(request, fingerprint or "", "injected")
                answer = _inject_fault(request, limit, delivery.fault)
            elif delivery.delay >= limit:
                answer = Answer()  # whatever it would be, it comes too late
            else:
                answer = self._answer(request, limit, fingerprint)
        except ConfigurationError as error:
            raise report_environment_error(
                ComponentEnvironmentError("language model", str(error))
            ) from None
        return _deliver(answer, delivery.delay, limit)

    def _answer(self, request: Request, limit: float, fingerprint: str | None) -> Answer:
        server = None if self.mode == "replay" else self._server(request.model)
        request = request if server is None else _scrub_request(request, server.scrub)
        given = fingerprint
        if given is None or server is not None:
            fingerprint = self.describe(request.model).fingerprint
        assert fingerprint is not None
        if given not in (None, fingerprint):
            raise ConfigurationError(
                "the server is another than the component was settled with",
                found=fingerprint,
                expected=given,
                remedy="ask the same server, or replay the cassette with --dura-llm=replay",
            )
        if self.cassette is None:
            assert server is not None
            return self._asked(server, request, limit, fingerprint)
        key = request.key(fingerprint)
        stored = self.cassette.find(key)
        if stored is not None:
            self._count(request, fingerprint, "reused")
            return stored
        plain = self._scrub(request.to_json())
        if server is None:
            self._count(request, fingerprint, "missed")
            raise report_environment_error(
                CassetteMissError(explain_miss(self.cassette, plain, fingerprint))
            )
        answer = self._asked(server, request, limit, fingerprint)
        return self.cassette.add(Exchange(key, fingerprint, plain, answer, _now()))

    def _asked(
        self, server: ModelServer, request: Request, limit: float, fingerprint: str
    ) -> Answer:
        self._count(request, fingerprint, "asked")
        answer = server.ask(request, limit)
        names = ("text", "detail", "finish", "fingerprint")
        texts = {name: self._scrub(server.scrub(getattr(answer, name))) for name in names}
        return replace(answer, **texts)

    def _count(self, request: Request, fingerprint: str, deed: str) -> None:
        with self._lock:
            self.counts[request.model, fingerprint, deed] += 1

    def _server(self, model: str | None) -> ModelServer:
        with self._lock:
            if model not in self._servers:
                self._servers[model] = self._connect(self._environ, model)
            return self._servers[model]

    def _probed(self, model: str | None) -> ModelDescription:
        server = self._server(model)
        known = self._described.get(server.model)
        if isinstance(known, ModelDescription) and known.base_url == server.base_url:
            return known
        if self.cassette is not None:
            shared = self.cassette.described(server.model, server.base_url, self._session)
            if shared is not None:
                return self._description(shared)
        words = server.scrub(model_about(self._environ))
        fingerprint, capabilities = server.probe()
        found = ModelDescription(
            server.model,
            server.base_url,
            fingerprint,
            capabilities,
            version("pytest-dura"),
            _now(),
            words,
        ).to_json()
        found = {key: self._scrub(value) for key, value in found.items()}
        if self.cassette is not None:
            # That of another process, if it was quicker.
            found = dict(self.cassette.describe(found, self._session))
        return self._description(found)

    def _replayed(self, model: str | None) -> ModelDescription:
        assert self.cassette is not None
        known = self._recorded()
        usual = self._environ.get("DURA_LLM_MODEL")
        return _choose_description(known, model, usual, str(self.cassette.file))

    def _recorded(self) -> list[ModelDescription]:
        """Every description that the cassette holds, in its order."""
        stored = [] if self.cassette is None else self.cassette.descriptions()
        return [self._description(each) for each in stored]

    def _description(self, data: Mapping[str, Any]) -> ModelDescription:
        try:
            return ModelDescription(**data)
        except TypeError as error:
            assert self.cassette is not None
            raise self.cassette.damaged(str(error)) from None


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


class _Process:
    """What is in use in this process."""

    session: ModelSession | None = None


def current() -> ModelSession:
    """The session that is in use in this process; a live one, unless another was put to use."""
    if _Process.session is None:
        _Process.session = ModelSession()
    return _Process.session


def in_use() -> ModelSession | None:
    """The session that is in use in this process, if one is by now."""
    return _Process.session


def use(session: ModelSession | None) -> ModelSession | None:
    """Put a session to use; ``None`` for a live one when it is first needed.

    Returns:
        What was in use before, to be put back.
    """
    before, _Process.session = _Process.session, session
    return before


@contextmanager
def using(session: ModelSession) -> Iterator[ModelSession]:
    """Context in which a session is in use."""
    before = use(session)
    try:
        yield session
    finally:
        use(before)
