"""Activation: when a fault becomes active, and who says so."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.parts import FaultPart, NotNegative, Positive, RefusedError, Share

TOLERANCE = 1e-9
"""s; two simulated times nearer than this are the same."""


class After(FaultPart):
    """Another fault of the same campaign whose event activates this one."""

    fault: str = Field(min_length=1, description="Id of the other fault.")
    event: Literal["activated", "manifested", "deactivated"] = Field(
        "activated",
        description="`manifested`: a value that the component read, or the command, was changed.",
    )
    delay: NotNegative = Field(
        0.0, description="Seconds from that event; at 0 it is the tick that follows."
    )


class Activation(FaultPart):
    """When a fault becomes active, and who says so.

    One of ``at``, ``when``, ``probability``, ``rate`` and ``after`` says when. All of them are
    decided on the channels as they are without any fault, so that faults do not shift each other.
    What falls due while the fault is active is lost. ``when`` activates it where its condition
    begins to hold within the window, and again only after it has not held.

    Attacks that the SecurityAssessor directs are decided on what that role perceives, and on the
    component's proposal: a fault on a sensor begins at the next percept.
    """

    at: NotNegative | None = Field(None, description="Simulated time of the activation, in s.")
    every: Positive | None = Field(None, description="With `at`: again after this period, in s.")
    when: str | None = Field(
        None,
        description="A condition on the channels, such as `odometry.speed > 5`; for the"
        " `security_assessor` also on the proposal: `proposal.acceleration > 1`.",
    )
    probability: Share | None = Field(
        None, description="Of an activation at each tick at which it is inactive."
    )
    rate: Positive | None = Field(
        None, description="Activations per second while inactive (a Poisson process), in 1/s."
    )
    after: After | None = Field(None, description="An event of another fault.")
    not_before: NotNegative = Field(
        0.0, description="Earliest time of `when`, `probability` and `rate`, in s."
    )
    not_after: Positive | None = Field(
        None, description="Latest time of `when`, `probability` and `rate`, in s."
    )
    times: Annotated[int, Field(ge=1)] | None = Field(
        None,
        description="At most so often, however it is activated. Default: once for `at`, `when` and"
        " `after`, else no limit.",
    )
    by: Literal["fault_injector", "security_assessor"] = Field(
        "fault_injector",
        description="Planned in the injector, or an attack that the SecurityAssessor directs.",
    )

    @field_validator("when")
    @classmethod
    def _condition(cls, text: str | None) -> str | None:
        if text is not None:
            parse_condition(text)
        return text

    @model_validator(mode="after")
    def _one_of_them(self) -> Activation:
        given = [name for name in TRIGGERS if getattr(self, name) is not None]
        directed = self.by == "security_assessor"
        if len(given) > 1:
            raise RefusedError(
                f"{' and '.join(given)} contradict each other",
                f"only one of {', '.join(TRIGGERS)}",
                "keep one of them; a window is given by not_before and not_after",
            )
        if not given and not directed:
            raise RefusedError(
                "nothing activates it",
                f"one of {', '.join(TRIGGERS)}",
                "add one of them, such as `at: 2.0`",
            )
        if directed:
            self._check_directed(given)
        self._check_repetition()
        self._check_window(given)
        return self

    def _check_directed(self, given: list[str]) -> None:
        if given and given[0] in ("probability", "rate"):
            raise RefusedError(
                f"the security_assessor does not direct by {given[0]!r}",
                "`at`, `when`, `after`, or nothing, which leaves it to that role",
                f"remove {given[0]!r}, or leave the fault to the fault_injector",
            )
        if self.after is not None and self.after.event == "manifested":
            raise RefusedError(
                "the security_assessor does not see whether a fault manifested",
                "the event `activated` or `deactivated`",
                "wait for another event, or leave the fault to the fault_injector",
            )

    def _check_repetition(self) -> None:
        if self.every is not None and self.at is None:
            raise RefusedError("`every` repeats `at`, which is not given", "`at` beside `every`")
        if self.at is not None and self.every is None and (self.times or 1) > 1:
            raise RefusedError(
                f"`at` alone happens once, not {self.times} times",
                "`every` beside `at` and `times`",
                "add `every`, or remove `times`",
            )

    def _check_window(self, given: list[str]) -> None:
        if self.not_after is not None and self.not_after < self.not_before:
            raise RefusedError(
                f"the window is empty: not_after ({self.not_after:g} s) is before not_before"
                f" ({self.not_before:g} s)",
                "not_before <= not_after",
                "exchange them, or remove one",
            )
        windowed = given and given[0] in ("when", "probability", "rate")
        if not windowed and (self.not_after is not None or self.not_before):
            raise RefusedError(
                f"a window does not bound {given[0] if given else 'a directive'!r}",
                "not_before and not_after beside `when`, `probability` or `rate`",
                "remove the window",
            )

    @property
    def by_chance(self) -> bool:
        """Whether it is drawn whether the fault becomes active at all."""
        drawn = self.probability is not None and 0.0 < self.probability < 1.0
        return drawn or self.rate is not None

    @property
    def limit(self) -> int | None:
        """The greatest number of activations; ``None`` for no limit."""
        if self.times is not None:
            return self.times
        repeated = self.every is not None or self.probability is not None or self.rate is not None
        triggered = self.when is not None or self.after is not None
        directed = self.by == "security_assessor" and not triggered
        return None if repeated or directed else 1

    @property
    def directed(self) -> bool:
        """Whether the SecurityAssessor, not the injector, decides when it begins."""
        return self.by == "security_assessor"

    def due(self, time: float, since: float) -> bool:
        """Whether an activation by ``at`` and ``every`` falls into ``(since, time]``."""
        return self.next_planned(since) <= time + TOLERANCE

    def next_planned(self, since: float) -> float:
        """The first time after ``since`` of an activation by ``at`` and ``every``; or infinity."""
        if self.at is None:
            return math.inf
        if since < self.at - TOLERANCE:
            return self.at
        if self.every is None:
            return math.inf
        passed = math.floor((since - self.at + TOLERANCE) / self.every)
        return self.at + (max(passed, 0) + 1) * self.every


TRIGGERS = ("at", "when", "probability", "rate", "after")


def planned_at(activation: Any) -> float | None:
    """The planned time of an activation in plain data, if it has one."""
    return (activation or {}).get("at")
