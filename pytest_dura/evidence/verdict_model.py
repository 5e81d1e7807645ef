"""Models of verdicts in the record, of monitors, and of comparisons with a baseline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Tag

from pytest_dura.evidence.entry import (
    Amount,
    Coded,
    Confidence,
    Count,
    Entry,
    JsonObject,
    Number,
    Positive,
    Sha256,
    Share,
)
from pytest_dura.requirements.model import Paired

if TYPE_CHECKING:
    from pytest_dura.requirements.campaign_verdicts import CampaignVerdict


class BoundEntry(Entry):
    """One-sided upper confidence bound on the rate of violations, over valid episodes."""

    confidence: Confidence
    """Confidence of the bound."""
    upper: Share | None
    """The bound; null where there is none."""
    method: str
    """How it was computed."""
    at_most: Share | None
    """The rate that was to be supported; null where every episode must satisfy it."""


class MarginsEntry(Entry):
    """In the unit of the check; null where it is infinite."""

    n: Positive
    """Episodes."""
    min: Number | None
    """Least."""
    q25: Number | None
    """First quartile."""
    median: Number | None
    """Median."""
    q75: Number | None
    """Third quartile."""
    max: Number | None
    """Greatest."""


class CounterexampleEntry(Entry):
    """A violating episode."""

    episode: str
    """Its id."""
    time: Number | None
    """When first, in simulated seconds."""
    margin: Number | None
    """By how much, negative, in the unit of the check."""
    valid: bool
    """Whether the run is valid; false where a planned fault was without effect."""


class PairsEntry(Entry):
    """Counts of pairs."""

    without: str
    """`faults`, or the role that the second runs lack."""
    case: str
    """Id of the case of the second runs."""
    pairs: Count
    """All pairs."""
    only_with: Count
    """Violated only with what the second run lacks."""
    only_without: Count
    """Violated only without it."""
    both: Count
    """Violated in both runs."""
    neither: Count
    """Violated in neither."""
    incomplete: Count
    """One run is invalid or missing."""
    acted_only_with: Count
    """Those of `only_with` in which recovery acted."""
    acted_only_without: Count
    """Those of `only_without`."""
    acted_both: Count
    """Those of `both`."""
    acted_neither: Count
    """Those of `neither`."""
    violated_with: Count
    """Violations with it, incomplete pairs included."""
    violated_without: Count
    """Violations without it, incomplete pairs included."""
    p_value: Share | None
    """Two-sided p-value of the exact McNemar test."""
    success_rate: Share | None
    """If the second runs lack the recovery: of its interventions where the requirement is violated
    without it, the share after which it was not, `acted_only_without` of those and `acted_both`;
    null without any."""


class SpoiltEntry(Entry):
    """An episode that says nothing."""

    episode: str
    """Its id."""
    verdict: Literal["missing", "invalid", "open"]
    """What it is."""
    detail: str
    """Why, in words."""


class MeasuredChange(Entry):
    """The changes, and their summary."""

    measure: str
    """Import path of the measure."""
    pairs: list[str]
    """The first episode of each pair."""
    values: list[Number | None]
    """For each pair the measure less that of its twin, in its unit; null for none."""
    lost: list[str]
    """Pairs with a value in the second run only."""
    gained: list[str]
    """Pairs with a value in the first run only."""
    valueless: list[str]
    """Pairs without a value in either run."""
    incomplete: list[str]
    """Pairs of which a run is invalid, missing or not whole."""
    n: Count
    """Pairs that have a change."""
    mean: Number | None
    """Of the changes; null without any."""
    median: Number | None
    """Of the changes; null without any."""
    max: Number | None
    """The greatest change; null without any."""
    max_pair: str | None
    """The first pair that has it; null without any."""
    min: Number | None
    """The least change; null without any."""
    min_pair: str | None
    """The first pair that has it; null without any."""
    p_value: Share
    """Two-sided p-value of the exact sign test on the changes."""


class MeasuredPairs(Entry):
    """By how much a measure differs in each pair."""

    without: str
    """`faults`, or the role that the second runs lack."""
    case: str
    """Id of the case of the second runs."""
    change: MeasuredChange
    """The changes, and their summary."""


def _form_of_pairs(value: Any) -> str:
    measured = isinstance(value, dict) and "change" in value
    return "measured" if measured or isinstance(value, MeasuredPairs) else "counted"


Pairs = Annotated[
    Annotated[PairsEntry, Tag("counted")] | Annotated[MeasuredPairs, Tag("measured")],
    Discriminator(_form_of_pairs),
]


class AttemptEntry(Entry):
    """Another verdict of the same test, which was retried or repeated; each is kept."""

    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str
    """Name of the component under test."""
    verdict: Literal["supported", "violated", "undecided"]
    """The three words there are."""
    reason: str
    """Why, in words."""
    method: str
    """`every episode`, or how a rate was decided: `fixed`, `sprt`, `e-process`."""
    planned: Count
    """Episodes that were planned, or may be run at most."""
    run: Count
    """Episodes that were run, missing and invalid ones included."""
    saved: Count
    """Planned episodes that were not run because the verdict stood without them."""
    episodes: Count
    """Valid episodes, the n of every rate and bound: those that satisfied or violated the
    requirement, and the open ones."""
    violations: Count
    """Valid episodes that violated it."""
    open: list[str]
    """Ids of valid episodes that ended before it was decided, by a crash, a halt or the violation
    of something else; the bound counts each as a violation."""
    unseen_crashes: list[str]
    """Ids of episodes, or of second runs of pairs, that ended critical and violate no requirement
    of their case on single episodes."""
    without_effect: Count
    """Invalid episodes that violated it all the same, without effect of the fault."""
    invalid: Count
    """Episodes that are no sample of it; those without effect of the fault included."""
    missing: Count
    """Episodes that an infrastructure error ended, or that a test did not judge since it failed by
    an error of its own."""
    vacuous: Count
    """Episodes that satisfied it because its condition never held."""
    bound: BoundEntry
    """One-sided upper confidence bound on the rate of violations, over valid episodes."""
    margin: Number | None
    """Worst robustness over valid episodes, in the unit of the check."""
    margins: MarginsEntry | None
    """How the robustness is distributed; null without any."""
    counterexamples: list[CounterexampleEntry]
    """The violating episodes, the valid ones first, of each kind the largest violation first."""
    pairs: Pairs | None
    """What the two runs of each pair came to; null for no requirement on pairs."""
    spoilt: SpoiltEntry | None
    """The first missing episode, or else the first invalid one, or else the first open one; null
    without any."""
    situation: Literal["repeated", "without effect"] | None
    """What its runs are if their trajectories are all equal, so that no rate follows: `repeated`
    where nothing is declared to vary, `without effect` where something is. Null if they differ, or
    there is one."""
    too_few: bool
    """Whether it is undecided only because its runs, which are valid, are too few: what
    `--dura-undecided=warn` excuses."""
    check: str
    """What was judged: a formula or the import path of a function; empty for test code."""
    paired: Coded[Paired] | None
    """For a requirement on pairs of runs."""

    @classmethod
    def of(cls, verdict: CampaignVerdict) -> AttemptEntry:
        """Make the entry of a verdict on no check, such as one on a campaign that never ran."""
        return cls.model_validate({**verdict.to_json(), "check": "", "paired": None})


class WaiverEntry(Entry):
    """A waiver."""

    kind: Literal["xfail", "rerun", "skip"]
    """What excused it."""
    reason: str
    """As the test gives it."""


class FalseCheck(Entry):
    """One of them."""

    check: str
    """Its text."""
    episodes: Positive
    """In how many episodes."""


class FailedAssertion(Entry):
    """That of one episode."""

    episode: str
    """Its id."""
    message: str
    """The message, and the line of the test."""


class AssertionSummary(Entry):
    """What the assertions of a test on single episodes rest on."""

    alone: bool
    """Whether they alone decided: the requirement has no check that could judge the episodes."""
    by_check: Count
    """Episodes that violated the requirement's own check."""
    observed: list[str]
    """What the test read of its episodes, sorted: attributes, signals, checks; at most 50."""
    false: list[FalseCheck]
    """Checks that a test asked for and that did not hold, though it passed."""
    failed: list[FailedAssertion]
    """The assertion that failed, for the first 10 episodes in which one did."""


class VerdictEntry(AttemptEntry):
    """What one requirement says of a campaign, with every figure that it rests on."""

    item: str
    """Node id of the test that asked."""
    waiver: WaiverEntry | None
    """What excused its failure; null if nothing did."""
    attempts: list[AttemptEntry]
    """Other verdicts of the same test, which was retried or repeated."""
    assertion: AssertionSummary | None
    """What the assertions of a test on single episodes rest on; null where no test decided."""
    also_without: Count | None
    """Violations that the run of the same seed without any fault shows as well: they count, and are
    not the faults' doing; null where that was measured of none."""


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
