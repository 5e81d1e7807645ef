"""Capabilities of a server and its model, measured by a few requests."""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, get_args

import numpy as np

from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import NOTHING
from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.client import import_extra
from pytest_dura.llm.endpoint import KEY, MODEL, URL, Endpoint
from pytest_dura.llm.port import (
    LONGEST_PAUSE,
    ONCE,
    Answer,
    ChatPort,
    Image,
    Message,
    Repeats,
    Request,
    Structured,
    TokensField,
)

LEVELS: tuple[Structured, ...] = get_args(Structured)
"""From the strongest to the weakest."""


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a server and its model, whenever and from wherever they are measured.

    Args:
        model: Name of the model.
        fingerprint: SHA-256 of the server's entry for the model, without times.
        structured: The strongest level of structured answers that it takes.
        enforced: Whether it kept to that level when the prompt demanded prose: to the schema, or
            at ``json_object`` to any JSON object.
        vision: Whether it read a code in a picture, and had no answer without the picture.
        seed: Whether two answers with the same seed at temperature 1 were equal.
        context: Tokens of prompt and answer together, where the server lists them.
        attempts: Tries until the first answer.
        requests: All requests that were made.
        words: A sentence on each of these, by name.
        tokens: The field in which it takes the longest answer.
        temperature: Whether it takes a temperature of 0.
        extra_body: Further fields of each request's body, as the environment has them.
        characters_per_token: Of its prompts, where the server counts tokens.
    """

    model: str
    fingerprint: str
    structured: Structured
    enforced: bool
    vision: bool
    seed: bool
    context: int | None = None
    attempts: int = 1
    requests: int = 0
    words: Mapping[str, str] = field(default_factory=dict)
    tokens: TokensField = "max_tokens"
    temperature: bool = True
    extra_body: Mapping[str, Any] = NOTHING
    characters_per_token: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return vars(self) | {"words": dict(self.words), "extra_body": dict(self.extra_body)}


_CONTEXTS = ("max_model_len", "context_length", "context_window")
_STABLE = (
    "id", "owned_by", "root", "parent", "meta", "details", "architecture", "quantization", "digest",
    "version", *_CONTEXTS,
)  # fmt: skip
"""Keys of a model's entry that stay across restarts, unlike ``created`` or ``status``."""
_MOST_MODELS = 20


@dataclass(frozen=True)
class ServerListing:
    """A server's list of models, and the fingerprint in its answers.

    Args:
        entry: Of the model in the list of models; empty where there is none.
        models: The names in that list.
        answer_fingerprint: Of its answers; empty if it varies, or there is none.
        words: A sentence on what the list has of the model.
    """

    entry: Mapping[str, Any]
    models: tuple[str, ...]
    answer_fingerprint: str
    words: str

    @classmethod
    def of(
        cls, listing: str, why_not: str, model: str, fingerprints: Iterable[str]
    ) -> ServerListing:
        """Read the body of ``GET /models``, or why there is none, and the answers' fingerprints."""
        try:
            body = json.loads(listing)
        except (ValueError, RecursionError):  # `words` has it
            body = None
        listed = body.get("data") if isinstance(body, dict) else None
        entries = [
            entry
            for entry in (listed if isinstance(listed, list) else [])
            if isinstance(entry, dict) and isinstance(entry.get("id"), str)
        ]
        models = tuple(str(entry["id"]) for entry in entries)
        entry = next((entry for entry in entries if entry["id"] == model), {})
        distinct = set(fingerprints)
        names = [name for name in _STABLE if name in entry]
        words = f"the list of models tells {', '.join(names)}" if entry else (
            why_not or f"the list of models does not name it, but {len(models)} others"
        )  # fmt: skip
        if len(distinct) > 1:
            words += "; the fingerprint of its answers varies, and is left out"
        fingerprint = distinct.pop() if len(distinct) == 1 else ""
        return cls(entry, models[:_MOST_MODELS], fingerprint, words)

    def fingerprint(self, model: str) -> str:
        """SHA-256, in hexadecimal."""
        stable = {name: self.entry[name] for name in _STABLE if name in self.entry}
        return hashlib.sha256(canonical([model, stable, self.answer_fingerprint])).hexdigest()

    @property
    def context(self) -> int | None:
        """Tokens that it takes at once, where its list has them."""
        meta = self.entry.get("meta")
        places = [self.entry.get(name) for name in _CONTEXTS]
        places.append(meta.get("n_ctx") if isinstance(meta, dict) else None)
        return next((place for place in places if type(place) is int and place > 0), None)


CODE = "K7XM4R"
"""Six letters and digits of which none looks like another."""
_QUESTION = (
    "A code of six letters and digits is written in the picture. Answer with the code alone. If"
    " there is no picture or you cannot see it, answer with the word NONE."
)
_SCALE, _MARGIN, _GAP = 8, 40, 3


def canary() -> Image:
    """Draw the code in black on white, in the built-in bitmap font, the same pixels everywhere.

    Shape about ``(170, 500, 3)``. The enlarged bitmap does not depend on a font library's version.
    """
    pictures, draw = import_extra("PIL.Image"), import_extra("PIL.ImageDraw")
    font = import_extra("PIL.ImageFont").load_default_imagefont()
    letters = []
    for char in CODE:
        left, _, right, bottom = font.getbbox(char)
        letter = pictures.new("L", (right - left + _GAP, bottom), 255)
        draw.Draw(letter).text((-left, 0), char, fill=0, font=font)
        letters.append(np.asarray(letter))
    small = np.hstack(letters)
    ink = np.kron(small, np.ones((_SCALE, _SCALE), dtype=np.uint8))
    page = np.pad(ink, _MARGIN, constant_values=255)
    return Image("canary", np.repeat(page[:, :, None], 3, axis=2).astype(np.uint8))


def holds_code(text: str) -> bool:
    """Whether an answer holds the code, however its characters are set apart."""
    return CODE in "".join(char for char in text.upper() if char.isalnum())


_ATTEMPTS = 3
_BUSY = ("HTTP 429", "HTTP 503")
_NO_ANSWER = ("unavailable", "timeout", "malformed")
_PERMANENT = (401, 403, 404)
_INVALID = (400, 422)


@dataclass(frozen=True)
class Dialect:
    """Fields that a server takes, as far as its refusals have shown."""

    seed: bool = True
    tokens: TokensField = "max_tokens"
    temperature: bool = True

    def applied(self, request: Request) -> Request:
        """The request in this dialect."""
        return replace(
            request,
            seed=request.seed if self.seed else None,
            tokens=self.tokens,
            temperature=request.temperature if self.temperature else None,
        )

    def after(self, refusal: Answer, request: Request) -> Dialect | None:
        """The dialect to try after a refusal that names a field of the request, if it does."""
        if _status_of(refusal) not in _INVALID:
            return None
        if request.tokens != "none" and re.search(r"max_(completion_)?tokens", refusal.detail):
            return self._next_tokens()
        if request.temperature is not None and "temperature" in refusal.detail:
            return replace(self, temperature=False)
        if request.seed is not None and re.search(r"\bseed\b", refusal.detail):
            return replace(self, seed=False)
        return None

    def weaker(self) -> Dialect | None:
        """The dialect to try after a refusal that names nothing; ``None`` after the last one."""
        if self.seed:
            return replace(self, seed=False)
        if self.tokens != "none":
            return self._next_tokens()
        return replace(self, temperature=False) if self.temperature else None

    def _next_tokens(self) -> Dialect:
        names = get_args(TokensField)
        return replace(self, tokens=names[min(names.index(self.tokens) + 1, len(names) - 1)])

    @property
    def words(self) -> str:
        """A sentence on the fields that it does not take."""
        refused = [] if self.tokens == "max_tokens" else ["max_tokens"]
        refused += ["max_completion_tokens"] if self.tokens == "none" else []
        refused += [] if self.temperature else ["temperature"]
        return f"refused {', '.join(refused)}" if refused else "takes max_tokens and temperature"


class ProbePort(ChatPort, Protocol):
    """Port of a server that lists its models."""

    def listing(self, budget: float) -> Answer:
        """The body of ``GET /models`` as the text; see :class:`ChatPort` for failures."""


class ProbeCalls:
    """The calls of one probe.

    Args:
        port: The server.
        endpoint: Its endpoint, for the messages.
        budget: Seconds for each call.
        pause: Seconds before a second try, and twice that before the third.
        retries: Greatest number of retries of a request, if more than two.
    """

    def __init__(
        self, port: ProbePort, endpoint: Endpoint, budget: float, pause: float, retries: int
    ) -> None:
        self._port, self._endpoint, self._budget, self._pause = port, endpoint, budget, pause
        self._repeats = Repeats(max(retries, _ATTEMPTS - 1), allowed=self._repeated)
        self.requests = 0
        self.attempts = 0
        self.dialect = Dialect()
        self.fingerprints: set[str] = set()
        self._counted: dict[int, int] = {}
        """Tokens of a prompt by its number of characters."""

    def ask(self, request: Request) -> Answer:
        """The answer to a request, made in the server's dialect as far as that is known.

        It is repeated where the server is not available: what a server cannot do must not be
        concluded from what it was too busy for. It is also repeated without a field that the
        server names as it refuses it.

        Raises:
            ConfigurationError: If the server stays too busy.
        """
        while True:
            adapted = self.dialect.applied(request)
            answer = self._call(adapted, self._repeats)
            if answer.cause in _BUSY:
                self.attempts = answer.attempts
                raise self._no_answer_error(answer, _status_of(answer))
            dialect = self.dialect.after(answer, adapted)
            if dialect is None:
                return answer
            self.dialect = dialect

    def _repeated(self, _cause: str) -> bool:
        self.requests += 1
        return True

    def _call(self, request: Request, repeats: Repeats = ONCE) -> Answer:
        """Make one call, and count it."""
        self.requests += 1
        answer = self._port.ask(request, self._budget, repeats=repeats)
        if answer.fingerprint:
            self.fingerprints.add(answer.fingerprint)
        tokens = answer.usage.get("prompt_tokens")
        if tokens is not None and not any(message.images for message in request.messages):
            self._counted.setdefault(sum(len(each.text) for each in request.messages), tokens)
        return answer

    @property
    def characters_per_token(self) -> float | None:
        """Characters of a prompt for each token of it; ``None`` where the server counts none.

        From the longest and the shortest prompt, since each has the tokens of a chat's frame, too.
        """
        least, most = min(self._counted, default=0), max(self._counted, default=0)
        tokens = self._counted.get(most, 0) - self._counted.get(least, 0)
        return round((most - least) / tokens, 3) if tokens > 0 else None

    def first(self, request: Request) -> Answer:
        """The first answer, to the request in the dialect of the server.

        Raises:
            ConfigurationError: If there is no answer after all tries, or the server
                refuses for good.
        """
        unanswered = 0
        while True:
            self.attempts += 1
            adapted = self.dialect.applied(request)
            answer = self._call(adapted)
            if answer.failure not in _NO_ANSWER:
                return answer
            status = _status_of(answer)
            if status in _INVALID:
                dialect = self.dialect.after(answer, adapted) or self.dialect.weaker()
                if dialect is None:
                    raise self._no_answer_error(answer, status)
                self.dialect = dialect
                continue
            unanswered += 1
            if status in _PERMANENT or unanswered > self._repeats.most:
                raise self._no_answer_error(answer, status)
            time.sleep(max(self._pause * unanswered, min(answer.retry_after or 0.0, LONGEST_PAUSE)))

    def server(self) -> ServerListing:
        """The server's listing; called last, it covers the fingerprints of all answers."""
        self.requests += 1
        listing = self._port.listing(self._budget)
        why_not = f"there is no list of models: {listing.detail}" if listing.failure else ""
        return ServerListing.of(listing.text, why_not, self._endpoint.model, self.fingerprints)

    def _no_answer_error(self, answer: Answer, status: int | None) -> ConfigurationError:
        tries = "1 try" if self.attempts == 1 else f"{self.attempts} tries"
        return ConfigurationError(
            f"the language model {self._endpoint.model!r} at {self._endpoint.public} gave no"
            f" answer in {tries} ({answer.failure}): {answer.detail}",
            key=KEY if status in (401, 403) else URL,
            expected="an OpenAI-compatible server that answers within"
            f" {self._budget:g} s at {self._endpoint.public}/chat/completions",
            remedy=self._remedy(answer, status),
        )

    def _remedy(self, answer: Answer, status: int | None) -> str:
        if status in (401, 403):
            return f"check {KEY}"
        if status == 404:
            models = ", ".join(self.server().models)
            known = f"; the server lists {models}" if models else ""
            return f"check {URL}, which often ends with /v1, and {MODEL}{known}"
        if status == 429:
            return "wait until the server has time, or raise DURA_LLM_RETRIES"
        if status is not None and 400 <= status < 500:
            return f"check {MODEL}, and what the server says"
        if answer.failure == "timeout":
            return "wait until the model is loaded, or give it more time"
        return f"start the server, or check {URL}"


def _status_of(answer: Answer) -> int | None:
    """The HTTP status with which a server refused, where it was that."""
    match = re.match(r"HTTP (\d{3}): ", answer.detail) if answer.failure else None
    return int(match[1]) if match else None


SEED = 7
SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "properties": {
        "words": {"type": "array", "items": {"type": "string", "maxLength": 16}, "maxItems": 3},
        "sentence": {"type": "string", "maxLength": 120},
        "mood": {"type": "string", "enum": ["calm", "rough"]},
    },
    "required": ["words", "sentence", "mood"],
    "additionalProperties": False,
}
"""A schema that each server can enforce that enforces any; llama.cpp ignores bounds of numbers."""
_SAMPLE = (
    "The rows below are objects near a car: id, kind, distance in m, speed in m/s, and the time in"
    " s until each of them is on the lane of the car. They are an example, and are of no importance"
    " for what is asked of you here; read them, and then forget them again.\n"
    "V1,car,12.4,ahead,11.9,-3.2,8.0,3.1,crossing,4.5,1.9\n"
    "V2,truck,31.0,left,-2.6,30.9,6.5,-0.4,oncoming,8.2,2.5\n"
    "P1,pedestrian,7.8,right,7.7,1.1,1.4,0.9,crossing,0.6,0.6\n"
)
"""A text of words and numbers, as a prompt is made of, of which the server counts the tokens."""
_VARIED = "Write twelve random words on one line, and nothing else."
_TEMPTING = (
    f"{_SAMPLE}Describe the sea in one sentence of plain prose. Do not write JSON, and no braces."
    " Begin with the words: The sea"
)


def probe(
    port: ProbePort, endpoint: Endpoint, budget: float, *, pause: float = 0.5,
    schema: Mapping[str, Any] = SCHEMA, retries: int = 0,
) -> Capabilities:  # fmt: skip
    """Measure the capabilities of a server and its model, in 5 to 9 requests.

    Each field that the server refuses costs one more.

    Args:
        port: The server.
        endpoint: Names the model; its public URL stands in the message of an error.
        budget: Seconds for each request.
        pause: Seconds before the first request is tried again; it is tried three times.
        schema: Of the structured answers, as
            :func:`~pytest_dura.llm.answers.read_answer` reads it.
        retries: How often a request is repeated whose server is not available, if more than twice.

    Raises:
        ConfigurationError: If the server gives no answer at all, or stays too busy.
    """
    calls = ProbeCalls(port, endpoint, budget, pause, retries)
    plain = Request(endpoint.model, (), max_tokens=700, extra=endpoint.extra_body)
    seed, seed_words = _seed(calls, plain)
    plain = replace(plain, seed=SEED if seed else None)
    structured, enforced, structured_words = _structured(calls, plain, schema)
    vision, vision_words = _vision(calls, plain)
    server = calls.server()
    context = server.context
    return Capabilities(
        model=endpoint.model,
        fingerprint=server.fingerprint(endpoint.model),
        structured=structured,
        enforced=enforced,
        vision=vision,
        seed=seed,
        context=context,
        attempts=calls.attempts,
        requests=calls.requests,
        words={
            "structured": structured_words,
            "vision": vision_words,
            "seed": seed_words,
            "server": server.words,
            "context": "the server tells none" if context is None else f"{context} tokens",
            "fields": calls.dialect.words,
        },
        tokens=calls.dialect.tokens,
        temperature=calls.dialect.temperature,
        extra_body=endpoint.extra_body,
        characters_per_token=calls.characters_per_token,
    )


def _seed(calls: ProbeCalls, plain: Request) -> tuple[bool, str]:
    """Whether equal seeds give equal answers where the sampling is free."""
    request = replace(plain, messages=(Message("user", _VARIED),), temperature=1.0, seed=SEED,
                      max_tokens=200)  # fmt: skip
    first = calls.first(request)
    if not calls.dialect.seed:
        return False, "a request with a seed was refused"
    second = calls.ask(request)
    if not first.text.strip() or not second.text.strip():
        failure = (first if not first.text.strip() else second).failure
        return False, f"there was nothing to compare ({failure})"
    equal = "equal" if first.text == second.text else "different"
    return first.text == second.text, (
        f"two answers with seed {SEED} at temperature 1, of {len(first.text)} and"
        f" {len(second.text)} characters, were {equal}"
    )


def _structured(
    calls: ProbeCalls, plain: Request, schema: Mapping[str, Any]
) -> tuple[Structured, bool, str]:
    """The strongest level that is enforced; else the strongest that is taken at all."""
    taken: list[Structured] = []
    words = []
    tempting = replace(plain, messages=(Message("user", _TEMPTING),))
    for level in LEVELS[:-1]:
        kept = {"type": "object"} if level == "json_object" else schema
        answer = calls.ask(replace(tempting, structured=level, schema=schema))
        reading = read_answer(answer, kept)
        if reading.answered:
            words.append(f"{level}: kept to it when asked for prose")
            return level, True, "; ".join(words)
        # A server that does not know tools answers as if there were none.
        called = reading.outcome in ("schema_violation", "unknown_action")
        if called if level == "tool" else answer.failure in ("", "truncated", "empty"):
            taken.append(level)
        words.append(f"{level}: {reading.outcome}, {reading.detail}")
    return (taken[0] if taken else "none"), False, "; ".join(words)


def _vision(calls: ProbeCalls, plain: Request) -> tuple[bool, str]:
    """Whether a code in a picture comes back, and does not without the picture."""
    seen = calls.ask(replace(plain, messages=(Message("user", _QUESTION, (canary(),)),)))
    if not holds_code(seen.text):
        came = f"{seen.failure}, {seen.detail}" if seen.failure else "another answer"
        return False, f"the code in the picture did not come back: {came}"
    blind = calls.ask(replace(plain, messages=(Message("user", _QUESTION),)))
    if holds_code(blind.text):
        return False, f"the code {CODE} came back without the picture, too"
    return True, f"the code {CODE} in the picture came back, and not without the picture"
