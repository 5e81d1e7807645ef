"""CampaignVerdict: the verdict of a requirement on a campaign with all its figures.

Situations says whether the runs differ. Runs with equal trajectories are one observation, however
many they are: no rate follows from them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from pytest_dura.core.codec import Confidence, Count, Number, Positive, Share
from pytest_dura.core.display import Shown, short_repr
from pytest_dura.requirements.model import Paired
from pytest_dura.requirements.pairs import ChangeTable, PairTable
from pytest_dura.requirements.rate_tests import (
    ADVISED_POWER,
    EXACT_METHOD,
    MAX_ADVISED_RUNS,
    advised_plan,
    plan_allowing,
)

if TYPE_CHECKING:
    from pytest_dura.requirements.runs import Run

Situation = Literal["repeated", "without effect"]
REPEATED: Situation = "repeated"
"""All runs are equal, and nothing is declared to vary: one situation, repeated."""
WITHOUT_EFFECT: Situation = "without effect"
"""All runs are equal, though something is declared to vary: it has no effect."""

SITUATIONS: dict[str, str] = {
    REPEATED: "one situation, repeated",
    WITHOUT_EFFECT: "the declared variation has no effect",
}
"""Texts of the two in messages."""


class Situations:
    """Collects whether the runs of a campaign, and their twins, are equal, in any order.

    Args:
        varies: Whether something is declared to vary, see :func:`varies`.
    """

    def __init__(self, *, varies: bool) -> None:
        self._varies = varies
        self._first: dict[str, tuple[int, str]] = {}
        self._several: set[str] = set()
        self._differ = False

    def add(self, run: Run) -> None:
        """Take in a run, or its twin."""
        valid = run.validity == "valid"
        self.add_run(run.case, run.number, run.trajectory, valid=valid, drawn=run.drawn)

    def add_run(self, case: str, number: int, trajectory: str, *, valid: bool, drawn: bool) -> None:
        """Take in a run as the record has it.

        Args:
            case: Id of its case.
            number: Of the run.
            trajectory: :attr:`Episode.trajectory`.
            valid: Whether it is valid; with an invalid run, equality of all is not shown.
            drawn: Whether random numbers were drawn in it: drawing counts as declared variation.
        """
        first, known = self._first.setdefault(case, (number, trajectory))
        if number != first:
            self._several.add(case)
        self._differ |= trajectory != known or not valid
        self._varies |= drawn

    @property
    def situation(self) -> Situation | None:
        """Kind of campaign if all runs are equal; ``None`` if they differ, or there is only one."""
        if self._differ or not self._first or self._several != self._first.keys():
            return None
        return WITHOUT_EFFECT if self._varies else REPEATED


def varies(paths: Iterable[str], faults: Collection[str]) -> bool:
    """Whether a scenario varies anything of a case.

    Args:
        paths: What it varies: ``world.x``, ``faults.id.x``.
        faults: Ids of the case's faults.
    """
    of_faults = {tuple(path.split(".", 2)[:2]) for path in paths}
    return any(path[0] != "faults" or path[-1] in faults for path in of_faults)


CampaignStatus = Literal["supported", "violated", "undecided"]
CAMPAIGN_STATUSES: tuple[str, ...] = get_args(CampaignStatus)

EVERY_EPISODE = "every episode"
"""The method of a requirement that accepts no violation."""


@dataclass(frozen=True, slots=True)
class Bound:
    """The one-sided upper confidence bound on the rate of violations, over valid episodes.

    An open episode counts as a violation: what it would have shown is not known, and the component
    may have caused its end.
    """

    confidence: Confidence
    """Confidence of the bound."""
    upper: Share | None
    """The bound; null where there is none: without a valid episode, where all runs are equal, and
    for a sequential probability ratio test that has not accepted."""
    method: str = EXACT_METHOD
    """How it was computed."""
    at_most: Share | None = None
    """The rate that was to be supported; null where every episode must satisfy it."""


WEAK_RATE = 0.5
"""Accepted rate of violations from which a requirement is weak."""
WEAK_CONFIDENCE = 0.8
"""Confidence below which a requirement is weak."""


def weakness(at_most: float | None, confidence: float) -> str:
    """Why a requirement asks for little, such as ``weak: accepts 50 % of runs``; empty if not.

    Args:
        at_most: Greatest acceptable rate of episodes that violate it.
        confidence: Of the bound on that rate.
    """
    reasons = []
    if at_most is not None and at_most >= WEAK_RATE:
        reasons.append(f"accepts violations in {100 * at_most:.4g} % of runs")
    if confidence < WEAK_CONFIDENCE:
        reasons.append(f"asks for {100 * confidence:.4g} % confidence")
    return f"weak: {' and '.join(reasons)}" if reasons else ""


_MEND, _DECIDE = "mend what violates it", "decide it by a sequential method"


def without_advice(reason: str) -> str:
    """The reason of a verdict without what would decide it, which stands in its card."""
    for start in (_MEND, _DECIDE):
        reason = reason.partition(f"; {start}")[0]
    return reason


def rate_advice(violations: int, episodes: int, at_most: float, confidence: float) -> str:
    """What would decide a rate that a fixed number of runs left undecided, with its prospects.

    More runs beside these would be a second look at them, which breaks the level.

    Args:
        violations: Among the runs, open ones included.
        episodes: Valid runs.
        at_most: Greatest acceptable rate.
        confidence: Of the bound on it.
    """
    rate = violations / episodes
    observed = f"at the observed rate of {100 * rate:.3g} %"
    if rate >= at_most:
        plan = plan_allowing(violations, at_most, confidence, rate)
        power = "below 0.01 %" if plan.power < 1e-4 else f"{100 * plan.power:.2g} %"
        return (
            f"{_MEND}: {observed} a new plan on a fresh seed of {plan.runs} runs, "
            f"which may hold {_violations(violations)}, succeeds with probability {power}"
        )
    advised = advised_plan(at_most, confidence, rate)
    if advised is None:
        return (
            f"{_DECIDE} (e-process, sprt): {observed} no new plan of up to "
            f"{MAX_ADVISED_RUNS} runs succeeds with probability {100 * ADVISED_POWER:.0f} %"
        )
    power = f"{observed} it succeeds with probability {100 * advised.power:.3g} %"
    if not violations:
        # That none was observed does not show that the rate is 0.
        half = plan_allowing(0, at_most, confidence, at_most / 2).power
        power = f"it succeeds with probability {100 * half:.2g} % if the true rate is half of that"
    fresh = f"a new plan on a fresh seed of {advised.runs} runs"
    allowed = _violations(advised.violations)
    return f"{_DECIDE} (e-process, sprt), or by {fresh}, which may hold {allowed}: {power}"


def _violations(count: int) -> str:
    return f"{count} violation" if count == 1 else f"{count or 'no'} violations"


@dataclass(frozen=True, slots=True)
class Margins:
    """Distribution of robustness over valid episodes with a margin, in the unit of the check."""

    n: Positive
    """Episodes."""
    min: float
    """Least."""
    q25: float
    """First quartile."""
    median: float
    """Median."""
    q75: float
    """Third quartile."""
    max: float
    """Greatest."""

    @classmethod
    def of(cls, margins: Sequence[float]) -> Margins | None:
        """Quantiles of a sample; ``None`` of an empty one."""
        if not margins:
            return None
        points = np.quantile(margins, [0.0, 0.25, 0.5, 0.75, 1.0])
        return cls(len(margins), *map(float, points))


@dataclass(frozen=True, slots=True)
class Counterexample:
    """An episode that violated the requirement."""

    episode: str
    """Its id."""
    time: Number | None
    """When first, in simulated seconds."""
    margin: Number | None
    """By how much, negative, in the unit of the check."""
    valid: bool = True
    """Whether the run is valid; false where a planned fault was without effect: the violation
    counts, and is none of the runs with that fault."""


def violation_text(time: float | None, margin: float | None, *, valid: bool = True) -> str:
    """When and by how much an episode violates a requirement, to stand behind its name.

    Such as `` at t = 6.50 s, margin -0.25``; empty where neither is known.

    Args:
        time: Seconds at which it was violated first.
        margin: Its robustness.
        valid: Whether the episode is valid.
    """
    when = "" if time is None else f" at t = {time:.2f} s"
    by = "" if margin is None else f", margin {margin:.3g}"
    return f"{when}{by}{'' if valid else ', without effect of the fault'}"


@dataclass(frozen=True, slots=True)
class UncountedEpisode:
    """An episode that does not decide a requirement."""

    episode: str
    """Its id."""
    verdict: Literal["missing", "invalid", "open"]
    """What it is."""
    detail: str
    """Why, in words."""


FEW_PROPOSALS = "the component made a valid proposal at only "
STOPPED = "no run could be judged: "
"""Begins the reason of a verdict whose item stopped before its first run."""
TEST_FAILED = "the test failed: "
"""Beginning of the detail of an episode that a test did not judge, by an error of its own."""


@dataclass(frozen=True, slots=True)
class CampaignVerdict(Shown):
    """Verdict of a requirement on a campaign, and all counts that it rests on."""

    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str
    """Name of the component under test."""
    verdict: CampaignStatus
    """The three words there are."""
    reason: str
    """Why, in words; names every obstacle of an undecided campaign."""
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
    open: tuple[str, ...]
    """Ids of valid episodes that ended before it was decided, by a crash, a halt or the violation
    of something else; the bound counts each as a violation."""
    unseen_crashes: tuple[str, ...]
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
    bound: Bound
    """One-sided upper confidence bound on the rate of violations, over valid episodes."""
    margin: float | None
    """Worst robustness over valid episodes, in the unit of the check."""
    margins: Margins | None
    """How the robustness is distributed; null without any."""
    counterexamples: tuple[Counterexample, ...]
    """The violating episodes, the valid ones first, of each kind the largest violation first."""
    pairs: PairTable | ChangeTable | None = None
    """What the two runs of each pair came to; null for no requirement on pairs."""
    first_uncounted: UncountedEpisode | None = None
    """The first missing episode, or else the first invalid one, or else the first open one; null
    without any."""
    situation: Situation | None = None
    """What its runs are if their trajectories are all equal, so that no rate follows: `repeated`
    where nothing is declared to vary, `without effect` where something is. Null if they differ, or
    there is one."""
    too_few: bool = False
    """Whether it is undecided only because its runs, which are valid, are too few: what
    `--dura-undecided=warn` excuses."""
    check: str = ""
    """What was judged: a formula or the import path of a function; empty for test code."""
    paired: Paired | None = None
    """For a requirement on pairs of runs."""
    beyond_plan: tuple[Count, ...] = ()
    """Numbers of runs beyond those that decide it, which merged parts of a session bring; they
    enter no count, rate, bound or table."""

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "requirement", self.requirement
        yield "case", self.case
        yield "component", self.component
        yield "verdict", self.verdict
        yield "reason", self.reason
        yield "runs", f"{self.run} of {self.planned}, {self.episodes} valid"
        yield "beyond the decision", number_ranges(self.beyond_plan) or None
        yield "violations", str(self.violations)
        bound = self.bound
        if bound.upper is not None:
            yield f"rate at most, at {bound.confidence:g} confidence", bound.upper
        yield "worst margin", self.margin
        yield (
            "counterexamples",
            [
                example.episode + violation_text(example.time, example.margin, valid=example.valid)
                for example in self.counterexamples
            ]
            or None,
        )


def number_ranges(numbers: Iterable[int]) -> str:
    """Write ascending numbers of runs as ranges, such as ``3 to 7, 9``."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    return ", ".join(f"{low} to {high}" if high > low else f"{low}" for low, high in ranges)


def beyond_plan_text(verdict: CampaignVerdict) -> str:
    """Say which runs lie beyond the decision; empty without any."""
    numbers = verdict.beyond_plan
    if not numbers:
        return ""
    run, lies, enters = ("runs", "lie", "enter") if numbers[1:] else ("run", "lies", "enters")
    return (
        f"{run} {number_ranges(numbers)} {lies} beyond the decision after {verdict.run} and "
        f"{enters} nothing"
    )


def with_doubt(verdict: CampaignVerdict, doubt: str) -> CampaignVerdict:
    """Leave a verdict undecided for a reason that its runs do not show; violated stays violated.

    Args:
        verdict: Of a campaign.
        doubt: The reason.
    """
    return replace(verdict, **doubted(verdict.verdict, verdict.reason, doubt))


def doubted(status: CampaignStatus, reason: str, doubt: str) -> dict[str, Any]:
    """Fields of a verdict that a doubt changes; none if it is violated, or has the doubt already.

    Args:
        status: Of the verdict.
        reason: Of the verdict.
        doubt: Why it cannot be trusted.
    """
    if status == "violated" or doubt in reason:
        return {}
    reason = doubt if status == "supported" else f"{reason}; {doubt}"
    return {"verdict": "undecided", "too_few": False, "reason": reason}
