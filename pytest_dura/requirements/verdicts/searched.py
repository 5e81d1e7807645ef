"""What a requirement says of an episode that a search chose. No rate is made of it.

A search looks where it expects violations, so that its episodes are no sample of anything. They
have types of their own, which neither :func:`judge_episode` nor a campaign takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pytest_dura.requirements.checks import Check
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import EpisodeWord, JudgedEpisode, judged


class SearchedEpisode(JudgedEpisode):
    """An episode that a search or a strategy chose. It answers to formulas, and enters no rate."""

    searched: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class SearchVerdict:
    """What one requirement says of one episode of a search; no :class:`EpisodeVerdict`.

    Args:
        requirement: Id of the requirement.
        episode: Id of the episode.
        word: ``satisfied``, ``violated``, ``open``, ``invalid`` or ``missing``.
        margin: Robustness; ``None`` where there is no trace to measure it on, and for a check that
            gives none.
        time: Seconds at which it was violated first, for a violation.
        detail: Why, in words.
        vacuous: Whether it is satisfied only because its condition never held.
    """

    requirement: str
    episode: str
    word: EpisodeWord
    margin: float | None
    time: float | None
    detail: str
    vacuous: bool = False


def judge_searched(
    requirement: Requirement, episode: SearchedEpisode, check: Check | None = None
) -> SearchVerdict:
    """What a requirement's check says of an episode of a search.

    Args:
        requirement: The requirement.
        episode: The episode.
        check: A check in place of the requirement's own.

    Raises:
        ConfigurationError: If the check cannot be read or imported, or names a signal that the
            episode does not have.
    """
    word, result = judged(requirement.check if check is None else check, episode)
    return SearchVerdict(
        requirement.id,
        episode.id,
        word,
        result.margin,
        result.time if word == "violated" else None,
        result.detail,
        result.vacuous and word == "satisfied",
    )
