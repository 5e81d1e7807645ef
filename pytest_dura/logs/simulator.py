"""RecordedLog: logs in the place of a simulator; each run of a case is one of them."""

from __future__ import annotations

import glob
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Generator
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import GeneratorView, Proposal, Tick
from pytest_dura.domains import DOMAINS, Domain
from pytest_dura.library.scenario import Scenario
from pytest_dura.logs.episode import (
    Recorded,
    columns_of,
    derived,
    digest,
    episode_of,
    plain,
    read_log_file,
    sampled,
    with_derived,
)
from pytest_dura.logs.mapping import bound, read_mapping
from pytest_dura.logs.reading import format_of

LOGS = Domain(name="logs", roles={"generator": "recorded"})
"""Episodes that were recorded; their signals are those of a mapping."""
_PLAYED = "recorded"
OPEN_LOOP = "open-loop"
"""First part of the names of sets that are played to roles: each verdict on them says so."""
LONGEST = 86_400.0
"""Seconds of the longest log."""


class RecordedLog(Simulator):
    """Logs, of which each is an episode that is not run again.

    The world has ``logs``, a path or a glob, and ``mapping``: a mapping file, or its data.
    """

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Read the mapping, and look for the logs."""
        if "log" in world:  # that of a run
            return dict(world)
        unknown = sorted(set(world) - {"logs", "files", "mapping"})
        if unknown or not isinstance(world.get("logs"), str):
            raise ConfigurationError(
                "the world of recorded logs names them",
                key="world",
                found=unknown[0] if unknown else world.get("logs"),
                expected="`logs`, a path or a glob, and `mapping`",
                remedy="write `world: {logs: 'drives/*.mcap', mapping: mapping.yaml}`",
            )
        files = world.get("files")
        if files is None:
            files = files_of(world["logs"])
            _refuse_copies(files)
        mapping = plain(read_mapping(world.get("mapping")))
        return {"logs": world["logs"], "files": files, "mapping": mapping}

    @classmethod
    def world_of_run(cls, world: Mapping[str, Any], run: int) -> dict[str, Any]:
        """Name the log of a run, with its digest."""
        files = world["files"]
        if files != files_of(world["logs"]):
            raise ConfigurationError(
                "the logs of the set are others than when it was collected",
                key="logs",
                found=", ".join(sorted(set(files) ^ set(files_of(world["logs"])))),
                expected=f"the same {len(files)} logs until the session ends",
                remedy="run the session again when no log is added or taken away",
            )
        if run >= len(files):
            raise ConfigurationError(
                "there are fewer logs than runs",
                key="runs",
                found=f"run {run + 1} of {len(files)} logs",
                expected="one run for each log",
                remedy="leave --dura-runs out",
            )
        file = files[run]
        return {"log": file, "sha256": digest(file), "mapping": world["mapping"]}

    @classmethod
    def units_of(cls, world: Mapping[str, Any]) -> dict[str, str]:
        """Units of the signals, as the mapping says, else the log, else the domain of its world."""
        mapping = read_mapping(world.get("mapping"))
        domains = [DOMAINS[each] for each in mapping.world if each in DOMAINS]
        units = {name: unit for each in domains for name, unit in each.units.items()}
        path = Path(files_of(world["logs"])[0])
        try:
            topics = {each.name: each for each in format_of(path).topics(path)}
            entries = bound(mapping, list(topics.values()), str(path))
        except ConfigurationError:  # which its episode says, too
            return units
        for name, entry in entries.items():
            field = entry.fields(name)[0]
            units[name] = entry.unit or topics[entry.topic].fields.get(field, "")
        return {name: unit for name, unit in units.items() if unit}

    def recorded_episode(self, spec: EpisodeSpec) -> Episode | None:
        """Read the log of a run, unless faults are laid over it or a component is asked."""
        component = spec.roles.get("generator")
        if spec.faults or component is None or component.label != RecordedNotRun.__name__:
            return None
        return episode_of(recorded_of(spec.scenario), spec)

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - no draws
        """Read the log, which is then played to the roles whatever they do."""
        recorded = recorded_of(scenario)
        _, resampled = sampled(recorded, self.time_step)
        self._columns = {name: each.values for name, each in resampled.items()}
        found = derived(recorded, self._columns, self.time_step)
        self._signals = with_derived(columns_of(resampled), found)
        return self._tick(0)

    def step(self, action: Any) -> Tick:  # noqa: ARG002 - the log goes on as it is
        """Go on to the next sample."""
        return self._tick(self._index + 1)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Return the signals of the log."""
        return {name: column[: len(ticks)].copy() for name, column in self._signals.items()}

    def check_action(self, action: Any) -> Any:
        """Take any action: it changes nothing."""
        return action

    def fallback_action(self) -> str:
        """Return the action of what was recorded."""
        return _PLAYED

    def snapshot(self) -> object:
        """Return the place within the log."""
        return self._columns, self._signals, self._index

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot."""
        self._columns, self._signals, self._index = snapshot

    def _tick(self, index: int) -> Tick:
        self._index = index
        values = {name: float(column[index]) for name, column in self._columns.items()}
        last = len(next(iter(self._columns.values()))) - 1
        return Tick(
            index=index,
            time=index * self.time_step,
            truth=MappingProxyType(values),
            channels=MappingProxyType({"log": MappingProxyType(values)}),
            truncated=index == last,
        )


def recorded_of(scenario: Mapping[str, Any]) -> Recorded:
    """Read the log of a run.

    Raises:
        ConfigurationError: If it is another one than the episode was made of.
    """
    world = scenario["world"]
    found = digest(world["log"])
    if found != world["sha256"]:
        raise ConfigurationError(
            "this is another log than the episode was made of",
            file=world["log"],
            found=f"SHA-256 {found}",
            expected=f"SHA-256 {world['sha256']}",
            remedy="put the recorded log back",
        )
    return read_log_file(world["log"], read_mapping(world["mapping"]))


class RecordedNotRun(Generator):
    """Stands for the system that was recorded, which is not run again."""

    def propose(self, view: GeneratorView) -> Proposal:  # noqa: ARG002 - nothing is decided
        """Go on to the next sample."""
        return Proposal(_PLAYED, "")


def files_of(pattern: str) -> list[str]:
    """List the logs of a path or a glob, sorted.

    Raises:
        ConfigurationError: If there are none.
    """
    exists = Path(pattern).exists()
    files = [pattern] if exists else sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207 - it may be absolute
    if not files:
        raise ConfigurationError(
            "no log is here",
            key="logs",
            found=pattern,
            expected="the path of a log, or a glob such as 'drives/*.mcap' in quotes",
            remedy="check the path, which is relative to where pytest was started",
        )
    return files


def _refuse_copies(files: Sequence[str]) -> None:
    """Refuse a set that holds a log twice, which would be no further draw.

    Raises:
        ConfigurationError: For two logs of the same bytes.
    """
    sizes: dict[int, list[str]] = {}
    for file in files:
        path = Path(file)
        parts = [path] if path.is_file() else [each for each in path.rglob("*") if each.is_file()]
        sizes.setdefault(sum(part.stat().st_size for part in parts), []).append(file)
    for alike in sizes.values():
        known: dict[str, str] = {}
        for file in alike if len(alike) > 1 else ():
            first = known.setdefault(digest(file), file)
            if first != file:
                raise ConfigurationError(
                    "a log is in the set twice",
                    key="logs",
                    found=f"{first} and {file}, of the same content",
                    expected="each log once, since each counts as a drive of its own",
                    remedy="take one of them away, or name the others by another glob",
                )


def log_scenario(
    pattern: str,
    mapping: object = None,
    requirements: Sequence[str] = (),
    key: str = "--dura-log",
    *,
    played: bool = False,
) -> Scenario:
    """Make the scenario of a set of logs, of which each is a run.

    Args:
        pattern: Path or glob of the logs.
        mapping: A mapping file, or its data.
        requirements: Ids of those that judge it.
        key: What named the logs, for messages.
        played: Whether the logs are played to roles, those of the domain of their world.

    Raises:
        ConfigurationError: For no logs, a mapping that cannot be read, and, where it does not give
            the step, a first log that cannot be read.
    """
    files = files_of(pattern)
    _refuse_copies(files)
    read = read_mapping(mapping, key)
    step = read.time_step or read_log_file(files[0], read).step()
    name = f"{OPEN_LOOP}/{set_name(pattern)}" if played else set_name(pattern)
    what = "played in open loop, which no command changes" if played else "not run"
    how = {"simulator": "logs"}
    for domain in read.world if played else ():
        how = {"simulator": f"{domain}.recorded", "policy": "log_only"}
    return Scenario.model_validate(
        {
            "name": name,
            "description": f"{len(files)} recorded logs, {what}; a rate takes them as independent",
            **how,
            "duration": LONGEST,
            "time_step": step,
            "runs": len(files),
            "time_budget": None,
            "world": {"logs": pattern, "files": files, "mapping": plain(read)},
            "requirements": list(requirements),
        }
    )


def set_name(pattern: str) -> str:
    """Make the name of a set of logs: ``drives/*.csv`` is ``drives/csv``."""
    pieces = [re.sub(r"[^A-Za-z0-9_.-]+", "", piece).strip(".-_") for piece in
              Path(pattern).as_posix().split("/")]  # fmt: skip
    return "/".join(piece for piece in pieces if piece) or "logs"
