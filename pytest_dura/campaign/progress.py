"""How far a campaign is: what it tells while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pytest_dura.requirements.campaign_judge import CampaignJudge


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
    """A campaign that tells how far it is, run after run.

    Told of each run, and asked a few times a second at most: only being asked costs anything.

    Args:
        case: Id of the case.
        subject: What the runs are for.
        budget: Runs that are planned, or may be run at most.
        judge: Judges the runs, if something does.
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
        """So many runs are over.

        Args:
            done: Runs that are over.
            budget: Runs that are planned by now, or may be run at most.
            simulated: Episodes that were simulated for this process, whatever for.
        """
        self.done, self.budget = done, budget
        if self._at_first is None:
            self._at_first = simulated
        if simulated == self._at_first:
            self._taken_over = done
        return self

    def end(self) -> RunningCampaign:
        """No further run follows."""
        self.ended = True
        return self

    def progress(self) -> CampaignProgress:
        """How far it is, without the bound on the rate."""
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
