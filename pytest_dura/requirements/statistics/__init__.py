"""Bounds, sequential tests and comparisons of the rate at which episodes violate a requirement."""

from __future__ import annotations

from pytest_dura.requirements.statistics.characteristics import (
    Boundaries,
    Characteristics,
    operating_characteristics,
    simulate,
)
from pytest_dura.requirements.statistics.comparison import (
    Comparison,
    ComparisonWord,
    compare_counts,
    compare_pairs,
    comparison_word,
    holm,
    mcnemar,
    mcnemar_one_sided,
)
from pytest_dura.requirements.statistics.eprocess import EProcess
from pytest_dura.requirements.statistics.exact import (
    METHOD,
    lower_bound,
    runs_needed,
    upper_bound,
)
from pytest_dura.requirements.statistics.fixed import FixedN
from pytest_dura.requirements.statistics.methods import METHODS, make_test
from pytest_dura.requirements.statistics.sequential import Decision, SequentialTest
from pytest_dura.requirements.statistics.sprt import Sprt

__all__ = [
    "METHOD",
    "METHODS",
    "Boundaries",
    "Characteristics",
    "Comparison",
    "ComparisonWord",
    "Decision",
    "EProcess",
    "FixedN",
    "SequentialTest",
    "Sprt",
    "compare_counts",
    "compare_pairs",
    "comparison_word",
    "holm",
    "lower_bound",
    "make_test",
    "mcnemar",
    "mcnemar_one_sided",
    "operating_characteristics",
    "runs_needed",
    "simulate",
    "upper_bound",
]
