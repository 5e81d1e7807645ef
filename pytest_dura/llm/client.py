"""The client of OpenAI-compatible servers: one call of the openai SDK, turned into an answer.

Packages of the extra ``llm`` are imported at first use.
"""

from __future__ import annotations

import base64
import io
import json
import os
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.completions import (
    BadBodyError,
    first_object,
    read_completion,
    refusal_of,
    short_text,
)
from pytest_dura.llm.endpoint import Endpoint
from pytest_dura.llm.port import ONCE, Answer, Image, Repeats, Request, ServerFault


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
    messages: list[dict[str, Any]] = []
    for message in request.messages:
        content: Any = message.text  # many servers read nothing but plain text
        if message.images:
            urls = [{"url": data_url(image)} for image in message.images]
            pictures = [{"type": "image_url", "image_url": url} for url in urls]
            content = [*pictures, {"type": "text", "text": message.text}]
        messages.append({"role": message.role, "content": content})
    body: dict[str, Any] = {"model": request.model, "messages": messages}
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


def data_url(image: Image) -> str:
    """The picture as a PNG in a ``data:`` URL; every pixel stays as it is."""
    pictures = import_extra("PIL.Image")
    file = io.BytesIO()
    pictures.fromarray(image.pixels).convert("RGB").save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


class OpenAiClient:
    """Client of an OpenAI-compatible server; it may be called from many threads.

    Every call goes to the base URL alone and ends within its budget; connections are kept for the
    next call, apart in each process. Nothing but the endpoint, proxies and certificates is taken
    from the environment: no other key, no other header. Secrets are taken out of all that comes
    back.

    Args:
        endpoint: The server and the key.

    Raises:
        ConfigurationError: If the extra ``llm`` is not installed, or a proxy cannot be used.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._openai, self._http = import_extra("openai"), import_extra("httpx2")
        if find_spec("PIL") is None:
            import_extra("PIL")
        self._wire = import_extra("pytest_dura.llm.wire")
        self.endpoint = endpoint
        self._sdks = {os.getpid(): self._sdk()}
        weakref.finalize(self, _close, self._sdks)

    def ask(
        self, request: Request, budget: float, fault: ServerFault = "", repeats: Repeats = ONCE
    ) -> Answer:
        """Make one call; see :class:`~pytest_dura.llm.port.ChatPort`. A fault takes 0 s."""

        def call(sdk: Any, timeout: float) -> Any:
            body = body_of(request)
            return sdk.chat.completions.with_streaming_response.create(
                model=body.pop("model"),
                messages=body.pop("messages"),
                extra_body=body,
                timeout=timeout,
            )

        if not fault:
            return self._asked(call, self._live, budget, repeats, read_completion)
        sdk = self._sdk(self._wire.failing(fault))
        return replace(self._asked(call, sdk, budget, ONCE, read_completion), seconds=0.0)

    def listing(self, budget: float) -> Answer:
        """The server's list of models: the text is the body of ``GET /models``."""

        def call(sdk: Any, timeout: float) -> Any:
            return sdk.models.with_streaming_response.list(timeout=timeout)

        def read(body: bytes) -> Answer:
            return Answer(body.decode(errors="replace"))

        return self._asked(call, self._live, budget, ONCE, read)

    @property
    def _live(self) -> Any:
        """The SDK of this process: one that was forked shares no connection with the other."""
        return self._sdks.get(os.getpid()) or self._sdks.setdefault(os.getpid(), self._sdk())

    def _sdk(self, network: Any = None) -> Any:
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
            http_client=self._wire.Wire(self.endpoint.sent_headers, network),
        )

    def _asked(
        self,
        make: Callable[[Any, float], Any],
        sdk: Any,
        budget: float,
        repeats: Repeats,
        read: Callable[[bytes], Answer],
    ) -> Answer:
        """The answer of one call, whatever happens in it."""
        if not budget > 0.0:
            return Answer(failure="timeout", detail="there is no time left for a call")
        call = self._wire.Call(budget, repeats)
        sdk = sdk.with_options(max_retries=repeats.most) if repeats.most else sdk
        try:
            # A step of the client may last longer than the call, whose deadline counts.
            answer: Answer = call.run(lambda: self._read(make(sdk, call.budget + 1.0), read, call))
        except self._wire.LateError:
            if call.status:
                answer = refusal_of(call.status, b"")
            elif call.failure is not None:
                detail = f"{type(call.failure).__name__}: {call.failure}"
                answer = Answer(failure="unavailable", detail=detail, cause="connection")
            else:
                answer = Answer(failure="timeout", detail="no whole answer within the budget")
        except BadBodyError as error:
            answer = Answer(failure=error.failure, detail=error.detail)
        except self._openai.APIStatusError as error:
            refusal = refusal_of(error.status_code, self._without_key(error.response.content))
            pause = self._wire.retry_after(error.response.headers)
            answer = replace(refusal, retry_after=pause)
        except self._openai.APIConnectionError as error:
            detail = f"{type(error.__cause__ or error).__name__}: {error.__cause__ or error}"
            answer = Answer(failure="unavailable", detail=detail, cause="connection")
        except self._http.TransportError as error:
            detail = f"the body ends in the middle: {error}"
            answer = Answer(failure="truncated", detail=detail)
        except Exception as error:  # a call never raises: its failure is an answer
            detail = f"the request could not be made: {type(error).__name__}: {error}"
            answer = Answer(failure="unavailable", detail=detail, cause="request")
        answer = answer.scrubbed(self.endpoint.scrub)
        begun = call.begun if call.attempts <= 1 else call.started
        seconds = time.monotonic() - begun
        return replace(
            answer,
            detail=short_text(answer.detail),
            seconds=min(seconds, call.budget) if answer.failure == "unavailable" else seconds,
            attempts=max(call.attempts, 1),
            waited=begun - call.begun,
        )

    def _read(self, response: Any, read: Callable[[bytes], Answer], call: Any) -> Answer:
        """The answer in a response."""
        with response as opened:
            if self._wire.is_event_stream(opened):
                return self._streamed(opened, read, call)
            body = b"".join(opened.iter_bytes())
        return read(self._without_key(body))

    def _streamed(self, response: Any, read: Callable[[bytes], Answer], call: Any) -> Answer:
        """The answer of a response that comes in parts, put together to one completion."""
        whole: dict[str, Any] = {}
        message: dict[str, str] = {}
        first_token = finish = None
        events = self._openai.Stream(
            cast_to=object, response=response.http_response, client=self._live
        )
        try:
            for event in events:
                first, ends = _add_part(event, whole, message)
                if first and first_token is None:
                    first_token = time.monotonic() - call.started
                finish = ends or finish
        except self._openai.APIError as error:
            if isinstance(error, self._openai.APIConnectionError):
                raise error.__cause__ or error from None
            return read(self._without_key(json.dumps({"error": error.body}).encode()))
        except (ValueError, RecursionError):
            raise BadBodyError("malformed", "an event is no JSON") from None
        if finish is None:
            raise BadBodyError("truncated", "the stream ends in the middle")
        arguments = message.pop("arguments", "")
        calls = {"tool_calls": [{"function": {"arguments": arguments}}]} if arguments else {}
        choice = {"message": {**message, **calls}, "finish_reason": finish}
        body = json.dumps({**whole, "choices": [choice]}).encode()
        return replace(read(self._without_key(body)), first_token=first_token)

    def _without_key(self, body: bytes) -> bytes:
        """A body before any of it is cut: half a key is one, too."""
        text = body.decode(errors="surrogateescape")
        return self.endpoint.scrub(text).encode(errors="surrogateescape")


def _close(sdks: Mapping[int, Any]) -> None:
    """Close the connections of this process."""
    if os.getpid() in sdks:
        sdks[os.getpid()].close()


_TEXTS = ("content", "refusal", "reasoning_content", "reasoning")


def _add_part(event: Any, whole: dict[str, Any], message: dict[str, str]) -> tuple[bool, Any]:
    """Add an event of a stream to the message; whether it has a text, and its finish reason.

    Raises:
        BadBodyError: For an event that is none of a chat completion.
    """
    if not isinstance(event, Mapping):
        raise BadBodyError("malformed", "an event is no object")
    for name in ("system_fingerprint", "usage"):
        if event.get(name) is not None:
            whole[name] = event[name]
    choice = first_object(event.get("choices"))
    delta = choice.get("delta")
    delta = delta if isinstance(delta, Mapping) else {}
    function = first_object(delta.get("tool_calls")).get("function")
    arguments = function.get("arguments") if isinstance(function, Mapping) else None
    parts = {name: delta.get(name) for name in _TEXTS} | {"arguments": arguments}
    for name, part in parts.items():
        if part is not None and not isinstance(part, str):
            raise BadBodyError("malformed", "a part of the answer is no text")
        if part:
            message[name] = message.get(name, "") + part
    return any(parts.values()), choice.get("finish_reason")
