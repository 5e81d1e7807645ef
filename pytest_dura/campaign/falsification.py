"""Limits of a search for violations, and what runs one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.searches import Falsification

BUDGET = 200
SHRINK_BUDGET = 150
REGION_RUNS = 50


@dataclass(frozen=True)
class Limits:
    """Limits of a search.

    Args:
        budget: Simulations of the search.
        shrink: Simulations for making each counterexample simpler; 0 leaves it as it was found.
        at_most: Faults that may be added at once.
        baselines: Whether the trivial searchers are run by themselves beside a claim; only
            benchmarks, which run them in any case, do without.
        at_least: Violations of each requirement after which the search ends.
        all: Whether the search goes on to the end of its budget.
        region_runs: Further simulations of each region of failures, for its probability; 0 for
            none. Regions are shown where more than one violation is asked for.
        surrogate: Whether a Gaussian process of all values so far takes part, for simulations that
            take much longer than it does.
    """

    budget: int = BUDGET
    shrink: int = SHRINK_BUDGET
    at_most: int = 1
    baselines: bool = True
    at_least: int = 1
    all: bool = False
    region_runs: int = REGION_RUNS
    surrogate: bool = False

    def __post_init__(self) -> None:
        """Refuse limits that make no sense.

        Raises:
            ConfigurationError: For a budget that is no whole number, or too small.
        """
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ConfigurationError(
                    f"{name} is a whole number of at least {least}",
                    key=name,
                    found=value,
                    expected=f"{least} or more",
                )
        if not isinstance(self.all, bool):
            raise ConfigurationError(
                "a search goes on to the end of its budget, or does not",
                key="all",
                found=self.all,
                expected="True or False",
                remedy="give a number of violations as `at_least`",
            )
        if not isinstance(self.surrogate, bool):
            raise ConfigurationError(
                "a surrogate takes part in a search, or does not",
                key="surrogate",
                found=self.surrogate,
                expected="True or False",
            )

    @property
    def regions(self) -> bool:
        """Whether the search goes on after a violation, and shows where failures lie."""
        return self.all or self.at_least > 1


_LEAST = {"budget": 1, "shrink": 0, "at_most": 1, "at_least": 1, "region_runs": 0}
"""Least whole number of each limit."""
Falsifier = Callable[..., Falsification]
