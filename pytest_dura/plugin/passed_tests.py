"""Whether a test that passed may pass: a pass rests on episodes, and on verdicts it asked for."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

from pytest_dura.plugin.episode_outcomes import judged_by_own_check
from pytest_dura.plugin.parametrize import decides_nothing
from pytest_dura.plugin.requirement_markers import marked_requirements

if TYPE_CHECKING:
    from pytest_dura.campaign.campaigns import Campaign
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.plugin.used_episodes import UsedEpisodes
    from pytest_dura.requirements.model import Requirement
    from pytest_dura.requirements.verdicts import JudgedEpisode
    from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict

OUR_FIXTURES = "pytest_dura.plugin.fixtures"


def check_passed(
    session: DuraSession,
    item: pytest.Function,
    used: Mapping[str, UsedEpisodes],
    decided: Collection[tuple[str, str]],
) -> None:
    """Fail a test that passed if the episodes that it looked at do not carry that.

    Args:
        session: The session of this process.
        item: The test.
        used: The episodes that it looked at, by case.
        decided: Requirement and case of the verdicts that it asked for.
    """
    from pytest_dura.campaign.campaigns import Campaign
    from pytest_dura.requirements.verdicts import JudgedEpisode

    for one in used.values():
        if one.failure:
            pytest.fail(one.failure, pytrace=False)
    looked_at = item.funcargs.get("episode")
    if isinstance(looked_at, JudgedEpisode):
        _check_violations(session, item, looked_at)
    for one in used.values():
        if one.cut:
            # What else the test looked at might have come out otherwise.
            told = f"invalid: {one.cut}: it shows a test nothing of what would have followed"
            _undecided(session, f"{told}; run such tests with --dura-end=complete")
    if isinstance(looked_at, JudgedEpisode):
        if looked_at.validity == "invalid":
            _undecided(session, f"invalid: {looked_at.id}: {looked_at.invalid_reason}")
        _check_decided_by_own(session, item, looked_at)
        _check_looked(session, item, looked_at)
    _check_searched(session, used.values())
    campaign = item.funcargs.get("campaign")
    if isinstance(campaign, Campaign):
        _check_decided(session, item, campaign, used, decided)
    if without_verdict(session, item, decided):
        _undecided(session, f"undecided: the test ended without a verdict; {_remedy(item)}")


def without_verdict(
    session: DuraSession, item: pytest.Item, decided: Collection[tuple[str, str]]
) -> bool:
    """Whether a test that asked for episodes came to no verdict, and does not say that it would.

    Args:
        session: The session of this process.
        item: The test, which has run.
        decided: Requirement and case of the verdicts that it asked for.
    """
    asked_for = _asked_for(item)
    if not asked_for or decided or decides_nothing(item):
        return False
    return "episode" not in asked_for or not marked_requirements(session, item)


def _asked_for(item: pytest.Item) -> list[str]:
    """Those of our fixtures that give a test its episodes; others may have some of these names."""
    info = getattr(item, "_fixtureinfo", None)
    known = {} if info is None else info.name2fixturedefs
    return [
        name
        for name in ("episode", "campaign", "run_episode")
        if name in known and _is_ours(name, known[name])
    ]


def _is_ours(name: str, definitions: Sequence[Any]) -> bool:
    """Whether a fixture is ours, or overrides ours and asks for it."""
    for one in reversed(definitions):
        if one.func.__module__ == OUR_FIXTURES:
            return True
        if name not in one.argnames:
            return False
    return False


def _remedy(item: pytest.Item) -> str:
    nothing = "say that it decides nothing: @pytest.mark.dura(..., verdict=False)"
    ways = {
        "episode": 'name what it decides, @pytest.mark.requirement("ID", text="..."), or ',
        "campaign": "call campaign.require(check), or ",
    }
    return ways.get(_asked_for(item)[0], "") + nothing


def _check_violations(session: DuraSession, item: pytest.Function, episode: JudgedEpisode) -> None:
    """A violation by what its requirements say in their files counts, whatever else is amiss.

    One that accepts a rate of violations is decided on all episodes, once they have run.
    """
    for requirement in marked_requirements(session, item):
        judged = judged_by_own_check(requirement, episode)
        if judged is not None and judged.verdict == "violated" and requirement.at_most is None:
            pytest.fail(f"violated: {_told(requirement, judged)}", pytrace=False)


def _check_decided_by_own(
    session: DuraSession, item: pytest.Function, episode: JudgedEpisode
) -> None:
    """A test on an episode passes by what its requirements say in their files, or not at all."""
    for requirement in marked_requirements(session, item):
        judged = judged_by_own_check(requirement, episode)
        if judged is not None and judged.verdict not in ("satisfied", "violated"):
            _undecided(session, f"{judged.verdict}: {_told(requirement, judged)}")


def _check_looked(session: DuraSession, item: pytest.Function, episode: JudgedEpisode) -> None:
    """A test supports by its assertions what it has looked at; of nothing it knows nothing."""
    from pytest_dura.plugin.observed_episode import looks_at

    alone = [
        one.id
        for one in marked_requirements(session, item)
        if judged_by_own_check(one, episode) is None
    ]
    if alone and not looks_at(episode).names:
        _undecided(
            session,
            f"invalid: the test looked at nothing of {episode.id}, so that it decides nothing "
            f"about {', '.join(alone)}; assert something of the episode, such as "
            '`episode.satisfies("always (gap > 0)")`',
        )


def _check_searched(session: DuraSession, used: Iterable[UsedEpisodes]) -> None:
    """A property test passes by at least one case that a strategy chose and that is valid."""
    from pytest_dura.campaign.search.space.searched import SearchedCase

    doubts = [one.doubt for one in used if isinstance(one.case, SearchedCase)]
    if doubts and all(doubts):
        why = str(doubts[0]).partition("(")[2]
        _undecided(session, f"undecided: none of {len(doubts)} cases is valid ({why}")


def _told(requirement: Requirement, judged: EpisodeVerdict) -> str:
    detail = "" if judged.detail == requirement.check else f": {judged.detail}"
    return f"{requirement.id} on {judged.episode}: {requirement.check}{detail}"


def _check_decided(
    session: DuraSession,
    item: pytest.Function,
    campaign: Campaign,
    used: Mapping[str, UsedEpisodes],
    decided: Collection[tuple[str, str]],
) -> None:
    """A test on a campaign that claims to decide a requirement must ask for its verdict."""
    used_here = used.get(campaign.case.id)
    if used_here is not None and used_here.doubt is not None:
        _undecided(session, used_here.doubt)
    if "episode" in item.funcargs:
        return  # it decides them
    claimed = [one.id for one in marked_requirements(session, item)]
    left = [name for name in claimed if (name, campaign.case.id) not in decided]
    if left:
        _undecided(
            session,
            f"undecided: the test never asked for a verdict on {', '.join(left)}; "
            "call campaign.require(check)",
        )


def _undecided(session: DuraSession, message: str) -> NoReturn:
    if session.options.warn_undecided:
        pytest.skip(message)
    pytest.fail(message, pytrace=False)
