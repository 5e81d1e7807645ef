"""Regions and trade-offs as data: what searches find, and tables and maps show.

Every session has those tables, and few search: nothing here imports the search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

NAME = "failure_regions"
"""Of the table of regions, and of the facts that it is concluded from."""
CONFIDENCE = 0.95
"""Two-sided, of each interval."""
FRONT = "pareto_front"
"""Of the table of trade-offs, and of the facts that it is concluded from."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A number of a case: a coordinate in its own unit.

    Args:
        name: Its path.
        low: Least value.
        high: Greatest value.
        unit: Of both; empty where none is declared.
        choices: Values of equal parts of the range, where it stands for a choice.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    choices: tuple[str, ...] = ()

    def value(self, coordinate: float) -> float:
        """Return the number at a coordinate in [0, 1], to five digits."""
        return float(f"{self.low + coordinate * (self.high - self.low):.5g}")


@dataclass(frozen=True, slots=True)
class Bound:
    """What a region bounds.

    Args:
        axis: The number.
        low: Its least value in the region.
        high: Its greatest value in the region.
    """

    axis: Axis
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Mass:
    """The probability of a violation in a region, from points of its own.

    Points are drawn evenly from a part of the space whose own probability is known: for the whole
    space that is plain Monte Carlo, for a box importance sampling with one weight. So the interval
    of the share of violations, which is exact (Clopper and Pearson, 1934), is one of the product.

    Args:
        volume: Probability of the box under the declared distributions.
        runs: Points that were drawn in it.
        violated: Those that violate the requirement.
        unknown: Those that decide nothing; each may be a violation.
    """

    volume: float
    runs: int
    violated: int
    unknown: int

    @property
    def low(self) -> float:
        """Lower end of the interval of the probability of a violation in the region."""
        return self.volume * lower_bound(self.violated, self.runs, (1.0 + CONFIDENCE) / 2.0)

    @property
    def high(self) -> float:
        """Upper end of that interval."""
        most = self.violated + self.unknown
        return self.volume * upper_bound(most, self.runs, (1.0 + CONFIDENCE) / 2.0)

    @property
    def estimate(self) -> float:
        """The estimated probability."""
        return self.volume * (self.violated / self.runs)


@dataclass(frozen=True, slots=True)
class Example:
    """A violating case of a region, made as simple as possible within it.

    Args:
        case: Id of the searched case.
        seed: Of its episode.
        margin: Robustness; ``None`` for a check that gives none.
        confirmed: Whether its replay was equal, and violated.
        name: Of the scenario that keeps it; empty where none does.
        before: Parameters that differed from the case as it stands.
        after: Those that still do.
    """

    case: str
    seed: int
    margin: float | None
    confirmed: bool
    name: str = ""
    before: int | None = None
    after: int | None = None


@dataclass(frozen=True, slots=True)
class Map:
    """Points over the two numbers that tell most.

    Args:
        x: The one that tells most.
        y: The next one; ``None`` where there is one alone, and margins take its place.
        violating: Places of violating points.
        others: Places of points that do not violate, those with the least margins.
    """

    x: Axis
    y: Axis | None
    violating: tuple[tuple[float, float], ...]
    others: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Region:
    """Where a requirement is violated on a case.

    Args:
        case: Id of the case.
        component: Name of the component under test.
        requirement: Id of the requirement.
        event: What happened: the part of the check that is violated, and how the episodes ended;
            empty for the whole space.
        options: What is chosen in it of options, such as the faults.
        bounds: What it bounds of numbers; empty for nothing.
        inside: Points of the search within.
        violating: Those of them that violate with this event.
        kept: All violating points of the requirement that the search kept.
        mass: How probable a violation there is; ``None`` where nothing was drawn.
        example: A violating case of it; ``None`` for the whole space.
        map: Its map; ``None`` without a number.
    """

    case: str
    component: str
    requirement: str
    event: str
    options: tuple[str, ...]
    bounds: tuple[Bound, ...]
    inside: int
    violating: int
    kept: int
    mass: Mass | None = None
    example: Example | None = None
    map: Map | None = None


@dataclass(frozen=True, slots=True)
class TradeOff:
    """A point of which no other of its search is worse by one margin, and not better by any.

    Args:
        case: Id of the case.
        component: Name of the component under test.
        margins: By requirement.
        values: What is chosen there, by parameter, as texts.
    """

    case: str
    component: str
    margins: Mapping[str, float]
    values: Mapping[str, str]
