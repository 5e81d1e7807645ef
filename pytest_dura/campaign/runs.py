"""CampaignRuns: the episodes of a campaign in order, and what decides on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.model import Requirement

NUMERIC_FIELDS = ("at_most", "confidence", "p0")


def requirement_of_call(
    own: Requirement, known: Mapping[str, Requirement], given: Mapping[str, Any]
) -> Requirement:
    """The requirement with what a call gives in addition.

    Args:
        own: The requirement in the test's marker, or one made for the call.
        known: The requirements of the files. One of these means the same wherever it is decided:
            the call may repeat what its file says of check, rate and pairs, and change none of it.
        given: Fields of :class:`Requirement` that the call gives, without those it leaves out.

    Raises:
        ConfigurationError: For a value that is not the file's, and a number that is none.
    """
    values = {key: _numeric_value(key, value) for key, value in given.items()}
    if known.get(own.id) != own:
        return replace(own, **values)
    # Without a check in its file, it is test code that says what is checked, and on what.
    decided_by_code = not own.check and own.paired is None
    free = ("check", "paired") if decided_by_code else ()
    for key, value in values.items():
        if key not in free and not _is_same(getattr(own, key), value):
            raise ConfigurationError(
                f"the requirement {own.id!r} is defined in a file, and is decided as it says there",
                key=key,
                found=_for_message(value),
                expected=_for_message(getattr(own, key)),
                remedy=f"leave `{key}` out, or decide a requirement of the test's own: "
                'requirement("OWN-1", text="...")',
            )
    return replace(own, **{key: value for key, value in values.items() if key in free})


def _is_same(own: Any, value: Any) -> bool:
    if isinstance(own, str) and isinstance(value, str):
        return own.split() == value.split()
    return bool(own == value)


def _for_message(value: Any) -> Any:
    if value is None:
        return "none"
    return asdict(value) if hasattr(value, "__dataclass_fields__") else value


def _numeric_value(key: str, value: Any) -> Any:
    return finite_number(key, value) if key in NUMERIC_FIELDS else value


def finite_number(key: str, value: Any) -> float:
    """A number as Python's own, since the record is JSON.

    Raises:
        ConfigurationError: For what is no finite number.
    """
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = math.nan
    if not math.isfinite(found):
        raise ConfigurationError(
            f"{key} is a finite number", key=key, found=value, remedy=f"correct {key}"
        )
    return found
