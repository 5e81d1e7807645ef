"""Episodes on their way into the record: their entries, reports of items, a spool on disk."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import sqlite3
import tempfile
import weakref
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from pytest_dura.core.codec import encode, fields_as_data
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import switching
from pytest_dura.core.measures import Measure, MeasureInfo, measured
from pytest_dura.evidence.case_model import CasePlan, RepeatEntry
from pytest_dura.evidence.conclusions.cases import with_chains
from pytest_dura.evidence.entry import Coded, Entry, JsonObject, plain_data
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.sessions import OWN_ORIGIN
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.judgements import Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality
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
    return {
        "flagged": episode.flagged,
        "measures": measured(measures, episode),
        "recoveries": len(episode.metrics.recoveries),
        "alerts": episode.metrics.alerts,
        "switching": encode(switching(episode)),
    }


EPISODES_PER_PART = 64
"""Episodes that a report holds unpacked; see :meth:`ItemReport.split`."""
_ABOUT_ITEM = ("item", "recorded_as", "attempt")
_PART_KEYS = ("components", "cases", "measures", "hazards", "requirements", "episodes", "chains")


class RepeatReport(RepeatEntry):
    """Result of repeating an episode."""

    case: str
    """Id of its case."""
    component: str
    """Name of the component under test."""


@dataclass
class ItemReport:
    """Report of one test item, which crosses processes as JSON.

    Args:
        item: Node id.
        recorded_as: Node id of the first of several items that repeat one test on the same
            parameters; empty where nothing repeats it.
        attempt: Number of the attempt at the item, from 1.
        retried: Whether this attempt passed after an earlier one had failed.
        components: Components under test, of :func:`describe_component`.
        sources: SHA-256 of the files of components by their names, by the components' digests.
        cases: Cases that it used.
        measures: What the simulators declare.
        hazards: Those that the requirements mitigate, and once in each process those of the user.
        requirements: Each requirement involved.
        episodes: Of :func:`episode_record`.
        judgements: What it asked, on campaigns and on single episodes.
        verdicts: On campaigns, for the formats that the process of the item writes; they follow
            from the judgements, and do not leave it.
        outcomes: Of tests on one episode, likewise.
        searches: For violations, without the item.
        monitors: How good they are.
        chains: How far each fault got, with the ``episode`` and its ``case``.
        claimed: Cases of what the item is to decide, which may never run.
        traces: ``{id, component, digest, trace}`` of episodes whose trace was written.
        models: Language models that were used, as in the record's ``models``, with the counts of
            this ``process`` since it began.
        problems: Doubts about the whole session, each beginning with ``infrastructure:``.
        objections: Further reasons why the session does not pass, whatever its verdicts say.
        notes: What the user should know of the session, without doubt about it.
        searched: ``{run, origin}`` of simulations of searches, where earlier sessions may have made
            them; ``run`` identifies each.
        repeats: Results of repeating an episode.
        parts: Packed reports with earlier episodes of the item.
    """

    item: str
    recorded_as: str = ""
    attempt: int = 1
    retried: bool = False
    components: list[JsonObject] = field(default_factory=list)
    sources: dict[str, dict[str, str]] = field(default_factory=dict)
    cases: list[CasePlan] = field(default_factory=list)
    measures: list[Coded[MeasureInfo]] = field(default_factory=list)
    hazards: list[Coded[Hazard]] = field(default_factory=list)
    requirements: list[Coded[Requirement]] = field(default_factory=list)
    episodes: list[JsonObject] = field(default_factory=list)
    judgements: list[Coded[Judgement]] = field(default_factory=list)
    verdicts: list[Coded[CampaignVerdict]] = field(default_factory=list)
    outcomes: list[JsonObject] = field(default_factory=list)
    searches: list[Coded[RecordedSearch]] = field(default_factory=list)
    monitors: list[Coded[MonitorQuality]] = field(default_factory=list)
    chains: list[JsonObject] = field(default_factory=list)
    claimed: list[CasePlan] = field(default_factory=list)
    traces: list[JsonObject] = field(default_factory=list)
    models: list[JsonObject] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    objections: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    searched: list[JsonObject] = field(default_factory=list)
    repeats: list[RepeatReport] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)

    def to_json(self) -> JsonObject:
        """Convert to plain data."""
        return {
            name: [_plain(each) for each in value] if isinstance(value, list) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_json(cls, data: JsonObject) -> ItemReport:
        """Make it of what :meth:`to_json` returns.

        Raises:
            ValidationError: If an entry does not agree with its model.
        """
        return _adapter().validate_python(data)

    @classmethod
    def from_text(cls, text: str | bytes) -> ItemReport:
        """Read the JSON of :meth:`to_json`, as it crosses processes."""
        return cls.from_json(json.loads(text))

    def __bool__(self) -> bool:
        """Whether it reports anything."""
        return any(value for name, value in vars(self).items() if name not in _ABOUT_ITEM)

    @property
    def full(self) -> bool:
        """Whether it holds so many episodes that they should be split off."""
        return len(self.episodes) + len(self.chains) >= EPISODES_PER_PART

    def without_secrets(self, redact: Callable[[Any], Any]) -> ItemReport:
        """Redact the report; packed parts were redacted when they were packed."""
        redacted = redact({**self.to_json(), "parts": []})
        return ItemReport.from_json({**redacted, "parts": self.parts})

    def split(self, redact: Callable[[Any], Any]) -> str:
        """Move the episodes into a packed report of their own, and return it.

        Args:
            redact: Removes secrets from plain data.
        """
        part = ItemReport("", **{name: getattr(self, name) for name in _PART_KEYS})
        self.episodes, self.chains = [], []
        text = json.dumps(part.without_secrets(redact).to_json(), allow_nan=False)
        return base64.b64encode(zlib.compress(text.encode(), 1)).decode()


def _plain(part: Any) -> Any:
    """Convert an entry or a dataclass of the domain to plain data."""
    if isinstance(part, Entry):
        return part.to_json()
    return encode(part) if is_dataclass(part) else part


@cache
def _adapter() -> TypeAdapter[ItemReport]:
    return TypeAdapter(ItemReport)


def unpack_report(part: str) -> ItemReport:
    """Unpack a report of :meth:`ItemReport.split`."""
    return ItemReport.from_text(zlib.decompress(base64.b64decode(part)))


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
        key = _key(episode["id"]), _key(episode["component"]), _inputs(episode["spec"])
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

    def add_chain(self, chain: JsonObject) -> None:
        """Add how far a fault of an episode got; the last report holds.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        keys = _key(chain["component"]), _key(chain["episode"]), _key(chain["id"])
        self._execute("INSERT OR REPLACE INTO chains VALUES (?, ?, ?, ?)", *keys, _packed(chain))

    def add_trace(self, trace: JsonObject) -> None:
        """Add the file of an episode's trace: ``{id, component, digest, trace}``.

        Several workers may report one, in any order; the weightiest reason to keep it stays.

        Raises:
            ConfigurationError: If it cannot be written.
        """
        keys = _key(trace["component"]), _key(trace["id"]), trace["digest"]
        known = "SELECT data FROM traces WHERE component = ? AND name = ? AND digest = ?"
        if any(
            _weight(_unpacked(data)["kept_for"]) > _weight(trace["trace"]["kept_for"])
            for (data,) in self._execute(known, *keys)
        ):
            return
        values = *keys, _packed(trace["trace"])
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
                chains = self._chains_of(*key) if traced else {}
                yield EpisodeEntry.model_validate(with_chains(episode, chains))

    def _chains_of(self, component: bytes, name: bytes) -> dict[str, JsonObject]:
        """How far the faults of the planned episode of this name got, by fault id."""
        rows = self._execute(
            "SELECT data FROM chains WHERE component = ? AND name = ?", component, name
        )
        return {chain["id"]: chain for chain in (_unpacked(data) for (data,) in rows)}

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


def _inputs(spec: JsonObject) -> bytes:
    """SHA-256 of what determines an episode; recorded timeouts stand in for the clock."""
    inputs = {key: value for key, value in spec.items() if key != "timeouts"}
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).digest()


def episode_order(episode: EpisodeEntry) -> tuple[str, str, int, int, bytes]:
    """Sort key of the episodes of a record, which no two different ones share."""
    spec = episode.spec
    return episode.case, episode.component, spec.run, episode.seed, _inputs(spec.to_json())


_REASONS = ("twin", "all", "sample", "missing", "violation")
"""Reasons to keep a trace, the weightiest last."""
_weight = _REASONS.index


def trace_weight(trace: TraceEntry | None) -> int:
    """Weight of the reason for which a trace is kept; -1 without one."""
    return -1 if trace is None else _weight(trace.kept_for)
