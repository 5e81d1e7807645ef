"""Fault: what is planned, as plain data from a scenario file to the record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from pytest_dura.core.codec import LEFT_OUT, fields_as_data
from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Fault:
    """A planned fault, which can be read where its type is not installed.

    :func:`pytest_dura.faults.fault_effect` makes of it what changes values, once an episode.
    """

    type: str
    """Type in the fault catalogue, or `package.module:Class`."""
    id: str
    """Its name in the case."""
    target: str
    """Sensor channel, field of a channel, or `command`."""
    activation: Mapping[str, Any] = field(default_factory=dict)
    """When it begins, in simulated seconds, and which role begins it."""
    duration: Any = None
    """Simulated seconds that it stays active, or what ends it; null for the rest of the episode."""
    parameters: Mapping[str, Any] | None = field(default=None, metadata=LEFT_OUT)
    """In the units that the catalogue states; absent if its type has none."""
    by_chance: bool = False
    """Whether its activation or its effect is drawn: the episode is valid also if it never
    manifests."""

    __repr__ = short_repr

    @property
    def planned_at(self) -> float | None:
        """Simulated time of its activation, in s, where the plan has one."""
        time: float | None = self.activation.get("at")
        return time

    def plain(self) -> dict[str, Any]:
        """Return its fields as plain data, from which :meth:`of` makes an equal fault."""
        return fields_as_data(self)

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
