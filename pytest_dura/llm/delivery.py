"""Delivery: what becomes of a request on its way to a model, and of the answer on its way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from pytest_dura.llm.port import Answer, Request, ServerFault

if TYPE_CHECKING:
    from pytest_dura.llm.client import OpenAiClient


def scrubbed(request: Request, scrub: Callable[[str], str]) -> Request:
    """The request as it may be sent: the very same unless a text holds the server's key."""
    messages = tuple(replace(one, text=scrub(one.text)) for one in request.messages)
    return request if messages == request.messages else replace(request, messages=messages)


def injected(request: Request, limit: float, fault: ServerFault) -> Answer:
    """How a request fails at a server that has this fault. No server is asked or needed.

    Args:
        request: What is asked.
        limit: Seconds for the answer.
        fault: How the server fails.

    Raises:
        ConfigurationError: If the extra ``llm`` is not installed.
    """
    # In live and in replay alike: what it says must not depend on which server there is.
    return replace(_nobody().ask(request, limit, fault), seconds=0.0)


def delivered(answer: Answer, delay: float, limit: float) -> Answer:
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
def _nobody() -> OpenAiClient:
    from pytest_dura.llm.client import OpenAiClient
    from pytest_dura.llm.endpoint import Endpoint

    return OpenAiClient(Endpoint("http://127.0.0.1/v1", "none"))
