"""Limits of a search for violations, and what runs one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.searches import Falsification

BUDGET = 200
SHRINK_BUDGET = 150


@dataclass(frozen=True)
class Limits:
    """Limits of a search.

    Args:
        budget: Simulations of the search.
        shrink: Simulations for making each counterexample simpler; 0 leaves it as it was found.
        at_most: Faults that may be added at once.
        baselines: Whether the trivial searchers are run by themselves beside a claim; only
            benchmarks, which run them in any case, do without.
    """

    budget: int = BUDGET
    shrink: int = SHRINK_BUDGET
    at_most: int = 1
    baselines: bool = True

    def __post_init__(self) -> None:
        """Refuse limits that make no sense.

        Raises:
            ConfigurationError: For a budget that is no whole number, or too small.
        """
        for name, least in (("budget", 1), ("shrink", 0), ("at_most", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ConfigurationError(
                    f"{name} is a whole number of at least {least}",
                    key=name,
                    found=value,
                    expected=f"{least} or more",
                )


Falsifier = Callable[..., Falsification]
