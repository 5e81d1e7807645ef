"""CampaignRuns: the episodes of a campaign in order, and the requirement that decides on them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pytest_dura.campaign.events import VerdictReached
from pytest_dura.campaign.fault_tracing import FaultTracer
from pytest_dura.campaign.runner import EpisodeRunner
from pytest_dura.core.display import Shown
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.core.text import one_line
from pytest_dura.execution.task import UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.library.requirements import check_formula
from pytest_dura.requirements.campaign_judge import RunSchedule
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict, explain_verdict, varies
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.episode_verdicts import JudgedEpisode
from pytest_dura.requirements.judgements import CampaignCourse, Judgement, RunJudgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.runs import Run

_NUMERIC_FIELDS = ("at_most", "confidence", "p0")


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
        return f"{self.first}; in {self.count} of {self.episodes} episodes" if self.first else ""


def _requirement_of_call(
    own: Requirement, known: Mapping[str, Requirement], given: Mapping[str, Any]
) -> Requirement:
    """The requirement with the fields that a call gives in addition.

    Args:
        own: The requirement in the test's marker, or one made for the call.
        known: The requirements of the files. One of these means the same wherever it is decided:
            the call may repeat what its file says of check, rate and pairs, and change none of it.
        given: Fields of :class:`Requirement` that the call gives, without those it leaves out.

    Raises:
        ConfigurationError: For a value that is not the file's, and a number that is none.
    """
    values: dict[str, Any] = {
        key: finite_number(key, value) if key in _NUMERIC_FIELDS else value
        for key, value in given.items()
    }
    if known.get(own.id) != own:
        return replace(own, **values)
    # Without a check in its file, it is test code that says what is checked, and on what.
    decided_by_code = not own.check and own.paired is None
    free = ("check", "paired") if decided_by_code else ()
    for key, value in values.items():
        if key not in free and not _is_same(getattr(own, key), value):
            raise ConfigurationError(
                f"the requirement {own.id!r} is defined in a file, and is decided as it says there",
                key=key,
                found=_for_message(value),
                expected=_for_message(getattr(own, key)),
                remedy=f"leave `{key}` out, or decide a requirement of the test's own: "
                'requirement("OWN-1", text="...")',
            )
    return replace(own, **{key: value for key, value in values.items() if key in free})


def _is_same(own: Any, value: Any) -> bool:
    if isinstance(own, str) and isinstance(value, str):
        return own.split() == value.split()
    return bool(own == value)


def _for_message(value: Any) -> Any:
    if value is None:
        return "none"
    return asdict(value) if hasattr(value, "__dataclass_fields__") else value


def finite_number(key: str, value: Any) -> float:
    """A number as Python's own, since the record is JSON.

    Raises:
        ConfigurationError: For what is no finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ConfigurationError(
            f"{key} is a finite number", key=key, found=value, remedy=f"correct {key}"
        )
    return number


class RequirementViolated(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A campaign does not support a requirement. ``verdict`` holds the counts it rests on."""

    def __init__(self, message: str, verdict: CampaignVerdict) -> None:
        self.verdict = verdict
        super().__init__(message)


@dataclass(repr=False)
class CampaignRuns(Shown):
    """The episodes of a campaign in order; base of :class:`Campaign`.

    Args:
        runner: Runs the episodes.
        case: The case.
        planned: Episodes that are planned, or may be run at most.
        requirement: What :meth:`Campaign.require` decides.
        until_decided: Whether runs end as soon as the requirement at hand is decided.
        tracer: Traces faults; by default one of its own.
    """

    runner: EpisodeRunner
    case: Case
    planned: int
    requirement: Requirement | None = None
    until_decided: bool = False
    tracer: FaultTracer | None = field(default=None, kw_only=True)
    failures: ComponentFailures = field(default_factory=ComponentFailures, init=False)
    """Of the component itself, in the episodes that the last verdict rests on."""
    judgement: Judgement | None = field(default=None, init=False)
    """The last question that was decided, with the runs that decided it."""

    def __post_init__(self) -> None:
        """Make a tracer, unless one is given."""
        self._tracer = self.tracer or FaultTracer(self.runner)

    def __repr__(self) -> str:
        return f"Campaign({one_line(repr(self.case.id), 80)}, {self.planned} runs planned)"

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows; nothing is simulated for it."""
        yield "case", self.case.id
        yield "component", self.component
        yield "runs planned", str(self.planned)
        yield "requirement", None if self.requirement is None else self.requirement.id

    @property
    def component(self) -> str:
        """Name of the component under test."""
        return self.case.roles(self.runner.roles)["generator"].label

    @property
    def episodes(self) -> list[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes."""
        return list(self)

    def __iter__(self) -> Iterator[JudgedEpisode]:
        return self.in_order([self.case])

    def in_order(
        self, cases: Sequence[Case], course: CampaignCourse | None = None
    ) -> Iterator[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes.

        Args:
            cases: This campaign's, and those whose runs are judged along with it.
            course: Ends the runs once they decide; each run is added to it before the next one.
        """
        judge = None if course is None else course.judge
        schedule = RunSchedule(self.planned, sequential=self.until_decided)
        schedule = schedule if course is None else course.schedule
        decided = self.requirement if judge is None else judge.requirement
        subject = "" if decided is None else decided.id
        run, ahead = 0, self.upcoming(cases)
        with self.runner.progress(self.case, subject, schedule.end, judge) as reach:
            while run < schedule.end if course is None else course.goes_on:
                ahead.reach(run)
                reach(run, schedule.end)
                episode = self.runner.episode(self.case, run, planned=self.planned, ahead=ahead)
                yield episode
                run += 1
                if course is None:
                    schedule.add(episode.validity)

    def upcoming(self, cases: Sequence[Case]) -> UpcomingTasks:
        """The planned runs of several cases as tasks, run by run."""
        return UpcomingTasks(
            self.planned, lambda run: [self.runner.task(case, run) for case in cases]
        )

    def decide(
        self,
        course: CampaignCourse,
        judged: Iterable[tuple[RunJudgement, Sequence[JudgedEpisode]]],
    ) -> list[int]:
        """Add runs to a course one by one, then trace their faults.

        Args:
            course: The course.
            judged: What the question's check says of each run, with the run itself, and with its
                twin if it is one of a pair.

        Returns:
            The numbers of the runs.
        """
        requirements = self.runner.requirements_of(self.case)
        self.failures = ComponentFailures()
        runs, faulty = [], []
        for judgement, episodes in judged:
            course.add(judgement, *(Run.of(episode, requirements) for episode in episodes))
            for episode in episodes:
                self.failures.add(episode)
            runs.append(episodes[0].spec.run)
            if episodes[0].faults:
                faulty.append(runs[-1])
        # Once all have run, so that a component that remembers episodes meets no twin between them.
        self._tracer.follow(self.case, faulty)
        self.judgement = course.judgement
        return runs

    def course_of(
        self, requirement: Requirement, check: Check | None = None, twins: str = ""
    ) -> CampaignCourse:
        """Begin the course of this campaign's runs.

        Args:
            requirement: What decides on them.
            check: A check in place of the requirement's own.
            twins: Id of the case of the second runs, if pairs are judged.

        Raises:
            ConfigurationError: Before anything is run, for a requirement that cannot be judged.
        """
        if self.runner.simulator is None:  # signals of another simulator are known once it runs
            check_formula(self.case.scenario, requirement.check if check is None else check)
        question = Judgement(
            "campaign",
            requirement.id,
            self.case.id,
            self.component,
            self.planned,
            requirement.check if check is None else check_name(check),
            requirement.paired,
            requirement.at_most,
            requirement.confidence,
            requirement.method,
            requirement.p0,
            self.until_decided,
            twins,
        )
        faults = {fault.id for fault in self.case.faults}
        return CampaignCourse(question, varies=varies(self.case.scenario.variation, faults))

    def is_declared(self, requirement: Requirement, check: Check | None) -> bool:
        """Whether runs have a verdict on a requirement themselves, as its case declares it."""
        if requirement.id not in self.case.requirements or callable(check):
            return False
        declared = self.runner.library().requirements[requirement.id].check
        return declared == (requirement.check if check is None else check)

    def requirement_of_call(self, own: Requirement, given: Mapping[str, Any]) -> Requirement:
        """The requirement with the fields that a call gives, apart from ``None``.

        Raises:
            ConfigurationError: For what is not as the requirement's file says.
        """
        values = {key: value for key, value in given.items() if value is not None}
        return _requirement_of_call(own, self.runner.library().requirements, values)

    def report_verdict(self, verdict: CampaignVerdict, requirement: Requirement) -> CampaignVerdict:
        """Report a verdict, and return it if it is "supported".

        Raises:
            RequirementViolated: If it is not.
        """
        __tracebackhide__ = True
        assert self.judgement is not None
        self.runner.events.emit(VerdictReached(verdict, requirement, self.judgement))
        if verdict.verdict != "supported":
            raise RequirementViolated(
                "\n".join(explain_verdict(verdict, requirement, str(self.failures))), verdict
            )
        return verdict
