"""Answers of a language model: their schema, their strict reading, and the classes of failure."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, create_model

from pytest_dura.core.episode import canonical
from pytest_dura.core.percepts import NOTHING
from pytest_dura.llm.port import Answer

ANSWERED: Literal["answered"] = "answered"

Failure = Literal[
    "unavailable", "timeout", "empty", "refused", "truncated", "malformed", "schema_violation",
    "unknown_action",
]  # fmt: skip
Outcome = Literal["answered", Failure]

FAILURES: tuple[Failure, ...] = get_args(Failure)
OUTCOMES: tuple[Outcome, ...] = (ANSWERED, *FAILURES)

FAILURE_MEANINGS: Mapping[Failure, str] = {
    "unavailable": "the server could not be reached, or answered with an error",
    "timeout": "no whole answer within the deadline",
    "empty": "an answer without a text",
    "refused": "the model or its server declined to answer",
    "truncated": "the answer ended before it was complete",
    "malformed": "what came is no chat completion, or its text is no JSON object",
    "schema_violation": "a JSON object that does not keep to the schema",
    "unknown_action": "an answer that keeps to the schema but for a maneuver that does not exist",
}


LONGEST = 20_000
"""Characters of the longest text that is read."""

OBSERVATIONS, REASONING = 240, 480
"""Bounds of an answer's texts, in characters. llama.cpp's server refuses strings without one."""
IDS, ID_LENGTH = 3, 16
"""Ids that may be cited, and their characters."""
CLAIMS = 4
"""Claims that an answer may state."""
OPTIONAL = frozenset({"claims"})
"""Keys of an answer that it may lack: a model that was made without them stays valid."""


def answer_schema(
    actions: Sequence[str], intents: Sequence[str], claim: Mapping[str, Any] = NOTHING
) -> dict[str, Any]:
    """The JSON schema of an answer, every string bounded, the reasoning before the decision.

    Args:
        actions: The values of ``maneuver``.
        intents: The values of ``intent``.
        claim: Schemas of what is claimed of an object, by name, where an answer states claims.
    """
    claims = {
        "type": "array",
        "items": _object_schema({"id": {"type": "string", "maxLength": ID_LENGTH}, **claim}),
        "maxItems": CLAIMS,
    }
    properties = {
        "observations": {"type": "string", "maxLength": OBSERVATIONS},
        **({"claims": claims} if claim else {}),
        "threat_ids": {
            "type": "array",
            "items": {"type": "string", "maxLength": ID_LENGTH},
            "maxItems": IDS,
        },
        "reasoning": {"type": "string", "maxLength": REASONING},
        "intent": {"type": "string", "enum": list(intents)},
        "maneuver": {"type": "string", "enum": list(actions)},
        # Grammars of servers bound whole numbers; llama.cpp's lets any other number pass.
        "confidence": {"type": "integer", "minimum": 0, "maximum": 100},
    }
    return _object_schema(properties)


def _object_schema(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties),
        "additionalProperties": False,
    }


def without(schema: Mapping[str, Any], keys: Collection[str]) -> Mapping[str, Any]:
    """The schema of an object without some of its keys."""
    properties = schema.get("properties", {})
    if not set(keys) & set(properties):
        return schema
    return _object_schema({name: value for name, value in properties.items() if name not in keys})


@dataclass(frozen=True)
class Reading:
    """Result of reading an answer.

    Args:
        outcome: ``answered``, or the class of the failure.
        detail: What is wrong, in a few words.
        content: The answer's object, where there is one that keeps to the schema.
    """

    outcome: Outcome
    detail: str = ""
    content: Mapping[str, Any] = NOTHING

    @property
    def answered(self) -> bool:
        """Whether it is a decision."""
        return self.outcome == ANSWERED


def read_answer(answer: Answer, schema: Mapping[str, Any]) -> Reading:
    """Read an answer strictly: the whole text is one JSON object that keeps to the schema.

    Nothing is mended: no text around the object, no code fence, no repeated key, no NaN.

    Args:
        answer: The answer of the server.
        schema: Of :func:`answer_schema`.
    """
    if answer.failure:
        return Reading(answer.failure, answer.detail)
    if not answer.text.strip():
        return Reading("empty", "the text is blank")
    if len(answer.text) > LONGEST:
        return Reading("malformed", f"a text of {len(answer.text)} characters")
    try:
        data = json.loads(
            answer.text, object_pairs_hook=_without_repeats, parse_constant=refuse_constant
        )
        answer.text.encode()
        json.dumps(data, ensure_ascii=False).encode()  # escapes may hide half a character
    except (ValueError, RecursionError) as error:
        return Reading("malformed", _shortened(f"no JSON: {error}"))
    if not isinstance(data, dict):
        return Reading("malformed", f"JSON, but no object: {type(data).__name__}")
    return _checked(data, schema)


def _checked(content: dict[str, Any], schema: Mapping[str, Any]) -> Reading:
    try:
        _answer_model(canonical(schema)).model_validate(content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    else:
        return Reading(ANSWERED, content=content)
    unknown = all(
        problem["loc"] == ("maneuver",) and problem["type"] == "literal_error"
        for problem in problems
    )
    if unknown and isinstance(content["maneuver"], str):
        return Reading("unknown_action", _shortened(f"maneuver {content['maneuver']!r}"))
    first = problems[0]
    place = ".".join(map(str, first["loc"]))
    return Reading("schema_violation", _shortened(f"{_shortened(place, 60)}: {first['msg']}"))


@lru_cache(maxsize=16)
def _answer_model(schema: bytes) -> type[BaseModel]:
    """A model of pydantic for the schema of an object whose texts are bounded.

    The library jsonschema reads any schema, and takes seconds to import where its optional
    dependencies are installed.
    """
    return _object_type(json.loads(schema))


def _object_type(schema: Mapping[str, Any]) -> type[BaseModel]:
    properties = schema.get("properties")
    fields: Any = {
        name: (_value_type(value), Field(default_factory=list) if name in OPTIONAL else ...)
        for name, value in (properties or {}).items()
    }
    config = ConfigDict(extra="allow" if properties is None else "forbid", strict=True)
    model: type[BaseModel] = create_model("Answer", __config__=config, **fields)
    return model


def _value_type(schema: Mapping[str, Any]) -> Any:
    """The type of one value: a word, a text, a number, an object, or a list of one of these."""
    if "enum" in schema:
        return Literal[tuple(schema["enum"])]
    if schema["type"] == "array":
        return Annotated[list[_value_type(schema["items"])], Field(max_length=schema["maxItems"])]  # type: ignore[misc] # made here
    if schema["type"] == "object":
        return _object_type(schema)
    if schema["type"] == "string":
        return Annotated[str, Field(max_length=schema["maxLength"])]
    bounds = Field(ge=schema.get("minimum"), le=schema.get("maximum"))
    if schema["type"] == "integer":
        return Annotated[int, bounds, BeforeValidator(_whole)]
    return Annotated[float, bounds, Field(allow_inf_nan=False)]


def _whole(value: Any) -> Any:
    """50 for 50.0, which is the same number in JSON."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a key stands there twice")
    return values


def refuse_constant(name: str) -> float:
    """Refuse NaN and infinities, which Python's reader of JSON takes.

    Raises:
        ValueError: Always.
    """
    raise ValueError(f"{name} is no number of JSON")


def _shortened(text: str, most: int = 200) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."
