"""Worlds of logs: what a domain makes of the poses in a log, such as gaps and times to collision.

A domain registers one in the group ``pytest_dura.log_worlds``; a mapping names it by ``world``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.registry import Registry
from pytest_dura.core.simulator import Scene

Columns = Mapping[str, NDArray[np.float64]]


class Derived(NamedTuple):
    """What follows from the columns of a log, as any sequence of these four.

    Args:
        least: Signals, or the least values that they may have; NaN where nothing is known.
        greatest: Greatest values, of the same names.
        events: Tick, kind, subject and detail.
        scene: The log from above, for the player.
    """

    least: Columns
    greatest: Columns
    events: Sequence[tuple[int, str, str, str]]
    scene: Scene | None


@runtime_checkable
class LogWorld(Protocol):
    """What a domain makes of logs."""

    def check(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Check what a mapping says of its world, and fill in defaults.

        Raises:
            ConfigurationError: For what does not fit.
        """

    def derive(self, columns: Columns, step: float, options: Mapping[str, Any]) -> Sequence[Any]:
        """Derive signals from the columns of a log, as the fields of :class:`Derived`.

        Raises:
            ConfigurationError: For a log that is not of such a world.
        """

    def scenario(
        self,
        columns: Columns,
        step: float,
        options: Mapping[str, Any],
        violated: int,
        **how: Any,
    ) -> tuple[dict[str, Any], list[str]]:
        """Make the keys of a scenario that begins before a violation, and say what was assumed.

        Args:
            columns: Columns of the log.
            step: Seconds from sample to sample.
            options: What the mapping says of the world.
            violated: Sample of the violation.
            how: ``before``, in seconds, and ``road``, where they were given.

        Raises:
            ConfigurationError: If the log shows no such scenario.
        """


LOG_WORLDS: Registry[LogWorld] = Registry(
    "pytest_dura.log_worlds",
    "world of logs",
    lambda value: isinstance(value, LogWorld),
    "an object with check, derive and scenario",
)
