"""Models of episodes in the record."""

from __future__ import annotations

from typing import Annotated, Literal

from pytest_dura.core.codec import Amount, Count, Limit, Number, Positive, Sha256
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.loop_signals import Switching
from pytest_dura.core.metrics import EpisodeMetrics, TracedFault
from pytest_dura.core.state import Event
from pytest_dura.evidence.entry import Entry
from pytest_dura.requirements.episode_verdicts import CheckVerdict


class TraceEntry(Entry):
    """The file of an episode's trace."""

    file: Annotated[str, Limit(pattern=r"^episodes/[^/\\]+\.mcap$")]
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
    switching: Switching
    """Who was in control."""


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
    (the plant ended by itself), `halt`, `lost` (a call of the component ended the process, and the
    trace with it) or `infrastructure`."""
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
    metrics: EpisodeMetrics
    """What the loop measured."""
    faults: list[TracedFault]
    """What came of each planned fault."""
    verdicts: dict[str, CheckVerdict]
    """What the requirements that its case declares say of it, by id; none on a requirement without
    a check, and on one whose check cannot be judged on it."""
    events: list[Event]
    """In the order in which they happened."""
    timings: EpisodeTimings
    """Where the time went."""
    spec: EpisodeSpec
    """All that determines it."""
