"""CampaignVerdict: the verdict of a requirement on a campaign with all its figures.

Situations says whether the runs differ. Runs with equal trajectories are one observation, however
many they are: no rate follows from them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

import numpy as np

from pytest_dura.core.display import Shown, short_repr
from pytest_dura.requirements.rate_tests import (
    ADVISED_POWER,
    EXACT_METHOD,
    MAX_ADVISED_RUNS,
    advised_plan,
    plan_allowing,
)

if TYPE_CHECKING:
    from pytest_dura.requirements.model import Requirement
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

    ``upper`` is ``None`` where there is none: without a valid episode, where all runs are equal,
    and for a sequential probability ratio test that has not accepted. ``at_most`` is the rate that
    was to be supported, ``None`` where every episode must satisfy the requirement.
    """

    confidence: float
    upper: float | None
    method: str = EXACT_METHOD
    at_most: float | None = None


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
            f"mend what violates it: {observed} a new plan on a fresh seed of {plan.runs} runs, "
            f"which may hold {_violations(violations)}, succeeds with probability {power}"
        )
    advised = advised_plan(at_most, confidence, rate)
    if advised is None:
        return (
            f"decide it by a sequential method (e-process, sprt): {observed} no new plan of up to "
            f"{MAX_ADVISED_RUNS} runs succeeds with probability {100 * ADVISED_POWER:.0f} %"
        )
    power = f"{observed} it succeeds with probability {100 * advised.power:.3g} %"
    if not violations:
        # That none was observed does not show that the rate is 0.
        half = plan_allowing(0, at_most, confidence, at_most / 2).power
        power = f"it succeeds with probability {100 * half:.2g} % if the true rate is half of that"
    return (
        "decide it by a sequential method (e-process, sprt), or by a new plan on a fresh seed of "
        f"{advised.runs} runs, which may hold {_violations(advised.violations)}: {power}"
    )


def _violations(count: int) -> str:
    return f"{count} violation" if count == 1 else f"{count or 'no'} violations"


@dataclass(frozen=True, slots=True)
class Margins:
    """Distribution of robustness over the valid episodes that have a margin."""

    n: int
    min: float
    q25: float
    median: float
    q75: float
    max: float

    @classmethod
    def of(cls, margins: Sequence[float]) -> Margins | None:
        """Quantiles of a sample; ``None`` of an empty one."""
        if not margins:
            return None
        points = np.quantile(margins, [0.0, 0.25, 0.5, 0.75, 1.0])
        return cls(len(margins), *map(float, points))


@dataclass(frozen=True, slots=True)
class Counterexample:
    """An episode that violated the requirement, when first, and by how much (negative margin).

    ``valid`` is false for a run that a planned fault left without effect: the violation counts, and
    is none of the runs with that fault.
    """

    episode: str
    time: float | None
    margin: float | None
    valid: bool = True


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
    """An episode that does not decide a requirement, and why."""

    episode: str
    verdict: Literal["missing", "invalid", "open"]
    detail: str


TEST_FAILED = "the test failed: "
"""Beginning of the detail of an episode that a test did not judge, by an error of its own."""


@dataclass(frozen=True, slots=True)
class CampaignVerdict(Shown):
    """Verdict and all counts that it rests on.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        component: Name of the component under test.
        verdict: ``supported``, ``violated`` or ``undecided``.
        reason: Why, in words; names every obstacle of an undecided campaign.
        method: ``every episode``, or how a rate was decided: ``fixed``, ``sprt``, ``e-process``.
        planned: Episodes that were planned, or may be run at most.
        run: Episodes that were run, missing and invalid ones included.
        saved: Planned episodes that were not run because the campaign was decided without them.
        episodes: Valid episodes, the n of every rate and bound: those that satisfied or violated
            the requirement, and the open ones.
        violations: Valid episodes that violated it.
        open: Ids of valid episodes that ended before it was decided, by a crash, a halt or the
            violation of something else. The bound counts each as a violation.
        unseen_crashes: Ids of episodes, or of twins of pairs, that ended critical and violate no
            requirement of their case on single episodes.
        without_effect: Invalid episodes that violated it all the same, without effect of the fault.
        invalid: Episodes that are no sample of it, those without effect included.
        missing: Episodes that an infrastructure error ended.
        vacuous: Episodes that satisfied it because its condition never held.
        bound: Bound on the rate of violations.
        margin: Worst robustness over valid episodes.
        margins: How the robustness is distributed.
        counterexamples: The violating episodes, the valid ones first, of each kind the largest
            violation first.
        pairs: For a requirement on pairs, what the two runs of each pair came to.
        spoilt: The first missing episode, or else the first invalid one, or else the first open
            one.
        situation: ``repeated`` if all runs are equal and nothing is declared to vary, ``without
            effect`` if they are though something is; ``None`` if they differ.
        too_few: Whether it is undecided only because its runs, which are valid, are too few: what
            ``--dura-undecided=warn`` excuses.
    """

    requirement: str
    case: str
    component: str
    verdict: CampaignStatus
    reason: str
    method: str
    planned: int
    run: int
    saved: int
    episodes: int
    violations: int
    open: tuple[str, ...]
    unseen_crashes: tuple[str, ...]
    without_effect: int
    invalid: int
    missing: int
    vacuous: int
    bound: Bound
    margin: float | None
    margins: Margins | None
    counterexamples: tuple[Counterexample, ...]
    pairs: Mapping[str, Any] | None = None
    spoilt: UncountedEpisode | None = None
    situation: Situation | None = None
    too_few: bool = False

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "requirement", self.requirement
        yield "case", self.case
        yield "component", self.component
        yield "verdict", self.verdict
        yield "reason", self.reason
        yield "runs", f"{self.run} of {self.planned}, {self.episodes} valid"
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

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        return asdict(self) | {
            "open": list(self.open),
            "unseen_crashes": list(self.unseen_crashes),
            "counterexamples": [asdict(counterexample) for counterexample in self.counterexamples],
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CampaignVerdict:
        """The inverse of :meth:`to_json`."""
        margins, spoilt = data["margins"], data.get("spoilt")
        return cls(
            **{
                **data,
                "open": tuple(data["open"]),
                "unseen_crashes": tuple(data["unseen_crashes"]),
                "bound": Bound(**data["bound"]),
                "margins": None if margins is None else Margins(**margins),
                "counterexamples": tuple(
                    Counterexample(**counterexample) for counterexample in data["counterexamples"]
                ),
                "spoilt": None if spoilt is None else UncountedEpisode(**spoilt),
            }
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


class _Explained(Protocol):
    """What an explanation needs of a verdict; those of the record have it, too."""

    @property
    def verdict(self) -> CampaignStatus: ...
    @property
    def counterexamples(self) -> Sequence[_ViolatingEpisode]: ...
    @property
    def without_effect(self) -> int: ...
    @property
    def spoilt(self) -> _UndecidingEpisode | None: ...


class _ViolatingEpisode(Protocol):
    """An episode that violated the requirement; see :class:`Counterexample`."""

    @property
    def episode(self) -> str: ...
    @property
    def time(self) -> float | None: ...
    @property
    def margin(self) -> float | None: ...


class _UndecidingEpisode(Protocol):
    """An episode that decides nothing; see :class:`UncountedEpisode`."""

    @property
    def episode(self) -> str: ...
    @property
    def verdict(self) -> Literal["missing", "invalid", "open"]: ...
    @property
    def detail(self) -> str: ...


def failure_entries(verdict: _Explained) -> Iterator[tuple[str, str]]:
    """Labels and texts on the episodes behind a verdict, for messages, terminal and reports.

    The label is empty for a missing episode, whose text begins with ``infrastructure:``, or with
    :data:`TEST_FAILED`.
    """
    if verdict.counterexamples:
        worst, *rest = verdict.counterexamples
        yield "worst", f"{worst.episode}{violation_text(worst.time, worst.margin)}"
        if rest:
            numbers = [f"#{each.episode.rpartition('#')[2]}" for each in rest]
            more = f" and {len(numbers) - _MOST_RUNS} more" if len(numbers) > _MOST_RUNS else ""
            yield "also in", ", ".join(numbers[:_MOST_RUNS]) + more
        if verdict.without_effect:
            yield "invalid", f"in {verdict.without_effect} of them no fault had an effect"
    spoilt = verdict.spoilt
    if spoilt is not None and verdict.verdict == "undecided":
        if spoilt.verdict == "missing":
            yield "", f"{spoilt.detail} (in {spoilt.episode})"
        else:
            yield spoilt.verdict, f"{spoilt.episode}: {spoilt.detail}"


_MOST_RUNS = 8
"""Runs that an entry names."""


def explain_verdict(
    verdict: CampaignVerdict, requirement: Requirement, component_failures: str
) -> list[str]:
    """Lines that say why a verdict is not "supported": in which run, when and by how much.

    Args:
        verdict: On the requirement.
        requirement: As it was judged.
        component_failures: The first failure of the component itself; empty without any.
    """
    what = f"{verdict.verdict}: {verdict.requirement} on {verdict.case} ({verdict.component})"
    entries = [("required", requirement.text)]
    if requirement.check != verdict.requirement:
        entries.append(("check", requirement.check))
    paired = requirement.paired
    if paired is not None and paired.measure:
        own = paired.measure.startswith("pytest_dura.")
        measure = paired.measure.rpartition(":")[2] if own else paired.measure
        text = f"{measure}, which may grow by {paired.change_at_most:g}"
        entries.append(("measure", text))
    if paired is not None:
        entries.append(("pairs", f"with {paired.without}, and without"))
    episodes = list(failure_entries(verdict))
    entries += [(label, text) for label, text in episodes if label]
    entries.append(("component", component_failures))
    lines = [text for label, text in episodes if not label]
    lines.append(f"{what}: {verdict.reason}")
    lines += [f"{label + ':':<9} {text}" for label, text in entries if text]
    # Lines of a component's own message must not look like lines of this report.
    return [line.replace("\n", "\n    ") for line in lines]
