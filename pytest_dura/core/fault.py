"""Fault: what is planned, as plain data from a scenario file to the record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError


@dataclass(frozen=True)
class Fault:
    """A planned fault, which can be read where its type is not installed.

    :func:`pytest_dura.faults.fault_effect` makes of it what changes values, once an episode.

    Args:
        type: Type in the fault catalogue, or ``package.module:Class``.
        id: Its name in the case.
        target: Sensor channel, field of a channel, or ``command``.
        activation: When it begins, in simulated seconds, and which role begins it.
        duration: Simulated seconds that it stays active, or what ends it; ``None`` for the rest of
            the episode.
        parameters: In the units that the catalogue states; ``None`` if its type has none.
        by_chance: Whether its activation or its effect is drawn: the episode is valid also if it
            never manifests.
    """

    type: str
    id: str
    target: str
    activation: Mapping[str, Any] = field(default_factory=dict)
    duration: Any = None
    parameters: Mapping[str, Any] | None = None
    by_chance: bool = False

    __repr__ = short_repr

    @property
    def planned_at(self) -> float | None:
        """Simulated time of its activation, in s, where the plan has one."""
        time: float | None = self.activation.get("at")
        return time

    def plain(self) -> dict[str, Any]:
        """Return its fields as plain data, from which :meth:`of` makes an equal fault."""
        plain = {part.name: getattr(self, part.name) for part in fields(self)}
        if self.parameters is None:
            del plain["parameters"]
        return plain

    def in_file(self) -> dict[str, Any]:
        """Return it as a scenario file may hold it: without what follows from its type."""
        plain = self.plain()
        del plain["by_chance"]
        return plain

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Fault:
        """Invert :meth:`plain`.

        Raises:
            ConfigurationError: For a key that no fault has, and for one that is missing.
        """
        known = [part.name for part in fields(cls)]
        wrong = [key for key in plain if key not in known]
        wrong += [key for key in ("type", "id", "target") if key not in plain]
        if wrong:
            raise ConfigurationError(
                f"planned faults have the keys {', '.join(known)}",
                key=wrong[0],
                found=", ".join(map(str, plain)),
                expected="type, id and target, and no other key than these",
                remedy="put what a type needs into its `parameters`",
            )
        return cls(**plain)
