"""ModelSession: what answers the requests of a session to language models, server or cassette."""

from __future__ import annotations

import os
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from datetime import datetime, timezone
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from threading import Event, RLock
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    ConfigurationError,
    report_environment_error,
)
from pytest_dura.llm.cassette import Cassette, Exchange
from pytest_dura.llm.endpoint import MODEL, model_about, retries_of
from pytest_dura.llm.misses import CassetteMissError, explain_miss
from pytest_dura.llm.places import Places
from pytest_dura.llm.port import Answer, Delivery, Repeats, Request
from pytest_dura.llm.servers import (
    Connect,
    ModelDescription,
    ModelServer,
    OpenAiServer,
    choose_description,
    latest_descriptions,
)
from pytest_dura.llm.usage import Meter, Tokens, estimate_tokens

if TYPE_CHECKING:
    from pytest_dura.llm.client import OpenAiClient


def _answers_within(answer: Answer, limit: float) -> bool:
    """Whether a recorded answer holds with this limit, and not only with a shorter one."""
    return answer.failure != "timeout" or answer.seconds >= limit


def _deliver(answer: Answer, delay: float, waited: float, limit: float) -> Answer:
    """The answer as it arrives: later by delay and wait, and not at all beyond the limit."""
    late = delay + waited
    seconds = answer.seconds + late
    if seconds <= limit and delay < limit:
        return answer if late == 0.0 else replace(answer, seconds=seconds)
    if answer.failure == "timeout":
        return replace(answer, seconds=limit)
    return Answer(failure="timeout", detail=f"no answer within {limit:g} s", seconds=limit)


Mode = Literal["live", "record", "replay"]
Scrub = Callable[[Any], Any]

_LATE_AT_FIRST = 3
"""Answers that may be late before any was in time; a server that loads its model is late once."""
_WITHOUT_LIMIT = 600.0
"""Seconds for an answer where the scenario gives the component no time budget."""


_is_counted: ContextVar[bool] = ContextVar("dura_llm_is_counted", default=True)


@contextmanager
def uncounted() -> Iterator[None]:
    """Context whose requests enter no count, those in threads with a copy of it included."""
    token = _is_counted.set(False)
    try:
        yield
    finally:
        _is_counted.reset(token)


class ModelSession:
    """Access to language models in one of three modes.

    In mode ``live`` each request goes to the server of the environment. In mode ``record`` the
    first of equal requests does, and the cassette answers the others, so that paired runs and
    reruns see the same. In mode ``replay`` nothing but the cassette answers: no environment is
    needed, and no connection is made.

    Args:
        mode: ``live``, ``record`` or ``replay``.
        cassette: The file, for the last two.
        environ: Names the server; by default the process's environment, when it is first needed.
        session: Id that all processes of one pytest session share: what one of them probes of a
            server holds for the others, and for no later session.
        scrub: Takes secrets out of plain data, beside the key of the server: out of answers before
            they are used, and out of all that is stored.
        connect: Makes the connection to the server of an environment.
        retries: How often a request is repeated at most whose server is not available; by default
            as the environment says.
        concurrency: Requests that are under way at the same time, at most.
        meter: Counts the requests to servers; by default without a limit.

    Raises:
        ConfigurationError: If the cassette, or the environment's number of retries, cannot be used.
    """

    def __init__(
        self,
        mode: Mode = "live",
        cassette: Path | None = None,
        *,
        environ: Mapping[str, str] | None = None,
        session: str = "",
        scrub: Scrub = lambda value: value,
        connect: Connect = OpenAiServer,
        retries: int | None = None,
        concurrency: int = 1,
        meter: Meter | None = None,
    ) -> None:
        self.mode = mode
        self._environ = os.environ if environ is None else environ
        self.retries = retries_of(self._environ) if retries is None else retries
        self.cassette: Cassette | None = None
        if mode != "live":
            if cassette is None:
                raise ConfigurationError(
                    f"the mode {mode} needs a cassette", key="--dura-cassette", expected="a file"
                )
            self.cassette = Cassette(cassette, writable=mode == "record")
        self.counts: Counter[tuple[str, str, str]] = Counter()
        """Number of requests by model, fingerprint and what answered them: ``asked`` of the server,
        ``reused`` from the cassette, ``injected`` as a fault, ``missed`` in the cassette. Beside
        these the calls that were ``repeated``, and by their cause those that ended as
        ``unavailable``, such as ``unavailable: HTTP 429``; a cassette's answers, too."""
        self.tokens: Counter[tuple[str, str, str]] = Counter()
        """Number of tokens by model, fingerprint and what they were for: ``prompt``, ``completion``
        and ``uncounted`` answers, behind ``asked`` or ``reused`` and a blank."""
        self.ended_by = ""
        """Why no server is asked any more, in words; empty while they are."""
        self._late: list[float] | None = []
        """Limits in s that the first answers passed; ``None`` from the first one in time on."""
        self._meter = meter or Meter()
        self._places = Places(concurrency)
        self._under_way: dict[str, Event] = {}
        """Requests that are being recorded, by key, each with the event of their end."""
        self._stopped = False
        self._session = session or secrets.token_hex(8)
        self._scrub, self._connect = scrub, connect
        self._servers: dict[str | None, ModelServer] = {}
        self._described: dict[str | None, ModelDescription | ConfigurationError] = {}
        self._lock = RLock()

    def stop(self) -> None:
        """Let no further request be answered, and record nothing any more."""
        with self._lock:
            self._stopped = True

    def close(self) -> None:
        """Close the cassette."""
        self.stop()
        if self.cassette is not None:
            self.cassette.close()

    def describe(self, model: str | None = None) -> ModelDescription:
        """Describe a model and its server, which is probed once per process.

        Args:
            model: Its name; by default the environment's, or the only one of the cassette.

        Raises:
            ConfigurationError: If there is no such model, or its server cannot be used.
        """
        with self._lock:
            if model not in self._described:
                try:
                    if self.mode == "replay" and self.cassette is not None:
                        usual, file = self._environ.get(MODEL), str(self.cassette.file)
                        described = choose_description(self._recorded(), model, usual, file)
                    else:
                        described = self._probed(model)
                    self._described[model] = self._described[described.model] = described
                except ConfigurationError as error:
                    self._described[model] = error
            known = self._described[model]
        if isinstance(known, ConfigurationError):
            raise known.with_traceback(None)
        return known

    def know(self, described: Iterable[Mapping[str, Any]]) -> None:
        """Take over descriptions of another process of this session, instead of probing again."""
        self._described |= {data["model"]: self._description(data) for data in described}

    @property
    def descriptions(self) -> list[ModelDescription]:
        """Every model that was described in this process, by name."""
        described = self._described.values()
        return latest_descriptions([
            description for description in described if isinstance(description, ModelDescription)
        ])  # fmt: skip

    @property
    def replayed(self) -> list[ModelDescription]:
        """In mode ``replay`` the models that the cassette knows, by name; else none.

        Raises:
            ConfigurationError: If the cassette cannot be read.
        """
        return latest_descriptions(self._recorded()) if self.mode == "replay" else []

    def known(self, model: str, fingerprint: str) -> ModelDescription | None:
        """The latest description of a model at the server with this fingerprint, if there is one.

        Raises:
            ConfigurationError: If the cassette cannot be read.
        """
        known = reversed(self._recorded() + self.descriptions)
        key = model, fingerprint
        return next((each for each in known if (each.model, each.fingerprint) == key), None)

    def ask(
        self,
        request: Request,
        budget: float | None,
        delivery: Delivery = Delivery(),  # noqa: B008 - it cannot be changed
        *,
        fingerprint: str | None = None,
        count_retries: bool = False,
    ) -> Answer:
        """The answer of a model to a request, which may be a failure.

        A fault on the way is injected by the client and never recorded, and takes no time but the
        delay. A delay adds to the seconds that the answer took and is not waited for; an answer
        that is later than the budget allows is none.

        Args:
            request: The request.
            budget: Seconds for the answer; ``None`` where there is no limit.
            delivery: How the request reaches the model.
            fingerprint: Of the server that is to answer; by default that of :meth:`describe`.
            count_retries: Whether calls that were repeated, and the pauses between them, are part
                of the seconds that the answer took, and of the budget.

        Raises:
            ComponentEnvironmentError: If there can be no answer, which says nothing about the
                component: the cassette misses the request (:class:`CassetteMissError`) or cannot be
                used, or the server has another fingerprint than the one given.
        """
        limit = _WITHOUT_LIMIT if budget is None else budget
        try:
            if delivery.fault:
                self._count(request, fingerprint or "", "injected")
                answer = self._offline_client.ask(request, limit, delivery.fault)
            elif delivery.delay >= limit:
                answer = Answer()  # whatever it would be, it comes too late
            else:
                answer = self._answer(request, limit, fingerprint, count_retries)
        except ConfigurationError as error:
            raise report_environment_error(
                ComponentEnvironmentError("language model", str(error))
            ) from None
        waited = answer.waited if count_retries else 0.0
        return _deliver(answer, delivery.delay, waited, limit)

    def scrub_text(self, text: str) -> str:
        """Take the keys of the servers in use, and other secrets, out of a text."""
        for server in tuple(self._servers.values()):
            text = server.scrub(text)
        scrubbed: str = self._scrub(text)
        return scrubbed

    def ask_all(
        self,
        requests: Sequence[Request],
        budget: float | None,
        *,
        fingerprint: str | None = None,
        count_retries: bool = False,
    ) -> list[Answer]:
        """The answers to several requests, in their order; they are made at once as far as may be.

        Args:
            requests: The requests.
            budget: As in :meth:`ask`, for each of them.
            fingerprint: As in :meth:`ask`.
            count_retries: As in :meth:`ask`.

        Raises:
            ComponentEnvironmentError: As in :meth:`ask`, for the first of those that have none.
        """
        calls = [
            partial(self.ask, request, budget, fingerprint=fingerprint, count_retries=count_retries)
            for request in requests
        ]
        return [call() for call in calls] if self.mode == "replay" else self._places.call_all(calls)

    @cached_property
    def _offline_client(self) -> OpenAiClient:
        """The client for injected faults, whose answers must not depend on any server."""
        from pytest_dura.llm.client import OpenAiClient
        from pytest_dura.llm.endpoint import Endpoint

        return OpenAiClient(Endpoint("http://127.0.0.1/v1", "none"))

    def _answer(
        self, request: Request, limit: float, fingerprint: str | None, count_retries: bool
    ) -> Answer:
        server = None if self.mode == "replay" else self._server(request.model)
        if server is not None:  # a text may hold the server's key
            texts = [server.scrub(message.text) for message in request.messages]
            pairs = zip(request.messages, texts, strict=True)
            messages = tuple(replace(message, text=text) for message, text in pairs)
            request = replace(request, messages=messages)
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
            return self._ask_server(server, request, limit, fingerprint, count_retries)
        key = request.key(fingerprint)
        while True:
            stored = self.cassette.find(key)
            if stored is not None and _answers_within(stored, limit):
                return self._reused(request, fingerprint, stored)
            if server is None:
                self._count(request, fingerprint, "missed")
                plain = self._scrubbed(request.to_json())
                if stored is None:
                    problem = explain_miss(self.cassette, plain, fingerprint)
                else:
                    problem = (
                        "the cassette has no answer to this request but a time-out after "
                        f"{stored.seconds:.3g} s, which says nothing of the {limit:g} s that this "
                        "session allows; record it again, or replay it with the recorded budget"
                    )
                raise report_environment_error(CassetteMissError(problem))
            with self._lock:
                ended = self._under_way.get(key)
                if ended is None:
                    self._under_way[key] = Event()
            if ended is None:
                ask = partial(self._ask_server, server, request, limit, fingerprint, count_retries)
                return self._record(key, request, limit, fingerprint, ask)
            ended.wait()  # each request keeps to a limit of its own

    def _record(
        self,
        key: str,
        request: Request,
        limit: float,
        fingerprint: str,
        ask: Callable[[], Answer],
    ) -> Answer:
        """Ask a server and record the exchange, while others with the same request wait for it."""
        assert self.cassette is not None
        try:
            stored = self.cassette.find(key)  # an earlier request may just have ended
            if stored is not None and _answers_within(stored, limit):
                return self._reused(request, fingerprint, stored)
            answer = ask()
            if answer.failure == "timeout":  # so much it was given
                answer = replace(answer, seconds=max(answer.seconds, limit))
            plain = self._scrubbed(request.to_json())
            with self._lock:
                self._check_goes_on()
                return self.cassette.add(Exchange(key, fingerprint, plain, answer, _now()))
        finally:
            with self._lock:
                self._under_way.pop(key).set()

    def _reused(self, request: Request, fingerprint: str, stored: Answer) -> Answer:
        self._count(request, fingerprint, "reused")
        self._count_answer(request, fingerprint, "reused", stored)
        return stored

    def _ask_server(
        self,
        server: ModelServer,
        request: Request,
        limit: float,
        fingerprint: str,
        count_retries: bool,
    ) -> Answer:
        refused: list[str] = []

        def allowed(cause: str) -> bool:
            """Count a request that is made again."""
            self._count(request, fingerprint, f"unavailable: {cause}")
            if self._stopped or self._limit():
                refused.append(cause)
                return False
            self._count(request, fingerprint, "repeated")
            return True

        repeats = Repeats(self.retries, count_retries, allowed)
        with self._places.taken():
            self._check_context(request, fingerprint)
            with self._lock:
                self._check_goes_on()
                self._limit()
            self._check_limit()
            self._count(request, fingerprint, "asked")
            answer = server.ask(request, limit, repeats)
            self._note_time(request, answer, limit)
            tokens = Tokens.of(answer.usage, answered=not answer.failure)
            if tokens.uncounted:  # so that a limit holds all the same
                texts = (message.text for message in request.messages)
                tokens = Tokens(estimate_tokens(*texts), estimate_tokens(answer.text))
            self._meter.end(tokens)
        if refused:
            self._check_goes_on()
            self._check_limit()
        self._count_answer(request, fingerprint, "asked", answer)
        return answer.scrubbed(lambda text: self._scrubbed(server.scrub(text)))

    def _limit(self) -> str:
        """Count a request against the limits; why it may not be made, or empty."""
        with self._lock:
            reached = "" if self.ended_by else self._meter.begin()
            if reached:
                self.ended_by = f"the limit of {reached} is reached (--dura-llm-limit)"
            return self.ended_by

    def _check_limit(self) -> None:
        if self.ended_by:
            raise report_environment_error(
                ComponentEnvironmentError("language model", self.ended_by)
            )

    def _check_context(self, request: Request, fingerprint: str) -> None:
        """End the session where prompt and answer are longer than the model's context.

        Raises:
            ComponentEnvironmentError: If they are.
        """
        known = self.known(request.model, fingerprint) if self._late == [] else None
        context = None if known is None else known.capabilities.get("context")
        if not isinstance(context, int):
            return
        per_token = known.capabilities.get("characters_per_token") if known else None
        texts = (message.text for message in request.messages)
        prompt = estimate_tokens(*texts, characters_per_token=per_token)
        if prompt + request.max_tokens > context:
            self.ended_by = (
                f"the context of {request.model} is {context} tokens, but the first prompt has "
                f"about {prompt} and an answer up to {request.max_tokens}: serve it with a larger "
                "context, or lower the planner's max_tokens, or set prompt: brief"
            )
            self._check_limit()

    def _note_time(self, request: Request, answer: Answer, limit: float) -> None:
        """End the session where the first answers all came too late, and nothing else came."""
        with self._lock:
            if self._late is None or answer.failure == "unavailable":
                return
            self._late = [*self._late, limit] if answer.failure == "timeout" else None
            if self._late is not None and len(self._late) == _LATE_AT_FIRST and not self.ended_by:
                self.ended_by = (
                    f"the first {_LATE_AT_FIRST} answers of {request.model} took longer than the "
                    f"{limit:g} s that an answer may take, and none came in time: raise "
                    "--dura-time-budget, or the planner's budget, or serve the model quicker"
                )

    def _check_goes_on(self) -> None:
        if self._stopped:
            raise report_environment_error(
                ComponentEnvironmentError("language model", "the session has ended")
            )

    def _scrubbed(self, value: Any) -> Any:
        """The value without secrets; what takes them out serves one thread at a time."""
        with self._lock:
            return self._scrub(value)

    def _count_answer(self, request: Request, fingerprint: str, how: str, answer: Answer) -> None:
        """Count the tokens of an answer, and why there is none if its server was not available."""
        if answer.failure == "unavailable":
            self._count(request, fingerprint, f"unavailable: {answer.cause or 'other'}")
        if _is_counted.get():
            tokens = Tokens.of(answer.usage, answered=not answer.failure)
            with self._lock:
                for name, number in vars(tokens).items():
                    self.tokens[request.model, fingerprint, f"{how} {name}"] += number

    def _count(self, request: Request, fingerprint: str, answered_by: str) -> None:
        if _is_counted.get():
            with self._lock:
                self.counts[request.model, fingerprint, answered_by] += 1

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
        about = server.scrub(model_about(self._environ))
        fingerprint, capabilities = server.probe()
        description = ModelDescription(
            server.model,
            server.base_url,
            fingerprint,
            capabilities,
            version("pytest-dura"),
            _now(),
            about,
        )
        data = {key: self._scrubbed(value) for key, value in description.to_json().items()}
        if self.cassette is not None:
            # That of another process, if it was quicker.
            data = dict(self.cassette.describe(data, self._session))
        return self._description(data)

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
    """The model session in use.

    One per process and not per context: a thread that a component starts must reach the cassette of
    the session. With a context of its own it would connect to a server in the middle of a replay.
    """

    session: ModelSession | None = None


def current() -> ModelSession:
    """The session in use in this process; a live one, unless another was put to use."""
    if _Process.session is None:
        _Process.session = ModelSession()
    return _Process.session


def in_use() -> ModelSession | None:
    """The session in use in this process, if one is by now."""
    return _Process.session


def use(session: ModelSession | None) -> ModelSession | None:
    """Put a session to use; ``None`` for a live one when it is first needed.

    Returns:
        The session that was in use before, to be put back.
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
