"""Bounds, sequential tests and comparisons of the rate at which episodes violate a requirement."""

from __future__ import annotations

from pytest_dura.requirements.statistics.comparison import (
    Comparison,
    ComparisonStatus,
    compare_counts,
    compare_pairs,
    comparison_status,
    holm,
    mcnemar,
    mcnemar_one_sided,
)
from pytest_dura.requirements.statistics.rate_tests import (
    EXACT_METHOD,
    METHODS,
    EProcess,
    FixedN,
    Sprt,
    lower_bound,
    make_test,
    runs_needed,
    upper_bound,
)
from pytest_dura.requirements.statistics.sequential import (
    Boundaries,
    Characteristics,
    Decision,
    SequentialTest,
    operating_characteristics,
    simulate,
)

__all__ = [
    "EXACT_METHOD",
    "METHODS",
    "Boundaries",
    "Characteristics",
    "Comparison",
    "ComparisonStatus",
    "Decision",
    "EProcess",
    "FixedN",
    "SequentialTest",
    "Sprt",
    "compare_counts",
    "compare_pairs",
    "comparison_status",
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
