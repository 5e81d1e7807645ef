"""What a driving component tells of its decisions, as far as it makes sense.

An account is never trusted: what has another type than it should is not there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pytest_dura.core.accounts import DECIDED
from pytest_dura.driving.maneuvers import Maneuver

ANSWERED = "answered"
INTENTS = {"slow_down": -1, "hold": 0, "speed_up": 1}
"""What a component says that it wants, and the sign of the change of speed."""
FAILURE_CLASSES = (
    "unavailable", "timeout", "empty", "refused", "truncated", "malformed", "schema_violation",
    "unknown_action",
)  # fmt: skip
"""Ways in which no decision came of an answer."""
UNREACHED = ("unavailable", "timeout")
"""Those of them that need not be the doing of who answers."""
AGAIN = re.compile(r"again(_\d+)?")
"""Variants that ask the very same once more."""
_GREATEST = 1e6
"""m/s2, either way."""
_MANEUVERS = {one.value: one for one in Maneuver}
_Value = TypeVar("_Value")


@dataclass(frozen=True)
class Told:
    """One decision.

    Without an answer of its own, a component has no intent, maneuver or citation.

    Args:
        tick: At which it came into force.
        at: Tick of the percept behind it.
        outcome: ``answered``, or one of :data:`FAILURE_CLASSES`.
        answered: Whether the component decided itself.
        perceived: Ids of what it was shown.
        cited: Ids of the objects that it calls threats.
        intent: Sign of the change of speed that it says it wants.
        maneuver: What it decided.
        beside: What it decided in variants of the request, where it did.
        failed: The failure class of each variant in which it did not.
        replaced: Decisions of the same tick that this one took the place of, such as a refused one.
    """

    tick: int
    at: int | None
    outcome: str | None
    answered: bool
    perceived: frozenset[str] | None
    cited: frozenset[str] | None
    intent: int | None
    maneuver: Maneuver | None
    beside: Mapping[str, Maneuver]
    failed: Mapping[str, str]
    replaced: tuple[Told, ...] = ()

    def differs(self, variant: str) -> bool | None:
        """Whether a variant led it to another maneuver, or to an answer that is no decision.

        ``None`` if that is not known: it did not decide, was not asked, or could not be reached.
        """
        if self.maneuver is None:
            return None
        if variant in self.beside:
            return self.beside[variant] is not self.maneuver
        return None if self.failed.get(variant, UNREACHED[0]) in UNREACHED else True

    @property
    def unstable(self) -> bool | None:
        """Whether it decided otherwise when it was asked the very same."""
        again = [name for name in (*self.beside, *self.failed) if AGAIN.fullmatch(name)]
        known = [one for one in map(self.differs, again) if one is not None]
        return any(known) if known else None


def told_decisions(accounts: Sequence[Mapping[str, Any]]) -> list[Told]:
    """The decisions that were made anew, in their order."""
    return [
        _told(account, tick)
        for tick, account in enumerate(accounts)
        if account.get(DECIDED) is True
    ]


def accelerations(accounts: Sequence[Mapping[str, Any]]) -> list[float | None]:
    """The accelerations in m/s2 that proposals ask for beside their maneuver, where they do."""
    return [_number(account.get("acceleration")) for account in accounts]


def _number(told: Any) -> float | None:
    if isinstance(told, bool) or not isinstance(told, (int, float)):
        return None
    # No ego comes near the ends, beyond which a whole number need not be a float.
    return float(told) if -_GREATEST <= told <= _GREATEST else None


def _told(account: Mapping[str, Any], tick: int) -> Told:
    at = account.get("at")
    is_known = isinstance(at, int) and not isinstance(at, bool) and 0 <= at <= tick
    outcome = account.get("outcome")
    answered = _answered(account) and account.get("fallback") is not True
    beside = account.get("beside")
    return Told(
        tick=tick,
        at=at if is_known else None,
        outcome=outcome if outcome in (ANSWERED, *FAILURE_CLASSES) else None,
        answered=answered,
        perceived=_ids(account.get("perceived")),
        cited=_ids(account.get("cited")) if answered else None,
        intent=_known(INTENTS, account.get("intent")) if answered else None,
        maneuver=_maneuver(account) if answered else None,
        beside=_beside(beside) if isinstance(beside, Mapping) else {},
        failed=_failed(beside) if isinstance(beside, Mapping) else {},
        replaced=_replaced(account.get("replaced"), tick),
    )


def _replaced(told: Any, tick: int) -> tuple[Told, ...]:
    if not isinstance(told, (list, tuple)):
        return ()
    return tuple(_told(one, tick) for one in told if isinstance(one, Mapping))


def _failed(told: Mapping[str, Any]) -> dict[str, str]:
    outcomes = {name: one.get("outcome") for name, one in told.items() if isinstance(one, Mapping)}
    return {name: one for name, one in outcomes.items() if one in FAILURE_CLASSES}


def _beside(told: Mapping[str, Any]) -> dict[str, Maneuver]:
    found = {}
    for name, one in told.items():
        if isinstance(one, Mapping) and _answered(one):
            maneuver = _maneuver(one)
            if maneuver is not None:
                found[name] = maneuver
    return found


def _answered(told: Mapping[str, Any]) -> bool:
    """Whether the decision is the component's own; one that cannot fail tells no outcome."""
    return bool(told.get("outcome", ANSWERED) == ANSWERED and _maneuver(told) is not None)


def _maneuver(told: Mapping[str, Any]) -> Maneuver | None:
    return _known(_MANEUVERS, told.get("maneuver"))


def _known(words: Mapping[str, _Value], word: Any) -> _Value | None:
    return words.get(word) if isinstance(word, str) else None


def _ids(told: Any) -> frozenset[str] | None:
    if not isinstance(told, (list, tuple)) or not all(isinstance(one, str) for one in told):
        return None
    return frozenset(told)
