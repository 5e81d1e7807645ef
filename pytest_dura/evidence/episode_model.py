"""Models of episodes in the record."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pytest_dura.evidence.case_model import FaultPlanEntry
from pytest_dura.evidence.entry import (
    Absent,
    Amount,
    Coded,
    Count,
    Entry,
    JsonObject,
    Number,
    OpenEntry,
    Positive,
    PositiveNumber,
    Sha256,
    Share,
)
from pytest_dura.requirements.episode_verdicts import CheckVerdict


class RoleEntry(Entry):
    """How a role is built."""

    path: str
    """Import path `package.module:Name`, or `file.py:Name` for what a conftest.py defines."""
    params: JsonObject
    """Its keyword parameters, the user's own."""
    opaque: Absent[bool] = None
    """Whether it was a bare instance, which no other process can build again."""


class ScenarioEntry(OpenEntry):
    """The scenario as the simulator and the roles read it, with the values that were drawn.

    The world is the user's own.
    """

    name: str
    """Name of the scenario."""
    duration: Absent[Number] = None
    """Simulated seconds."""
    iterations: Absent[Positive] = None
    """Decisions at most; absent without a limit."""
    world: Absent[JsonObject] = None
    """The world."""


class TerminationEntry(Entry):
    """When it ends."""

    time_limit: PositiveNumber
    """Simulated seconds."""
    goal: bool
    """Whether reaching the goal ends it."""
    violation: bool
    """Whether a violation ends it."""
    iterations: Positive | None
    """Decisions at most."""
    decided: Absent[bool] = None
    """Whether it ends once every requirement of its case is decided; absent if not."""


class SpecEntry(Entry):
    """All that determines the episode: from it, it can be run again."""

    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    run: Count
    """Number of the run, from 0."""
    seed: Count
    """Seed of every stream in the episode."""
    simulator: RoleEntry
    """How to build the simulator."""
    roles: dict[str, RoleEntry]
    """How to build each role, by its name."""
    scenario: ScenarioEntry
    """The scenario as the simulator and the roles read it, with the values that were drawn; the
    world is the user's own."""
    faults: list[FaultPlanEntry]
    """The planned faults, with the values that were drawn."""
    policy: Annotated[str, Field(pattern=r"^(recover|halt|log_only|refine\([1-9][0-9]*\))$")]
    """What follows a refused proposal."""
    termination: TerminationEntry
    """When it ends."""
    time_step: PositiveNumber
    """Simulated seconds per tick."""
    time_budget: PositiveNumber | None
    """Seconds that the component has for one proposal; null waits for ever."""
    timeouts: list[Annotated[int, Field(ge=-1)]]
    """Recorded calls in which the component overran its budget: number of the proposal, -1 for the
    reset."""


class FaultEntry(Entry):
    """A fault in an episode, from plan to outcome.

    Times in simulated seconds, null for what never happened.
    """

    id: str
    """Its name in the case."""
    target: str
    """Sensor channel, field of a channel, or `command`."""
    planned_at: Number | None
    """Planned activation, in s."""
    activated_at: Number | None
    """First tick at which it acted, in s."""
    manifested_at: Number | None
    """First tick at which it changed what a role read, or the command, in s."""
    read_by: list[str]
    """Roles that read what it changed; none for a fault of the command."""
    deactivated_at: Number | None
    """First tick at which the latest activation no longer acted, in s."""
    detected_at: Number | None
    """First alert while it was active, in s: also one from before it manifested, if it did."""
    detected_by: str | None
    """Role that raised it."""
    pattern: str | None
    """Pattern of that alert."""
    recovery_at: Number | None
    """First recovery action, in s."""
    recovery: str | None
    """Name of that action."""
    recovered_at: Number | None
    """First tick after it at which the proposal was acceptable again, in s."""
    activations: Count
    """How often it was activated."""
    manifest_ticks: Count
    """Ticks at which it manifested."""
    flagged_ticks: Count
    """Those at which the proposal was unsafe."""
    by_chance: bool
    """Whether it is drawn whether it has any effect."""
    manifestation_latency: Number | None
    """From activation to manifestation, in s."""
    detection_latency: Number | None
    """From activation to the first alert, in s."""
    recovery_latency: Number | None
    """From manifestation to the first recovery action, in s."""
    time_to_recover: Number | None
    """From there until the proposal was acceptable again, in s."""
    propagation: str | None
    """Whether the proposals left those of the fault-free twin; null where that was not measured."""
    propagated_at: Number | None
    """When they did, in s."""
    unknown: str
    """Why that cannot be said; empty if it can."""
    outcome: (
        Literal[
            "idle",
            "masked",
            "contained",
            "tolerated",
            "violated",
            "violated also without it",
            "missing",
        ]
        | None
    )
    """What came of it; null where no verdict asked. What is violated also without it is not its
    doing."""
    violated: list[str]
    """Requirements that were violated from its manifestation on."""
    violated_without: list[str] | None
    """Those among them that the fault-free twin violates, too; null without a twin."""


class EventEntry(Entry):
    """Something that happened at one tick."""

    tick: Count
    """Number of the tick, from 0."""
    time: Number
    """Simulated seconds."""
    kind: str
    """Such as `alert`, `unsafe`, `recovery`, `fault_activated`."""
    subject: str
    """Who or what it is about."""
    detail: str
    """In words."""
    data: JsonObject
    """Further values."""


class TraceEntry(Entry):
    """The file of an episode's trace."""

    file: Annotated[str, Field(pattern=r"^episodes/[^/\\]+\.mcap$")]
    """Its path in the bundle."""
    sha256: Sha256
    """SHA-256 of the file."""
    bytes: Positive
    """Its size, in bytes."""
    kept_for: Literal["violation", "sample", "missing", "all", "twin"]
    """Why it was kept; `twin` if only to be seen beside a counterexample, as its run of the same
    seed without its faults or without a role."""


class OriginEntry(Entry):
    """Which session simulated it, and why."""

    session: str | None
    """Id of the earlier session that it was taken over from; null for one of this session."""
    changed: list[str] | None
    """What changed since an earlier session simulated an episode of this name, in words; empty
    where that was missing or damaged, null where there was none or it was taken over."""


class SwitchingEntry(Entry):
    """Who was in control."""

    decisions: Count
    """Ticks at which something was decided."""
    recovered: Count
    """Those at which recovery was in control."""
    recovery_time: Amount
    """Simulated seconds for which it was."""
    takeovers: Count
    """Times that recovery took over."""
    returns: Count
    """Times that control went back."""
    time_to_safe: list[Number | None]
    """For each takeover, seconds until a proposal was not unsafe; null where the episode ended
    before."""
    share: Share | None
    """Share of the decisions that recovery made."""
    switches: Count
    """Changes of control in both directions."""
    censored: Count
    """Takeovers with null in `time_to_safe`."""


class OutcomeEntry(Entry):
    """The figures of the case table."""

    flagged: bool
    """Whether a proposal was found unsafe."""
    measures: dict[str, bool | Number | None]
    """What the simulator's measures come to, by name; null for a number that it has not, absent
    where it lacks the signals."""
    recoveries: Count
    """Stretches in which recovery acted."""
    alerts: Count
    """Alerts."""
    switching: SwitchingEntry
    """Who was in control."""


class SeriesEntry(Entry):
    """A value over an episode, in its own unit."""

    last: Number | None
    """At the end."""
    min: Number | None
    """Least."""
    max: Number | None
    """Greatest."""


class FaultCounts(Entry):
    """Counts of faults."""

    planned: Count
    """Planned."""
    succeeded: Count
    """Manifested."""
    detected: Count
    """Detected."""
    recovered: Count
    """Recovered from."""
    impact_ticks: Count
    """Ticks at which one manifested and the proposal was unsafe."""


class TallyEntry(Entry):
    """How often a failure mode showed in an episode's decisions."""

    hits: Count
    """Decisions that showed it."""
    of: Count
    """Decisions that could have."""
    null_hits: Count
    """The same of a null component, which ignores its input, on the same decisions."""
    null_of: Count
    """Decisions of it that could have."""
    kind: Literal["failure", "infrastructure", "control", "comparison"]
    """Whether it is a failure, one of the server or the way there, the negative control, or a
    comparison that is no failure by itself."""


class EpisodeMetricsEntry(Entry):
    """What the loop measured."""

    violations: dict[str, Count]
    """Ticks at which each kind was violated, by role or threshold."""
    performance: dict[str, SeriesEntry]
    """Values over time, by name."""
    wall_clock: dict[str, SeriesEntry]
    """Values that depend on the machine's speed, by name."""
    robustness_min: dict[str, Number | None]
    """Least score of each monitor, by role."""
    faults: FaultCounts
    """Counts of faults."""
    recoveries: Count
    """Stretches in which recovery acted."""
    recoveries_succeeded: Count
    """Those after which the proposal was acceptable again."""
    alerts: Count
    """Alerts."""
    reactions: dict[str, Positive]
    """How often the component reacted in which way to what looked like an attack, by class:
    `unaffected`, `erratic`, `frozen`, `follows the fake`, or the assessor's own. A suspicion that
    is not over at the end has none."""
    proposals: Count
    """How often the component was asked."""
    valid_proposals: Count
    """How often it answered with an action of the simulator."""
    processing_us: dict[str, Number | None]
    """Mean wall-clock time of a call, by role, in microseconds."""
    tallies: dict[str, TallyEntry]
    """What the component's accounts of its decisions show, by failure mode; empty where it gives
    none."""
    answer_seconds: list[Amount]
    """Wall-clock seconds that its decisions took, by its own account."""
    answer_ages: list[Amount]
    """Simulated seconds from the percept behind each decision of its own to the tick at which it
    came into force, by its own account."""
    answer_usage: Absent[UsageEntry] = None
    """What its decisions used of language models, by its own account; absent where it tells of
    nothing."""
    user: JsonObject
    """Metrics of the user's own, by name."""


class UsageEntry(Entry):
    """What decisions used of language models, as the component's account has it.

    A replay from a cassette has the same.
    """

    requests: Count
    """Requests, those beside the decisions included."""
    prompt: Count
    """Tokens of the requests, as the server counted them."""
    completion: Count
    """Tokens of the answers."""
    uncounted: Count
    """Answers for which the server counted no tokens."""


class EpisodeTimings(Entry):
    """Where the time went."""

    simulated_seconds: Amount
    """Simulated time, in s."""
    processing_seconds: dict[str, Amount]
    """Wall-clock time by role, in s."""


class EpisodeEntry(Entry):
    """One closed-loop run."""

    id: str
    """`case#run`."""
    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str
    """Name of the component under test."""
    seed: Count
    """Its seed."""
    planned: bool
    """Whether it is part of its case's plan; one chosen by hand enters no rate."""
    origin: OriginEntry
    """Which session simulated it, and why."""
    validity: Literal["valid", "invalid", "missing"]
    """Invalid: a planned fault never manifested. Missing: an infrastructure error ended it."""
    invalid_reason: str | None
    """Which planned fault never manifested."""
    termination: str
    """What ended it: `goal`, `time`, `critical`, `violation`, `decided`, `iterations`, `truncated`
    (the plant ended by itself), `halt` or `infrastructure`."""
    failure: str | None
    """Message of the infrastructure error."""
    digest: Sha256
    """SHA-256 of everything in it but wall-clock timings; a replay gives the same."""
    trajectory: Sha256
    """SHA-256 of time, signals of truth and percept, decisions and end: equal for runs that differ
    by their seeds alone."""
    drawn: bool
    """Whether a random number was drawn from a stream of its seed."""
    trace: TraceEntry | None
    """Its trace in the bundle; null where none was kept."""
    outcome: OutcomeEntry
    """The figures of the case table."""
    metrics: EpisodeMetricsEntry
    """What the loop measured."""
    faults: list[FaultEntry]
    """What came of each planned fault."""
    verdicts: dict[str, Coded[CheckVerdict]]
    """What the requirements that its case declares say of it, by id; none on a requirement without
    a check, and on one whose check cannot be judged on it."""
    events: list[EventEntry]
    """In the order in which they happened."""
    timings: EpisodeTimings
    """Where the time went."""
    spec: SpecEntry
    """All that determines it."""
