"""ModelDescription: what a model and the server behind it are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class ModelDescription:
    """A model and the server behind it, as plain data that holds no secret.

    Args:
        model: Name of the model.
        base_url: Of the server, without user, password and query.
        fingerprint: What tells this server and model from others.
        capabilities: What the server can do, as the probe found it.
        tool: Version of pytest-dura that asked.
        created: When, in ISO 8601.
    """

    model: str
    base_url: str
    fingerprint: str
    capabilities: Mapping[str, Any]
    tool: str
    created: str

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)
