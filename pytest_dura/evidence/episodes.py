"""Episodes on their way into the record: their entries, and a spool on disk."""

from __future__ import annotations

import json
import os
import sqlite3
import tempfile
import weakref
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pytest_dura.core.clock import timeliness
from pytest_dura.core.codec import decode, encode, fields_as_data
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import switching
from pytest_dura.core.measures import Measure, measured
from pytest_dura.evidence.conclusions.faults import with_chains
from pytest_dura.evidence.entry import JsonObject, plain_data
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry, inputs_digest
from pytest_dura.evidence.lines import FaultTrace, KeptTrace
from pytest_dura.evidence.sessions import OWN_ORIGIN
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.runs import declared_verdicts


def episode_record(
    episode: Episode,
    *,
    planned: bool,
    origin: Mapping[str, Any] = OWN_ORIGIN,
    requirements: Iterable[Requirement] = (),
) -> dict[str, Any]:
    """Build the entry of an episode in the record.

    Args:
        episode: The episode.
        planned: Whether it is part of its case's plan. One whose seed was chosen by hand is not,
            and does not enter the case's rates.
        origin: The earlier ``session`` that it was taken over from, or what ``changed`` since one
            simulated an episode of its name.
        requirements: Those that its case declares.
    """
    # The recorded timeouts stand in for the clock when the episode is replayed.
    spec = replace(episode.spec, timeouts=episode.timeouts).to_json()
    record: dict[str, Any] = plain_data(
        {
            "id": episode.id,
            "case": episode.spec.case,
            "component": episode.spec.component,
            "seed": episode.spec.seed,
            "planned": planned,
            "origin": dict(origin),
            "validity": episode.validity,
            "invalid_reason": episode.invalid_reason,
            "termination": episode.termination,
            "failure": episode.failure,
            "digest": episode.digest,
            "trajectory": episode.trajectory,
            "drawn": episode.drawn,
            "trace": None,
            "outcome": outcome_figures(episode, episode.spec.measures),
            "metrics": encode(episode.metrics.summary()),
            "faults": [encode(fault.traced()) for fault in episode.faults],
            "verdicts": {
                name: encode(verdict)
                for name, verdict in declared_verdicts(episode, requirements).items()
            },
            "events": [fields_as_data(event) for event in episode.events],
            "timings": {
                "simulated_seconds": episode.time[-1] if episode.ticks else 0.0,
                "processing_seconds": {
                    role: sum(nanoseconds) / 1e9
                    for role, (_, nanoseconds) in episode.metrics.processing_ns.items()
                },
            },
            "spec": spec,
        }
    )
    return record


def outcome_figures(episode: Episode, measures: Iterable[Measure]) -> dict[str, Any]:
    """Compute the figures of the case table, with those that the simulator declares."""
    spec, decisions = episode.spec, len(episode.decisions["source"])
    kept = timeliness(spec.clock, spec.time_step, episode.signals, decisions)
    return {
        "flagged": episode.flagged,
        "measures": measured(measures, episode),
        "recoveries": len(episode.metrics.recoveries),
        "alerts": episode.metrics.alerts,
        "switching": encode(switching(episode)),
    } | ({} if kept is None else {"timeliness": encode(kept)})


SPOOL_PREFIX = ".session-"
"""Prefix of the file's name, which is seen only where open files cannot be removed."""

_MOST_BYTES = 2_000_000
"""Size in the file of episodes that are kept in memory as well, where they take 20 times as much:
1000 of a built-in scenario, for formats read a session's episodes a dozen times. Of a session that
has more, none are kept."""

_T = TypeVar("_T")

# Keys are bytes: SQLite knows neither lone surrogates nor large integers.
_TABLES = """
PRAGMA journal_mode = OFF;
PRAGMA synchronous = OFF;
PRAGMA temp_store = FILE;
CREATE TABLE episodes (
    name BLOB, component BLOB, inputs BLOB, digest TEXT, planned INTEGER,
    place BLOB, run BLOB, seed BLOB, data BLOB,
    UNIQUE (name, component, inputs)
);
CREATE INDEX ordered ON episodes (place, component, run, seed);
CREATE TABLE chains (
    component BLOB, name BLOB, fault BLOB, data BLOB, PRIMARY KEY (component, name, fault)
);
CREATE TABLE traces (
    component BLOB, name BLOB, digest TEXT, data BLOB, PRIMARY KEY (component, name, digest)
);
"""


class EpisodeSpool:
    """Keeps entries of episodes, and what is reported of them later, in a file.

    The file loses its name as soon as it is open, so that a killed session leaves none behind.

    Args:
        directory: Where the file is made; default: where the system has its temporary files.

    Raises:
        ConfigurationError: If it cannot be made.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._directory = directory
        self._connection = self._guarded(self._open)
        self._entries: list[EpisodeEntry] | None = None
        self._changes = 0

    def add(self, episode: JsonObject) -> str:
        """Add an episode, and return the digest of the first one that had the same inputs.

        The first entry stays, but becomes ``planned`` as soon as any of them is.

        Args:
            episode: Of :func:`episode_record`.

        Raises:
            ConfigurationError: If it cannot be written, on a full disk for example.
        """
        key = _key(episode["id"]), _key(episode["component"]), inputs_digest(episode["spec"])
        rows = self._execute(
            "SELECT digest, planned FROM episodes WHERE name = ? AND component = ? AND inputs = ?",
            *key,
        )
        if not rows:
            order = _key(episode["case"]), _number(episode["spec"]["run"]), _number(episode["seed"])
            values = (*key, episode["digest"], bool(episode["planned"]), *order, _packed(episode))
            self._execute("INSERT INTO episodes VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", *values)
            return str(episode["digest"])
        ((digest, planned),) = rows
        if episode["planned"] and not planned:
            self._execute(
                "UPDATE episodes SET planned = 1 WHERE name = ? AND component = ? AND inputs = ?",
                *key,
            )
        return str(digest)

    def add_chain(self, line: FaultTrace) -> None:
        """Add how far a fault of an episode got; the last report holds.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        keys = _key(line.component), _key(line.episode), _key(line.fault.id)
        chain = _packed(encode(line.fault))
        self._execute("INSERT OR REPLACE INTO chains VALUES (?, ?, ?, ?)", *keys, chain)

    def add_trace(self, line: KeptTrace) -> None:
        """Add the file of an episode's trace.

        Several workers may report one, in any order; the weightiest reason to keep it stays.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        keys = _key(line.component), _key(line.id), line.digest
        known = "SELECT data FROM traces WHERE component = ? AND name = ? AND digest = ?"
        if any(
            _weight(_unpacked(data)["kept_for"]) > _weight(line.trace["kept_for"])
            for (data,) in self._execute(known, *keys)
        ):
            return
        values = *keys, _packed(line.trace)
        self._execute("INSERT OR REPLACE INTO traces VALUES (?, ?, ?, ?)", *values)

    def __iter__(self) -> Iterator[EpisodeEntry]:
        """Iterate by case, component, run and seed; each episode has its chains and its trace."""
        if self._entries is not None:
            yield from self._entries
            return
        ((size,),) = self._execute("SELECT sum(length(data)) FROM episodes")
        if (size or 0) > _MOST_BYTES:
            yield from self._stored()
            return
        entries: list[EpisodeEntry] = []
        changes = self._changes
        for entry in self._stored():
            entries.append(entry)
            yield entry
        if changes == self._changes:
            self._entries = entries

    def _stored(self) -> Iterator[EpisodeEntry]:
        query = """
            SELECT episodes.data, episodes.planned, traces.data, episodes.component, episodes.name
            FROM episodes LEFT JOIN traces USING (component, name, digest)
            ORDER BY place, episodes.component, run, seed, inputs
        """
        with closing(self._guarded(lambda: self._connection.execute(query))) as cursor:
            while (row := self._guarded(cursor.fetchone)) is not None:
                data, planned, trace, *key = row
                episode = {**_unpacked(data), "planned": bool(planned)}
                if trace is not None:
                    episode["trace"] = _unpacked(trace)
                traced = bool(planned and episode["faults"])
                known = "SELECT data FROM chains WHERE component = ? AND name = ?"
                rows = self._execute(known, *key) if traced else ()
                chains = [_unpacked(chain) for (chain,) in rows]
                by_fault = {chain["id"]: chain for chain in chains}
                yield decode(EpisodeEntry, with_chains(episode, by_fault))

    def close(self) -> None:
        """Delete the file."""
        self._forget()

    def _open(self) -> sqlite3.Connection:
        if self._directory is not None:
            self._directory.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=SPOOL_PREFIX, dir=self._directory)
        os.close(handle)
        file: Path | None = Path(name)
        # Autocommit: without a journal there is nothing to roll back to.
        connection = sqlite3.connect(name, isolation_level=None, check_same_thread=False)
        if os.name == "posix":
            Path(name).unlink()
            file = None
        self._forget = weakref.finalize(self, _remove_spool, connection, file)
        connection.executescript(_TABLES)
        return connection

    def _execute(self, statement: str, *values: Any) -> list[Any]:
        if not statement.lstrip().startswith("SELECT"):
            self._entries = None
            self._changes += 1
        return self._guarded(lambda: self._connection.execute(statement, values).fetchall())

    def _guarded(self, operation: Callable[[], _T]) -> _T:
        try:
            return operation()
        except (OSError, sqlite3.Error) as error:
            raise ConfigurationError(
                f"the episodes of the session cannot be kept: {error}",
                key="--dura-evidence",
                found=str(self._directory or tempfile.gettempdir()),
                expected="a directory that can be written, with room for the session's episodes",
                remedy="make room, or choose another directory",
            ) from None


def _remove_spool(connection: sqlite3.Connection, file: Path | None) -> None:
    connection.close()
    if file is not None:
        file.unlink(missing_ok=True)


def _key(text: str) -> bytes:
    """Bytes that are ordered as the text is."""
    return text.encode("utf-8", "surrogatepass")


def _number(value: int) -> bytes:
    """Bytes that are ordered as whole numbers from 0 on are."""
    size = (value.bit_length() + 7) // 8
    return size.to_bytes(4, "big") + value.to_bytes(size, "big")


def _packed(value: Any) -> bytes:
    return zlib.compress(json.dumps(value, allow_nan=False).encode(), 1)


def _unpacked(data: bytes) -> Any:
    return json.loads(zlib.decompress(data))


_REASONS = ("twin", "all", "sample", "missing", "violation")
"""Reasons to keep a trace, the weightiest last."""
_weight = _REASONS.index


def trace_weight(trace: TraceEntry | None) -> int:
    """Weight of the reason for which a trace is kept; -1 without one."""
    return -1 if trace is None else _weight(trace.kept_for)
