"""Bounds, sequential tests and comparisons of the rate at which episodes violate a requirement."""

from __future__ import annotations

from pytest_dura.requirements.statistics.exact import (
    METHOD,
    lower_bound,
    runs_needed,
    upper_bound,
)

__all__ = ["METHOD", "lower_bound", "runs_needed", "upper_bound"]
