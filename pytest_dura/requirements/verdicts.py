"""The public names for judging: verdicts on episodes and on campaigns."""

from __future__ import annotations

from pytest_dura.requirements.campaigns import Bound, CampaignVerdict, Counterexample, Margins
from pytest_dura.requirements.episodes import EpisodeVerdict, JudgedEpisode, judge_episode
from pytest_dura.requirements.judging import CampaignJudge, judge_campaign

__all__ = [
    "Bound",
    "CampaignJudge",
    "CampaignVerdict",
    "Counterexample",
    "EpisodeVerdict",
    "JudgedEpisode",
    "Margins",
    "judge_campaign",
    "judge_episode",
]
