"""CampaignJudge: from verdicts on episodes, one by one, to the verdict on their campaign."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.campaign_verdicts import (
    EVERY_EPISODE,
    FEW_PROPOSALS,
    REPEATED,
    SITUATIONS,
    TEST_FAILED,
    WITHOUT_EFFECT,
    Bound,
    CampaignStatus,
    CampaignVerdict,
    Counterexample,
    Margins,
    Situation,
    UncountedEpisode,
    rate_advice,
)
from pytest_dura.requirements.episode_verdicts import EpisodeStatus, EpisodeVerdict
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.rate_tests import (
    EXACT_METHOD,
    lower_bound,
    make_test,
    upper_bound,
)
from pytest_dura.requirements.sequential import SequentialTest, require_between


def method_of(requirement: Requirement, *, until_decided: bool = False) -> str:
    """How the requirement is decided: ``every episode``, or a method for its rate.

    Raises:
        ConfigurationError: For a method without a rate.
    """
    if requirement.at_most is not None:
        return requirement.method or ("e-process" if until_decided else "fixed")
    for key, value in (("method", requirement.method), ("p0", requirement.p0)):
        if value is not None:
            raise ConfigurationError(
                "a method decides on a rate, and this requirement accepts no violation at all",
                key=key,
                found=value,
                expected="`at_most` with it",
                remedy=f"add `at_most`, or leave `{key}` out",
            )
    return EVERY_EPISODE


def _rate_test(requirement: Requirement, method: str, planned: int) -> SequentialTest | None:
    """Test of the requirement's rate; ``None`` where no violation is accepted.

    Raises:
        ConfigurationError: For a method that cannot decide on this rate.
    """
    if requirement.at_most is None:
        return None
    return make_test(
        method, requirement.at_most, requirement.confidence, requirement.p0, max(planned, 1)
    )


def _not_manifested(verdicts: Sequence[EpisodeVerdict]) -> list[str]:
    """The planned faults that manifested in none of the episodes."""
    if not verdicts:
        return []
    first, *others = verdicts
    return [
        name
        for name in first.not_manifested
        if all(name in verdict.not_manifested for verdict in others)
    ]


def _first_uncounted(verdicts: Sequence[EpisodeVerdict]) -> UncountedEpisode | None:
    """The first missing episode, or else the first invalid one, or else the first open one.

    Of missing ones the first that an infrastructure error ended comes before those that a test
    failed to judge.
    """
    statuses: tuple[Literal["missing", "invalid", "open"], ...] = ("missing", "invalid", "open")
    for status in statuses:
        of_status = [verdict for verdict in verdicts if verdict.verdict == status]
        if of_status:
            first = min(of_status, key=lambda verdict: verdict.detail.startswith(TEST_FAILED))
            return UncountedEpisode(first.episode, status, first.detail)
    return None


def counterexamples(judged: Sequence[EpisodeVerdict]) -> tuple[Counterexample, ...]:
    """The violating episodes, the valid ones first, of each kind the largest violation first."""
    violated = [verdict for verdict in judged if verdict.verdict == "violated"]
    violated.sort(
        key=lambda verdict: (
            verdict.without_effect,
            verdict.margin if verdict.margin is not None else 0.0,
            verdict.episode,
        )
    )
    return tuple(
        Counterexample(verdict.episode, verdict.time, verdict.margin, not verdict.without_effect)
        for verdict in violated
    )


MAX_INVALID_SHARE = 0.2
"""Share of invalid episodes above which a campaign is undecided."""
_MIN_VALID_PROPOSALS = 0.5
"""Share of valid proposals below which a claim would rest on the recovery, not on the component."""


_MAX_EXTRA_SHARE = 0.2
"""Further runs that may follow invalid ones, as a share of a fixed number of planned runs."""


class RunSchedule:
    """Number of runs of a campaign: the planned ones, and a further run for each invalid one.

    Args:
        planned: Runs that are planned.
        sequential: Whether the judge decides when the runs end; it has no further runs.
    """

    def __init__(self, planned: int, *, sequential: bool) -> None:
        self.end = planned
        """Runs that are due by now."""
        self._most = planned + (0 if sequential else math.ceil(_MAX_EXTRA_SHARE * planned))

    def add(self, validity: str) -> None:
        """Take in the validity of the next run."""
        self.end += validity == "invalid" and self.end < self._most


class CampaignJudge:
    """Judges a requirement on the episodes of a case, in the order in which they are run.

    Args:
        requirement: The requirement; its rate, confidence and method say how it is judged.
        case: Id of the case.
        planned: Episodes that are planned, or may be run at most.
        component: The component's name, for a campaign of which nothing was run.
        until_decided: Whether runs end as soon as the requirement is decided. A sequential
            method ends them in any case.

    Raises:
        ConfigurationError: For a rate, confidence or method that makes no sense.
    """

    def __init__(
        self,
        requirement: Requirement,
        case: str,
        *,
        planned: int,
        component: str | None = None,
        until_decided: bool = False,
    ) -> None:
        self.requirement, self.case, self.planned = requirement, case, planned
        self._noun = "episodes" if requirement.paired is None else "pairs"
        self._where_it_holds = requirement.paired is not None and requirement.paired.prevents
        """Whether only runs count in which there was something to prevent."""
        self.component, self.until_decided = component, until_decided
        self.verdicts: list[EpisodeVerdict] = []
        self.situation: Situation | None = None
        """What the runs are, if all are equal; set by the caller, who has their trajectories."""
        self._counts: Counter[str] = Counter()
        require_between("confidence", requirement.confidence, 0.5, 1.0)
        if requirement.at_most is not None:
            require_between("at_most", requirement.at_most, 0.0, 1.0)
        self.method = method_of(requirement, until_decided=until_decided)
        self.test = _rate_test(requirement, self.method, planned)
        """Decides whether the rate is supported; an open episode counts as a violation."""
        self._rejecting = _rate_test(requirement, self.method, planned)
        """Decides whether the rate is violated; only true violations count as such."""
        self._after_support = 0

    @property
    def sequential(self) -> bool:
        """Whether the number of runs depends on what they show."""
        return self.until_decided or self.method in ("sprt", "e-process")

    @property
    def violations(self) -> int:
        """Episodes that violated it so far."""
        return self._count("violated")

    @property
    def upper(self) -> float | None:
        """The bound on the rate of violations so far; ``None`` where no rate is to be decided."""
        return None if self.test is None else self._bound(self._valid).upper

    def add(self, verdict: EpisodeVerdict) -> None:
        """The next episode's verdict.

        Raises:
            ConfigurationError: For an episode of another component, and what is no verdict on an
                episode of a campaign, such as one on an episode that a search chose.
        """
        if not isinstance(verdict, EpisodeVerdict):
            raise ConfigurationError(
                "a campaign rests on verdicts on its own episodes",
                key=self.requirement.id,
                found=type(verdict).__name__,
                expected="an EpisodeVerdict; episodes that a search chose are no sample",
            )
        known = self.component if not self.verdicts else self.verdicts[0].component
        if known is not None and verdict.component != known:
            raise ConfigurationError(
                "a campaign judges one component",
                key=self.requirement.id,
                found=", ".join(sorted({known, verdict.component})),
                remedy="judge the episodes of each component apart",
            )
        self.verdicts.append(verdict)
        status = "vacuous" if self._is_outside(verdict) else verdict.verdict
        self._counts["without effect" if verdict.without_effect else status] += 1
        if self.sequential and verdict.valid and status != "vacuous":
            self._test(verdict.verdict)

    def _is_outside(self, verdict: EpisodeVerdict) -> bool:
        """Whether a run enters no n: there was nothing to prevent in it."""
        return self._where_it_holds and verdict.vacuous

    def _test(self, status: EpisodeStatus) -> None:
        """Count a valid episode in the tests of the rate, as far as they have not decided."""
        if self.test is None or self._rejecting is None:
            return
        if self.test.decision == "supported":
            self._after_support += status != "satisfied"
        elif self.test.decision is None:
            self.test.update(status != "satisfied")
        if self._rejecting.decision is None:
            self._rejecting.update(status == "violated")

    @property
    def decided(self) -> bool:
        """Whether further episodes cannot change the verdict.

        For a plan of a fixed number of runs only if they repeat one situation.
        """
        if self.situation == REPEATED:
            return True
        if not self.sequential:
            return False
        if self._count("missing"):
            return True  # undecided, unless it was violated before
        if self.test is None or self._rejecting is None:
            return self._count("violated") + self._count("without effect") > 0
        # A test that can only come out against the component goes on all the same: "undecided"
        # may be excused, "violated" may not.
        if self.test.decision == "supported":
            # Too many invalid or vacuous episodes stand against it, which further ones may mend.
            return not self._obstacles(decided=True)
        return self._rejecting.decision == "violated"

    @property
    def status(self) -> CampaignStatus:
        """What :meth:`verdict` decides, without the figures that go with it."""
        return self._decision()[0]

    def verdict(self) -> CampaignVerdict:
        """The verdict on what was added so far."""
        status, reason = self._decision()
        valid = [
            verdict for verdict in self.verdicts if verdict.valid and not self._is_outside(verdict)
        ]
        margins = [
            verdict.margin
            for verdict in valid
            if verdict.margin is not None and verdict.verdict != "open"
        ]
        early = self.sequential and self.decided and status != "undecided"
        early = early or self.situation == REPEATED
        return CampaignVerdict(
            requirement=self.requirement.id,
            case=self.case,
            component=self.verdicts[0].component if self.verdicts else self.component or "none",
            verdict=status,
            reason=reason,
            method=self.method,
            planned=self.planned,
            run=len(self.verdicts),
            saved=max(0, self.planned - len(self.verdicts)) if early else 0,
            episodes=len(valid),
            violations=self._count("violated"),
            open=tuple(verdict.episode for verdict in valid if verdict.verdict == "open"),
            unseen_crashes=tuple(
                verdict.unseen_crash for verdict in self.verdicts if verdict.unseen_crash
            ),
            without_effect=self._count("without effect"),
            invalid=self._invalid,
            missing=self._count("missing"),
            vacuous=self._count("vacuous") or sum(verdict.vacuous for verdict in valid),
            bound=self._bound(len(valid)),
            margin=min(margins) if margins else None,
            margins=Margins.of(margins),
            counterexamples=counterexamples(self.verdicts),
            first_uncounted=_first_uncounted(self.verdicts),
            situation=self.situation,
            too_few=status == "undecided" and self.situation is None and not self._flaws(),
        )

    def _count(self, status: str) -> int:
        return self._counts[status]

    @property
    def _valid(self) -> int:
        """The n of every rate and bound."""
        return self._count("satisfied") + self._count("violated") + self._count("open")

    @property
    def _invalid(self) -> int:
        return self._count("invalid") + self._count("without effect")

    def _bound(self, valid: int) -> Bound:
        confidence, at_most = self.requirement.confidence, self.requirement.at_most
        if self.situation is not None:
            method = EXACT_METHOD if self.test is None else self.test.method
            return Bound(confidence, None, method, at_most)
        if self.test is None or self.method == "fixed":
            worst = self._count("violated") + self._count("open")
            upper = upper_bound(worst, valid, confidence) if valid else None
            return Bound(confidence, upper, EXACT_METHOD, at_most)
        return Bound(confidence, self.test.upper if valid else None, self.test.method, at_most)

    def _decision(self) -> tuple[CampaignStatus, str]:
        one = self.situation is not None
        return self._decide_on_one_situation() if one else self._decide()

    def _decide(self) -> tuple[CampaignStatus, str]:
        violations, valid = self._count("violated"), self._valid
        counts = f"{violations} of {valid} valid {self._noun} violated it"
        if self._count("open"):
            counts += f", {self._count('open')} ended before it was decided"
        if self.test is None:
            if violations:
                return "violated", counts
            if self._count("without effect"):
                return "violated", self._violated_without_effect()
            obstacles = self._obstacles()
            if obstacles:
                return "undecided", "; ".join(obstacles)
            return "supported", f"all {valid} valid {self._noun} satisfied it"
        if self.method == "fixed":
            return self._decide_fixed(counts)
        return self._decide_sequential(self.test, counts)

    def _violated_without_effect(self) -> str:
        count = f"{self._count('without effect')} of {self._invalid} invalid {self._noun}"
        return f"violated, without effect of the fault, in {count}"

    def _decide_on_one_situation(self) -> tuple[CampaignStatus, str]:
        """Equal runs are one observation: it violates the requirement or not, at no rate."""
        assert self.situation is not None
        situation = SITUATIONS[self.situation]
        violations, valid = self._count("violated"), self._valid
        if violations and (self.test is None or violations == valid):
            counts = f"{violations} of {valid} valid {self._noun} violated it"
            return "violated", f"{counts}: {situation}"
        obstacles = self._obstacles(decided=self.decided)
        if self.situation == WITHOUT_EFFECT:
            obstacles.append(f"{situation}: all {len(self.verdicts)} {self._noun} are equal")
        elif self.test is not None:
            obstacles.append(f"{situation}: no rate can be bound")
        if obstacles:
            return "undecided", "; ".join(obstacles)
        return "supported", f"all {valid} valid {self._noun} satisfied it: {situation}"

    def _decide_sequential(self, test: SequentialTest, counts: str) -> tuple[CampaignStatus, str]:
        limit, confidence = self.requirement.at_most, self.requirement.confidence
        text = f"{counts}; {self.method} at {confidence:g} confidence"
        if self._rejecting is not None and self._rejecting.decision == "violated":
            # What this test shows is weaker than "violated" says: the limit itself may hold.
            p0 = self.requirement.p0
            why = "" if p0 is None else f", since the rate is above p0 = {p0:g}"
            return "violated", f"{text} rejects a rate of at most {limit:g}{why}"
        obstacles = self._obstacles(decided=test.decision is not None)
        if obstacles:
            return "undecided", "; ".join(obstacles)
        if test.decision == "supported":
            return "supported", f"{text} supports a rate of at most {limit:g}"
        return (
            "undecided",
            f"{text} has not decided on at most {limit:g} within {self.planned} runs",
        )

    def _decide_fixed(self, counts: str) -> tuple[CampaignStatus, str]:
        at_most, confidence = self.requirement.at_most, self.requirement.confidence
        assert at_most is not None
        violations, valid = self._count("violated"), self._valid
        if violations:
            # What was not run, is missing or open counts as satisfied here: it may not make a
            # violation.
            open_runs = self._count("missing") + max(0, self.planned - len(self.verdicts))
            lower = lower_bound(violations, valid + open_runs, confidence)
            if lower > at_most:
                return "violated", (
                    f"{counts}: at {confidence:g} confidence the rate is above {lower:.3g}, "
                    f"and at most {at_most:g} is allowed"
                )
        obstacles = self._obstacles(decided=self.decided)
        if obstacles:
            return "undecided", "; ".join(obstacles)
        upper = upper_bound(violations + self._count("open"), valid, confidence)
        reason = f"{counts}: at {confidence:g} confidence the rate is at most {upper:.3g}"
        if upper <= at_most:
            return "supported", reason
        worst = violations + self._count("open")
        if worst > at_most * valid:
            share = f"{100 * worst / valid:.3g} %, more than the {100 * at_most:.3g} % allowed"
            reason = reason.replace(counts, f"{counts} ({share})", 1)
        advice = rate_advice(worst, valid, at_most, confidence)
        return "undecided", f"{reason}, which does not support {at_most:g}; {advice}"

    def _obstacles(self, *, decided: bool = False) -> list[str]:
        """Reasons why this campaign cannot support a claim."""
        run, shortages = len(self.verdicts), []
        if run < self.planned and not decided:
            shortages.append(f"only {run} of {self.planned} planned {self._noun} were run")
        return [*shortages, *self._flaws()]

    def _flaws(self) -> list[str]:
        """Reasons that stand against the runs themselves, and not against their number."""
        run, valid = len(self.verdicts), self._valid
        missing, invalid = self._count("missing"), self._invalid
        flaws = []
        if missing:
            first = _first_uncounted(self.verdicts)
            by_test = first is not None and first.detail.startswith(TEST_FAILED)
            what = "not judged, since the test failed" if by_test else "missing (infrastructure)"
            flaws.append(f"{missing} of {run} {self._noun} are {what}")
        if run and invalid / run > MAX_INVALID_SHARE:
            share = f"more than {MAX_INVALID_SHARE:.0%}"
            flaws.append(f"{invalid} of {run} {self._noun} are invalid, {share}")
        if not valid and self._count("vacuous"):
            number = self._count("vacuous")
            flaws.append(f"there was nothing to prevent in the {number} valid {self._noun}")
        elif not valid:
            flaws.append(f"none of the {self._noun} was valid")
        flaws += self._early_ends()
        if self.test is not None and self._count("without effect"):
            flaws.append(self._violated_without_effect())
        if self._after_support:
            before = 0 if self.test is None else self.test.episodes
            flaws.append(
                f"supported after {before} {self._noun}, and {self._after_support} after these "
                "violated it or ended before it was decided"
            )
        satisfied = self._count("satisfied")
        vacuous = 0 if self._where_it_holds else sum(each.vacuous for each in self.verdicts)
        if satisfied and satisfied == vacuous and not self._count("violated"):
            flaws.append(f"its condition held in none of the {valid} valid {self._noun} (vacuous)")
        never = _not_manifested([verdict for verdict in self.verdicts if verdict.valid])
        if never:
            flaws.append(f"{', '.join(never)} manifested in none of the {valid} valid {self._noun}")
        proposals = sum(verdict.proposals for verdict in self.verdicts)
        valid_proposals = sum(verdict.valid_proposals for verdict in self.verdicts)
        if valid_proposals < _MIN_VALID_PROPOSALS * proposals:
            ticks = f"{valid_proposals} of {proposals} ticks"
            flaws.append(f"{FEW_PROPOSALS}{ticks}")
        return flaws

    def _early_ends(self) -> list[str]:
        """Runs whose end the component may have caused, where no bound counts them."""
        obstacles = []
        open_ = [verdict for verdict in self.verdicts if verdict.verdict == "open"]
        if open_ and self.test is None:
            count = f"{len(open_)} of {self._valid} valid {self._noun}"
            obstacles.append(f"{count} ended before it was decided ({_ends(open_)})")
        unharmed = [
            verdict for verdict in self.verdicts if verdict.verdict == "invalid" and verdict.ended
        ]
        if unharmed:
            count = f"{len(unharmed)} invalid {self._noun}"
            obstacles.append(f"{count} ended before a fault had an effect ({_ends(unharmed)})")
        unseen = [verdict.unseen_crash for verdict in self.verdicts if verdict.unseen_crash]
        if unseen:
            runs = f"{unseen[0]} and {len(unseen) - 1} more" if unseen[1:] else unseen[0]
            obstacles.append(f"a crash that no requirement sees: {runs} ended critical")
        return obstacles


def _ends(verdicts: Sequence[EpisodeVerdict]) -> str:
    """How the runs ended, with their numbers, such as ``8 critical, 1 halt``."""
    ends = Counter(verdict.ended for verdict in verdicts)
    return ", ".join(f"{count} {end}" for end, count in sorted(ends.items()))


def judge_campaign(
    requirement: Requirement,
    case: str,
    verdicts: Sequence[EpisodeVerdict],
    *,
    planned: int,
    component: str | None = None,
    until_decided: bool = False,
    situation: Situation | None = None,
) -> CampaignVerdict:
    """The verdict of a requirement on the episodes of a case.

    Args:
        requirement: The requirement.
        case: Id of the case.
        verdicts: One per episode that was run. Of several attempts at one episode a violation
            counts before anything else, and otherwise the last one.
        planned: Episodes that were planned.
        component: The component's name, for a campaign of which nothing was run.
        until_decided: Whether runs ended as soon as the requirement was decided.
        situation: What the runs are, if all of them are equal.

    Raises:
        ConfigurationError: As :class:`CampaignJudge`.
    """
    judge = CampaignJudge(
        requirement, case, planned=planned, component=component, until_decided=until_decided
    )
    latest: dict[str, EpisodeVerdict] = {}
    for verdict in verdicts:
        before = latest.get(verdict.episode)
        if before is None or before.verdict != "violated":
            latest[verdict.episode] = verdict
    for attempt in latest.values():
        judge.add(attempt)
    judge.situation = situation
    return judge.verdict()
