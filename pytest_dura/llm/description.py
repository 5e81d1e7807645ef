"""ModelDescription: what a model and the server behind it are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pytest_dura.core.errors import ConfigurationError


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
        about: What the model is, in the words of who named it; empty if nobody says.
    """

    model: str
    base_url: str
    fingerprint: str
    capabilities: Mapping[str, Any]
    tool: str
    created: str
    about: str = ""

    @property
    def spoken_of(self) -> str:
        """What the model is in words, or else its name."""
        return self.about or self.model

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def latest(known: Sequence[ModelDescription]) -> list[ModelDescription]:
    """The last description of each model, by name: the answers of that server came last."""
    by_name = {each.model: each for each in known}
    return [by_name[name] for name in sorted(by_name)]


def chosen(
    known: Sequence[ModelDescription], model: str | None, usual: str | None, file: str
) -> ModelDescription:
    """The description of a model in a cassette.

    Of several descriptions the last one counts: the answers of that server came last.

    Args:
        known: All that the cassette holds, in their order.
        model: Which one is wanted; if nobody says, the only one there is, or the usual one.
        usual: What the environment names.
        file: The cassette, for messages.

    Raises:
        ConfigurationError: If there is none, or it is not clear which.
    """
    names = sorted({one.model for one in known})
    wanted = model or (names[0] if len(names) == 1 else usual)
    found = [one for one in known if one.model == wanted]
    if found:
        return found[-1]
    problem = f"the cassette knows no model {wanted!r}"
    if not names:
        problem = "the cassette knows no model at all"
    elif wanted is None:
        problem = "the cassette knows several models, and none of them is named"
    raise ConfigurationError(
        problem,
        file=file,
        key="--dura-cassette",
        found=wanted,
        expected=", ".join(names[:10]) or "a cassette that --dura-llm=record wrote",
        remedy="name another model, or record it with --dura-llm=record",
    )
