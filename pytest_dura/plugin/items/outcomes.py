"""Results of items, requirement by requirement, and checks of tests that passed.

A pass rests on the episodes that the test looked at, on the verdicts that it asked for, and on
the requirement's own check.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import pytest

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.items.markers import Target, decides_nothing, marked_requirements
from pytest_dura.plugin.options import LONG_NAMES

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
    from pytest_dura.requirements.episode_verdicts import (
        EpisodeStatus,
        EpisodeVerdict,
        JudgedEpisode,
    )
    from pytest_dura.requirements.judgements import Judgement
    from pytest_dura.requirements.model import Requirement


class UsedEpisodes:
    """Facts about the episodes of one case that an item looked at; no episode is kept.

    Args:
        case: The case.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        self.failure = ""
        """The first infrastructure error among them."""
        self.early_end = ""
        """The first that ended once all was decided, in words, if one did."""
        self._seeds: dict[str, int] = {}
        self._invalid: dict[str, str] = {}

    def add(self, episode: JudgedEpisode) -> None:
        """Note an episode that the item looked at."""
        name = episode.id
        self._seeds[name] = episode.spec.seed
        self._invalid.pop(name, None)
        if episode.validity == "invalid":
            self._invalid[name] = str(episode.invalid_reason)
        if episode.termination == "decided" and not self.early_end:
            self.early_end = (
                f"{name} ended at {episode.time[-1]:g} s, once its requirements were decided"
            )
        if episode.failure is not None:
            self.failure = self.failure or f"{episode.failure} (in {name})"

    def episode(self, runner: Runner, name: str) -> JudgedEpisode | None:
        """Return the episode of this id that the item looked at last, if any."""
        if name not in self._seeds:
            return None
        return runner.fetch(self.case, int(name.rpartition("#")[2]), self._seeds[name])

    @property
    def undecided_reason(self) -> str | None:
        """Why they leave a campaign without a verdict undecided, if they do."""
        from pytest_dura.requirements.campaign_judge import MAX_INVALID_SHARE

        if len(self._invalid) <= MAX_INVALID_SHARE * len(self._seeds):
            return None
        # In the order in which the item looked at them.
        first = next(name for name in self._seeds if name in self._invalid)
        counts = f"{len(self._invalid)} of {len(self._seeds)}"
        return f"undecided: {counts} episodes are invalid ({first}: {self._invalid[first]})"


@dataclass(frozen=True)
class ItemResult:
    """Result of an item for one requirement.

    Args:
        requirement: The requirement.
        case: The case it was judged on, if the item has one.
        verdict: Of an item on a campaign.
        judged: What an item on one episode says of it.
        judgement: What that item asked, and what its assertions came to.
        episode: The episode that the item looked at, if it looked at one.
    """

    requirement: Requirement
    case: Case | None = None
    verdict: CampaignVerdict | None = None
    judged: EpisodeVerdict | None = None
    judgement: Judgement | None = None
    episode: JudgedEpisode | None = None

    @property
    def status(self) -> str | None:
        """Verdict, if there is one: ``supported``, ``violated`` and so on."""
        return self._judged.verdict if self._judged else None

    @property
    def component(self) -> str | None:
        """Name of the component under test, if it is known."""
        return self._judged.component if self._judged else None

    @property
    def _judged(self) -> CampaignVerdict | EpisodeVerdict | None:
        return self.judged or self.verdict

    @property
    def question(self) -> tuple[Any, ...]:
        """Key of what is decided: equal for several attempts of a test, and for them alone."""
        key = self.requirement.id, self.component
        if self.verdict is not None:
            bound = self.verdict.bound
            return *key, self.verdict.case, self.verdict.check, bound.at_most, bound.confidence
        return *key, self.judgement and self.judgement.case


@dataclass
class Decided:
    """What an item decided since its last report, for what the process of the item writes.

    Args:
        results: The results, without case and episode.
        searched: Ids of the requirements that it searched for violations of.
    """

    results: list[ItemResult] = field(default_factory=list)
    searched: set[str] = field(default_factory=set)

    def without_secrets(self, redact: Callable[[Any], Any]) -> Decided:
        """Copy it without secrets; most often there is none, and it is the very same object."""
        if not self.results:
            return self
        parts: list[tuple[Any, ...]] = [
            (each.requirement, each.verdict, each.judged, each.judgement) for each in self.results
        ]
        given = encode(parts)
        safe = redact(given)
        if safe is given:
            return self
        results = []
        for known, plain in zip(parts, safe, strict=True):
            requirement, verdict, judged, judgement = (
                part and decode(type(part), data) for part, data in zip(known, plain, strict=True)
            )
            results.append(
                ItemResult(requirement, verdict=verdict, judged=judged, judgement=judgement)
            )
        return Decided(results, self.searched)


@dataclass(frozen=True)
class ItemJudged:
    """An item has run, or could not be set up, and its results are known.

    Args:
        item: An item that uses the runner.
        report: Its report, which is not passed on yet.
        results: Its results.
    """

    item: pytest.Item
    report: pytest.TestReport
    results: Sequence[ItemResult]


_EARLIER_RESULTS = pytest.StashKey[list[ItemResult]]()


def item_results(
    context: SessionContext,
    item: pytest.Item,
    decided: Decided,
) -> list[ItemResult]:
    """Return the results of an item that has run or could not be set up.

    Args:
        context: The session's context.
        item: An item that uses the runner.
        decided: What it decided when it ran.

    Returns:
        The results in the order of their requirements in the item's markers. What was to be
        decided on a campaign and was not is undecided. Of several attempts a violation counts
        before anything else, as in the record.
    """
    claimed = {requirement.id: requirement for requirement in marked_requirements(context, item)}
    results = _decided_results(context, item, decided.results, claimed)
    # A search decides its requirements without a verdict.
    answered = {result.requirement.id for result in results} | decided.searched
    target = target_of(item)
    for name, requirement in claimed.items():
        if name not in answered:
            results.append(_undecided_result(context, item, requirement, target))
    violated = {
        result.question: result
        for result in item.stash.get(_EARLIER_RESULTS, [])
        if result.status == "violated"
    }
    results = [violated.get(result.question, result) for result in results]
    item.stash[_EARLIER_RESULTS] = results
    return results


def parameters_of(item: pytest.Item) -> Mapping[str, Any]:
    """Return the parameters of an item, those of our fixtures by their short names."""
    parameters: Mapping[str, Any] = getattr(getattr(item, "callspec", None), "params", {})
    return {name.removeprefix(LONG_NAMES): value for name, value in parameters.items()}


def given_to(item: pytest.Item, name: str) -> Any:
    """Return what our fixture of this short name gave to an item; ``None`` if nothing."""
    arguments = getattr(item, "funcargs", {})
    return arguments.get(LONG_NAMES + name, arguments.get(name))


def target_of(item: pytest.Item) -> Any:
    """Return the planned case or the parametrized target of an item, which has a ``case``."""
    return getattr(item, "planned", None) or marked_target(item)


def marked_target(
    item: pytest.Item, fixtures: Sequence[str] = ("episode", "campaign")
) -> Target | None:
    """Return the run, or the case, that a test with the marker ``dura`` looks at."""
    targets = map(parameters_of(item).get, fixtures)
    return next((target for target in targets if isinstance(target, Target)), None)


def episode_of(item: pytest.Item) -> JudgedEpisode | None:
    """Return the episode that the item looks at, if there is one."""
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode

    episode = given_to(item, "episode")
    return episode if isinstance(episode, JudgedEpisode) else None


def _decided_results(
    context: SessionContext,
    item: pytest.Item,
    results: Iterable[ItemResult],
    claimed: Mapping[str, Requirement],
) -> list[ItemResult]:
    """Complete results by case and episode, and sort them: campaigns first, as in the markers."""
    episode, order = episode_of(item), list(claimed)
    completed = []
    for result in results:
        name = result.requirement.id
        about = result.verdict or result.judgement
        completed.append(
            replace(
                result,
                requirement=claimed.get(name, result.requirement),
                case=None if about is None else _case_of_result(context, item, about.case),
                episode=None if result.verdict else episode,
            )
        )
    return sorted(
        completed,
        key=lambda result: (
            order.index(result.requirement.id) if result.requirement.id in claimed else len(order),
            result.verdict is None,
        ),
    )


def _undecided_result(
    context: SessionContext, item: pytest.Item, requirement: Requirement, target: Any
) -> ItemResult:
    """Make the result of a requirement that the item was to decide, and did not."""
    case = None if target is None else target.case
    if case is None or "episode" in parameters_of(item):
        return ItemResult(requirement, case, episode=episode_of(item))
    from pytest_dura.requirements.campaign_judge import judge_campaign

    campaign = given_to(item, "campaign")
    verdict = judge_campaign(
        requirement,
        case.id,
        [],
        planned=context.options.runs or getattr(target, "planned", case.scenario.planned),
        component=getattr(campaign, "component", None),
    )
    undecided = replace(verdict, reason="the test ended without a verdict on it")
    return ItemResult(requirement, case, verdict=undecided)


def _case_of_result(context: SessionContext, item: pytest.Item, name: str) -> Case | None:
    """Return the case of this id; ``None`` for one that a test made by itself."""
    target = target_of(item)
    if target is not None and target.case.id == name:
        case: Case = target.case
        return case
    try:
        return context.runner.case(name)
    except ConfigurationError:  # faults that the test made itself have no name
        return None


def outcome_of_test(
    requirement: Requirement,
    requirements: Sequence[Requirement],
    target: Target,
    episode: JudgedEpisode,
    *,
    error: BaseException | None,
    failed: str,
) -> tuple[EpisodeVerdict, Judgement]:
    """Judge a test on an episode: by its outcome, and by the requirement's own check.

    Args:
        requirement: What the test decides.
        requirements: Those of the episode's case.
        target: What the test looks at.
        episode: The episode.
        error: What the test raised, if anything.
        failed: Which of its own assertions failed, of :func:`failed_assertion`; empty if none did.
    """
    from pytest_dura.plugin.items.observed_episode import observations_of
    from pytest_dura.requirements.episode_verdicts import (
        EARLY_ENDS,
        CheckVerdict,
        EpisodeVerdict,
    )
    from pytest_dura.requirements.judgements import Assertion, Judgement, RunJudgement
    from pytest_dura.requirements.runs import Run

    status, detail = status_of_test(episode, error)
    failed = failed if status == "violated" else ""
    detail = failed or detail
    margin = time = None
    judged = _judged_by_own_check(requirement, episode)
    if judged is not None and judged.verdict == "violated":
        status, margin, time = "violated", judged.margin, judged.time
        detail = detail or judged.detail
    elif judged is not None and status == "satisfied" and judged.verdict != "satisfied":
        status, detail = judged.verdict, judged.detail
    vacuous = status == "satisfied" and judged is not None and judged.vacuous
    may_be_unseen = status != "violated" and episode.termination == "critical"
    unseen = may_be_unseen and Run.of(episode, requirements).is_unseen_crash
    own = EpisodeVerdict(
        requirement=requirement.id,
        episode=episode.id,
        component=episode.spec.component,
        verdict=status,
        margin=margin,
        time=time,
        detail=detail,
        proposals=episode.metrics.proposals,
        valid_proposals=episode.metrics.valid_proposals,
        vacuous=vacuous,
        not_manifested=tuple(episode.not_manifested),
        without_effect=status == "violated" and episode.validity == "invalid",
        ended=episode.termination if episode.termination in EARLY_ENDS else "",
        unseen_crash=episode.id if unseen else "",
    )
    assertion = Assertion(
        alone=judged is None,
        by_check=judged is not None and judged.verdict == "violated",
        observed=tuple(observations_of(episode).names),
        false=() if failed else tuple(observations_of(episode).false),
        failed=failed,
    )
    run = RunJudgement(episode.digest, episode.spec.run, verdict=CheckVerdict.of(own))
    return own, Judgement(
        "test",
        requirement.id,
        target.case.id,
        own.component,
        target.planned,
        at_most=requirement.at_most,
        confidence=requirement.confidence,
        runs=(run,),
        assertion=assertion,
    )


def failed_assertion(item: pytest.Item, excinfo: pytest.ExceptionInfo[BaseException]) -> str:
    """Describe what failed in a test: message, what was compared, and the line in its file."""
    from pytest_dura.evidence.text import one_line

    error = excinfo.value
    lines = [line for line in str(error).split("\n") if line.strip()]
    # pytest appends the comparison to the test's own message.
    compared = [line for line in lines[1:] if line.startswith("assert ")]
    text = "; ".join([*lines[:1], *compared[:1]]) or type(error).__name__
    own_entries = [entry for entry in excinfo.traceback if entry.path == item.path]
    if not own_entries:
        return one_line(text, 500)
    place = item.nodeid.partition("::")[0]
    return f"{one_line(text, 500)} ({place}:{own_entries[-1].lineno + 1})"


def _judged_by_own_check(requirement: Requirement, episode: JudgedEpisode) -> EpisodeVerdict | None:
    """Judge by the requirement's own check; ``None`` where it has none that applies."""
    if not requirement.check or requirement.paired is not None:
        return None
    from pytest_dura.requirements.episode_verdicts import judge_episode

    try:
        return judge_episode(requirement, episode)
    except ConfigurationError:  # the check is about signals of another domain
        return None


def status_of_test(
    episode: JudgedEpisode, error: BaseException | None
) -> tuple[EpisodeStatus, str]:
    """Return what the outcome of a test says of its episode, and why."""
    from pytest_dura.requirements.campaign_verdicts import TEST_FAILED

    message = str(error).partition("\n")[0] if error is not None else ""
    if episode.failure is not None:
        return "missing", episode.failure
    if error is None:
        return "satisfied", ""
    says_invalid = isinstance(error, pytest.fail.Exception) and message.startswith("invalid: ")
    if says_invalid or isinstance(error, pytest.skip.Exception):
        return "invalid", message
    if isinstance(error.__context__, ConfigurationError):
        return "missing", f"{TEST_FAILED}{message}"
    if isinstance(error, (AssertionError, pytest.fail.Exception)):
        return "violated", message
    return "missing", f"{TEST_FAILED}{type(error).__name__}: {message}"


_Judged: TypeAlias = "tuple[Requirement, EpisodeVerdict | None]"
"""A requirement of a test, and what its own check says of the episode, if it has one."""
_OUR_FIXTURES = ("pytest_dura.plugin.fixtures", "pytest_dura.plugin.short_fixtures")


def check_passed(
    context: SessionContext,
    item: pytest.Function,
    used: Mapping[str, UsedEpisodes],
    decided: Collection[tuple[str, str]],
) -> None:
    """Fail a test that passed if the episodes that it looked at do not support that.

    Args:
        context: The session's context.
        item: The test.
        used: The episodes that it looked at, by case.
        decided: Requirement and case of the verdicts that it asked for.
    """
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode

    for episodes in used.values():
        if episodes.failure:
            _fail(episodes.failure)
    looked_at = given_to(item, "episode")
    judged: list[_Judged] = []
    if isinstance(looked_at, JudgedEpisode):
        judged = [
            (requirement, _judged_by_own_check(requirement, looked_at))
            for requirement in marked_requirements(context, item)
        ]
        _check_violations(judged)
    for episodes in used.values():
        if episodes.early_end:
            # What the test read beyond that end might have been otherwise.
            text = "it shows a test nothing of what would have followed"
            remedy = "run such tests with --dura-end=complete"
            _fail(f"invalid: {episodes.early_end}: {text}; {remedy}")
    if isinstance(looked_at, JudgedEpisode):
        if looked_at.validity == "invalid":
            _fail(f"invalid: {looked_at.id}: {looked_at.invalid_reason}")
        _check_decided_by_own(judged)
        _check_looked(judged, looked_at)
    _check_searched(used.values())
    campaign = given_to(item, "campaign")
    if isinstance(campaign, Campaign):
        _check_decided(context, item, campaign, used, decided)
    if without_verdict(context, item, decided):
        _fail(f"undecided: the test ended without a verdict; {_remedy(item)}")


def without_verdict(
    context: SessionContext, item: pytest.Item, decided: Collection[tuple[str, str]]
) -> bool:
    """Whether a test that uses episodes came to no verdict, and does not declare that.

    Args:
        context: The session's context.
        item: The test, which has run.
        decided: Requirement and case of the verdicts that it asked for.
    """
    fixtures = episode_fixtures_of(item)
    if not fixtures or decided or decides_nothing(item):
        return False
    return "episode" not in fixtures or not marked_requirements(context, item)


def episode_fixtures_of(item: pytest.Item) -> list[str]:
    """List those of our fixtures that give a test its episodes, by name and origin."""
    info = getattr(item, "_fixtureinfo", None)
    known = {} if info is None else info.name2fixturedefs
    return [
        name
        for name in ("episode", "campaign", "run_episode")
        if any(full in known and _is_ours(full, known[full]) for full in (LONG_NAMES + name, name))
    ]


def _is_ours(name: str, definitions: Sequence[Any]) -> bool:
    """Whether a fixture is ours, or overrides ours and requests it."""
    for definition in reversed(definitions):
        if definition.func.__module__ in _OUR_FIXTURES:
            return True
        if name not in definition.argnames:
            return False
    return False


def _remedy(item: pytest.Item) -> str:
    nothing = "say that it decides nothing: @pytest.mark.dura(..., verdict=False)"
    ways = {
        "episode": 'name what it decides, @pytest.mark.requirement("ID", text="..."), or ',
        "campaign": "call campaign.require(check), or ",
    }
    return ways.get(episode_fixtures_of(item)[0], "") + nothing


def _check_violations(judged: Iterable[_Judged]) -> None:
    """Fail a test whose episode violates the check of a requirement, whatever else happened.

    One that accepts a rate of violations is decided on all episodes, once they have run.
    """
    for requirement, verdict in judged:
        if verdict is not None and verdict.verdict == "violated" and requirement.at_most is None:
            _fail(f"violated: {_violation_text(requirement, verdict)}")


def _check_decided_by_own(judged: Iterable[_Judged]) -> None:
    """Fail a test whose episode does not satisfy its requirements' own checks."""
    for requirement, verdict in judged:
        if verdict is not None and verdict.verdict not in ("satisfied", "violated"):
            _fail(f"{verdict.verdict}: {_violation_text(requirement, verdict)}")


def _check_looked(judged: Iterable[_Judged], episode: JudgedEpisode) -> None:
    """Fail a test that read nothing of its episode, and so decides nothing by assertions."""
    from pytest_dura.plugin.items.observed_episode import observations_of

    alone = [requirement.id for requirement, verdict in judged if verdict is None]
    if alone and not observations_of(episode).names:
        _fail(
            f"invalid: the test looked at nothing of {episode.id}, so that it decides nothing "
            f"about {', '.join(alone)}; assert something of the episode, such as "
            '`episode.satisfies("always (gap > 0)")`',
        )


def _check_searched(used: Iterable[UsedEpisodes]) -> None:
    """Fail a property test none of whose cases is valid."""
    from pytest_dura.library.cases import SearchedCase

    reasons = [
        used_episodes.undecided_reason
        for used_episodes in used
        if isinstance(used_episodes.case, SearchedCase)
    ]
    if reasons and all(reasons):
        reason = str(reasons[0]).partition("(")[2]
        _fail(f"undecided: none of {len(reasons)} cases is valid ({reason}")


def _violation_text(requirement: Requirement, judged: EpisodeVerdict) -> str:
    detail = "" if judged.detail == requirement.check else f": {judged.detail}"
    return f"{requirement.id} on {judged.episode}: {requirement.check}{detail}"


def _check_decided(
    context: SessionContext,
    item: pytest.Function,
    campaign: Campaign,
    used: Mapping[str, UsedEpisodes],
    decided: Collection[tuple[str, str]],
) -> None:
    """Fail a test on a campaign that asked for no verdict on a requirement of its markers."""
    used_episodes = used.get(campaign.case.id)
    if used_episodes is not None and used_episodes.undecided_reason is not None:
        _fail(used_episodes.undecided_reason)
    if given_to(item, "episode") is not None:
        return  # it decides them
    claimed = [requirement.id for requirement in marked_requirements(context, item)]
    undecided = [name for name in claimed if (name, campaign.case.id) not in decided]
    if undecided:
        _fail(
            f"undecided: the test never asked for a verdict on {', '.join(undecided)}; "
            "call campaign.require(check)",
        )


def _fail(message: str) -> NoReturn:
    pytest.fail(message, pytrace=False)
