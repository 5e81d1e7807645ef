"""Models of hazards, requirements and cases in the record: their faults, figures and coverage."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pytest_dura.core.codec import Amount, Count, Limit, Number, Positive, Sha256, Share
from pytest_dura.core.fault import Fault
from pytest_dura.evidence.entry import Absent, Entry


class RangeEntry(Entry):
    """A range, drawn from uniformly."""

    min: Number
    """Least value, in the unit of what varies."""
    max: Number
    """Greatest value, in that unit."""
    pieces: Absent[Positive] = None
    """So many numbers, each drawn from the range: an input over time."""
    unit: Absent[str] = None
    """Unit of what varies, where the scenario states one."""


class ChoicesEntry(Entry):
    """Values, each as likely as the others."""

    choice: Annotated[list[Any], Limit(min_items=1)]
    """The values."""


Variation = RangeEntry | ChoicesEntry


class ShareEntry(Entry):
    """A count over episodes, with its shares."""

    valid: Count
    """Valid episodes."""
    run: Count
    """All planned episodes that were run."""
    share_of_valid: Share | None
    """Share of the valid episodes; null without any."""
    share_of_planned: Amount | None
    """Count over all runs divided by the planned episodes; above 1 where further runs followed
    invalid ones."""


class LatencyEntry(Entry):
    """A latency over the episodes in which it is known, in seconds."""

    median: Number
    """Median, in s."""
    max: Number
    """Greatest, in s."""


class FaultRates(Entry):
    """Shares of the episodes that could; null without any."""

    activation: Share | None
    """Of all runs."""
    manifestation: Share | None
    """Of all runs."""
    propagation: Share | None
    """Of those followed."""
    detection: Share | None
    """Of those manifested."""
    recovery: Share | None
    """Of those in which recovery acted."""


class FaultMetricsEntry(Entry):
    """How far one fault got, over the planned episodes of a case."""

    id: str
    """Id of the fault."""
    target: str
    """Sensor channel, field of a channel, or `command`."""
    run: Count
    """Episodes in which it was planned."""
    activated: Count
    """Episodes in which it was active."""
    manifested: Count
    """Episodes in which it changed what a role read, or the command."""
    read_by: list[str]
    """Roles that read what it changed, in any of them; none for a fault of the command."""
    followed: Count
    """Of those, episodes in which it is known whether it changed a proposal."""
    propagated: Count
    """Of those, episodes in which it did."""
    detected: Count
    """Of the manifested, episodes with an alert."""
    recovery: Count
    """Of the manifested, episodes in which recovery acted."""
    recovered: Count
    """Of the manifested, episodes in which control was handed back."""
    judged: Count
    """Episodes whose outcome is known."""
    violated: Count
    """Of those, episodes that violated a requirement from its manifestation on, and not as well
    without any fault."""
    violated_without: Count
    """Of the judged, further episodes in which all that was violated from its manifestation on is
    violated without any fault, too."""
    rates: FaultRates
    """Shares of the episodes that could; null without any."""
    detection_latency: LatencyEntry | None
    """From activation to the alert, in s."""
    recovery_latency: LatencyEntry | None
    """From manifestation to the first recovery action, in s."""
    time_to_recover: LatencyEntry | None
    """From there until the proposal was acceptable again, in s."""


class FailureModeEntry(Entry):
    """A failure mode over a case's valid episodes.

    Decisions of one episode depend on each other, so that only a share of episodes has a bound.
    """

    name: str
    """Its name; formulas read it as `proposal.` and the name."""
    kind: Literal["failure", "infrastructure", "control", "comparison"]
    """Whether it is a failure, one of the server or the way there, the negative control, or a
    comparison that is no failure by itself."""
    hits: Count
    """Decisions that showed it."""
    of: Count
    """Decisions that could have."""
    share: Share | None
    """Their share; null where none could have."""
    null_hits: Count
    """The same of the null component."""
    null_of: Count
    """Decisions of it that could have."""
    null_share: Share | None
    """Their share; null where none could have."""
    episodes: Count
    """Episodes in which it ever showed."""
    of_episodes: Count
    """Episodes in which it could have."""
    upper: Share | None
    """Exact upper bound, with confidence 0.95, on the rate of such episodes; null without any."""


class MeasuredNumbers(Entry):
    """Numbers of valid episodes, in the unit of their measure."""

    runs: Count
    """Episodes that have one."""
    mean: Number | None
    """Mean."""
    sd: Number | None
    """Standard deviation."""


class TimeToSafe(Entry):
    """From a takeover until a proposal was not unsafe."""

    median: Number | None
    """Median, in s."""
    max: Number | None
    """Greatest, in s."""
    censored: Count
    """Takeovers after which the episode ended before that."""


class SwitchingFigures(Entry):
    """Control."""

    share: Share | None
    """Share of the decisions that recovery made."""
    takeovers: Count
    """Times that recovery took over."""
    switches_per_episode: Amount
    """Changes of control in both directions, per episode."""
    time_to_safe: TimeToSafe
    """From a takeover until a proposal was not unsafe."""


class MeanFigure(Entry):
    """Over valid episodes."""

    mean: Number | None
    """Mean, in the metric's unit."""
    runs: Count
    """Episodes in which it has a value."""


class Percentiles(Entry):
    """In seconds; percentiles are those of the nearest rank."""

    decisions: Positive
    """Decisions whose time is known."""
    p50: Amount
    """Median, in s."""
    p95: Amount
    """95th percentile, in s."""
    max: Amount
    """Greatest, in s."""


Measured = ShareEntry | MeasuredNumbers


class CaseMetricsEntry(Entry):
    """What the planned episodes of a case come to."""

    planned: Count
    """Planned episodes."""
    run: Count
    """Episodes that were run."""
    valid: Count
    """Valid ones."""
    invalid: Count
    """Those whose fault never manifested."""
    missing: Count
    """Those that an infrastructure error ended."""
    ended_early: Count
    """Those that ended once every requirement of the case was decided; what follows counts what was
    seen by then."""
    flagged: ShareEntry | None
    """Episodes with a proposal that was found unsafe; null where the domain has no such signal."""
    measures: dict[str, Measured]
    """What the measures of its simulator come to, by name: how often they are true, or the spread
    of a number over valid episodes; absent where no episode has one."""
    recoveries: Count
    """Stretches in which recovery acted, in valid episodes."""
    alerts: Count
    """Alerts in valid episodes."""
    rescued: ShareEntry | None
    """Episodes in which recovery took over; null where none was run."""
    reactions: dict[str, Positive]
    """How often the component reacted in which way to what looked like an attack, in valid
    episodes, by class."""
    switching: SwitchingFigures | None
    """How control was shared over the valid episodes; null where nothing was decided."""
    user: dict[str, MeanFigure]
    """Metrics of the user's own, by name."""
    faults: list[FaultMetricsEntry]
    """One entry for each fault."""
    failure_modes: list[FailureModeEntry]
    """What the component's accounts of its decisions show; empty where it gives none."""
    answer_times: Percentiles | None
    """How long decisions took in wall-clock time by the component's own account, over valid
    episodes; null where it tells of none."""
    answer_ages: Percentiles | None
    """How old the component's own decisions were when they came into force, by its own account,
    over valid episodes: simulated time since the percept behind them; null where it tells of
    none."""


class RepeatEntry(Entry):
    """A repetition."""

    episode: str
    """Id of the episode."""
    digest: Sha256
    """Its digest as it is recorded."""
    repeated_digest: Sha256 | None
    """That of the repetition; null where there is none."""
    result: Literal["equal", "within tolerances", "different", "failed", "skipped"]
    """Whether the digests are equal, or, of a simulator that is not deterministic, the signals
    within the tolerances that it declares; `failed` for a repetition that an infrastructure error
    ended, `skipped` where equal seeds may give other episodes for a reason outside of the session,
    such as a server that is asked anew."""
    detail: str
    """Why it failed or was skipped, or how signals compare, in words."""
    declared: str
    """What declares that equal seeds may give other episodes: the component, the simulator, the
    session. Then the runs of the case count as draws. Empty if nothing does."""


class CasePlan(Entry):
    """A scenario with faults, for one component, before it is run."""

    order: Positive | None
    """Place of its scenario in tables, from 1, as the scenario file gives it; null for none, which
    come last, by name."""
    id: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off, or `~generator=` and its reference."""
    scenario: str
    """Name of the scenario."""
    faults: list[Fault]
    """The planned faults, before what varies is drawn."""
    component: str
    """Name of the component under test."""
    without: list[str]
    """Roles that are switched off, for the second runs of pairs; `generator` where a reference
    takes the place of the component under test."""
    off: list[str]
    """Roles that a fixture or the scenario switches off for all runs."""
    requirements: list[str]
    """Ids of the requirements that apply to the scenario."""
    variation: dict[str, Variation]
    """What differs between runs, by dotted path: `world.x`, `faults.id.x`."""
    planned: Count
    """Planned episodes, or the most that may be run."""
    runs_override: Count | None
    """`--dura-runs`, which replaced what the scenario plans."""
    seed: Absent[Count] = None
    """Seed of run 0 that the scenario names, from which those of further runs follow; absent where
    all follow from the base seed."""
    reference: Absent[str] = None
    """The component that takes the place of the component under test, for the second runs of
    pairs; absent without one."""


class CaseEntry(CasePlan):
    """A scenario with faults, for one component."""

    metrics: CaseMetricsEntry
    """What its planned episodes come to."""
    repeat: RepeatEntry | None
    """What came of running one of its planned episodes once more in the session, which is part of
    no count; null where none was."""
    missing_runs: list[Count]
    """Numbers of planned runs of which nothing was heard; the first hundred."""
    missing_runs_total: Count
    """How many they are."""


class OverallEntry(Entry):
    """All cases of a component together."""

    component: str
    """Name of the component under test."""
    cases: Positive
    """How many cases."""
    metrics: CaseMetricsEntry
    """What their planned episodes come to, pooled."""


class CellEntry(Entry):
    """One requirement in one scenario under one set of faults."""

    requirement: str
    """Id of the requirement."""
    scenario: str
    """Name of the scenario."""
    faults: str
    """Ids of the faults, joined with `+`; empty without any."""
    component: str
    """Name of the component under test."""
    case: str
    """Id of the case that tests it, or would."""
    applies: Literal["scenario", "test"]
    """Why there is a cell: the scenario lists the requirement, or a test claims it there."""
    verdict: Literal["supported", "violated", "undecided"] | None
    """The worst verdict on it; null: untested."""


class ChoiceEntry(Entry):
    """A choice."""

    value: Any
    """The value."""
    count: Count
    """How often."""


class ParameterEntry(Entry):
    """Which part of what a scenario varies was drawn, over the seeds of valid planned episodes."""

    scenario: str
    """Name of the scenario."""
    parameter: str
    """Dotted path: `world.x`, `faults.id.x`."""
    low: Number | None
    """Least value of the range, in its unit; null for choices."""
    high: Number | None
    """Greatest value of the range, in its unit; null for choices."""
    choices: list[ChoiceEntry] | None
    """How often each choice was drawn; null for a range."""
    drawn: Count
    """Values that were drawn."""
    least: Number | None
    """Least of them, in the unit of the range."""
    greatest: Number | None
    """Greatest of them, in the unit of the range."""
    bins: list[Count]
    """How many fell into each of ten equal parts of the range; empty for choices."""
    covered: Share
    """Share of the parts, or of the choices, with any."""


class PairEntry(Entry):
    """Which combinations of two varied parameters of a scenario were drawn."""

    scenario: str
    """Name of the scenario."""
    first: str
    """Dotted path of a parameter."""
    second: str
    """Dotted path of the other one."""
    drawn: Count
    """Draws of both: seeds of valid planned episodes."""
    met: Count
    """Cells with any draw."""
    counts: Annotated[list[Annotated[list[Count], Limit(min_items=1)]], Limit(min_items=1)]
    """Draws by cell: a row for each part of the first parameter, in it a number for each part of
    the second. Parts are fifths of a range, or single choices."""
    covered: Share
    """Share of the cells with any draw."""


class CombinationsEntry(Entry):
    """Which combinations of the parameters of a scenario were drawn, two at a time."""

    pairs: Positive
    """Pairs of parameters, over all scenarios."""
    cells: Positive
    """Cells of all of them."""
    met: Count
    """Cells with any draw."""
    unpaired: Count
    """Varied parameters that stand in no pair: inputs over time, and choices of more than 20
    values."""
    worst: list[PairEntry]
    """The pairs, those with the least share of cells first; the first thousand."""


class CoverageEntry(Entry):
    """What was tried of what there is."""

    cells: list[CellEntry]
    """Requirement x scenario x faults, for each component."""
    left_out: Count
    """Untested cells that are too many to be listed."""
    parameters: list[ParameterEntry]
    """Ranges that scenarios vary."""
    combinations: Absent[CombinationsEntry] = None
    """Pairs of them; absent where no scenario varies two."""
