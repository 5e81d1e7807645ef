"""World of logs that the domain registers: signals, scene and scenarios from recorded drives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pytest_dura.core.simulator import Scene
from pytest_dura.driving.criticality import near_miss_events
from pytest_dura.driving.log_scenarios import scenario_of
from pytest_dura.driving.recorded import Drive, Floats, options_of


class RecordedDrive:
    """The domain's world of logs."""

    def check(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Check what a mapping says of the drive."""
        return options_of(options).model_dump(mode="json")

    def derive(
        self, columns: Mapping[str, Floats], step: float, options: Mapping[str, Any]
    ) -> tuple[dict[str, Floats], dict[str, Floats], list[tuple[int, str, str, str]], Scene]:
        """Derive signals, near misses and a scene; see ``pytest_dura.logs.worlds``.

        Raises:
            ConfigurationError: For a log without an ego, and one whose world is mirrored.
        """
        drive = Drive(columns, step, options_of(options))
        drive.refuse_mirror()
        least = drive.signals()
        greatest = {name: column.copy() for name, column in least.items()}
        lacking = drive.unknown
        if lacking.any():
            first = int(np.argmax(lacking))
            for name in least:
                if name not in ("near_misses", "pet"):
                    least[name][lacking] = greatest[name][lacking] = np.nan
            greatest["near_misses"][first:] = np.nan  # more of them may have been there
            least["pet"][:] = 0.0
        events = near_miss_events(drive.encounters)
        return least, greatest, events, drive.scene()

    def scenario(
        self,
        columns: Mapping[str, Floats],
        step: float,
        options: Mapping[str, Any],
        violated: int,
        **how: Any,
    ) -> tuple[dict[str, Any], list[str]]:
        """Make a scenario of what a drive shows before a violation, and say what was assumed.

        Raises:
            ConfigurationError: If the world is mirrored, or the ego not on a road then.
        """
        drive = Drive(columns, step, options_of(options))
        drive.refuse_mirror()
        return scenario_of(drive, violated, **how)


RECORDED_DRIVE = RecordedDrive()
"""The registered world."""
