"""Models of episodes in the record."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from typing import Annotated, Literal

from pytest_dura.core.clock import Timeliness
from pytest_dura.core.codec import Amount, Count, Limit, Number, Positive, Sha256, encode
from pytest_dura.core.episode import EpisodeSpec, outcome_of
from pytest_dura.core.loop_signals import Switching
from pytest_dura.core.metrics import EpisodeMetrics, FaultCounts, TracedFault
from pytest_dura.core.state import Event
from pytest_dura.evidence.entry import Absent, Entry, JsonObject
from pytest_dura.requirements.campaign_verdicts import TEST_FAILED
from pytest_dura.requirements.episode_verdicts import EARLY_ENDS, CheckVerdict

INFRASTRUCTURE = "infrastructure: "
"""Beginning of a message on what is no fault of the component."""


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
    same_as: Absent[str] = None
    """Id of the run with recovery that it is, where recovery was not asked in that one: the run
    without it is the same, and was not simulated. Absent where it was simulated by itself."""


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
    timeliness: Absent[Timeliness]
    """How its time was kept; absent where the world waits for the component."""


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

    def contradictions(self) -> Iterator[str]:
        """Yield what its fields cannot say together."""
        yield from self._contradictions_of_spec()
        yield from self._contradictions_of_metrics()
        alerts = {event.time for event in self.events if event.kind == "alert"}
        for fault in self.faults:
            for problem in self._contradictions_of_fault(fault, alerts):
                yield f"{fault.id}: {problem}"
        for name, verdict in self.verdicts.items():
            for problem in self.contradictions_of(verdict):
                yield f"{name} is {problem}"

    def _contradictions_of_spec(self) -> Iterator[str]:
        spec, validity = self.spec, self.validity
        if self.id != f"{spec.case}#{spec.run}" or self.case != spec.case:
            yield f"its spec is that of {spec.case}#{spec.run}"
        if spec.timeouts is None:
            yield "its spec does not say which calls overran their budget"
        if self.seed != spec.seed:
            yield f"seed {self.seed}, and {spec.seed} in its spec"
        if (validity == "missing") != (self.failure is not None):
            yield f"{validity}, and its failure is {self.failure!r}"
        if (validity == "invalid") != (self.failure is None and self.invalid_reason is not None):
            yield f"{validity}, because {self.invalid_reason!r}"
        if validity == "missing" and self.origin.session is not None:
            yield "it was taken over, and it is missing"
        if self.origin.same_as is not None and (self.outcome.flagged or validity == "missing"):
            yield f"it is recorded as {self.origin.same_as}, and it was flagged or is missing"
        missing = {fault.id for fault in spec.faults} - {fault.id for fault in self.faults}
        if missing:
            yield f"there is no entry for its faults {', '.join(sorted(missing))}"

    def _contradictions_of_metrics(self) -> Iterator[str]:
        metrics, outcome = self.metrics, self.outcome
        counts = FaultCounts.summed_up(self.faults)
        if metrics.faults != counts:
            yield f"its faults are {encode(metrics.faults)}, and they come to {encode(counts)}"
        if metrics.recoveries != outcome.recoveries:
            yield f"{metrics.recoveries} recoveries, and {outcome.recoveries} in its outcome"
        if metrics.alerts != outcome.alerts:
            yield f"{metrics.alerts} alerts, and {outcome.alerts} in its outcome"
        lasted = self.timings.simulated_seconds
        yield from metrics.contradictions(outcome.switching.decisions, lasted)
        first: dict[str, float] = {}
        for event in self.events:
            if event.kind == "fault_manifested":
                first.setdefault(event.subject, event.time)
        for fault in self.faults:
            if fault.manifested_at != first.get(fault.id):
                manifested = f"{fault.id} manifested at {fault.manifested_at} s"
                yield f"{manifested}, and its events say {first.get(fault.id)}"

    def _contradictions_of_fault(
        self, fault: TracedFault, alerts: Collection[float]
    ) -> Iterator[str]:
        """Derive latencies and outcome of a fault from the rest of its chain again.

        Args:
            fault: The fault.
            alerts: Times of the alerts, in s.
        """
        for latency, seconds in fault.latencies().items():
            if (recorded := getattr(fault, latency)) != seconds:
                yield f"{latency} is {recorded} s, and its times give {seconds}"
        if fault.read_by and not fault.success:
            yield f"read by {', '.join(fault.read_by)}, and it never manifested"
        detected, began = fault.detected_at, fault.began_at
        if detected is not None and (not fault.success or began is None or detected < began):
            yield f"detected at {detected} s, and no alert of then can answer it"
        elif detected is not None and detected not in alerts:
            yield f"detected at {detected} s, and its events say of no alert then"
        without = fault.violated_without
        if extra := sorted({*(without or ())} - {*fault.violated}):
            yield f"{extra[0]} is violated without it, and not with it"
        outcome, missing = fault.outcome, self.failure is not None
        expected = outcome_of(fault, fault.propagation, fault.violated, without, missing=missing)
        if outcome is None and fault.violated:
            yield "violated, and it has no outcome"
        if outcome not in (None, expected):
            yield f"its outcome is {outcome!r}, and its chain gives {expected!r}"

    def contradictions_of(self, verdict: CheckVerdict) -> Iterator[str]:
        """Yield what a check cannot say of an episode that came to this."""
        status, margin, time = verdict.status, verdict.margin, verdict.time
        if status in ("satisfied", "open") and self.validity != "valid":
            yield f"{status}, and the run is {self.validity}"
        if status == "invalid" and self.validity == "missing":
            yield f"{status}, and the run is {self.validity}"
        if status == "open" and self.termination not in EARLY_ENDS:
            yield f"{status}, and the run ended by {self.termination}"
        unexplained = not verdict.detail.startswith((INFRASTRUCTURE, TEST_FAILED))
        if status == "missing" and self.validity != "missing" and unexplained:
            yield f"{status}, and no error says why"
        lasted = self.timings.simulated_seconds
        if time is not None and (status != "violated" or time > lasted):
            yield f"{status} at {time} s of {lasted} s"
        if status == "satisfied" and margin is not None and margin < 0:
            yield f"{status} by {margin}"
        if verdict.vacuous and status != "satisfied":
            yield f"{status}, and vacuous"


def inputs_digest(spec: JsonObject) -> bytes:
    """SHA-256 of what determines an episode; recorded timeouts stand in for the clock."""
    inputs = {key: value for key, value in spec.items() if key != "timeouts"}
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).digest()


def episode_order(episode: EpisodeEntry) -> tuple[str, str, int, int, bytes]:
    """Sort key of the episodes of a record, which no two different ones share."""
    spec = episode.spec
    return episode.case, episode.component, spec.run, episode.seed, inputs_digest(spec.to_json())
