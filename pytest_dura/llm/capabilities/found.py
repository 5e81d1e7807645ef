"""Capabilities: what the probe found, as plain data for evidence and cassettes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, get_args

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.port import Structured

LEVELS: tuple[Structured, ...] = get_args(Structured)
"""From the strongest to the weakest."""


@dataclass(frozen=True)
class Capabilities:
    """What a server and its model can do. Nothing here depends on when or where it was asked.

    Args:
        model: Name of the model.
        fingerprint: SHA-256 of what the server tells of itself and the model, without times.
        structured: The level at which it is asked for structured answers.
        enforced: Whether it kept to that level when it was tempted not to: to the schema, or at
            ``json_object`` to any JSON object.
        vision: Whether it read a code in a picture, and did not tell it without the picture.
        seed: Whether two answers with the same seed at temperature 1 were equal.
        context: Tokens of prompt and answer together, where the server tells.
        attempts: Tries until the first answer.
        requests: How often it was asked in all.
        words: For each of these what happened, in a few words.
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

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"words": dict(self.words)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Capabilities:
        """The inverse of :meth:`to_json`.

        Raises:
            ConfigurationError: For what is no capabilities.
        """
        for key, kinds in _KINDS.items():
            if key not in data or type(data[key]) not in kinds:
                raise _refused(key, data.get(key), " or ".join(kind.__name__ for kind in kinds))
        if unknown := sorted(set(data) - set(_KINDS)):
            raise _refused(unknown[0], data[unknown[0]], "one of " + ", ".join(_KINDS))
        if data["structured"] not in LEVELS:
            raise _refused("structured", data["structured"], "one of " + ", ".join(LEVELS))
        if not all(isinstance(one, str) for pair in data["words"].items() for one in pair):
            raise _refused("words", data["words"], "texts by name")
        return cls(**{**data, "words": dict(data["words"])})


_KINDS: Mapping[str, tuple[type, ...]] = {
    "model": (str,),
    "fingerprint": (str,),
    "structured": (str,),
    "enforced": (bool,),
    "vision": (bool,),
    "seed": (bool,),
    "context": (int, type(None)),
    "attempts": (int,),
    "requests": (int,),
    "words": (dict,),
}


def _refused(key: str, found: object, expected: str) -> ConfigurationError:
    return ConfigurationError(
        f"the capabilities of a language model cannot be read at {key!r}",
        key=key,
        found=found,
        expected=expected,
        remedy="record them anew",
    )
