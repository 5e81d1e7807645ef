"""Model that the resolved parameters of a role state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pytest_dura.core.role_spec import RoleSpec

LIVE = "a live language model answers"
"""Why an episode is not repeated."""
PROMPT = "what is put before a model"
"""Message of a component, on which faults act."""
MODEL = "how a model is reached"
"""Message, too: its faults delay calls, or let them fail."""


def stated_model(role: RoleSpec) -> tuple[str, str] | None:
    """Model and fingerprint of the server, if the resolved parameters of a role state them."""
    server = role.params.get("server")
    place = server if isinstance(server, Mapping) else role.params
    model, fingerprint = role.params.get("model"), place.get("fingerprint")
    if isinstance(model, str) and isinstance(fingerprint, str):
        return model, fingerprint
    return None
