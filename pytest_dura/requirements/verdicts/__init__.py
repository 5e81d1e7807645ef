"""The public names for judging: verdicts on episodes and on campaigns."""

from __future__ import annotations

from pytest_dura.requirements.verdicts.campaigns import (
    Bound,
    CampaignVerdict,
    Counterexample,
    Margins,
)
from pytest_dura.requirements.verdicts.episodes import (
    EpisodeVerdict,
    JudgedEpisode,
    SearchedEpisode,
    SearchVerdict,
    judge_episode,
    judge_searched,
)
from pytest_dura.requirements.verdicts.judging import CampaignJudge, judge_campaign

__all__ = [
    "Bound",
    "CampaignJudge",
    "CampaignVerdict",
    "Counterexample",
    "EpisodeVerdict",
    "JudgedEpisode",
    "Margins",
    "SearchVerdict",
    "SearchedEpisode",
    "judge_campaign",
    "judge_episode",
    "judge_searched",
]
