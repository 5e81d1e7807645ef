"""The client of OpenAI-compatible servers: one call of the openai SDK, turned into an answer.

It never repeats a call; :mod:`pytest_dura.llm.retries` does where that is wanted. Packages of the
extra ``llm`` are imported at first use.
"""

from __future__ import annotations

import base64
import io
import json
import time
from collections.abc import Callable
from dataclasses import replace
from http import HTTPStatus
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from urllib.parse import urlsplit

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.answers import refuse_constant
from pytest_dura.llm.endpoint import Endpoint
from pytest_dura.llm.port import Answer, Image, Message, Request, ServerFault, WireFailure
from pytest_dura.llm.retries import retry_after


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


_LONGEST_DETAIL = 300
_LONGEST_CODE = 100
_FILTERED = ("content_filter", "content_policy_violation", "ResponsibleAIPolicyViolation")
"""Codes with which a server says that a content filter declined."""


def refusal_of(status: int, body: bytes) -> Answer:
    """The answer for the body of an error, with whatever status."""
    message, code = _error(body)
    message = message.strip() or _phrase(status)
    shown = f" ({code})" if code and code not in message else ""
    detail = _short_text(f"HTTP {status}: {message}{shown}")
    if code in _FILTERED:
        return Answer(failure="refused", detail=detail)
    return Answer(failure="unavailable", detail=detail, cause=f"HTTP {status}")


def _short_text(text: str) -> str:
    """A text of a server's on one line that acts on no terminal, bounded."""
    line = " ".join("".join(char if char.isprintable() else " " for char in text).split())
    return line if len(line) <= _LONGEST_DETAIL else line[: _LONGEST_DETAIL - 1] + "…"


def _short_code(value: Any) -> str:
    """A short text of a server's on one line; empty for anything else."""
    return _short_text(value)[:_LONGEST_CODE] if isinstance(value, str) else ""


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return "an error without words"


def _error(body: bytes) -> tuple[str, str]:
    """Message and code of an error's body, in any of the forms that servers use."""
    text = body.decode(errors="replace")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return text, ""
    error = data.get("error") or data if isinstance(data, dict) else data
    if not isinstance(error, dict):
        return (error if isinstance(error, str) else text), ""
    message = next((error[key] for key in ("message", "detail", "title") if error.get(key)), text)
    codes = (_short_code(error.get(key)) for key in ("code", "type"))
    shown = message if isinstance(message, str) else json.dumps(message)
    return shown, next(filter(None, codes), "")


class BadBodyError(Exception):
    """Error for a body that is no chat completion.

    Args:
        failure: Its class.
        detail: What is wrong with it.
    """

    def __init__(self, failure: WireFailure, detail: str) -> None:
        super().__init__(detail)
        self.failure, self.detail = failure, _short_text(detail)


def _object_of(body: bytes) -> dict[str, Any]:
    """Parse the JSON object in a body: UTF-8, and no numbers but JSON's.

    Raises:
        BadBodyError: ``truncated`` for the beginning of an object, ``empty`` for nothing at all,
            else ``malformed``.
    """
    if not body.strip():
        raise BadBodyError("empty", "the body of the response is empty")
    text = _decoded(body)
    try:
        data = json.loads(text, parse_constant=refuse_constant)
    except json.JSONDecodeError as error:
        if _ends_early(text, error):
            raise _cut(body) from None
        raise BadBodyError("malformed", f"the body is no JSON: {text[:80]}") from None
    except (ValueError, RecursionError) as error:  # NaN, endless digits, endless nesting
        raise BadBodyError("malformed", f"the body is no JSON: {error}") from None
    if not isinstance(data, dict):
        raise BadBodyError("malformed", f"JSON, but no object: {type(data).__name__}")
    return data


def _decoded(body: bytes) -> str:
    try:
        return body.decode()
    except UnicodeDecodeError as error:
        if error.end == len(body) and "unexpected end" in error.reason:
            raise _cut(body) from None
        raise BadBodyError("malformed", "the body is no text in UTF-8") from None


def _cut(body: bytes) -> BadBodyError:
    return BadBodyError("truncated", f"the body ends in the middle, at byte {len(body)}")


def _ends_early(text: str, error: json.JSONDecodeError) -> bool:
    """Whether a text looks like the beginning of a JSON object."""
    whole = text.strip()
    if not whole.startswith("{"):
        return False
    at_end = error.pos >= len(text.rstrip())
    return at_end or error.msg.startswith("Unterminated string") or not whole.endswith("}")


LONGEST_TEXT = 64_000
"""Characters of an answer that are kept."""
_MOST_TOKENS = 2**53
_COUNTED = ("prompt_tokens", "completion_tokens", "total_tokens")


def read_completion(body: bytes) -> Answer:
    """Read the answer in a body; a body that holds none is a failure of its class."""
    try:
        completion = _object_of(body)
        if completion.get("error") or completion.get("object") == "error":
            return refusal_of(200, body)
        return _answer(completion)
    except BadBodyError as error:
        return Answer(failure=error.failure, detail=error.detail)


def _answer(completion: dict[str, Any]) -> Answer:
    choice, message = _first_choice(completion)
    content, refusal = message.get("content"), message.get("refusal")
    if content is not None and not isinstance(content, str):
        raise BadBodyError("malformed", "no chat completion: the content is no text")
    finish = _short_code(choice.get("finish_reason"))
    text = _encodable(content or "")
    failure, detail = _failure(text, refusal, finish)
    return Answer(
        text[:LONGEST_TEXT],
        failure,
        _short_text(_encodable(detail)),
        finish=finish,
        usage=_usage(completion.get("usage")),
        fingerprint=_short_code(completion.get("system_fingerprint")),
    )


def _failure(text: str, refusal: Any, finish: str) -> tuple[WireFailure, str]:
    """The class of failure of an answer, and why; both empty for a whole text."""
    if refusal:
        return "refused", f"refusal: {refusal}"
    if finish == "content_filter":
        return "refused", "finish_reason: content_filter"
    if len(text) > LONGEST_TEXT:
        return "truncated", f"of {len(text)} characters {LONGEST_TEXT} are kept"
    if finish == "length":
        return "truncated", "finish_reason: length"
    if not text.strip():
        return "empty", f"no text; finish_reason: {finish or 'none'}"
    return "", ""


def _first_choice(completion: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The first choice, and its message."""
    if "choices" not in completion:
        raise BadBodyError("malformed", "no chat completion: it has no choices")
    choices = completion["choices"] or []
    if not isinstance(choices, list):
        raise BadBodyError("malformed", "no chat completion: choices is no list")
    if not choices:
        raise BadBodyError("empty", "no choices")
    choice = choices[0]
    message = choice.get("message") if isinstance(choice, dict) else None
    if not isinstance(message, dict):
        raise BadBodyError("malformed", "no chat completion: the choice has no message")
    return choice, message


def _usage(usage: Any) -> dict[str, int]:
    counts = usage if isinstance(usage, dict) else {}
    return {
        name: counts[name]
        for name in _COUNTED
        if type(counts.get(name)) is int and 0 <= counts[name] < _MOST_TOKENS
    }


def _encodable(text: str) -> str:
    """The text without half characters, which JSON's escapes can hold and no file can."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def body_of(request: Request, base_url: str) -> dict[str, Any]:
    """Body of a request to a server, as plain data.

    OpenAI's own servers refuse ``max_tokens`` for their newer models; other servers know it alone.
    """
    host = urlsplit(base_url).hostname or ""
    bound = "max_completion_tokens" if host.endswith(".openai.com") else "max_tokens"
    body: dict[str, Any] = {
        "model": request.model,
        "messages": [_message_body(message) for message in request.messages],
        "temperature": request.temperature,
        bound: request.max_tokens,
    }
    if request.seed is not None:
        body["seed"] = request.seed
    return body | _response_format(request)


def _response_format(request: Request) -> dict[str, Any]:
    schema = dict(request.schema)
    if request.structured == "json_schema":
        named = {"name": "answer", "strict": True, "schema": schema}
        return {"response_format": {"type": "json_schema", "json_schema": named}}
    if request.structured == "json_object_schema":
        return {"response_format": {"type": "json_object", "schema": schema}}
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
    environment: no other key, no header. The key is taken out of all that comes back.

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
            body = body_of(request, self.endpoint.base_url)
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
            base_url=self.endpoint.base_url,
            max_retries=0,
            http_client=self._http.Client(
                transport=self._transport.Wire(self.endpoint.key, network, proxy),
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
        limit = self._transport.LONGEST_BODY
        try:
            with call(sdk) as response:
                body = b"".join(response.iter_bytes())
            if len(body) > limit:
                return Answer(failure="malformed", detail=f"a body of more than {limit} bytes")
            return read(self._without_key(body))
        except self._openai.APIStatusError as error:
            refusal = refusal_of(error.status_code, self._without_key(error.response.content))
            return replace(refusal, retry_after=retry_after(error.response.headers))
        except Exception as error:
            # A call never raises: its failure is an answer.
            failure, detail, cause = self._failed(error)
            shown = _short_text(self.endpoint.scrub(detail))
            return Answer(failure=failure, detail=shown, cause=cause)

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
