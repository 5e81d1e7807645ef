"""The client: one call of the openai SDK, without retries, turned into an answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from pytest_dura.llm.client.body import body_of
from pytest_dura.llm.client.completion import read_completion
from pytest_dura.llm.client.refusals import refusal_of, words
from pytest_dura.llm.endpoint import Endpoint
from pytest_dura.llm.extra import imported
from pytest_dura.llm.port import Answer, Request, ServerFault, WireFailure


class OpenAiClient:
    """An OpenAI-compatible server behind the port; it may be asked from many threads.

    Every call makes a connection of its own, goes to the base URL alone, ends within its budget and
    is never repeated. Nothing but the endpoint is taken from the environment: no proxy, no other
    key, no header. The key is taken out of all that comes back.

    Args:
        endpoint: The server and the key.

    Raises:
        ConfigurationError: If the extra ``llm`` is not installed.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._openai, self._http = imported("openai"), imported("httpx2")
        if find_spec("PIL") is None:
            imported("PIL")
        self._wires = imported("pytest_dura.llm.client.wire")
        self._failing = imported("pytest_dura.llm.client.failing").failing
        self.endpoint = endpoint
        self._live = self._sdk(imported("pytest_dura.llm.client.deadline").Network)

    def ask(self, request: Request, budget: float, fault: ServerFault = "") -> Answer:
        """One call; see :class:`~pytest_dura.llm.port.ChatPort`. An injected failure takes 0 s."""

        def call(sdk: Any) -> Any:
            body = body_of(request, self.endpoint.base_url)
            return sdk.chat.completions.with_streaming_response.create(
                model=body.pop("model"),
                messages=body.pop("messages"),
                extra_body=body,
                timeout=budget,
            )

        if not fault:
            return self._timed(call, self._live, budget, read_completion)
        sdk = self._sdk(partial(self._failing, fault))
        return replace(self._timed(call, sdk, budget, read_completion), seconds=0.0)

    def listing(self, budget: float) -> Answer:
        """What the server tells of its models: the text is the body of ``GET /models``."""

        def call(sdk: Any) -> Any:
            return sdk.models.with_streaming_response.list(timeout=budget)

        def read(body: bytes) -> Answer:
            return Answer(body.decode(errors="replace"))

        return self._timed(call, self._live, budget, read)

    def _sdk(self, network: Any) -> Any:
        """The SDK on a network. What it would read from the environment is given to it."""
        return self._openai.OpenAI(
            api_key=self.endpoint.key,
            admin_api_key="",
            organization="",
            project="",
            webhook_secret="",
            base_url=self.endpoint.base_url,
            max_retries=0,
            http_client=self._http.Client(
                transport=self._wires.Wire(self.endpoint.key, network),
                trust_env=False,
                follow_redirects=False,
            ),
        )

    def _timed(
        self, call: Callable[[Any], Any], sdk: Any, budget: float, read: Callable[[bytes], Answer]
    ) -> Answer:
        if not budget > 0.0:
            return Answer(failure="timeout", detail="there is no time left for a call")
        start = time.perf_counter()
        answer = self._called(call, sdk, read)
        seconds = time.perf_counter() - start
        scrub = self.endpoint.scrub
        return replace(
            answer,
            text=scrub(answer.text),
            detail=scrub(answer.detail),
            finish=scrub(answer.finish),
            fingerprint=scrub(answer.fingerprint),
            seconds=seconds,
        )

    def _called(
        self, call: Callable[[Any], Any], sdk: Any, read: Callable[[bytes], Answer]
    ) -> Answer:
        """The answer of one call, whatever happens in it."""
        limit = self._wires.LONGEST_BODY
        try:
            with call(sdk) as response:
                body = b"".join(response.iter_bytes())
            if len(body) > limit:
                return Answer(failure="malformed", detail=f"a body of more than {limit} bytes")
            return read(self._without_key(body))
        except self._openai.APIStatusError as error:
            return refusal_of(error.status_code, self._without_key(error.response.content))
        except Exception as error:
            # A call never raises: what is wrong with a request is told where answers are read.
            failure, detail = self._failed(error)
            return Answer(failure=failure, detail=words(self.endpoint.scrub(detail)))

    def _without_key(self, body: bytes) -> bytes:
        """A body before any of it is cut: half a key is one, too."""
        text = body.decode(errors="surrogateescape")
        return self.endpoint.scrub(text).encode(errors="surrogateescape")

    def _failed(self, error: Exception) -> tuple[WireFailure, str]:
        """Class and words of an error that came instead of a response, or within it."""
        openai, http = self._openai, self._http
        if isinstance(error, openai.APITimeoutError | http.TimeoutException):
            return "timeout", "no whole answer within the budget"
        if isinstance(error, openai.APIConnectionError):
            told = error.__cause__ or error
            return "unavailable", f"{type(told).__name__}: {told}"
        if isinstance(error, http.TransportError):
            return "truncated", f"the body ends in the middle: {error}"
        return "unavailable", f"the request could not be made: {type(error).__name__}: {error}"
