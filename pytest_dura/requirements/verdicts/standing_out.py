"""Which episodes of a campaign, and which faults, stand out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pytest_dura.requirements.verdicts.campaigns import Counterexample, Spoilt
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict


def idle(verdicts: Sequence[EpisodeVerdict]) -> list[str]:
    """The planned faults that manifested in none of the episodes: nothing is known of them."""
    if not verdicts:
        return []
    return [name for name in verdicts[0].idle if all(name in one.idle for one in verdicts)]


def first_spoilt(verdicts: Sequence[EpisodeVerdict]) -> Spoilt | None:
    """The first missing episode, or else the first invalid one, or else the first open one."""
    words: tuple[Literal["missing", "invalid", "open"], ...] = ("missing", "invalid", "open")
    for word in words:
        for one in verdicts:
            if one.verdict == word:
                return Spoilt(one.episode, word, one.detail)
    return None


def counterexamples(judged: Sequence[EpisodeVerdict]) -> tuple[Counterexample, ...]:
    """The violating episodes, the valid ones first, of each kind the largest violation first."""
    violated = [one for one in judged if one.verdict == "violated"]
    violated.sort(
        key=lambda one: (
            one.without_effect,
            one.margin if one.margin is not None else 0.0,
            one.episode,
        )
    )
    return tuple(
        Counterexample(one.episode, one.time, one.margin, not one.without_effect)
        for one in violated
    )
