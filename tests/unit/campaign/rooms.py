"""A simulator whose class checks its world itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thermostat import Thermostat

from pytest_dura import ConfigurationError


class Room(Thermostat):
    """A thermostat that allows ``start`` and ``outside``, without filling in defaults."""

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world as it is.

        Raises:
            ConfigurationError: For any other key, and for a room below 0 °C.
        """
        unknown = sorted(set(world) - {"start", "outside"})
        if unknown:
            raise ConfigurationError("no such thing in a room", key=unknown[0], remedy="remove it")
        if world.get("start", 0.0) < 0.0:
            raise ConfigurationError("a room is not that cold", key="world.start")
        return dict(world)
