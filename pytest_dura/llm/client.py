"""The client of OpenAI-compatible servers: one call of the openai SDK, turned into an answer.

It never repeats a call; :mod:`pytest_dura.llm.retries` does where that is wanted. Packages of the
extra ``llm`` are imported at first use.
"""

from __future__ import annotations

import base64
import io
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.completions import BadBodyError, read_completion, refusal_of, short_text
from pytest_dura.llm.endpoint import Endpoint
from pytest_dura.llm.port import Answer, Image, Message, Request, ServerFault, WireFailure
from pytest_dura.llm.retries import retry_after
from pytest_dura.llm.streams import EventStream, is_stream


def import_extra(name: str) -> Any:
    """Import a module that the extra ``llm`` installs, or that needs it.

    Raises:
        ConfigurationError: If it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"a language model needs the package {name.partition('.')[0]!r}: {error}",
            remedy="pip install 'pytest-dura[llm]'",
        ) from None


def body_of(request: Request) -> dict[str, Any]:
    """Body of a request, as plain data."""
    body: dict[str, Any] = {
        "model": request.model,
        "messages": [_message_body(message) for message in request.messages],
    }
    if request.temperature is not None:
        body["temperature"] = request.temperature
    if request.tokens != "none":
        body[request.tokens] = request.max_tokens
    if request.seed is not None:
        body["seed"] = request.seed
    if request.stream:
        body |= {"stream": True, "stream_options": {"include_usage": True}}
    return body | _structured_body(request) | dict(request.extra)


_TOOL = "answer"


def _structured_body(request: Request) -> dict[str, Any]:
    schema = dict(request.schema)
    if request.structured == "json_schema":
        named = {"name": _TOOL, "strict": True, "schema": schema}
        return {"response_format": {"type": "json_schema", "json_schema": named}}
    if request.structured == "json_object_schema":
        return {"response_format": {"type": "json_object", "schema": schema}}
    if request.structured == "tool":
        # Not strict: that refuses bounds of strings, which a server without it may keep to.
        function = {"name": _TOOL, "description": "Give the answer.", "parameters": schema}
        return {
            "tools": [{"type": "function", "function": function}],
            "tool_choice": {"type": "function", "function": {"name": _TOOL}},
        }
    if request.structured == "json_object":
        return {"response_format": {"type": "json_object"}}
    return {}


def _message_body(message: Message) -> dict[str, Any]:
    if not message.images:  # many servers read nothing but plain text
        return {"role": message.role, "content": message.text}
    parts: list[dict[str, Any]] = [
        {"type": "image_url", "image_url": {"url": data_url(image)}} for image in message.images
    ]
    return {"role": message.role, "content": [*parts, {"type": "text", "text": message.text}]}


def data_url(image: Image) -> str:
    """The picture as a PNG in a ``data:`` URL; every pixel stays as it is."""
    pictures = import_extra("PIL.Image")
    file = io.BytesIO()
    pictures.fromarray(image.pixels).convert("RGB").save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


class OpenAiClient:
    """Client of an OpenAI-compatible server; it may be called from many threads.

    Every call goes to the base URL alone, ends within its budget and is never repeated; connections
    are kept for the next call. Nothing but the endpoint, proxies and certificates is taken from the
    environment: no other key, no other header. Secrets are taken out of all that comes back.

    Args:
        endpoint: The server and the key.

    Raises:
        ConfigurationError: If the extra ``llm`` is not installed, or a proxy cannot be used.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._openai, self._http = import_extra("openai"), import_extra("httpx2")
        if find_spec("PIL") is None:
            import_extra("PIL")
        self._transport = import_extra("pytest_dura.llm.transport")
        self.endpoint = endpoint
        proxy = self._transport.environment_proxy(endpoint.base_url)
        self._live = self._sdk(self._transport.Network(), proxy)

    def ask(self, request: Request, budget: float, fault: ServerFault = "") -> Answer:
        """Make one call; see :class:`~pytest_dura.llm.port.ChatPort`. A fault takes 0 s."""

        def call(sdk: Any) -> Any:
            body = body_of(request)
            return sdk.chat.completions.with_streaming_response.create(
                model=body.pop("model"),
                messages=body.pop("messages"),
                extra_body=body,
                timeout=budget,
            )

        if not fault:
            return self._timed(call, self._live, budget, read_completion)
        sdk = self._sdk(self._transport.failing(fault))
        return replace(self._timed(call, sdk, budget, read_completion), seconds=0.0)

    def listing(self, budget: float) -> Answer:
        """The server's list of models: the text is the body of ``GET /models``."""

        def call(sdk: Any) -> Any:
            return sdk.models.with_streaming_response.list(timeout=budget)

        def read(body: bytes) -> Answer:
            return Answer(body.decode(errors="replace"))

        return self._timed(call, self._live, budget, read)

    def _sdk(self, network: Any, proxy: Any = None) -> Any:
        """The SDK on a network. All that it would read from the environment is given to it."""
        return self._openai.OpenAI(
            api_key=self.endpoint.key,
            admin_api_key="",
            organization="",
            project="",
            webhook_secret="",
            base_url=self.endpoint.address,
            default_query=dict(self.endpoint.query),
            max_retries=0,
            http_client=self._http.Client(
                transport=self._transport.Wire(self.endpoint.sent_headers, network, proxy),
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
        answer = self._called(call, sdk, read, start)
        seconds = time.perf_counter() - start
        scrub = self.endpoint.scrub
        return replace(
            answer,
            text=scrub(answer.text),
            thoughts=scrub(answer.thoughts),
            detail=scrub(answer.detail),
            finish=scrub(answer.finish),
            fingerprint=scrub(answer.fingerprint),
            seconds=seconds,
        )

    def _called(
        self, call: Callable[[Any], Any], sdk: Any, read: Callable[[bytes], Answer], start: float
    ) -> Answer:
        """The answer of one call, whatever happens in it."""
        try:
            with call(sdk) as response:
                if is_stream(response.headers.get("content-type", "")):
                    return self._streamed(response, read, start)
                body = b"".join(response.iter_bytes())
            limit = self._transport.LONGEST_BODY
            if len(body) > limit:
                return Answer(failure="malformed", detail=f"a body of more than {limit} bytes")
            return read(self._without_key(body))
        except BadBodyError as error:
            return Answer(failure=error.failure, detail=error.detail)
        except self._openai.APIStatusError as error:
            refusal = refusal_of(error.status_code, self._without_key(error.response.content))
            return replace(refusal, retry_after=retry_after(error.response.headers))
        except Exception as error:
            # A call never raises: its failure is an answer.
            failure, detail, cause = self._failed(error)
            shown = short_text(self.endpoint.scrub(detail))
            return Answer(failure=failure, detail=shown, cause=cause)

    def _streamed(self, response: Any, read: Callable[[bytes], Answer], start: float) -> Answer:
        """The answer of a response that comes in parts."""
        stream, size, limit = EventStream(), 0, self._transport.LONGEST_STREAM
        chunked = "transfer-encoding" in response.headers
        for chunk in response.iter_bytes():
            size += len(chunk)
            if size > limit:
                return Answer(failure="malformed", detail=f"a stream of more than {limit} bytes")
            stream.feed(chunk, time.perf_counter() - start)
            if stream.ended and not chunked:
                break  # the end of the connection, which some servers leave open, tells no more
        return replace(read(self._without_key(stream.body())), first_token=stream.first_token)

    def _without_key(self, body: bytes) -> bytes:
        """A body before any of it is cut: half a key is one, too."""
        text = body.decode(errors="surrogateescape")
        return self.endpoint.scrub(text).encode(errors="surrogateescape")

    def _failed(self, error: Exception) -> tuple[WireFailure, str, str]:
        """Class, message and cause of an error that came instead of a response, or within it."""
        openai, http = self._openai, self._http
        if isinstance(error, openai.APITimeoutError | http.TimeoutException):
            return "timeout", "no whole answer within the budget", ""
        if isinstance(error, openai.APIConnectionError):
            cause = error.__cause__ or error
            return "unavailable", f"{type(cause).__name__}: {cause}", "connection"
        if isinstance(error, http.TransportError):
            return "truncated", f"the body ends in the middle: {error}", ""
        detail = f"the request could not be made: {type(error).__name__}: {error}"
        return "unavailable", detail, "request"
