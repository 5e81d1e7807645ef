"""What a call of a language model comes to: a decision, or one class of failure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

ANSWERED: Literal["answered"] = "answered"

Failure = Literal[
    "unavailable",
    "timeout",
    "empty",
    "refused",
    "truncated",
    "malformed",
    "schema_violation",
    "unknown_action",
]
Outcome = Literal["answered", Failure]

FAILURES: tuple[Failure, ...] = get_args(Failure)
OUTCOMES: tuple[Outcome, ...] = (ANSWERED, *FAILURES)

MEANINGS: Mapping[Failure, str] = {
    "unavailable": "the server could not be reached, or answered with an error",
    "timeout": "no whole answer within the deadline",
    "empty": "an answer without a text",
    "refused": "the model or its server declined to answer",
    "truncated": "the answer ended before it was complete",
    "malformed": "what came is no chat completion, or its text is no JSON object",
    "schema_violation": "a JSON object that does not keep to the schema",
    "unknown_action": "an answer that keeps to the schema but for a maneuver that does not exist",
}
