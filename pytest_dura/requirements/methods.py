"""How a requirement's rate is decided: the method that applies, and the sequential test for it."""

from __future__ import annotations

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.statistics import SequentialTest, make_test
from pytest_dura.requirements.verdicts.campaigns import EVERY_EPISODE


def method_of(requirement: Requirement, *, until_decided: bool = False) -> str:
    """How the requirement is decided: ``every episode``, or a method for its rate.

    Raises:
        ConfigurationError: For a method without a rate.
    """
    if requirement.at_most is not None:
        return requirement.method or ("e-process" if until_decided else "fixed")
    for key, value in (("method", requirement.method), ("p0", requirement.p0)):
        if value is not None:
            raise ConfigurationError(
                "a method decides on a rate, and this requirement accepts no violation at all",
                key=key,
                found=value,
                expected="`at_most` with it",
                remedy=f"add `at_most`, or leave `{key}` out",
            )
    return EVERY_EPISODE


def check_share(key: str, value: float, *, above: float) -> None:
    """Refuse a rate or a confidence that makes no sense.

    Raises:
        ConfigurationError: If it does not lie strictly between ``above`` and 1.
    """
    if not above < value < 1.0:
        raise ConfigurationError(
            f"{key} lies strictly between {above:g} and 1",
            key=key,
            found=value,
            expected="a share such as 0.05" if above == 0 else "a share such as 0.95",
            remedy=f"correct {key}",
        )


def rate_test(requirement: Requirement, method: str, planned: int) -> SequentialTest | None:
    """What decides on the requirement's rate; ``None`` where no violation is accepted.

    Raises:
        ConfigurationError: For a method that cannot decide on this rate.
    """
    if requirement.at_most is None:
        return None
    return make_test(
        method, requirement.at_most, requirement.confidence, requirement.p0, max(planned, 1)
    )
