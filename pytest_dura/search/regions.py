"""Regions: where the violations of a search lie, how probable they are, and an example of each.

Violating points are sorted by requirement, by what happened, and by what was chosen of options.
Within each sort boxes are made (:mod:`pytest_dura.search.boxes`). Points of the search do not
estimate a probability: further points are drawn evenly within each box, and in the whole space.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.campaign.events import FactEstablished
from pytest_dura.core.codec import encode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import stream
from pytest_dura.search.boxes import Box, boxes, separation
from pytest_dura.search.counterexamples import (
    CounterexampleStore,
    confirm_violation,
    store_counterexample,
)
from pytest_dura.search.portfolio import Batch, Outcome, finite_or_none
from pytest_dura.search.region_data import (
    FRONT,
    NAME,
    Axis,
    Bound,
    Example,
    Map,
    Mass,
    Region,
    TradeOff,
)
from pytest_dura.search.space import FaultSlot, Interval, OneOf, Parameter, SearchSpace
from pytest_dura.search.trials import Objective, Trials

_MOST_ON_FRONT = 20
"""Points of the front that are shown, evenly along the margins of the first requirement."""
_MOST_BOXES = 3
"""Boxes of one sort of violations."""
_MOST_REGIONS = 6
"""Regions of a requirement."""
_MOST_NEAR = 1000
"""Points that violate nothing and are kept, those of the least margins."""
_MOST_VIOLATING = 2000
"""Violating points that are kept, the first ones."""
_MOST_SHOWN = 150
"""Points of each kind on a map."""
_FIRST_WORLD = 2**40
"""Seeds of further points are numbered from here on: no search comes so far."""


@dataclass(frozen=True, slots=True)
class _Kept:
    """A simulated point; ``events`` says what each violated objective came to, else is empty."""

    point: NDArray[np.float64]
    world: int
    margins: tuple[float, ...]
    events: tuple[str, ...]


class KeptPoints:
    """Violating points of a search and those that nearly violate, a bounded number of them.

    Args:
        objectives: How many objectives there are.
    """

    def __init__(self, objectives: int) -> None:
        self.objectives = objectives
        self.violating: list[_Kept] = []
        self._near: list[tuple[float, int, _Kept]] = []
        self.front: list[_Kept] = []
        """Points of which no other is at least as bad by each margin, and worse by one."""

    def add(self, point: NDArray[np.float64], world: int, outcome: Outcome) -> None:
        """Add a simulated point."""
        kept = _Kept(np.asarray(point), world, outcome.margins, outcome.events)
        if any(outcome.violated):
            self.violating += [kept] * (len(self.violating) < _MOST_VIOLATING)
        elif not all(map(math.isnan, outcome.margins)):
            least = min(margin for margin in outcome.margins if not math.isnan(margin))
            entry = (-least, len(self._near), kept)
            push = heapq.heappush if len(self._near) < _MOST_NEAR else heapq.heappushpop
            push(self._near, entry)
        if self.objectives > 1 and not any(map(math.isnan, outcome.margins)):
            self._add_to_front(kept)

    def _add_to_front(self, kept: _Kept) -> None:
        if not any(_dominates(other, kept) for other in self.front):
            self.front = [other for other in self.front if not _dominates(kept, other)] + [kept]

    @property
    def near(self) -> list[_Kept]:
        """Points that violate nothing, the least margin first."""
        return [kept for *_, kept in sorted(self._near, key=lambda entry: (-entry[0], entry[1]))]


def _dominates(one: _Kept, other: _Kept) -> bool:
    """Whether a point is at least as bad by each margin; of equal ones the first counts."""
    return all(a <= b for a, b in zip(one.margins, other.margins, strict=True))


@dataclass(frozen=True)
class RegionSearch:
    """Finds the regions of a search that has ended.

    Args:
        trials: Runs the episodes.
        kept: Points of the search.
        seed: Of the search.
        runs: Further points of each region and of the whole space; 0 for none.
        shrink: Simulations for making each example simpler.
        store: Keeps the examples.
        on_store_error: Receives the error of an example that cannot be kept; by default it is
            raised.
    """

    trials: Trials
    kept: KeptPoints
    seed: int
    runs: int
    shrink: int
    store: CounterexampleStore | None = None
    on_store_error: Callable[[ConfigurationError], None] | None = None
    _drawn: Iterator[int] = field(default_factory=lambda: itertools.count(_FIRST_WORLD))

    def emit(self) -> None:
        """Emit each region as a fact of the session; the whole space stands behind them."""
        for number, objective in enumerate(self.trials.objectives):
            regions = list(self._regions(number, objective))
            for place, region in enumerate(regions):
                about = f"{region.case} ({region.component}) {region.requirement} {place + 1}"
                fact = FactEstablished(NAME, about, number * 100 + place, encode(region))
                self.trials.runner.events.emit(fact)
        for place, trade_off in enumerate(self._front()):
            about = f"{trade_off.case} ({trade_off.component}) {place + 1}"
            self.trials.runner.events.emit(FactEstablished(FRONT, about, place, encode(trade_off)))

    def _front(self) -> Iterator[TradeOff]:
        """Yield the front, from the least margin of the first requirement on; none of one point."""
        front = sorted(self.kept.front, key=lambda kept: kept.margins)
        step = max(len(front) / _MOST_ON_FRONT, 1.0)
        chosen = [front[int(i * step)] for i in range(min(len(front), _MOST_ON_FRONT))]
        names = [objective.requirement.id for objective in self.trials.objectives]
        space = self.trials.space
        component = space.case.roles(self.trials.runner.roles)["generator"].label
        for kept in chosen if len(front) > 1 else ():
            chosen_options = ", ".join(_options_of(space, kept.point))
            values = {
                path: chosen_options if isinstance(value, dict) else str(value)
                for path, value in space.values(kept.point).items()
            }
            margins = dict(zip(names, map(float, kept.margins), strict=True))
            yield TradeOff(space.case.id, component, margins, values)

    def _regions(self, number: int, objective: Objective) -> Iterator[Region]:
        violating = [kept for kept in self.kept.violating if kept.events[number]]
        if not violating:
            return
        case = self.trials.space.case
        component = case.roles(self.trials.runner.roles)["generator"].label
        common = (case.id, component, objective.requirement.id)
        whole = Box.whole(self.trials.space.layout.size)
        for sort in _sorts(self.trials.space, violating, number)[:_MOST_REGIONS]:
            yield from self._of_sort(common, sort, number, len(violating))
        mass = self._mass(whole, (), number, f"{objective.requirement.id}:whole")
        simulated = len(self.kept.violating) + len(self.kept.near)
        yield Region(*common, "", (), (), simulated, len(violating), len(violating), mass)

    def _of_sort(
        self, common: tuple[str, str, str], sort: _Sort, number: int, all_: int
    ) -> Iterator[Region]:
        space = self.trials.space
        others = [
            kept
            for kept in (*self.kept.violating, *self.kept.near)
            if _options_of(space, kept.point) == sort.options
            and not (kept.events and kept.events[number] == sort.event)
        ]
        points = np.array([kept.point for kept in (*sort.points, *others)])
        hits = np.arange(len(points)) < len(sort.points)
        axes = list(_axes(space, sort.points[0].point))
        columns = [index for index, _ in axes]
        numbers = points[:, columns]
        margins = [kept.margins[number] for kept in (*sort.points, *others)]
        # Of too few points to separate anything, or without a number, the whole sort is a region.
        made = list(boxes(numbers, hits, _MOST_BOXES)) if columns else []
        for place, box in enumerate(made or [Box.whole(len(columns))]):
            inside = box.contains(numbers)
            bounds = tuple(
                Bound(axis, axis.value(box.low[i]), axis.value(box.high[i]))
                for i, (_, axis) in enumerate(axes)
                if box.bounded[i]
            )
            whole = Box.whole(space.layout.size)
            low, high = whole.low.copy(), whole.high.copy()
            low[columns], high[columns] = box.low, box.high
            name = f"{common[2]}:{sort.event}:{'+'.join(sort.options)}:{place}"
            yield Region(
                *common,
                sort.event,
                sort.options,
                bounds,
                int(inside.sum()),
                int((inside & hits).sum()),
                all_,
                self._mass(Box(low, high), sort.options_at, number, name),
                self._example(sort, box, numbers[hits], number),
                _map_of(axes, box, numbers, hits, margins),
            )

    def _mass(
        self, box: Box, options: Sequence[tuple[int, int, int]], number: int, name: str
    ) -> Mass | None:
        """Estimate the probability of a violation in a box by points that are drawn for it."""
        if not self.runs:
            return None
        low, high = box.low.copy(), box.high.copy()
        for index, which, count in options:
            low[index], high[index] = which / count, (which + 1) / count
        part = Box(low, high)
        points = part.draw(stream(self.seed, f"region:{name}"), self.runs)
        worlds = [next(self._drawn) for _ in points]
        violated = unknown = 0
        batch = Batch("region", points, world=worlds[0], spread=True)
        subject = f"region of {self.trials.objectives[number].requirement.id}"
        with self.trials.phase(subject, len(points)) as simulated:
            for outcome in self.trials.evaluate(batch):
                simulated()
                violated += outcome.violated[number]
                known = outcome.known is None or outcome.known[number]
                unknown += outcome.simulated and not (known or outcome.violated[number])
        return Mass(part.volume, len(points), violated, unknown)

    def _example(
        self,
        sort: _Sort,
        box: Box,
        numbers: NDArray[np.float64],
        number: int,
    ) -> Example:
        """Make a violating point in the middle of a region simpler; it stays of its sort."""
        objective = self.trials.objectives[number]
        inside, bounded = box.contains(numbers), box.bounded
        within = np.flatnonzero(inside) if inside.any() else np.arange(len(sort.points))
        middle = (box.low + box.high)[bounded] / 2.0
        reach = np.maximum((box.high - box.low)[bounded], 1e-9)
        distances = np.abs((numbers[within][:, bounded] - middle) / reach).max(axis=1, initial=0.0)
        chosen = sort.points[within[int(np.argmin(distances))]]
        case = self.trials.case(chosen.point.tolist(), chosen.world)
        confirmed = confirm_violation(
            self.trials,
            objective,
            case,
            self.shrink,
            also=lambda episode: self.trials.outcome(episode).events[number] == sort.event,
        )
        found, name = confirmed.counterexample, ""
        if self.store is not None and found.repeats.confirmed:
            try:
                origin = "a search for where failures lie"
                stored = store_counterexample(self.trials, objective, confirmed, self.store, origin)
                name = stored.name or ""
            except ConfigurationError as error:
                if self.on_store_error is None:
                    raise
                self.on_store_error(error)
        shrinking = found.shrinking
        return Example(
            found.case,
            found.seed,
            found.margin,
            found.repeats.confirmed,
            name,
            None if shrinking is None else shrinking.before,
            None if shrinking is None else shrinking.after,
        )


@dataclass(frozen=True)
class _Sort:
    """Violating points of one event and equal options.

    ``options_at`` holds the index, the choice and the number of choices of each option.
    """

    event: str
    options: tuple[str, ...]
    options_at: tuple[tuple[int, int, int], ...]
    points: list[_Kept]


def _sorts(space: SearchSpace, violating: Sequence[_Kept], number: int) -> list[_Sort]:
    """Sort violating points, the sort with the most of them first."""
    sorts: Mapping[Any, list[_Kept]] = defaultdict(list)
    for kept in violating:
        sorts[kept.events[number], _options_of(space, kept.point)].append(kept)
    made = [
        _Sort(event, options, tuple(_options_at(space, points[0].point)), points)
        for (event, options), points in sorts.items()
    ]
    return sorted(made, key=lambda sort: -len(sort.points))


def _options_at(space: SearchSpace, point: NDArray[np.float64]) -> Iterator[tuple[int, int, int]]:
    for group, where in space.layout.slices():
        if group.options:
            which = min(int(point[where.start] * group.options), group.options - 1)
            yield where.start, which, group.options


def _options_of(space: SearchSpace, point: NDArray[np.float64]) -> tuple[str, ...]:
    """Name what a point chooses of options."""
    named = []
    for parameter, start in _starts(space):
        if isinstance(parameter, OneOf):
            named.append(f"{parameter.path}: {parameter.value([point[start]])}")
        elif isinstance(parameter, FaultSlot):
            which = min(int(point[start] * (len(parameter.choices) + 1)), len(parameter.choices))
            fault = parameter.choices[which - 1].fault.id if which else "none"
            named.append(f"fault: {fault}")
    return tuple(named)


def _starts(space: SearchSpace) -> Iterator[tuple[Parameter, int]]:
    """Yield the parameters, each with the index of its first coordinate."""
    start = 0
    for parameter in space.parameters:
        yield parameter, start
        start += sum(group.size for group in parameter.groups)


def _axes(space: SearchSpace, point: NDArray[np.float64]) -> Iterator[tuple[int, Axis]]:
    """Yield the numbers that have a meaning with the options of a point, and their indices."""
    for parameter, start in _starts(space):
        if isinstance(parameter, FaultSlot):
            which = min(int(point[start] * (len(parameter.choices) + 1)), len(parameter.choices))
            if which:
                choice, index = parameter.choices[which - 1], start + 1
                for inner in choice.inner:
                    yield from _axes_of(inner, index, f"{choice.fault.id}.{inner.path}")
                    index += sum(group.size for group in inner.groups)
        elif isinstance(parameter, Interval):
            yield from _axes_of(parameter, start, parameter.path)


def _axes_of(parameter: Parameter, start: int, name: str) -> Iterator[tuple[int, Axis]]:
    if isinstance(parameter, Interval):
        for piece in range(parameter.pieces or 1):
            place = name if parameter.pieces is None else f"{name}[{piece}]"
            yield start + piece, Axis(place, parameter.low, parameter.high, parameter.unit)
    elif isinstance(parameter, OneOf):
        values = tuple(map(str, parameter.values))
        yield start, Axis(name, 0.0, 1.0, "", values)


def _map_of(
    axes: Sequence[tuple[int, Axis]],
    box: Box,
    numbers: NDArray[np.float64],
    hits: NDArray[np.bool_],
    margins: Sequence[float],
) -> Map | None:
    """Draw up the map of the two numbers that separate violations best."""
    if not axes:
        return None
    gains = separation(box, numbers, hits)
    first, *rest = np.argsort(-gains, kind="stable")
    x, y = axes[first][1], axes[rest[0]][1] if rest else None

    def places(wanted: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
        made = []
        for index in np.flatnonzero(wanted)[:_MOST_SHOWN]:
            margin = finite_or_none(margins[index])
            across = margin if y is None else y.value(numbers[index, rest[0]])
            if across is not None:
                made.append((x.value(numbers[index, first]), float(f"{across:.5g}")))
        return tuple(made)

    return Map(x, y, places(hits), places(~hits))
