from .detector_training import Training, train
from .falsification import (
    Falsification,
    FoundCounterexample,
    Limits,
    ParameterChange,
    ReplayCount,
    SearcherReport,
    SearchOutcome,
    Shrinking,
    SpaceCoverage,
)
from .fault_tracing import CausalChain
from .reduction import Reduction, reduce_faults
from .reporting import CampaignProgress, RunningCampaign

__all__ = [
    "CampaignProgress",
    "CausalChain",
    "Falsification",
    "FoundCounterexample",
    "Limits",
    "ParameterChange",
    "Reduction",
    "ReplayCount",
    "RunningCampaign",
    "SearchOutcome",
    "SearcherReport",
    "Shrinking",
    "SpaceCoverage",
    "Training",
    "reduce_faults",
    "train",
]
