"""The port to a language model: requests, answers, and faults on the way there."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.codec import Amount, Positive, decode
from pytest_dura.core.episode import canonical
from pytest_dura.core.percepts import NOTHING

WireFailure = Literal["", "unavailable", "timeout", "empty", "refused", "truncated", "malformed"]
"""How a call can fail before there is a whole text to read; empty if it did not. Here
``malformed`` is a body that is no chat completion."""

Structured = Literal["json_schema", "json_object_schema", "tool", "json_object", "none"]
"""How a server is asked for a structured answer: OpenAI's ``json_schema``; llama-cpp-python's
``json_object`` with a ``schema``; a ``tool`` that has to be called, whose arguments are the answer;
``json_object`` alone; or by the words of the prompt only."""

TokensField = Literal["max_tokens", "max_completion_tokens", "none"]
"""The field in which a server takes the longest answer; ``none`` for one that takes no bound."""


@dataclass(frozen=True, eq=False)
class Image:
    """Picture in a message.

    Args:
        name: The channel that it comes from, such as ``camera_front``.
        pixels: RGB, shape ``(height, width, 3)``, ``uint8``.
    """

    name: str
    pixels: NDArray[np.uint8]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its pixels and shape, whatever a file format makes of them."""
        shape = "x".join(map(str, self.pixels.shape))
        data = np.ascontiguousarray(self.pixels, dtype=np.uint8).tobytes()
        return hashlib.sha256(shape.encode() + b"|" + data).hexdigest()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Image):
            return NotImplemented
        return (self.name, self.digest) == (other.name, other.digest)

    def __hash__(self) -> int:
        return hash((self.name, self.digest))


@dataclass(frozen=True)
class Message:
    """Message of a conversation; ``images`` come before the text."""

    role: Literal["system", "user", "assistant"]
    text: str
    images: tuple[Image, ...] = ()


@dataclass(frozen=True)
class Request:
    """Request: all that determines an answer, as far as a client can.

    Args:
        model: Name of the model.
        messages: The conversation.
        schema: JSON schema of the answer.
        structured: How the server is asked to keep to it.
        temperature: Of the sampling; 0 takes the most likely token. ``None`` is not sent.
        max_tokens: Longest answer.
        seed: Of the sampling; ``None`` where the server takes none.
        sample: Number of the sample, where the same request is made several times.
        tokens: The field that has ``max_tokens``.
        extra: Further fields of the body, as they are sent.
        stream: Whether the answer comes in parts, so that the time to the first is known.
    """

    model: str
    messages: tuple[Message, ...]
    schema: Mapping[str, Any] = NOTHING
    structured: Structured = "none"
    temperature: float | None = 0.0
    max_tokens: int = 700
    seed: int | None = None
    sample: int = 0
    tokens: TokensField = "max_tokens"
    extra: Mapping[str, Any] = NOTHING
    stream: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return plain data, with images by their digests. It holds no key and no address.

        What only few requests have is left out where they have it not: their keys stay as they were
        before there was such a thing.
        """
        messages = []
        for message in self.messages:
            images = [{"name": image.name, "sha256": image.digest} for image in message.images]
            messages.append({"role": message.role, "text": message.text, "images": images})
        given = {"messages": messages, "schema": dict(self.schema), "extra": dict(self.extra)}
        return _without_usual(vars(self) | given, REQUEST_EXTRAS)

    def key(self, fingerprint: str) -> str:
        """SHA-256 of the request to a server with this fingerprint."""
        return hashlib.sha256(canonical([self.to_json(), fingerprint])).hexdigest()


def _without_usual(data: Mapping[str, Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    return {key: data[key] for key in data if key not in usual or data[key] != usual[key]}


REQUEST_EXTRAS: dict[str, Any] = {"tokens": "max_tokens", "extra": {}, "stream": False}
"""Parts of a request that its plain data may lack, with what they are then."""


@dataclass(frozen=True)
class Answer:
    """Answer of a server. A call never raises: its failure is an answer, too.

    Args:
        text: The raw text without thoughts, or the arguments of the tool, of bounded length.
        failure: Why there is no whole text, if so.
        detail: Message of the server or the connection on the failure, shortened.
        seconds: Wall-clock seconds that it took.
        finish: Why the model ended, as the server has it.
        usage: Tokens, as the server counted them.
        fingerprint: Of the server, if it sends one with each answer.
        cause: Why it was ``unavailable``: ``HTTP 429`` and the like, ``connection``, or ``request``
            for one that could not be made.
        retry_after: Seconds after which the server wants to be asked again, where it says so.
        attempts: Requests that were made; see :class:`Repeats`.
        waited: Wall-clock seconds before the last of these calls began; not in ``seconds``.
        thoughts: What a reasoning model thought before it answered, as far as the server tells, of
            bounded length.
        first_token: Wall-clock seconds until the first part of the answer or the thoughts came,
            where it was streamed.
    """

    text: str = ""
    failure: WireFailure = ""
    detail: str = ""
    seconds: Amount = 0.0
    finish: str = ""
    usage: Mapping[str, int] = field(default_factory=dict)
    fingerprint: str = ""
    cause: str = ""
    retry_after: Amount | None = None
    attempts: Positive = 1
    waited: Amount = 0.0
    thoughts: str = ""
    first_token: Amount | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data; what only few answers have is left out where they have it not."""
        return _without_usual(vars(self) | {"usage": dict(self.usage)}, ANSWER_EXTRAS)

    def scrubbed(self, scrub: Callable[[str], str]) -> Answer:
        """The answer with all texts of the server, each as ``scrub`` returns it."""
        names = ("text", "detail", "finish", "fingerprint", "thoughts")
        texts: dict[str, Any] = {name: scrub(getattr(self, name)) for name in names}
        return replace(self, **texts)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Answer:
        """The inverse of :meth:`to_json`.

        Raises:
            MismatchError: If the data is no answer.
        """
        return decode(cls, {**ANSWER_EXTRAS, **data})


ANSWER_EXTRAS: dict[str, Any] = {
    name: getattr(Answer(), name)
    for name in ("cause", "retry_after", "attempts", "waited", "thoughts", "first_token")
}
"""Parts of an answer that its plain data may lack, with what they are then."""


ServerFault = Literal["", "refused", "http_429", "http_500", "cut", "garbage", "error_text"]
"""How a server can be made to fail: it refuses the connection, answers 429 or 500, ends in the
middle of its answer, answers with what is no JSON, or with status 200 and an error."""


@dataclass(frozen=True)
class Delivery:
    """How a request reaches the model; the message on the channel ``model``.

    Args:
        fault: How the server fails instead of answering, if so.
        delay: Seconds that the answer takes longer.
    """

    fault: ServerFault = ""
    delay: float = 0.0


LONGEST_PAUSE = 60.0
"""Seconds; a server that wants to be left alone for longer is not asked again."""


@dataclass(frozen=True)
class Repeats:
    """Rule for repeating a request whose server answers 429 or 503, or takes no connection.

    Nothing else is repeated: what a model answers counts, whatever it is.

    Args:
        most: Greatest number of repetitions.
        counted: Whether requests that were repeated, and the pauses, are part of the budget.
        allowed: Says whether a request may be made again after one that failed for this cause.
    """

    most: int = 0
    counted: bool = False
    allowed: Callable[[str], bool] = lambda _cause: True

    def time_for(self, limit: float) -> float:
        """Longest time in s that a request takes whose every attempt may take ``limit`` seconds."""
        return limit if self.counted else (self.most + 1) * limit + self.most * 2 * LONGEST_PAUSE


ONCE = Repeats()


class ChatPort(Protocol):
    """A language model behind some wire."""

    def ask(
        self, request: Request, budget: float, fault: ServerFault = "", repeats: Repeats = ONCE
    ) -> Answer:
        """Make one call that ends within the budget.

        Args:
            request: The request.
            budget: Seconds of wall-clock time.
            fault: How the server is made to fail; then nothing is sent to the real one.
            repeats: Whether the request is repeated where its server is not available.
        """
