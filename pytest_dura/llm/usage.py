"""Usage: requests and tokens of a session, and the limits at which it ends."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

from pytest_dura.core.codec import Count
from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.llm.port import Answer

_CHARACTERS_PER_TOKEN = 4


def estimate_tokens(*texts: str, characters_per_token: float | None = None) -> int:
    """Estimate the tokens of texts.

    Args:
        texts: The texts.
        characters_per_token: As a server counted them; by default four, as English text has.
    """
    per_token = characters_per_token or _CHARACTERS_PER_TOKEN
    return sum(math.ceil(len(text) / per_token) for text in texts)


@dataclass(frozen=True)
class Tokens:
    """Tokens of one or more requests, as the server counted them.

    Args:
        prompt: Of the requests.
        completion: Of the answers.
        uncounted: Answers for which the server counted nothing.
    """

    prompt: Count = 0
    completion: Count = 0
    uncounted: Count = 0

    @classmethod
    def of(cls, usage: Mapping[str, int], *, answered: bool) -> Tokens:
        """Those of one request.

        Args:
            usage: ``prompt_tokens`` and ``completion_tokens``, as the answer gives them.
            answered: Whether the model answered: a failure without usage is no uncounted answer.
        """
        prompt, completion = (usage.get(f"{name}_tokens") for name in ("prompt", "completion"))
        if prompt is None or completion is None:
            return cls(prompt or 0, completion or 0, int(answered))
        return cls(prompt, completion)

    def __add__(self, other: Tokens) -> Tokens:
        return Tokens(*(getattr(self, x.name) + getattr(other, x.name) for x in fields(self)))

    @property
    def text(self) -> str:
        """In words; empty where there is nothing to say."""
        if self == Tokens():
            return ""
        text = f"{self.prompt} + {self.completion} tokens (prompts + answers)"
        if self.uncounted:
            answers = "1 answer" if self.uncounted == 1 else f"{self.uncounted} answers"
            text += f"; the server counted none for {answers}"
        return text

    @property
    def total(self) -> int:
        """Tokens of requests and answers."""
        return self.prompt + self.completion


def usage_of(answers: Iterable[Answer]) -> dict[str, int]:
    """What the requests behind some answers used, as an account says it.

    Args:
        answers: Answers, also those from a cassette.
    """
    requests, tokens = 0, Tokens()
    for answer in answers:
        requests += 1
        tokens += Tokens.of(answer.usage, answered=not answer.failure)
    return {"requests": requests, **asdict(tokens)}


@dataclass(frozen=True)
class Limits:
    """What a session may ask of servers; ``None`` where there is no limit.

    Args:
        requests: Number of requests.
        tokens: Of prompts and answers.
    """

    requests: int | None = None
    tokens: int | None = None

    @classmethod
    def parse(cls, text: str, key: str) -> Limits:
        """Parse ``requests=5000,tokens=2e6``, or one of these.

        Raises:
            ConfigurationError: For anything else.
        """
        names = [each.name for each in fields(cls)]
        values: dict[str, int] = {}
        for part in text.split(","):
            name, _, amount = (each.strip() for each in part.partition("="))
            try:
                number = float(amount)
            except ValueError:
                number = 0.0
            if name not in names or name in values or number <= 0.0 or not number.is_integer():
                raise ConfigurationError(
                    f"{key} limits what a session asks of language models",
                    key=key,
                    found=text,
                    expected=f"{', '.join(names)}, each once at most, with a whole number above 0",
                    remedy=f"for example {key}=requests=5000,tokens=2e6",
                )
            values[name] = int(number)
        return cls(**values)


class Meter:
    """What the processes of a session have asked of servers so far, against its limits.

    Args:
        limits: Those of the session.
        file: Shared by the processes of the session, each of which adds what it asks.
    """

    def __init__(self, limits: Limits = Limits(), file: Path | None = None) -> None:
        self.limits = limits
        self._file, self._read = file, 0
        self._requests, self._tokens = 0, Tokens()
        self._lock = Lock()

    def begin(self) -> str | None:
        """Count a request that is about to be made.

        Returns:
            The limit that is reached, in words; then it may not be made.
        """
        if self.limits == Limits():
            return None
        with self._lock:
            self._add(1, Tokens())
            limits = self.limits
            if limits.requests is not None and self._requests > limits.requests:
                return f"{limits.requests} requests"
            if limits.tokens is not None and self._tokens.total >= limits.tokens:
                return f"{limits.tokens} tokens"
            return None

    def end(self, tokens: Tokens) -> None:
        """Count the tokens of a request that was made."""
        if self.limits != Limits():
            with self._lock:
                self._add(0, tokens)

    def _add(self, requests: int, tokens: Tokens) -> None:
        if self._file is None:
            self._requests, self._tokens = self._requests + requests, self._tokens + tokens
            return
        # What is appended in one write is whole, also beside the writes of other processes.
        with self._file.open("ab", buffering=0) as stream:
            stream.write(f"{requests} {tokens.prompt} {tokens.completion}\n".encode())
        with self._file.open("rb") as stream:
            stream.seek(self._read)
            added = stream.read()
        for line in added.splitlines():
            other, prompt, completion = map(int, line.split())
            self._requests += other
            self._tokens += Tokens(prompt, completion)
        self._read += len(added)
