from .address import Addresses, describe_machine
from .cache import CLAIM, EPISODE, EpisodeCache, prune, read_age, read_size
from .codec import pack
from .executors import IN_FLIGHT, Execution, ExecutorChoice
from .processes import MAX_STARTS, ProcessPool
from .store import EpisodeStore
from .task import EpisodeTask, missing_episode, run_episode
from .worker import CallFailedError, ProcessLostError

__all__ = [
    "CLAIM",
    "EPISODE",
    "IN_FLIGHT",
    "MAX_STARTS",
    "Addresses",
    "CallFailedError",
    "EpisodeCache",
    "EpisodeStore",
    "EpisodeTask",
    "Execution",
    "ExecutorChoice",
    "ProcessLostError",
    "ProcessPool",
    "describe_machine",
    "missing_episode",
    "pack",
    "prune",
    "read_age",
    "read_size",
    "run_episode",
]
