from .events import (
    EpisodeUsed,
    EventStream,
    FaultsTraced,
    MonitorsMeasured,
    Progress,
    RunningCampaign,
    SearchedEpisodeUsed,
    SearchEnded,
    SessionEvent,
    VerdictReached,
)
from .falsification import (
    Limits,
)

__all__ = [
    "EpisodeUsed",
    "EventStream",
    "FaultsTraced",
    "Limits",
    "MonitorsMeasured",
    "Progress",
    "RunningCampaign",
    "SearchEnded",
    "SearchedEpisodeUsed",
    "SessionEvent",
    "VerdictReached",
]
