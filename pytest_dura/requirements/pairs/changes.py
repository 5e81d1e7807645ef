"""Change: by how much a measure differs between episodes and their twins that lack something."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Change:
    """The change of a measure in each pair: its value with it less its value without it.

    A pair has a change only if both of its runs have a finite value. Which pairs do not, and why,
    is kept: an attack after which the car never clears the junction gives no clearance time, and a
    mean over the other pairs alone would hide exactly that.

    Args:
        measure: Name of the measure.
        pairs: Id of each pair.
        values: The change in each pair, in the measure's unit; ``None`` where there is none.
        lost: Ids of pairs with a value only without it.
        gained: Ids of pairs with a value only with it.
        valueless: Ids of pairs that were measured and have no value in either run.
        incomplete: Ids of pairs of which a run is invalid or missing.
    """

    measure: str
    pairs: tuple[str, ...]
    values: tuple[float | None, ...]
    lost: tuple[str, ...] = ()
    gained: tuple[str, ...] = ()
    valueless: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    @classmethod
    def between(
        cls, measure: str, sides: Mapping[str, tuple[float | None, float | None]]
    ) -> Change:
        """From the values with it and without it, by id of the pair.

        Args:
            measure: Name of the measure.
            sides: ``(with it, without it)``. ``None`` is a run that was not measured: it is
                invalid or missing. NaN, or an infinite number, is a run that has no value.
        """
        kinds: dict[str, list[str]] = {}
        values: list[float | None] = []
        for pair, (own, twin) in sides.items():
            kind, value = _compare(own, twin)
            kinds.setdefault(kind, []).append(pair)
            values.append(value)
        groups = {kind: tuple(ids) for kind, ids in kinds.items() if kind != "changed"}
        return cls(measure, tuple(sides), tuple(values), **groups)

    @property
    def changes(self) -> list[float]:
        """The changes there are."""
        return [value for value in self.values if value is not None]

    @property
    def n(self) -> int:
        """Pairs that have a change."""
        return len(self.changes)

    @property
    def mean(self) -> float | None:
        """Over the pairs that have one."""
        return statistics.fmean(self.changes) if self.n else None

    @property
    def median(self) -> float | None:
        """Over the pairs that have one."""
        return statistics.median(self.changes) if self.n else None

    @property
    def greatest(self) -> tuple[str, float] | None:
        """The pair in which the measure grew most, the first of equals, and by how much."""
        return max(self._changed(), key=_by_change, default=None)

    @property
    def least(self) -> tuple[str, float] | None:
        """The pair in which it grew least or shrank most; the worst for, say, a smallest gap."""
        return min(self._changed(), key=_by_change, default=None)

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the exact sign test, against "growing is as likely as shrinking".

        Pairs without a change, and those in which nothing changed, do not count; 1 without others.
        """
        from pytest_dura.requirements.statistics import mcnemar

        # The same binomial distribution with probability 1/2.
        return mcnemar(sum(one > 0 for one in self.changes), sum(one < 0 for one in self.changes))

    def _changed(self) -> list[tuple[str, float]]:
        found = zip(self.pairs, self.values, strict=True)
        return [(pair, value) for pair, value in found if value is not None]

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record: the changes, and the summary."""
        greatest, least = self.greatest, self.least
        data: dict[str, Any] = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
        }
        return data | {
            "n": self.n,
            "mean": self.mean,
            "median": self.median,
            "max": greatest[1] if greatest else None,
            "max_pair": greatest[0] if greatest else None,
            "min": least[1] if least else None,
            "min_pair": least[0] if least else None,
            "p_value": self.p_value,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Change:
        """The inverse of :meth:`to_json`."""
        ids = {name: tuple(data[name]) for name in ("lost", "gained", "valueless", "incomplete")}
        return cls(data["measure"], tuple(data["pairs"]), tuple(data["values"]), **ids)


def _by_change(changed: tuple[str, float]) -> float:
    return changed[1]


def _compare(own: float | None, twin: float | None) -> tuple[str, float | None]:
    if own is None or twin is None:
        return "incomplete", None
    has_own, has_twin = math.isfinite(own), math.isfinite(twin)
    if has_own and has_twin:
        return "changed", own - twin
    if has_twin:
        return "lost", None
    return ("gained" if has_own else "valueless"), None
