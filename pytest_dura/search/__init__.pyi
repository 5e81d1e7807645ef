from .counterexamples import write_counterexample
from .drawing import CaseDrawing
from .falsify import falsify_case
from .portfolio import Batch, Outcome, Portfolio, search, trivial_searchers
from .searchers import Pulses
from .shrinking import Reduction, minimise, reduce_faults, shrink
from .simplification import changes_of, count_parameters, simpler_values
from .space import Group, Layout, SearchSpace, on_grid
from .splitting import RareRate, Splitting
from .trials import Objective, Trials

__all__ = [
    "Batch",
    "CaseDrawing",
    "Group",
    "Layout",
    "Objective",
    "Outcome",
    "Portfolio",
    "Pulses",
    "RareRate",
    "Reduction",
    "SearchSpace",
    "Splitting",
    "Trials",
    "changes_of",
    "count_parameters",
    "falsify_case",
    "minimise",
    "on_grid",
    "reduce_faults",
    "search",
    "shrink",
    "simpler_values",
    "trivial_searchers",
    "write_counterexample",
]
