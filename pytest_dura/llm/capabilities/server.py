"""Server: what it tells of itself, and a fingerprint that stays where server and model do."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.core.episode import canonical

_STABLE = (
    "id",
    "owned_by",
    "root",
    "parent",
    "meta",
    "details",
    "architecture",
    "quantization",
    "digest",
    "version",
    "max_model_len",
    "context_length",
    "context_window",
)
"""What of a model's entry stays across restarts; not ``created``, ``permission``, ``status``."""
_CONTEXTS = ("max_model_len", "context_length", "context_window")
_MOST = 20


@dataclass(frozen=True)
class Server:
    """What the server told of itself.

    Args:
        entry: Of the model in the list of models; empty where there is none.
        models: The names in that list.
        said: The fingerprint that it gives with each answer; empty if it varies, or gives none.
        words: What happened.
    """

    entry: Mapping[str, Any]
    models: tuple[str, ...]
    said: str
    words: str

    @classmethod
    def of(cls, listing: str, why_not: str, model: str, said: Iterable[str]) -> Server:
        """From the body of ``GET /models``, or why there is none, and the answers' fingerprints."""
        entries = _entries(listing)
        models = tuple(str(one["id"]) for one in entries)
        entry = next((one for one in entries if one["id"] == model), {})
        told = set(said)
        names = [name for name in _STABLE if name in entry]
        words = f"the list of models tells {', '.join(names)}" if entry else (
            why_not or f"the list of models does not name it, but {len(models)} others"
        )  # fmt: skip
        if len(told) > 1:
            words += "; the fingerprint of its answers varies, and is left out"
        return cls(entry, models[:_MOST], told.pop() if len(told) == 1 else "", words)

    def fingerprint(self, model: str) -> str:
        """SHA-256, in hexadecimal."""
        stable = {name: self.entry[name] for name in _STABLE if name in self.entry}
        return hashlib.sha256(canonical([model, stable, self.said])).hexdigest()

    @property
    def context(self) -> int | None:
        """Tokens that it takes at once, where it tells."""
        meta = self.entry.get("meta")
        places = [self.entry.get(name) for name in _CONTEXTS]
        places.append(meta.get("n_ctx") if isinstance(meta, dict) else None)
        return next((one for one in places if type(one) is int and one > 0), None)


def _entries(listing: str) -> list[dict[str, Any]]:
    try:
        found = json.loads(listing)
    except (ValueError, RecursionError):  # such a server has no list; `words` tells it
        return []
    data = found.get("data") if isinstance(found, dict) else None
    return [
        one
        for one in (data if isinstance(data, list) else [])
        if isinstance(one, dict) and isinstance(one.get("id"), str)
    ]
