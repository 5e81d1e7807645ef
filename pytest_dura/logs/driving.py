"""RecordedDriveSimulator: drives of logs played to the roles of driving, whatever these do.

The loop is open: what a component proposes changes nothing that follows, and is compared with what
the driver did. Faults act on the sensor channels, and detectors see these, as in simulations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.state import Tick
from pytest_dura.driving.bodies import HEADING, VX, VY, BodyList, X, Y
from pytest_dura.driving.criticality import near_miss_events
from pytest_dura.driving.highway import HighwaySimulator
from pytest_dura.driving.log_scenarios import on_road
from pytest_dura.driving.recorded import Drive, options_of
from pytest_dura.driving.sensors import EgoState, channels, route_map, signs
from pytest_dura.logs.episode import derived, sampled
from pytest_dura.logs.simulator import RecordedLog, recorded_of

_CAMERAS = ("camera_front", "camera_third_person")


class RecordedDriveSimulator(HighwaySimulator):
    """Logs of driving, of which each is the world of a run; the ego drives as it was recorded.

    The world is that of :class:`~pytest_dura.logs.simulator.RecordedLog`, with a mapping whose
    world is ``driving``. The map, the stop line and the signs are those of a built-in road, on
    which the drive is placed as for a scenario from a log.
    """

    lacks = {f"channels.{name}": "a log has no pictures" for name in _CAMERAS}  # noqa: RUF012 - as declared
    hindsight = frozenset()

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Read the mapping, and look for the logs.

        Raises:
            ConfigurationError: For a mapping without the world ``driving``.
        """
        checked = RecordedLog.check_scenario(world)
        if set(checked["mapping"].get("world", {})) != {"driving"}:
            raise ConfigurationError(
                "only a log with poses can be played to the roles of driving",
                key="world.mapping",
                found="a mapping without `world: {driving: {}}`",
                expected="one with this world, and signals such as `ego.x`",
                remedy="add them to the mapping",
            )
        return checked

    @classmethod
    def world_of_run(cls, world: Mapping[str, Any], run: int) -> dict[str, Any]:
        """Name the log of a run, with its digest."""
        return RecordedLog.world_of_run(world, run)

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - no draws
        """Read the log, and place the drive on a road.

        Raises:
            ConfigurationError: For a log that is longer than the episode, or has gaps.
        """
        recorded = recorded_of(scenario)
        _, resampled = sampled(recorded, self.time_step)
        columns = {name: each.values for name, each in resampled.items()}
        ((_, options),) = recorded.world.items()
        drive = Drive(columns, self.time_step, options_of(options))
        ticks = len(drive.ego)
        length = (ticks - 1) * self.time_step
        gaps = int(drive.unknown.sum())
        if gaps or length > scenario["duration"]:
            raise ConfigurationError(
                "a log that has gaps, or is longer than the episode, cannot be played to roles",
                file=recorded.file,
                found=f"{gaps} of {ticks} samples unknown, {length:g} s",
                expected=f"a pose at each sample, and at most {scenario['duration']:g} s",
                remedy="cut the log at its gaps, or give `longest_gap` and `method: linear`",
            )
        self._file, self._drive, self._dt = recorded.file, drive, self.time_step
        rows, self._route, self.assumed = on_road(drive)
        self._map, self._signs = route_map(self._route), signs(self._route)
        self._rows = rows
        self._there: NDArray[np.bool_] = np.asarray(np.isfinite(rows).all(axis=2))
        ego = rows[:, 0]
        self._speed = np.cos(ego[:, HEADING]) * ego[:, VX] + np.sin(ego[:, HEADING]) * ego[:, VY]
        self._gains = np.diff(self._speed, prepend=self._speed[:1]) / self._dt
        turned = np.unwrap(ego[:, HEADING])
        self._turns = np.diff(turned, prepend=turned[:1]) / self._dt
        own = {name: column for name, column in columns.items() if np.isfinite(column).all()}
        found = derived(recorded, columns, self._dt)
        self._signals = {**own, **found.least}
        self._commanded = self._gains[:1].repeat(ticks)
        return self._played(0)

    def step(self, action: Any) -> Tick:
        """Go on to the next sample; the command is kept, to be compared."""
        self._commanded[self._index + 1] = self._acceleration(action)
        return self._played(self._index + 1)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """The signals of the log, and how far each command was from what the driver then did."""
        error = np.abs(self._gains - self._commanded)
        columns = {**self._signals, "command_error": error}
        return {name: column[: len(ticks)].copy() for name, column in columns.items()}

    def found_events(self, ticks: Sequence[Tick]) -> Sequence[tuple[int, str, str, str]]:
        """The near misses of the log."""
        found = near_miss_events(self._drive.encounters)
        return [each for each in found if each[0] < len(ticks)]

    def snapshot(self) -> object:
        """The place within the log, and the commands so far."""
        return self._index, self._commanded.copy()

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot."""
        index, commanded = snapshot
        self._commanded = commanded.copy()
        self._played(index)

    def _played(self, index: int) -> Tick:
        self._index = index
        chosen = np.flatnonzero(self._there[index, 1:]) + 1
        names = tuple(self._drive.ids[place] for place in chosen)
        bodies = BodyList(names, self._rows[index, chosen])
        row = self._rows[index, 0]
        s, lateral = self._route.project(float(row[X]), float(row[Y]))
        gain = float(self._gains[index])
        self._state = EgoState(
            float(row[X]), float(row[Y]), float(row[HEADING]), float(self._speed[index]), gain,
            gain, float(self._turns[index]), s, lateral,
        )  # fmt: skip
        given = channels(self._state, bodies, self._map, self._signs, lambda _view: None)
        events: tuple[tuple[str, str, str], ...] = ()
        if not index:
            detail = "recorded, and played in open loop: no command changes what follows. "
            events = (("recorded", self._file, detail + " ".join(self.assumed)),)
        return Tick(
            index=index,
            time=index * self._dt,
            truth={"ego": self._state, "bodies": bodies},
            channels={name: given[name] for name in given if name not in _CAMERAS},
            events=events,
            truncated=index == len(self._rows) - 1,
        )
