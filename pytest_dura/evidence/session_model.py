"""Models of what the record says of the session itself: environment, inputs, components, gate."""

from __future__ import annotations

from typing import Annotated, Literal

from pytest_dura.core.codec import Amount, Count, Limit, Positive, Sha256
from pytest_dura.evidence.entry import Absent, Entry, JsonObject
from pytest_dura.evidence.shard_units import ShardUnit


class ToolEntry(Entry):
    """What wrote the record."""

    name: str
    """Its name."""
    version: str
    """Its version."""
    code: str | None
    """SHA-256 of the names and digests of its own Python files, which tells apart what has one
    version; null where they cannot be read."""


class HypothesisProfile(Entry):
    """The profile of Hypothesis that property tests ran under, settings of their own apart.

    Absent where Hypothesis was not imported.
    """

    profile: str
    """Its name."""
    max_examples: Positive
    """Cases that a test tries where none of them fails."""
    derandomize: bool
    """Whether the same cases are drawn in every session."""
    database: bool
    """Whether cases that failed are kept for further sessions."""


class GitState(Entry):
    """State of the project's repository; null outside of one."""

    commit: Annotated[str, Limit(pattern=r"^[0-9a-f]{40,64}$")] | None
    """Commit."""
    dirty: bool | None
    """Whether files differ from it, the evidence apart."""


class EnvironmentEntry(Entry):
    """Where a session ran."""

    python: str
    """Version of Python."""
    platform: str
    """Operating system, in words."""
    machine: str
    """Type of the processor."""
    byte_order: Literal["little", "big"]
    """Order of the bytes of a number."""
    cpu_features: list[str] | None
    """Instruction sets that NumPy uses here; digests depend on them. Null where it does not
    tell."""
    blas: str | None
    """The library that multiplies NumPy's matrices."""
    packages: dict[str, str]
    """Versions of what results depend on, by distribution."""
    git: GitState
    """State of the project's repository; null outside of one."""
    hypothesis: Absent[HypothesisProfile] = None
    """The profile of Hypothesis that property tests ran under, settings of their own apart; absent
    where Hypothesis was not imported."""


class ExecutionEntry(Entry):
    """Who simulated the episodes of a session.

    Digests do not depend on it: each process has the same code, packages and arithmetic as the
    session, or is refused.
    """

    executor: str
    """Its registered name. `in-process`: the processes of pytest, or of pytest-xdist. `processes`:
    processes of the same machine. `dask`: the workers of a Dask cluster. `auto` in a session that
    did not come to its end: one of the first two."""
    processes: Positive | None
    """How many processes of the same machine; null for another executor."""
    chosen: Absent[str] = None
    """Why `--dura-executor=auto` chose it; absent where an executor was named."""
    at_once: Absent[dict[str, Positive]] = None
    """What each process of the session did at the same time, such as requests to a server, and how
    often at most, for episodes that it simulated at once in threads; absent where it was one after
    the other."""


class SecondEngineEntry(Entry):
    """What a second engine for formulas was compared on (ini `dura_stl_engine = both`).

    Where it differs from our own, the episode is missing and the gate fails.
    """

    engine: Literal["rtamt"]
    """Its name."""
    version: str
    """Its version."""
    compared: Count
    """Verdicts on episodes by formulas that both engines came to, differences included; what two
    requirements, or a search and a test, ask of one episode by one formula is one."""
    not_compared: dict[str, Positive]
    """Verdicts that it does not come to, by the reason: a check that is a function, a trace of one
    sample, what it fails on."""


class EarlierSession(Entry):
    """The earlier sessions, by their ids."""

    session: str
    """Its id."""
    episodes: Positive
    """Episodes that were taken over from it."""


class OutdatedEpisodes(Entry):
    """Episodes that were simulated again, by the reason."""

    changed: list[str]
    """What differs from the closest episode of the same name in an earlier session, in words; empty
    where that was missing or damaged."""
    episodes: Positive
    """How many."""


class SearchOrigins(Entry):
    """The same of what searches and property tests simulated, whose episodes are in no record.

    Null where none was resumed. Replays are never taken over.
    """

    simulations: Count
    """Different ones, replays included."""
    taken_over: Count
    """Episodes that an earlier session simulated."""
    sessions: list[EarlierSession]
    """The earlier sessions, by their ids."""
    outdated: list[OutdatedEpisodes]
    """Episodes that were simulated again, by the reason."""


class SourcesEntry(Entry):
    """What all episodes of a session rest on, as `--dura-resume` compares it."""

    digest: Sha256
    """SHA-256 over names and contents of the files, and the versions."""
    files: Count
    """Python files below the root directory. Folders of `norecursedirs`, virtual environments and
    the evidence are left out, and so are test modules; `conftest.py` files count."""
    versions: Count
    """Versions of installed packages, of Python, the platform, the arithmetic and pytest-dura."""


class ResumeEntry(Entry):
    """What a session took over from the one that it resumed, and what it simulated again.

    Computed again from the episodes, apart from resumed, session, sources, problems and searched.
    """

    searched: SearchOrigins | None
    """The same of what searches and property tests simulated, whose episodes are in no record; null
    where none was resumed. Replays are never taken over."""
    resumed: bool
    """Whether the session went on with an interrupted one (`--dura-resume`). Of merged shards
    whether any did."""
    session: Annotated[str, Limit(pattern=r"^[0-9a-f]{32}$")] | None
    """Id of this session; null for merged shards."""
    sources: SourcesEntry | None
    """What all of its episodes rest on, as `--dura-resume` compares it; null where those are too
    many files, and for merged shards that differ."""
    problems: list[str]
    """Why episodes could not be kept for other processes or a later session, in words."""
    taken_over: Count
    """Episodes that an earlier session simulated."""
    sessions: list[EarlierSession]
    """The earlier sessions, by their ids."""
    outdated: list[OutdatedEpisodes]
    """Episodes that were simulated again, by the reason."""


class ShardEntry(Entry):
    """A part of a session, and what the whole is. All shards of a session have the same plan."""

    index: Positive
    """Its number, from 1."""
    count: Positive
    """How many shards there are."""
    plan: Sha256 | None
    """SHA-256 over all units of the whole session; null until they are known."""
    units: Count | None
    """Units of the whole session; null until they are known."""
    holds: list[ShardUnit]
    """The units of this shard, sorted."""


class MergedShard(Entry):
    """A session that is part of a merged record."""

    index: Positive | None
    """Number of its shard, from 1; null for a session that was not split, as for what follows."""
    count: Positive | None
    """How many shards there are."""
    plan: Sha256 | None
    """SHA-256 over all units of the whole session."""
    units: Count | None
    """How many units it held."""
    created: str
    """When it began, in ISO 8601."""
    finished: str
    """When it ended, in ISO 8601."""
    command: str
    """Its command."""
    environment: EnvironmentEntry
    """Where it ran."""
    gate: Literal["passed", "failed"]
    """The result of its own gate."""
    exit_code: Count
    """Of it."""
    wall_seconds: Amount
    """From its start until its record was complete, in s."""
    evidence_seconds: Amount
    """Part of these that the evidence took, in s."""
    record: Sha256
    """SHA-256 of its `evidence.json`."""


class SelectionEntry(Entry):
    """Which of the planned verdicts the session was asked for.

    What `-k`, `--deselect`, a conftest and `--dura-runs` left of the plan. Of a shard, that of the
    whole session.
    """

    planned: Count
    """Verdicts that all collected tests and scenario items would come to."""
    asked: Count
    """Those of them that the session was asked for."""
    left_out: list[str]
    """The others: items of scenarios, or requirement, case and test; at most 20."""
    runs: Positive | None
    """Of `--dura-runs`, where that is less than what is declared; otherwise null."""
    declared_runs: list[Positive]
    """The least and the greatest number of runs that were declared where there are fewer."""


class InputEntry(Entry):
    """A file that results depend on."""

    path: str
    """Relative to the project's root; `package/...` in an installed package; elsewhere the name and
    its folder's."""
    kind: str
    """What it is to the session: `scenario`, `requirements`, `hazards`, `faults`, `test`,
    `conftest`, `component`, `check`, `role`, `configuration`, `baseline`, or what the package that
    read it calls it."""
    sha256: Sha256 | None
    """SHA-256 when it was read; null if it could not be."""
    changed: bool
    """Whether it was another one at the end."""


class SourceFile(Entry):
    """A source file."""

    path: str
    """Relative to the project's root, or `package/...` of an installed package."""
    sha256: Sha256
    """SHA-256 of its content."""


class ComponentEntry(Entry):
    """A component under test."""

    name: str
    """Its name; cases, episodes and verdicts refer to it."""
    path: str
    """Import path `package.module:Name`, or `file.py:Name` for what a conftest.py defines."""
    params: JsonObject
    """The parameters that it is made with, the user's own."""
    distribution: str | None
    """The installed distribution that it belongs to."""
    version: str | None
    """Version of that distribution."""
    digest: Sha256 | None
    """SHA-256 over the names and contents of all Python files of its top-level package, or of the
    defining file where that package has more than 1000. Null for what has no source."""
    file_count: Count
    """How many files the digest covers."""
    files: list[SourceFile]
    """Those files; the defining one alone where they are more than 50 or installed."""
    opaque: bool
    """Whether it was a bare instance, which no other process can build again."""


class ComponentUnderTest(Entry):
    """The component under test; `name` and `version` are null as long as no episode names it."""

    name: str | None
    """Its name; cases, episodes and verdicts refer to it."""
    path: Absent[str] = None
    """Import path `package.module:Name`, or `file.py:Name` for what a conftest.py defines."""
    params: Absent[JsonObject] = None
    """The parameters that it is made with, the user's own."""
    distribution: str | None
    """The installed distribution that it belongs to."""
    version: str | None
    """Version of that distribution."""
    digest: Sha256 | None
    """SHA-256 over the names and contents of all Python files of its top-level package, or of the
    defining file where that package has more than 1000. Null for what has no source."""
    file_count: Absent[Count] = None
    """How many files the digest covers."""
    files: Absent[list[SourceFile]] = None
    """Those files; the defining one alone where they are more than 50 or installed."""
    opaque: Absent[bool] = None
    """Whether it was a bare instance, which no other process can build again."""
    others: Absent[list[ComponentEntry]] = None
    """Further components of the session."""
    sources: Absent[dict[Sha256, dict[str, Sha256]]] = None
    """By the digest of each component of the session: the SHA-256 of every file that it covers, by
    name, relative to the folder of its package."""


class SessionTimings(Entry):
    """Where the session's time went."""

    wall_seconds: Amount
    """From the start until the record was complete, in s; of merged shards their sum."""
    evidence_seconds: Amount
    """Those that the controller spent on gathering the evidence, in s."""
    simulated_seconds: Amount
    """Simulated time of all recorded episodes, in s."""
    processing_seconds: dict[str, Amount]
    """Wall-clock time by role, in s."""
