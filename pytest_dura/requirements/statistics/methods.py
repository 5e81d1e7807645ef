"""A sequential test by the name of its method."""

from __future__ import annotations

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.statistics.eprocess import EProcess
from pytest_dura.requirements.statistics.fixed import FixedN
from pytest_dura.requirements.statistics.sequential import (
    SequentialTest,
    error_level,
    require_between,
)
from pytest_dura.requirements.statistics.sprt import Sprt

METHODS = ("fixed", "sprt", "e-process")
"""The names that :func:`make_test` knows."""


def make_test(
    method: str,
    limit: float,
    confidence: float = 0.95,
    p0: float | None = None,
    planned: int | None = None,
) -> SequentialTest:
    """A new test of "the rate of violations is at most ``limit``", with no episode counted.

    Args:
        method: ``fixed``, ``sprt`` or ``e-process``.
        limit: Greatest acceptable rate.
        confidence: One minus the level of each wrong decision; above one half, below which a
            confidence claims nothing and the inversion of the e-process is not an interval.
        p0: For ``sprt`` alone, which needs it: a rate below ``limit`` that ought to pass.
        planned: Needed by ``fixed``: the number of episodes. The others take it and need none;
            a campaign that ends before they decide is undecided.

    Raises:
        ConfigurationError: For an unknown method, a limit outside (0, 1), a confidence outside
            (0.5, 1), and a ``p0`` or a number of episodes that is missing or makes no sense.
    """
    if method not in METHODS:
        raise ConfigurationError(
            "there is no such method of testing a rate",
            key="method",
            found=method,
            expected=", ".join(METHODS),
        )
    require_between("limit", limit, 0.0, 1.0)
    require_between("confidence", confidence, 0.5, 1.0)
    _check_planned(method, planned)
    if method == "sprt":
        if p0 is None:
            raise ConfigurationError(
                "a SPRT needs a rate at which the component ought to pass",
                key="p0",
                expected=f"a rate between 0 and the limit {limit:g}, both excluded",
                remedy="declare p0 before the campaign, or take the method e-process",
            )
        return Sprt(limit, p0, alpha=error_level(confidence))
    if p0 is not None:
        raise ConfigurationError(
            f"the method {method} has no second rate",
            key="p0",
            found=p0,
            remedy="leave p0 out, or take the method sprt",
        )
    if method == "e-process":
        return EProcess(limit, confidence)
    assert planned is not None
    return FixedN(limit, confidence, planned)


def _check_planned(method: str, planned: int | None) -> None:
    if (planned is None and method == "fixed") or (planned is not None and planned < 1):
        raise ConfigurationError(
            f"the method {method} cannot plan this number of episodes",
            key="planned",
            found=planned,
            expected="a whole number of 1 or more",
        )
