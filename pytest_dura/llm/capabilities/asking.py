"""Asking: the probe's calls, counted, and the first of them tried more than once."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from typing import Protocol

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.capabilities.server import Server
from pytest_dura.llm.endpoint import KEY, MODEL, URL, Endpoint
from pytest_dura.llm.port import Answer, ChatPort, Request

ATTEMPTS = 3
_DEAD = ("unavailable", "timeout", "malformed")
_FOR_GOOD = (401, 403, 404)


class Probed(ChatPort, Protocol):
    """A port whose server tells of its models."""

    def listing(self, budget: float) -> Answer:
        """The body of ``GET /models`` as the text; see :class:`ChatPort` for failures."""


class Asking:
    """The calls of one probe.

    Args:
        port: Who is asked.
        endpoint: Whose model, for the messages.
        budget: Seconds for each call.
        pause: Seconds before a second try, and twice that before the third.
    """

    def __init__(self, port: Probed, endpoint: Endpoint, budget: float, pause: float) -> None:
        self._port, self._endpoint, self._budget, self._pause = port, endpoint, budget, pause
        self.requests = 0
        self.attempts = 0
        self.fingerprints: set[str] = set()

    def ask(self, request: Request) -> Answer:
        """One call."""
        self.requests += 1
        answer = self._port.ask(request, self._budget)
        if answer.fingerprint:
            self.fingerprints.add(answer.fingerprint)
        return answer

    def first(self, request: Request) -> tuple[Answer, Request]:
        """The first answer, and the request that got it: without a seed if it was refused so.

        Raises:
            ConfigurationError: If there is no answer after :data:`ATTEMPTS` tries, or the server
                refuses for good.
        """
        while True:
            self.attempts += 1
            answer = self.ask(request)
            if answer.failure not in _DEAD:
                return answer, request
            status = status_of(answer)
            if status in _FOR_GOOD or self.attempts == ATTEMPTS:
                raise self._given_up(answer, status)
            if status in (400, 422):
                request = replace(request, seed=None)
            else:
                time.sleep(self._pause * self.attempts)

    def server(self) -> Server:
        """What the server tells of itself; best asked last."""
        self.requests += 1
        listing = self._port.listing(self._budget)
        why_not = f"there is no list of models: {listing.detail}" if listing.failure else ""
        return Server.of(listing.text, why_not, self._endpoint.model, self.fingerprints)

    def _given_up(self, answer: Answer, status: int | None) -> ConfigurationError:
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
        if status is not None and 400 <= status < 500:
            return f"check {MODEL}, and what the server says"
        if answer.failure == "timeout":
            return "wait until the model is loaded, or give it more time"
        return f"start the server, or check {URL}"


def status_of(answer: Answer) -> int | None:
    """The HTTP status with which a server refused, where it was that."""
    found = re.match(r"HTTP (\d{3}): ", answer.detail) if answer.failure else None
    return int(found[1]) if found else None
