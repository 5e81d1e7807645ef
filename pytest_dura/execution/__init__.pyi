from .address import address_of, describe_machine
from .cache import EPISODE, EpisodeCache
from .codec import pack
from .executors import IN_FLIGHT, Execution, ExecutorChoice
from .processes import MAX_STARTS, ProcessPool
from .replies import CallFailedError, ProcessLostError
from .sources import SourceRules, Sources
from .store import EpisodeStore
from .task import EpisodeTask, missing_episode, run_episode

__all__ = [
    "EPISODE",
    "IN_FLIGHT",
    "MAX_STARTS",
    "CallFailedError",
    "EpisodeCache",
    "EpisodeStore",
    "EpisodeTask",
    "Execution",
    "ExecutorChoice",
    "ProcessLostError",
    "ProcessPool",
    "SourceRules",
    "Sources",
    "address_of",
    "describe_machine",
    "missing_episode",
    "pack",
    "run_episode",
]
