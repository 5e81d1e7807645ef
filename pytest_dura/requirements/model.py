"""Requirement: what the component must do, as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

from pytest_dura.core.codec import LEFT_OUT, Confidence, Number, PositiveNumber, Share
from pytest_dura.core.display import Shown, short_repr
from pytest_dura.core.errors import ConfigurationError

Kind = Literal["safety", "security", "performance", "recovery"]
KINDS: tuple[str, ...] = get_args(Kind)

Method = Literal["fixed", "sprt", "e-process"]
FAULTS = "faults"
"""What stands for all faults of a case in :class:`Paired`."""
METHODS: tuple[str, ...] = get_args(Method)


@dataclass(frozen=True, slots=True)
class Paired:
    """A requirement on pairs: the same seeds with something and without it.

    Without a ``measure``, a pair violates the requirement if its check is violated with it and
    satisfied without it. With one, a pair does if the measure grows by more than
    ``change_at_most``. With a ``reference``, the second run of each pair is that of another
    component, which nothing overrules. With both, for recovery: of the violations without it that
    the reference avoids, it prevents each, or all but a share.
    """

    without: str = ""
    """`faults`, or the role that is switched off in the second run of each pair; empty with a
    reference."""
    measure: str = ""
    """Import path `package.module:function` of a function of an episode to a number; empty where
    the check is compared."""
    change_at_most: Number | None = None
    """Greatest acceptable growth of the measure, in its unit."""
    reference: str = ""
    """Registered name or import path of the component that takes the place of the component under
    test in the second run of each pair, where recovery does not act; empty without one."""

    __repr__ = short_repr

    @property
    def prevents(self) -> bool:
        """Whether a role has to prevent what a reference avoids, so that there are three runs."""
        return bool(self.without and self.reference)

    @property
    def sides(self) -> str:
        """What the runs of a pair are, in words."""
        if self.prevents:
            return f"with {self.without}, without, and with {self.reference} as the component"
        if self.reference:
            return f"the component, and {self.reference} in its place"
        return f"with {self.without}, and without"


@dataclass(frozen=True, slots=True)
class Requirement(Shown):
    """One requirement.

    Args:
        id: Unique name, such as ``SAF-1``.
        text: What is required, in words.
        kind: The kind of dependability it belongs to.
        source: Where it comes from: a standard, a hazard analysis, a contract.
        check: Formula over signals that an episode must satisfy, or the import path
            ``package.module:function`` of a function of the episode; empty where test code checks.
        reason: Why the bound is what it is.
        at_most: Greatest acceptable rate of episodes that violate it; ``None`` accepts none.
        confidence: One-sided confidence of the bound on that rate.
        method: How a rate is decided; by default ``fixed`` for a fixed number of runs and
            ``e-process`` for runs until it is decided.
        p0: For ``sprt``, the rate below ``at_most`` up to which a component is rarely rejected.
        applies_to: Globs of the scenarios to which it applies besides those that name it.
        paired: What the second run of each pair lacks, for a requirement on pairs.
        mitigates: Ids of the hazards that meeting it mitigates.
        scale: Of signals of its check, how much of each counts as one unit of importance: a search
            compares margins in these.
    """

    id: str
    text: str = ""
    kind: Kind = "safety"
    source: str = ""
    check: str = ""
    reason: str = ""
    at_most: Share | None = None
    confidence: Confidence = 0.95
    method: Method | None = None
    p0: Share | None = None
    applies_to: tuple[str, ...] = ()
    paired: Paired | None = None
    mitigates: tuple[str, ...] = ()
    scale: Mapping[str, PositiveNumber] = field(default_factory=dict, hash=False, metadata=LEFT_OUT)

    __repr__ = short_repr

    @property
    def judges_crashes(self) -> bool:
        """Whether it sees the crash of a run, and not only how two runs differ.

        One that is compared with a reference does: what the reference has as well is counted apart.
        """
        paired = self.paired
        return paired is None or (bool(paired.reference) and not paired.without)

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "requirement", self.id
        yield "text", self.text
        yield "kind", self.kind
        yield "check", describe_check(self)
        yield "reason", self.reason
        yield "source", self.source


def describe_check(requirement: Requirement) -> list[str]:
    """Lines that say what is judged and how."""
    lines = [requirement.check or "decided by test code"]
    paired = requirement.paired
    if paired is not None and paired.measure:
        lines = [f"{paired.measure} grows by at most {paired.change_at_most:g}"]
    if paired is not None:
        lines.append(f"on pairs of runs: {paired.sides}")
    if requirement.at_most is not None:
        method = f" by {requirement.method}" if requirement.method else ""
        lines.append(
            f"violated in at most {requirement.at_most:g} of the episodes, "
            f"at {requirement.confidence:g} confidence{method}"
        )
    if requirement.applies_to:
        lines.append(f"applies to {', '.join(requirement.applies_to)}")
    if requirement.scale:
        units = ", ".join(f"{name} {amount:g}" for name, amount in requirement.scale.items())
        lines.append(f"one unit of importance: {units}")
    if requirement.mitigates:
        lines.append(f"mitigates {', '.join(requirement.mitigates)}")
    return lines


_NUMERIC_FIELDS = ("at_most", "confidence", "p0")


def requirement_of_call(
    own: Requirement, known: Mapping[str, Requirement], given: Mapping[str, Any]
) -> Requirement:
    """The requirement with the fields that a call gives in addition.

    Args:
        own: The requirement in the test's marker, or one made for the call.
        known: The requirements of the files. One of these means the same wherever it is decided:
            the call may repeat what its file says of check, rate and pairs, and change none of it.
        given: Fields of :class:`Requirement` that the call gives; ``None`` where it does not.

    Raises:
        ConfigurationError: For a value that is not the file's, and one that is not a finite number.
    """
    values: dict[str, Any] = {
        key: finite_number(key, value) if key in _NUMERIC_FIELDS else value
        for key, value in given.items()
        if value is not None
    }
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


def finite_number(key: str, value: Any) -> float:
    """A number as Python's own, since the record is JSON.

    Raises:
        ConfigurationError: For what is not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ConfigurationError(
            f"{key} is a finite number", key=key, found=value, remedy=f"correct {key}"
        )
    return number
