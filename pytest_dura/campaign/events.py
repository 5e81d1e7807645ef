"""Events of a session: what its runner reports, as frozen dataclasses on one stream.

An event is emitted in the process that runs the item, when it happens. Its parts are the objects
themselves, and no copies: a subscriber changes none of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from pytest_dura.core.metrics import TracedFault
    from pytest_dura.library.cases import Case, SearchedCase
    from pytest_dura.requirements.campaign_judge import CampaignJudge
    from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode, SearchedEpisode
    from pytest_dura.requirements.judgements import Judgement
    from pytest_dura.requirements.model import Requirement
    from pytest_dura.requirements.monitoring.quality import MonitorQuality
    from pytest_dura.requirements.searches import Falsification


@dataclass(frozen=True, slots=True)
class EpisodeUsed:
    """An item looks at an episode of a case; at every use, though it is simulated once.

    ``planned`` is how many are planned of the case, 0 if this one's seed was chosen by hand.
    """

    case: Case
    episode: JudgedEpisode
    planned: int


@dataclass(frozen=True, slots=True)
class SearchedEpisodeUsed:
    """An item looks at an episode of a case that a strategy chose, which is no sample."""

    case: SearchedCase
    episode: SearchedEpisode


@dataclass(frozen=True, slots=True)
class VerdictReached:
    """An item decides a requirement on a campaign; ``judgement`` has the runs that decide it."""

    verdict: CampaignVerdict
    requirement: Requirement
    judgement: Judgement


@dataclass(frozen=True, slots=True)
class FaultsTraced:
    """Each fault of an episode was followed from plan to outcome, once in a process."""

    case: Case
    episode: JudgedEpisode
    chains: Sequence[TracedFault]


@dataclass(frozen=True, slots=True)
class FactEstablished:
    """An item establishes a fact that a further table of the session rests on.

    ``about`` names what it is on, once for each table; ``order`` is its place there.
    """

    table: str
    about: str
    order: int
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class MonitorsMeasured:
    """The quality of a case's monitors was measured where recovery did not act."""

    case: Case
    qualities: Sequence[MonitorQuality]


@dataclass(frozen=True, slots=True)
class SearchEnded:
    """A search for violations has ended."""

    case: Case
    search: Falsification


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a campaign or search is: a run is about to begin, or all of them are over.

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
        upper: Upper confidence bound on the rate of violations; see :meth:`bounded`.
        confidence: One-sided confidence of that bound.
        ended: Whether no further run follows, for whatever reason.
        requests: Requests of guests that this process has made so far; ``None`` where it makes
            none, or nothing has counted them.
        judge: Judges the runs; ``None`` where nothing is judged.
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
    ended: bool = False
    requests: int | None = None
    judge: CampaignJudge | None = field(default=None, repr=False, compare=False)

    def bounded(self) -> Progress:
        """The same with the bound by now, which may take some milliseconds.

        There is none before the first run, and for a requirement that accepts no violation.
        """
        upper = None if self.judge is None else self.judge.upper
        if self.judge is None or upper is None:
            return self
        return replace(self, upper=upper, confidence=self.judge.requirement.confidence)


class RunningCampaign:
    """Makes the events on the progress of a campaign or search.

    Args:
        case: Id of the case.
        subject: What the runs are for.
        budget: Runs that are planned, or may be run at most.
        judge: Judges the runs; ``None`` where nothing is judged.
    """

    def __init__(
        self, case: str, subject: str, budget: int, judge: CampaignJudge | None = None
    ) -> None:
        early = judge is not None and judge.sequential
        self._latest = Progress(case, subject, 0, budget, early, judge=judge)
        self._at_first: int | None = None

    def reach(self, done: int, budget: int, simulated: int) -> Progress:
        """Note how many runs are over.

        Args:
            done: Runs that are over.
            budget: Runs that are planned by now, or may be run at most.
            simulated: Episodes that were simulated for this process so far.
        """
        if self._at_first is None:
            self._at_first = simulated
        taken_over = done if simulated == self._at_first else self._latest.taken_over
        now = self._latest
        self._latest = Progress(
            now.case, now.subject, done, budget, now.may_end_early, taken_over, self._violations,
            judge=now.judge,
        )  # fmt: skip
        return self._latest

    def end(self) -> Progress:
        """Note that no further run follows."""
        return replace(self._latest, violations=self._violations, ended=True)

    @property
    def _violations(self) -> int | None:
        return None if self._latest.judge is None else self._latest.judge.violations


SessionEvent = (
    EpisodeUsed
    | SearchedEpisodeUsed
    | VerdictReached
    | FaultsTraced
    | MonitorsMeasured
    | FactEstablished
    | SearchEnded
    | Progress
)
"""What a runner emits."""
_Kind = TypeVar("_Kind")


class EventStream:
    """Delivers each event to the subscribers of its type, in the order of their subscriptions."""

    def __init__(self) -> None:
        self._handlers: dict[type, list[Callable[[Any], object]]] = {}

    def subscribe(self, kind: type[_Kind], handler: Callable[[_Kind], object]) -> None:
        """Call a handler with each event of this type from now on.

        Args:
            kind: One of the types of :data:`SessionEvent`.
            handler: What it raises is raised where the event is emitted, and ends the delivery.
        """
        self._handlers.setdefault(kind, []).append(handler)

    def emit(self, event: object) -> None:
        """Deliver an event: one of :data:`SessionEvent`, or of those who extend the stream."""
        __tracebackhide__ = True
        for handler in self._handlers.get(type(event), ()):
            handler(event)
