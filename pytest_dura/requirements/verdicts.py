"""The public names for judging: verdicts on episodes and on campaigns."""

from __future__ import annotations

from pytest_dura.requirements.campaigns import (
    Bound,
    CampaignVerdict,
    Counterexample,
    judge_campaign,
)
from pytest_dura.requirements.episodes import EpisodeVerdict, JudgedEpisode, judge_episode

__all__ = [
    "Bound",
    "CampaignVerdict",
    "Counterexample",
    "EpisodeVerdict",
    "JudgedEpisode",
    "judge_campaign",
    "judge_episode",
]
