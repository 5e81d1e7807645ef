"""The probe: a few requests that show what a server does, whatever it says that it can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.capabilities.asking import Asking, Probed
from pytest_dura.llm.capabilities.canary import CODE, QUESTION, canary, tells
from pytest_dura.llm.capabilities.found import LEVELS, Capabilities
from pytest_dura.llm.endpoint import Endpoint
from pytest_dura.llm.port import Answer, Message, Request, Structured

__all__ = ["Probed", "probe"]

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
"""What each server that enforces schemas can enforce; llama.cpp leaves out bounds of numbers."""
_VARIED = "Write twelve random words on one line, and nothing else."
_TEMPTING = (
    "Describe the sea in one sentence of plain prose. Do not write JSON, and no braces. Begin with"
    " the words: The sea"
)


def probe(
    port: Probed, endpoint: Endpoint, budget: float, *, pause: float = 0.5,
    schema: Mapping[str, Any] = SCHEMA,
) -> Capabilities:  # fmt: skip
    """Find out what a server and its model can do, in 5 to 8 requests.

    Args:
        port: Who is asked.
        endpoint: Names the model; its public URL stands in the message of an error.
        budget: Seconds for each request.
        pause: Seconds before the first request is tried again; it is tried three times.
        schema: Of the structured answers that are asked for, as
            :func:`~pytest_dura.llm.answers.read_answer` reads it.

    Raises:
        ConfigurationError: If the server gives no answer at all.
    """
    asking = Asking(port, endpoint, budget, pause)
    plain = Request(endpoint.model, (), max_tokens=700)
    seed, seed_words = _seed(asking, plain)
    plain = replace(plain, seed=SEED if seed else None)
    structured, enforced, structured_words = _structured(asking, plain, schema)
    vision, vision_words = _vision(asking, plain)
    server = asking.server()
    context = server.context
    return Capabilities(
        model=endpoint.model,
        fingerprint=server.fingerprint(endpoint.model),
        structured=structured,
        enforced=enforced,
        vision=vision,
        seed=seed,
        context=context,
        attempts=asking.attempts,
        requests=asking.requests,
        words={
            "structured": structured_words,
            "vision": vision_words,
            "seed": seed_words,
            "server": server.words,
            "context": "the server tells none" if context is None else f"{context} tokens",
        },
    )


def _seed(asking: Asking, plain: Request) -> tuple[bool, str]:
    """Whether equal seeds give equal answers where the sampling is free."""
    wanted = replace(plain, messages=(Message("user", _VARIED),), temperature=1.0, seed=SEED,
                     max_tokens=200)  # fmt: skip
    first, used = asking.first(wanted)
    if used.seed is None:
        return False, "a request with a seed was refused"
    second = asking.ask(wanted)
    if not first.text.strip() or not second.text.strip():
        failure = (first if not first.text.strip() else second).failure
        return False, f"there was nothing to compare ({failure})"
    equal = "equal" if first.text == second.text else "different"
    return first.text == second.text, (
        f"two answers with seed {SEED} at temperature 1, of {len(first.text)} and"
        f" {len(second.text)} characters, were {equal}"
    )


def _structured(
    asking: Asking, plain: Request, schema: Mapping[str, Any]
) -> tuple[Structured, bool, str]:
    """The strongest level that is enforced; else the strongest that is taken at all."""
    taken: list[Structured] = []
    words = []
    tempting = replace(plain, messages=(Message("user", _TEMPTING),))
    for level in LEVELS[:-1]:
        kept = {"type": "object"} if level == "json_object" else schema
        answer = asking.ask(replace(tempting, structured=level, schema=schema))
        reading = read_answer(answer, kept)
        if reading.answered:
            words.append(f"{level}: kept to it when asked for prose")
            return level, True, "; ".join(words)
        if answer.failure in ("", "truncated", "empty"):
            taken.append(level)
        words.append(f"{level}: {reading.outcome}, {reading.detail}")
    return (taken[0] if taken else "none"), False, "; ".join(words)


def _vision(asking: Asking, plain: Request) -> tuple[bool, str]:
    """Whether a code in a picture comes back, and does not without the picture."""
    seen = asking.ask(replace(plain, messages=(Message("user", QUESTION, (canary(),)),)))
    if not tells(seen.text):
        return False, f"the code in the picture did not come back: {_told(seen)}"
    blind = asking.ask(replace(plain, messages=(Message("user", QUESTION),)))
    if tells(blind.text):
        return False, f"the code {CODE} came back without the picture, too"
    return True, f"the code {CODE} in the picture came back, and not without the picture"


def _told(answer: Answer) -> str:
    return f"{answer.failure}, {answer.detail}" if answer.failure else "another answer"
