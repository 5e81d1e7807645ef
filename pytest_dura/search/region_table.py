"""Table of the regions in which a search's violations lie."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pytest_dura.core.codec import decode
from pytest_dura.evidence import ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, RecordHead
from pytest_dura.search.region_data import (
    CONFIDENCE,
    FRONT,
    NAME,
    Bound,
    Example,
    Mass,
    Region,
    TradeOff,
)

_MOST_BOUNDS = 4


def regions_of(head: RecordHead) -> list[Region]:
    """Read the regions of a record, in their order."""
    facts = [fact for fact in head.facts or () if fact.table == NAME]
    return [decode(Region, dict(fact.data)) for fact in facts]


class FailureRegions(Table):
    """One row for each region, and one for the whole space of each search."""

    name = NAME
    title = "Where failures lie"
    about = (
        "Boxes in which points of a search violate. The probability is that of a violation there, "
        "under the declared ranges and choices, with added faults drawn evenly. It rests on new "
        "points, drawn evenly within the box, whose own probability is known (importance sampling; "
        "plain Monte Carlo for the whole space): an exact "
        f"{100 * CONFIDENCE:.0f} % interval for each row by itself, part of no verdict"
    )
    columns = (
        ConcludedColumn("region"),
        ConcludedColumn("where"),
        ConcludedColumn("what", "the part that is violated, and how the runs ended"),
        ConcludedColumn("violations", "of the search's points within"),
        ConcludedColumn("new", "violating ones of the new points"),
        ConcludedColumn("probability", "with its interval"),
        ConcludedColumn("example", "made simpler; `pytest NAME` runs it"),
    )
    detail = True

    def add(self, episode: EpisodeEntry) -> None:
        """Add nothing: episodes of a search are in no record."""

    def rows(self) -> Iterable[Sequence[CellValue]]:
        """Yield a row for each region."""
        regions = regions_of(self.head)
        several = len({region.component for region in regions}) > 1
        for number, region in numbered(regions):
            yield (
                region_name(number, region, several=several),
                where_text(region),
                region.event or "any",
                f"{region.violating} of {region.inside}",
                None if region.mass is None else drawn_text(region.mass),
                None if region.mass is None else probability_text(region.mass),
                None if region.example is None else example_text(region.example),
            )


class ParetoFront(Table):
    """One row for each point that no other beats by every margin."""

    name = FRONT
    title = "Trade-offs between requirements"
    about = (
        "Points of a search of several requirements of which no other is worse by one margin and "
        "not better by any (the Pareto front), from the least margin of the first requirement on"
    )
    columns = (
        ConcludedColumn("point"),
        ConcludedColumn("margins", "by requirement; below 0 it is violated"),
        ConcludedColumn("where", "the values of the parameters"),
    )
    detail = True

    def add(self, episode: EpisodeEntry) -> None:
        """Add nothing: episodes of a search are in no record."""

    def rows(self) -> Iterable[Sequence[CellValue]]:
        """Yield a row for each point."""
        facts = [fact for fact in self.head.facts or () if fact.table == FRONT]
        for fact in facts:
            point = decode(TradeOff, dict(fact.data))
            margins = ", ".join(f"{name} {margin:.4g}" for name, margin in point.margins.items())
            where = "; ".join(f"{path}: {value}" for path, value in point.values.items())
            yield fact.about, margins, where


def numbered(regions: Sequence[Region]) -> Iterable[tuple[int, Region]]:
    """Yield each region with its number among those of its search and requirement, from 1."""
    counts: dict[tuple[str, str, str], int] = {}
    for region in regions:
        key = (region.case, region.component, region.requirement)
        counts[key] = counts.get(key, 0) + 1
        yield counts[key], region


def region_name(number: int, region: Region, *, several: bool = False) -> str:
    """Name a region: ``SAF-1 on a/b: 2``; of several components with that of the component."""
    by = f" ({region.component})" if several else ""
    return f"{region.requirement} on {region.case}{by}: {number if region.event else 'all'}"


def where_text(region: Region) -> str:
    """Say what a region bounds: ``fault: freeze; ego.speed 8.2 to 12 m/s``."""
    more = len(region.bounds) - _MOST_BOUNDS
    texts = [*region.options, *map(bound_text, region.bounds[:_MOST_BOUNDS])]
    texts += [f"and {more} more"] if more > 0 else []
    return "; ".join(texts) or "everywhere"


def bound_text(bound: Bound) -> str:
    """Say what is bounded of a number."""
    axis = bound.axis
    if axis.choices:
        count = len(axis.choices)
        first = min(int(bound.low * count), count - 1)
        last = max(min(int(bound.high * count - 1e-9), count - 1), first)
        return f"{axis.name}: {' or '.join(axis.choices[first : last + 1])}"
    unit = f" {axis.unit}" if axis.unit not in ("", "1") else ""
    if bound.low <= axis.low:
        return f"{axis.name} at most {bound.high:g}{unit}"
    if bound.high >= axis.high:
        return f"{axis.name} at least {bound.low:g}{unit}"
    return f"{axis.name} {bound.low:g} to {bound.high:g}{unit}"


def drawn_text(mass: Mass) -> str:
    """Say what was drawn: ``47 of 50, 1 undecided``."""
    text = f"{mass.violated} of {mass.runs}"
    return f"{text}, {mass.unknown} undecided" if mass.unknown else text


def probability_text(mass: Mass) -> str:
    """Say how probable a violation is: ``0.012 (0.0098 to 0.013)``."""
    return f"{mass.estimate:.2g} ({mass.low:.2g} to {mass.high:.2g})"


def example_text(example: Example) -> str:
    """Name an example, and say how simple it was made and whether its replay was equal."""
    again = "replayed" if example.confirmed else "not repeatable"
    return f"{example.name or example.case} ({again})"
