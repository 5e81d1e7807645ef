"""Draw cases by choices, the simplest first: what Hypothesis strategies are made of."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.domains import simulator_spec
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.library.fault_campaigns import FaultCampaign
from pytest_dura.library.scenario import check_world, world_checker
from pytest_dura.search.space import (
    SLOT,
    FaultChoice,
    FaultSlot,
    Interval,
    OneOf,
    Parameter,
    SearchSpace,
    digits_of,
)

LEVELS = 3
"""Whole numbers that a value is made of."""

Edges = tuple[float, float]
"""Where a cell begins, which is nearer to the nominal value and no part of it, and its far end."""


class Scale(ABC):
    """The values of one number or one choice."""

    @abstractmethod
    def count(self, *before: int) -> int:
        """How many numbers there are to choose from, at least one, after those chosen before."""

    @abstractmethod
    def value(self, *chosen: int) -> Any:
        """The value of so many numbers; the nominal one if all are 0."""


@dataclass(frozen=True)
class NumberScale(Scale):
    """The numbers of the grid of :mod:`numbers` from ``low`` to ``high``.

    Args:
        low: Least value.
        high: Greatest value.
        nominal: The simplest value; the nearest number within the interval stands for it.
    """

    low: float
    high: float
    nominal: float

    def count(self, *before: int) -> int:
        """Cells on either side of the nominal value, the nearest first; then parts of them."""
        return len(self._parts(before))

    def value(self, *chosen: int) -> float:
        """A number of the grid; the nominal value itself as it was given."""
        return self._parts(chosen[:-1])[chosen[-1]][1]

    @cached_property
    def _known(self) -> dict[tuple[int, ...], list[Edges]]:
        return {}

    def _parts(self, chosen: tuple[int, ...]) -> list[Edges]:
        if chosen not in self._known:
            self._known[chosen] = self._made(chosen)
        return self._known[chosen]

    def _made(self, chosen: tuple[int, ...]) -> list[Edges]:
        if not chosen:
            return self._cells()
        begin, end = self._parts(chosen[:-1])[chosen[-1]]
        if begin == end:
            return [(begin, end)]
        points = self._between(begin, end, LEVELS - 1 - len(chosen))
        *nearer, last = zip([begin, *points], [*points, end], strict=True)
        return [last, *nearer]

    def _cells(self) -> list[Edges]:
        centre = min(max(self.nominal, self.low), self.high)
        edges: list[Edges] = []
        for end in (self.high, self.low):
            points = self._between(centre, end, LEVELS - 1)
            edges += zip([centre, *points], [*points, end], strict=True)
        cells = [edge for edge in edges if edge[0] != edge[1]]
        digits = digits_of(self.low, self.high) + LEVELS

        def distance(cell: Edges) -> float:
            # Without what floats are off by: of two as near, the one above comes first.
            return round(abs(cell[1] - centre), digits)

        return [(centre, centre), *sorted(cells, key=distance)]

    def _between(self, begin: float, end: float, fewer: int) -> list[float]:
        """The numbers between two others that have so many digits less than the grid."""
        digits = digits_of(self.low, self.high) - fewer
        step = 10.0**-digits
        least, greatest = sorted((begin, end))
        numbers = range(math.floor(least / step), math.ceil(greatest / step) + 1)
        points = [round(number * step, digits) for number in numbers]
        points = [point for point in points if least < point < greatest]
        return points if begin < end else points[::-1]


@dataclass(frozen=True)
class WordScale(Scale):
    """Values of no order, each a cell of its own.

    Args:
        values: The values.
        nominal: The simplest of them, if it is one of them.
    """

    values: tuple[Any, ...]
    nominal: Any

    def count(self, *before: int) -> int:
        """All of them, and then nothing more to choose."""
        return 1 if before else len(self.values)

    def value(self, *chosen: int) -> Any:
        """The nominal value first, the others in their order."""
        others = [value for value in self.values if value != self.nominal]
        ordered = [*(value for value in self.values if value == self.nominal), *others]
        return ordered[chosen[0]]


@dataclass(frozen=True)
class Scaled:
    """A parameter as scales, one for each of its numbers.

    Args:
        path: The parameter's name.
        scales: Its scales.
        listed: Whether its value is a list.
    """

    path: str
    scales: tuple[Scale, ...]
    listed: bool = False

    def value(self, chosen: Sequence[Sequence[int]]) -> Any:
        """The value of so many numbers for each scale."""
        found = [scale.value(*item) for scale, item in zip(self.scales, chosen, strict=True)]
        return found if self.listed else found[0]


def scaled(parameter: Parameter) -> Scaled:
    """A parameter as scales.

    Args:
        parameter: An interval, or one of several values.

    Raises:
        TypeError: For any other kind.
    """
    if isinstance(parameter, OneOf):
        return Scaled(parameter.path, (WordScale(parameter.values, parameter.nominal),))
    if not isinstance(parameter, Interval):
        raise TypeError(f"{type(parameter).__name__} is no number and no choice")
    low, high, given = parameter.low, parameter.high, parameter.nominal
    if parameter.pieces is None:
        return Scaled(parameter.path, (NumberScale(low, high, _number(given)),))
    several = isinstance(given, (list, tuple)) and len(given) == parameter.pieces
    nominal = given if several else [given] * parameter.pieces
    scales = tuple(NumberScale(low, high, _number(item)) for item in nominal)
    return Scaled(parameter.path, scales, listed=True)


def _number(value: Any) -> float:
    """The nominal value, or 0 where the scenario has none, or no number."""
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if plain and math.isfinite(value) else 0.0


Keys = tuple[str | int, ...]


@dataclass(frozen=True)
class Omission:
    """A part of a case that may be left out.

    Args:
        path: As a variation would name it, such as ``world.vehicles.0`` or ``faults.delay``.
        keys: Where it is in the world; empty for a fault.
    """

    path: str
    keys: Keys = ()

    def covers(self, path: str) -> bool:
        """Whether a parameter is one of this part."""
        return path.startswith(f"{self.path}.")


def omissions(case: Case, world: Mapping[str, Any]) -> tuple[Omission, ...]:
    """What may be left out of a case: its faults first, then entries of its world.

    Those are entries of lists, such as vehicles, and parts that need not be there, such as random
    traffic; only where the simulator's class has a ``check_scenario`` that accepts the world
    without them.

    Args:
        case: The case.
        world: Its world, defaults filled in.
    """
    faults = [Omission(f"faults.{fault['id']}") for fault in case.faults]
    entry = case.scenario.simulator
    simulator = simulator_spec(entry.path, entry.params)
    if world_checker(simulator) is None:
        return tuple(faults)

    def accepted(keys: Keys) -> bool:
        try:
            found = check_world(case.scenario, simulator, without_omissions(world, [keys]))
        except ConfigurationError:
            return False
        return isinstance(keys[-1], int) or _at(found, keys) is None

    places = [keys for keys in _places(world, ()) if accepted(keys)]
    return (*faults, *(Omission(".".join(map(str, ("world", *place))), place) for place in places))


def without_omissions(world: Mapping[str, Any], places: Iterable[Keys]) -> dict[str, Any]:
    """The world without entries of lists, and with nothing in the place of other parts."""
    without: Any = world
    # From the last to the first, so that no place shifts another.
    for keys in sorted(places, key=lambda keys: [str(key).zfill(9) for key in keys], reverse=True):
        without = _without(without, keys)
    return dict(without)


def _without(data: Any, keys: Sequence[str | int]) -> Any:
    key, *rest = keys
    if isinstance(data, Mapping):
        return {**data, key: _without(data[key], rest) if rest else None}
    assert isinstance(key, int)
    items = list(data)
    items[key : key + 1] = [_without(items[key], rest)] if rest else []
    return items


def _places(data: Any, keys: Keys) -> Iterator[Keys]:
    """Entries of lists of mappings, and mappings within mappings; not what is within entries."""
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield (*keys, key)
            yield from _places(value, (*keys, key))
        elif isinstance(value, (list, tuple)) and all(isinstance(item, Mapping) for item in value):
            for number in range(len(value)):
                yield (*keys, key, number)


def _at(data: Any, keys: Keys) -> Any:
    for key in keys:
        data = data[key]
    return data


Pick = Callable[[int], int]
"""Of so many, the number of one from 0, which is the simplest."""

SEEDS = 10_000
"""Seeds that an episode may have."""
OMISSION_ODDS = 8
"""Once in so many times a part of the case is left out."""

_NOTHING = WordScale((None,), None)
"""In the place of a number that has no meaning: there is one value to choose."""
_NO_PARAMETER = Scaled("", (_NOTHING,))
_STAGES = ("activation.at", "duration", "")
"""What is chosen of a fault, one after the other; the last stands for all the rest."""


@dataclass(frozen=True)
class Slots:
    """Room for faults that are added.

    Args:
        choices: The faults.
        at_least: How many there are at least.
        at_most: How many there are at most.
    """

    choices: tuple[FaultChoice, ...] = ()
    at_least: int = 0
    at_most: int = 0

    def chosen(self, pick: Pick) -> Iterator[bool]:
        """Whether there is a fault in each slot."""
        for number in range(self.at_most):
            needed = number < self.at_least
            yield pick(1 if needed else 2) == 1 or needed

    def kinds(self, pick: Pick, chosen: Sequence[bool]) -> list[int | None]:
        """The number of the fault in each slot."""
        numbers = [pick(len(self.choices) if there else 1) for there in chosen]
        return [number if there else None for number, there in zip(numbers, chosen, strict=True)]

    def parameters(self, kinds: Sequence[int | None]) -> Iterator[tuple[int, Scaled]]:
        """The parameters of each fault with the number of its slot; equally many in any case."""
        for of_choices in self._stages:
            width = max(map(len, of_choices), default=0)
            for slot, kind in enumerate(kinds):
                inner = () if kind is None else of_choices[kind]
                for item in (*inner, *(_NO_PARAMETER,) * (width - len(inner))):
                    yield slot, item

    @cached_property
    def _stages(self) -> list[list[list[Scaled]]]:
        """For each stage, and each of the choices, its parameters."""

        def stage(parameter: Parameter) -> str:
            return parameter.path if parameter.path in _STAGES else _STAGES[-1]

        return [
            [[scaled(item) for item in kind.inner if stage(item) == name] for kind in self.choices]
            for name in _STAGES
        ]


@dataclass(frozen=True)
class CaseDrawing:
    """What may be chosen of a case.

    Args:
        space: The case, and what it varies.
        varied: The parameters of the case itself.
        slots: Room for more faults.
        omissions: What may be left out.
    """

    space: SearchSpace
    varied: tuple[Scaled, ...]
    slots: Slots
    omissions: tuple[Omission, ...]

    @classmethod
    def of(
        cls,
        case: Case,
        faults: Sequence[FaultCampaign] = (),
        *,
        at_least: int = 0,
        at_most: int = 1,
        leave_out: bool = True,
    ) -> CaseDrawing:
        """What the case's scenario varies, faults that may be added, and what may be left out.

        Args:
            case: The case.
            faults: Faults that may be added.
            at_least: How many of them there are at least.
            at_most: How many of them there are at most.
            leave_out: Whether anything may be left out.

        Raises:
            ConfigurationError: For faults that cannot be used, and numbers that are none.
        """
        if not 0 <= at_least <= at_most or (at_most and not faults and at_least):
            raise ConfigurationError(
                "so many faults cannot be drawn",
                key="at_most",
                found=f"at least {at_least}, at most {at_most}, of {len(faults)} given",
                expected="0 <= at_least <= at_most, and faults to choose from",
            )
        scenario = case.scenario
        simulator = simulator_spec(scenario.simulator.path, scenario.simulator.params)
        if scenario.variation or (faults and at_most):
            space = SearchSpace.of(case, faults, at_most=at_most)
        else:  # the seed alone, and what may be left out
            space = SearchSpace(case, (), check_world(scenario, simulator, scenario.world))
        slots = [parameter for parameter in space.parameters if isinstance(parameter, FaultSlot)]
        return cls(
            space,
            tuple(
                scaled(parameter)
                for parameter in space.parameters
                if not isinstance(parameter, FaultSlot)
            ),
            Slots(slots[0].choices, at_least, at_most) if slots else Slots(),
            omissions(case, space.world) if leave_out else (),
        )

    def draw(self, pick: Pick) -> SearchedCase:
        """A case.

        Args:
            pick: Makes the choices. It is called equally often for all of them.

        Raises:
            ConfigurationError: If what was chosen contradicts itself.
        """
        there = list(self.slots.chosen(pick))
        left_out = [omission for omission in self.omissions if pick(OMISSION_ODDS) == 0]
        kinds = self.slots.kinds(pick, there)
        of_faults = list(self.slots.parameters(kinds))
        of_case = [_unless(item, left_out) for item in self.varied]
        values = _values([*(item for _, item in of_faults), *of_case], pick)
        found: dict[str, Any] = {}
        for slot, kind in enumerate(kinds):
            inner = zip(of_faults, values, strict=False)
            own = {item.path: value for (number, item), value in inner if number == slot}
            fault = None if kind is None else self.slots.choices[kind].made(own)
            found[f"{SLOT}{slot + 1}"] = fault
        for entry, value in zip(of_case, values[len(of_faults) :], strict=True):
            if entry.path:
                found[entry.path] = value
        return self._reduced(self.space.made(found, pick(SEEDS)), left_out)

    def _reduced(self, case: SearchedCase, left_out: Sequence[Omission]) -> SearchedCase:
        """The case without what is left out, its world checked."""
        scenario, seed = case.scenario, case.scenario.seed
        simulator = simulator_spec(scenario.simulator.path, scenario.simulator.params)
        world = without_omissions(
            scenario.world, [omission.keys for omission in left_out if omission.keys]
        )
        check_world(scenario, simulator, world)
        if not left_out:
            return case
        assert seed is not None
        gone = {omission.path for omission in left_out}
        faults = [fault for fault in case.faults if f"faults.{fault['id']}" not in gone]
        return make_searched_case(self.space.case, world, faults, seed)


def _unless(item: Scaled, left_out: Sequence[Omission]) -> Scaled:
    if any(part.covers(item.path) for part in left_out):
        return Scaled("", (_NOTHING,) * len(item.scales))
    return item


def _values(parameters: Sequence[Scaled], pick: Pick) -> list[Any]:
    """How far each is from its simplest value first, then in how many digits."""
    chosen: list[list[list[int]]] = [[[] for _ in parameter.scales] for parameter in parameters]
    for _ in range(LEVELS):
        for item, numbers in zip(parameters, chosen, strict=True):
            for scale, before in zip(item.scales, numbers, strict=True):
                before.append(pick(scale.count(*before)))
    return [parameter.value(numbers) for parameter, numbers in zip(parameters, chosen, strict=True)]
