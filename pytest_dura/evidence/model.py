"""The evidence record as renderers read it: a typed head, and its episodes one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pytest_dura.core import codec
from pytest_dura.core.codec import Count, Positive
from pytest_dura.core.display import Shown
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CaseEntry, CoverageEntry, OverallEntry
from pytest_dura.evidence.entry import Absent, Entry, JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import Gate
from pytest_dura.evidence.item_verdicts import ItemVerdict, Waiver
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.session_model import (
    ComponentEntry,
    ComponentUnderTest,
    EnvironmentEntry,
    ExecutionEntry,
    InputEntry,
    MergedShard,
    ResumeEntry,
    SecondEngineEntry,
    SelectionEntry,
    SessionTimings,
    ShardEntry,
    ToolEntry,
)
from pytest_dura.evidence.signing import SignedReview, read_review
from pytest_dura.evidence.verdict_model import EffectivenessEntry, LookEntry
from pytest_dura.requirements.comparison import ComparedBaseline
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.judgements import Doubt, Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality

CellValue = str | codec.Number | bool | None
"""Value of a cell of a concluded table."""


@dataclass(frozen=True)
class ConcludedColumn:
    """A column of a further table."""

    name: str
    """Its heading."""
    meaning: str = ""
    """What it counts or measures."""
    unit: str = ""
    """Of its numbers."""


@dataclass(frozen=True)
class ConcludedTable:
    """A further table of the session, which follows from its episodes."""

    title: str
    """Its heading."""
    about: str
    """What it shows, in one sentence."""
    columns: tuple[ConcludedColumn, ...]
    """The first one names the row."""
    rows: tuple[tuple[CellValue, ...], ...]
    """A value for each column; null where there is none."""
    detail: bool = False
    """Whether the terminal shows it with ``-v`` alone."""
    lines: tuple[str, ...] = field(default=(), metadata=codec.LEFT_OUT)
    """What it comes to, in sentences, which stand in the terminal in any case."""


class Totals(Entry):
    """Counts that every format states. Waived verdicts also count under their own status."""

    gate: Literal["passed", "failed", "incomplete"]
    """As `gate.result`."""
    requirements: Count
    """Requirements."""
    cases: Count
    """Cases with one component each."""
    episodes: Count
    """Episodes that were run."""
    valid: Count
    """Valid ones."""
    invalid: Count
    """Invalid ones."""
    missing: Count
    """Missing ones."""
    supported: Count
    """Verdicts."""
    violated: Count
    """Verdicts."""
    undecided: Count
    """Verdicts."""
    waived: Count
    """Verdicts that a waiver excuses."""


@dataclass(frozen=True)
class Fact:
    """A fact that a further table rests on, beside the episodes of the record."""

    table: str
    """Name of the table."""
    about: str
    """What it is on; of one table and process there is one fact on it."""
    order: Count
    """Its place among those of the table."""
    data: dict[str, Any]
    """What is known of it, as the table reads it."""
    process: str = field(default="", metadata=codec.LEFT_OUT)
    """The process that it is true of, where each counts for itself; of merged sessions with the
    SHA-256 of the session's record before it. Absent where it is true of the session."""


COUNTED = tuple(each.name for each in fields(Totals) if each.name != "gate")
"""Names of the counts."""


class RecordHead(Entry):
    """What a session leaves behind, its episodes apart, which are read one at a time.

    Every other file of the bundle is rendered from it. Times are in seconds, simulated unless
    stated otherwise; a number that is not finite is null.
    """

    schema_version: Literal["5"]
    """Version of this schema."""
    status: Literal["running", "complete", "interrupted"]
    """How the session ended. Only `complete` can be a pass; `running` is one that was killed."""
    created: str
    """When the session began, in ISO 8601."""
    tool: ToolEntry
    """What wrote the record."""
    command: str
    """The command of the session; of merged sessions that of the first one, with the merged
    evidence."""
    base_seed: Count
    """From which every episode's seed follows."""
    evidence_level: Literal["summary", "violations", "all"]
    """Of which episodes traces are kept: `--dura-evidence-level`."""
    require_repeatable: bool
    """Whether a case that is not repeatable fails the gate (ini `dura_require_repeatable`)."""
    environment: EnvironmentEntry
    """Where the session ran; of merged sessions the first one."""
    execution: ExecutionEntry
    """Who simulated the episodes (`--dura-executor`); of merged sessions the first one."""
    second_engine: Absent[SecondEngineEntry] = None
    """What a second engine for formulas was compared on (ini `dura_stl_engine`); of merged sessions
    their sums. Absent without one."""
    options: Absent[dict[str, str]] = None
    """Options on which results depend, by name, as JSON: what all parts that are merged have in
    common. Absent where none is given."""
    resume: ResumeEntry
    """What was taken over from earlier sessions (`--dura-resume`), fault-free twins apart."""
    shard: ShardEntry | None
    """Which part of a session this is (`--dura-shard`); null for a whole one."""
    merged_from: list[MergedShard] | None
    """The sessions of which `python -m pytest_dura merge` made this record, by the numbers of their
    shards and when they began; null for the record of a session."""
    selection: SelectionEntry
    """Which of the planned verdicts the session was asked for: what `-k`, `--deselect`, a conftest
    and `--dura-runs` left of the plan. Of a shard, that of the whole session."""
    component_under_test: ComponentUnderTest
    """The component under test."""
    measures: list[MeasureInfo]
    """The figures that simulators declare for their episodes, in the order of tables."""
    units: Absent[dict[str, str]] = None
    """Units of the signals that checks name, by name, as domains declare them. Absent where none is
    known; one that two domains declare differently is not among them."""
    hazards: Absent[list[Hazard]] = None
    """Sorted by id: those of the user's files, and of the built-in ones those that a requirement of
    the session mitigates. Absent where there are none."""
    requirements: list[Requirement]
    """Sorted by id."""
    cases: list[CaseEntry]
    """Sorted by id and component."""
    judgements: list[Judgement]
    """What items asked, from which the verdicts follow; sorted by item, requirement and case."""
    failed_items: Absent[list[str]] = None
    """Node ids of the test items that failed in the end, sorted; absent where none did."""
    stopped_items: Absent[dict[str, str]] = None
    """Why failed items of scenarios judged no run, such as a fault of a channel that the simulator
    does not have; by node id, absent where each judged some."""
    waivers: dict[str, Waiver]
    """What excuses failures, by the node id of the item."""
    doubts: list[Doubt]
    """Cases whose episodes cannot be trusted."""
    verdicts: list[ItemVerdict]
    """Sorted by case and requirement."""
    searches: list[RecordedSearch]
    """What searches for violations came to (`campaign.falsify`). None of it is part of a verdict or
    of a rate."""
    monitors: list[MonitorQuality]
    """Quality of the monitors."""
    overall: list[OverallEntry]
    """What the planned episodes of all cases come to, one entry for each component; cases in which
    a role is switched off for comparison are not among them."""
    effectiveness: list[EffectivenessEntry]
    """What the runs show of recovery and monitors by themselves, also that they cannot show it; no
    verdict."""
    baseline: ComparedBaseline | None
    """What the session was compared with; null without."""
    looks: Absent[list[LookEntry]] = None
    """Earlier verdicts on rates, of the evidence that this session replaced and of the baseline: a
    bound holds with its confidence for one look. Absent where there are none."""
    finished: str | None
    """When it ended, in ISO 8601; null as long as it runs."""
    gate: Gate
    """Whether the session passed. It fails closed."""
    inputs: list[InputEntry]
    """The files that the session was run from."""
    facts: Absent[list[Fact]] = None
    """What further tables rest on beside the episodes, sorted by table and place: taken as recorded
    where the record is verified. Absent where there are none."""
    coverage: CoverageEntry
    """What was tried of what there is."""
    conclusions: dict[str, ConcludedTable]
    """Further tables, of this package or of others, by name."""
    timings: SessionTimings
    """Where the session's time went."""
    redacted: dict[str, Positive]
    """How often a secret was replaced, by the name of its environment variable or the kind of
    secret."""
    totals: Totals
    """What every format states."""

    def components(self) -> list[ComponentUnderTest | ComponentEntry]:
        """List the components under test, the first one first."""
        first = self.component_under_test
        return [first, *(first.others or ())]

    def contradictions(self) -> Iterator[str]:
        """Yield what its keys cannot say together, apart from what follows from others."""
        if self.status != "complete":
            yield f"the session is {self.status}: its evidence is incomplete"
        for key in ("cases", "requirements", "hazards"):
            listed: list[Any] = getattr(self, key) or []
            if len({(each.id, getattr(each, "component", "")) for each in listed}) < len(listed):
                yield f"{key}: one of them is listed twice"
        failed = self.failed_items or []
        if failed != sorted(set(failed)):
            yield "failed_items: not each of them once, in order"
        if self.timings.evidence_seconds > self.timings.wall_seconds:
            yield "timings: the evidence took longer than the session"
        known = {hazard.id for hazard in self.hazards or ()}
        for requirement in self.requirements:
            named = requirement.mitigates
            for hazard in dict.fromkeys(named):
                if hazard not in known:
                    mitigated = f"it mitigates {hazard}, which is not listed"
                    yield f"requirement {requirement.id}: {mitigated}"
                if named.count(hazard) > 1:
                    yield f"requirement {requirement.id}: it mitigates {hazard} twice"


class WholeRecord(RecordHead):
    """Content of ``evidence.json``."""

    episodes: list[EpisodeEntry]
    """Sorted by case, component, run and seed."""


@dataclass(frozen=True)
class SessionRecord(Shown):
    """Content of ``evidence.json``. Its episodes may be many, and are never all in memory.

    Args:
        head: Every top-level key but ``episodes``.
        directory: The bundle's directory, in which the files of traces lie.
        read_episodes: Returns a new iterator over the episodes at each call, in their order.
    """

    head: RecordHead
    directory: Path
    read_episodes: Callable[[], Iterator[EpisodeEntry]]

    def __repr__(self) -> str:
        totals = self.head.totals
        return (
            f"<record, {self.head.status}, gate {totals.gate}, {totals.episodes} episodes, "
            f"{totals.supported} supported, {totals.violated} violated, "
            f"{totals.undecided} undecided>"
        )

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        head, totals = self.head, self.head.totals
        yield "session", f"{head.created}, {head.status}"
        yield "gate", [head.gate.result, *head.gate.reasons]
        yield "component", [component.name for component in components_under_test(self)]
        yield "episodes", f"{totals.episodes}, {totals.valid} valid"
        yield (
            "verdicts",
            [f"{entry.requirement} on {entry.case}: {entry.verdict}" for entry in head.verdicts]
            or None,
        )

    def episodes(self) -> Iterator[EpisodeEntry]:
        """Iterate over the episodes, in the order of the record."""
        return self.read_episodes()

    @cached_property
    def review(self) -> SignedReview | None:
        """The review that lies beside the bundle; its signature is not checked."""
        return read_review(self.directory, self.head.finished or self.head.created)

    def to_json(self) -> JsonObject:
        """Convert to plain data, with all episodes."""
        episodes = [episode.to_json() for episode in self.episodes()]
        return {**self.head.to_json(), "episodes": episodes}

    @classmethod
    def of(cls, record: Mapping[str, Any], directory: Path) -> SessionRecord:
        """Make a record of plain data that is in memory as a whole.

        Raises:
            MismatchError: If it does not agree with the entries.
        """
        head = {key: value for key, value in record.items() if key != "episodes"}
        whole = codec.decode(WholeRecord, dict(record))
        return cls(codec.decode(RecordHead, head), directory, whole.episodes.__iter__)

    def changed(self, **changes: Any) -> SessionRecord:
        """Copy with other values of top-level keys, as plain data or entries."""
        return replace(self, head=self.head.replace(**changes))


def components_under_test(record: SessionRecord) -> list[ComponentUnderTest | ComponentEntry]:
    """List the components under test that the record describes, the first one first."""
    return record.head.components()
