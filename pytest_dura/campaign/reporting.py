"""Reports of a campaign: how far it is, and why its verdict is not "supported"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.requirements.campaign_judge import CampaignJudge
    from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
    from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True, slots=True)
class CampaignProgress:
    """How far a campaign is, as plain data.

    Args:
        case: Id of the case.
        subject: What the runs are for, such as the id of a requirement; empty where only the
            test function knows.
        done: Runs that are over.
        budget: Runs that are planned, or may be run at most.
        may_end_early: Whether the runs end once the requirement is decided.
        taken_over: Of the runs that are over the first ones, as far as they were at hand: this or
            an earlier session had simulated them.
        violations: Runs that violated the requirement; ``None`` where nothing is judged.
        upper: Upper confidence bound on the rate of violations, from the runs so far; ``None``
            where there is none, and for a requirement that accepts no violation.
        confidence: One-sided confidence of that bound.
    """

    case: str
    subject: str
    done: int
    budget: int
    may_end_early: bool = False
    taken_over: int = 0
    violations: int | None = None
    upper: float | None = None
    confidence: float | None = None


@dataclass
class RunningCampaign:
    """Progress of a campaign, updated at each run.

    An update costs nothing; ``progress``, which a display reads some times a second, computes.

    Args:
        case: Id of the case.
        subject: What the runs are for.
        budget: Runs that are planned, or may be run at most.
        judge: Judges the runs; ``None`` where nothing is judged.
    """

    case: str
    subject: str
    budget: int
    judge: CampaignJudge | None = None
    done: int = field(default=0, init=False)
    ended: bool = field(default=False, init=False)
    """Whether no further run follows, for whatever reason."""
    _taken_over: int = field(default=0, init=False)
    _at_first: int | None = field(default=None, init=False)

    def reach(self, done: int, budget: int, simulated: int) -> RunningCampaign:
        """Set how many runs are over.

        Args:
            done: Runs that are over.
            budget: Runs that are planned by now, or may be run at most.
            simulated: Episodes that were simulated for this process so far.
        """
        self.done, self.budget = done, budget
        if self._at_first is None:
            self._at_first = simulated
        if simulated == self._at_first:
            self._taken_over = done
        return self

    def end(self) -> RunningCampaign:
        """End it: no further run follows."""
        self.ended = True
        return self

    def progress(self) -> CampaignProgress:
        """Progress as plain data, without the bound on the rate."""
        judge = self.judge
        return CampaignProgress(
            case=self.case,
            subject=self.subject,
            done=self.done,
            budget=self.budget,
            may_end_early=judge is not None and judge.sequential,
            taken_over=self._taken_over,
            violations=None if judge is None else judge.violations,
        )

    def bounded(self, progress: CampaignProgress) -> CampaignProgress:
        """The same with the bound on the rate, which may take some milliseconds."""
        judge = self.judge
        upper = None if judge is None else judge.upper
        if judge is None or upper is None:
            return progress
        return replace(progress, upper=upper, confidence=judge.requirement.confidence)


@dataclass
class ComponentFailures:
    """The first failure of the component itself, and in how many episodes there was one."""

    first: str = ""
    count: int = 0
    episodes: int = 0

    def add(self, episode: Episode) -> None:
        """Take in an episode."""
        self.episodes += 1
        failed = [event for event in episode.events if event.kind == "component_failure"]
        if failed:
            text = f"{failed[0].subject} {failed[0].detail} (t = {failed[0].time:.2f} s)"
            self.first = self.first or text
            self.count += 1

    def __str__(self) -> str:
        return f"{self.first}; in {self.count} of {self.episodes} episodes"


def explain_verdict(
    verdict: CampaignVerdict, requirement: Requirement, failures: ComponentFailures
) -> list[str]:
    """Lines that say why a verdict is not "supported": in which run, when and by how much."""
    what = f"{verdict.verdict}: {verdict.requirement} on {verdict.case} ({verdict.component})"
    lines = [f"{what}: {verdict.reason}"]
    spoilt = verdict.spoilt if verdict.verdict == "undecided" else None
    if spoilt is not None and spoilt.verdict == "missing":
        lines.insert(0, f"{spoilt.detail} (in {spoilt.episode})")
    if requirement.text:
        lines.append(f"required: {requirement.text}")
    if requirement.check and requirement.check != verdict.requirement:
        lines.append(f"check:    {requirement.check}")
    paired = requirement.paired
    if paired is not None and paired.measure:
        lines.append(f"measure:  {paired.measure}, which may grow by {paired.change_at_most:g}")
    if paired is not None:
        lines.append(f"pairs:    with {paired.without}, and without")
    lines += _violations(verdict)
    if spoilt is not None and spoilt.verdict != "missing":
        lines.append(f"{spoilt.verdict + ':':<9} {spoilt.episode}: {spoilt.detail}")
    if failures.first:
        lines.append(f"component: {failures}")
    # Lines of a component's own message must not look like lines of this report.
    return [line.replace("\n", "\n    ") for line in lines]


def _violations(verdict: CampaignVerdict) -> list[str]:
    if not verdict.counterexamples:
        return []
    lines = [f"worst:    {describe_counterexample(asdict(verdict.counterexamples[0]))}"]
    others = [
        counterexample.episode.rpartition("#")[2] for counterexample in verdict.counterexamples[1:]
    ]
    if others:
        lines.append(f"also in:  {_runs(others)}")
    if verdict.without_effect:
        lines.append(f"invalid:  in {verdict.without_effect} of them no fault had an effect")
    return lines


def describe_counterexample(example: Mapping[str, Any]) -> str:
    """Run, time and margin of a counterexample, from its plain data."""
    time, margin = example["time"], example["margin"]
    when = "" if time is None else f" at t = {time:.2f} s"
    by = ""
    if margin is not None:
        by = f", by {abs(margin):.3g}" if margin else ", right at the bound"
    return f"{example['episode']}{when}{by}"


def _runs(numbers: Sequence[str]) -> str:
    shown = ", ".join(f"#{number}" for number in numbers[:8])
    return shown + (f" and {len(numbers) - 8} more" if len(numbers) > 8 else "")


def describe_check(requirement: Requirement) -> list[str]:
    """Lines that say what is judged and how."""
    lines = [requirement.check or "decided by test code"]
    paired = requirement.paired
    if paired is not None and paired.measure:
        lines = [f"{paired.measure} grows by at most {paired.change_at_most:g}"]
    if paired is not None:
        lines.append(f"on pairs of runs: with {paired.without}, and without")
    if requirement.at_most is not None:
        method = f" by {requirement.method}" if requirement.method else ""
        lines.append(
            f"violated in at most {requirement.at_most:g} of the episodes, "
            f"at {requirement.confidence:g} confidence{method}"
        )
    if requirement.applies_to:
        lines.append(f"applies to {', '.join(requirement.applies_to)}")
    return lines
