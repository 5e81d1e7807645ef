"""Models of what the record says of monitors, and of comparisons with a baseline."""

from __future__ import annotations

from typing import Literal

from pytest_dura.evidence.entry import (
    Amount,
    Count,
    Entry,
    JsonObject,
    Number,
    Sha256,
    Share,
)


class EffectivenessEntry(Entry):
    """What the runs show of one role."""

    role: str
    """`recovery_planner`, or the name of a monitor."""
    component: str
    """Name of the component under test."""
    requirement: str | None
    """The requirement on pairs that it was held against; null for a monitor, which is held against
    all that it was measured on."""
    finding: Literal[
        "prevented",
        "introduced",
        "prevented none",
        "never acted",
        "changed nothing",
        "warned",
        "warned of none",
        "silent",
        "cannot be told",
    ]
    """What they show: recovery `prevented` violations, `introduced` some and prevented none,
    `prevented none` although it acted, `never acted` where it was needed, or `changed nothing`
    although it acted; a monitor `warned`, `warned of none` although it flagged, or was `silent`; or
    it `cannot be told`, since nothing was violated."""
    detail: str
    """The same in words, with its figures."""


class SpreadEntry(Entry):
    """Times, in seconds."""

    min: Number
    """Least, in s."""
    median: Number
    """Median, in s."""
    max: Number
    """Greatest, in s."""


class MonitorEntry(Entry):
    """How a monitor did on episodes in which nobody acted on its word; one count per episode."""

    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    monitor: str
    """Role name of the monitor, or `alerts`."""
    target: str
    """Id of the requirement, or `faults`."""
    component: str
    """Name of the component under test."""
    horizon: Number | None
    """How long before a violation an alarm counts, in s; null for faults."""
    true_positives: Count
    """Positive episodes that it warned of or detected."""
    false_negatives: Count
    """The other positive episodes."""
    false_positives: Count
    """Other episodes in which it raised an alarm."""
    true_negatives: Count
    """Other episodes in which it raised none."""
    late: Count
    """False negatives with an alarm that came too late."""
    early: Count
    """The other false negatives with an alarm."""
    untimed: Count
    """Violated episodes whose check tells no time; in none of the counts."""
    invalid: Count
    """Invalid episodes; in none of the counts."""
    missing: Count
    """Missing episodes; in none of the counts."""
    lead_times: list[Number]
    """Of each true positive of a requirement, in s."""
    delays: list[Number]
    """Of each true positive for faults, from the activation to the alert, in s."""
    false_alarms: Count
    """Alarms in episodes that are not positive."""
    hours: Amount
    """Simulated hours of the episodes that are not positive."""
    episodes: Count
    """Episodes that were counted."""
    precision: Share | None
    """Share of its alarmed episodes that are true."""
    recall: Share | None
    """Share of the positive episodes that it warned of."""
    false_positive_rate: Share | None
    """Share of the other episodes in which it raised an alarm."""
    false_alarms_per_hour: Amount | None
    """Per simulated hour."""
    lead_time: SpreadEntry | None
    """Of the lead times, in s."""
    delay: SpreadEntry | None
    """Of the delays, in s."""


class ComparisonEntry(Entry):
    """One requirement on one case, now and in the baseline."""

    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str | None
    """Name of the component under test."""
    baseline_component: str | None
    """The baseline's component; null for what is new."""
    word: Literal["better", "worse", "no evidence of a change", "new", "gone", "no comparison"]
    """What is said of it, after the correction."""
    reason: str
    """Why there is no comparison."""
    uncorrected: Literal["better", "worse", "no evidence of a change"] | None
    """The word that this comparison alone would have got."""
    confidence: Share | None
    """Of the words."""
    violations: Count | None
    """Violating episodes now."""
    episodes: Count | None
    """Valid episodes now."""
    baseline_violations: Count | None
    """Violating episodes of the baseline."""
    baseline_episodes: Count | None
    """Valid episodes of the baseline."""
    test: Literal["McNemar", "Fisher"] | None
    """Exact test: McNemar for runs of equal seeds, Fisher for others."""
    only_now: Count | None
    """Seeds that violate it now alone."""
    only_baseline: Count | None
    """Seeds that violated it in the baseline alone."""
    p_worse: Share | None
    """One-sided p-value against `the rate is not higher`."""
    p_better: Share | None
    """One-sided p-value against `the rate is not lower`."""
    p_worse_holm: Share | None
    """Adjusted for all comparisons."""
    p_better_holm: Share | None
    """Adjusted for all comparisons."""


class LookEntry(Entry):
    """An earlier verdict on a rate."""

    created: str
    """When its session began, in ISO 8601."""
    base_seed: Count
    """Base seed of its session."""
    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case."""
    component: str
    """Name of the component under test."""
    check: str
    """What was judged."""
    identity: str
    """SHA-256 of the component's digest and parameters."""
    planned: Count
    """Episodes that were planned."""
    episodes: Count
    """Valid episodes."""
    violations: Count
    """Valid episodes that violated it."""


class BaselineEntry(Entry):
    """An earlier record that the session is compared with."""

    path: str
    """As the user gave it."""
    sha256: Sha256
    """SHA-256 of its file."""
    created: str
    """When its session began, in ISO 8601."""
    status: Literal["complete", "interrupted"]
    """How its session ended."""
    base_seed: Count
    """Its base seed."""
    component: JsonObject
    """Its component under test, as it is recorded there."""
    correction: str
    """How the words hold together."""
    tests: Count
    """How many comparisons the correction counts."""
    comparisons: list[ComparisonEntry]
    """Verdict by verdict."""
