from .events import (
    EpisodeUsed,
    EventStream,
    FactEstablished,
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
    "FactEstablished",
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
