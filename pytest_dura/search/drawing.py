"""Draw cases from whole numbers, 0 the simplest: the base of the Hypothesis strategies."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.library.fault_campaigns import FaultCampaign
from pytest_dura.library.scenario import check_world, world_checker
from pytest_dura.search.simplification import ABSENT, Keys, value_at, with_values
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
"""Whole numbers that a value is drawn from."""

Edges = tuple[float, float]
"""A cell: the end nearer to the nominal value, which is no part of it, and the far end."""


class Scale(ABC):
    """The values of one number or one choice."""

    @abstractmethod
    def count(self, *before: int) -> int:
        """Return how many numbers there are to choose from, at least 1, after earlier choices."""

    @abstractmethod
    def value(self, *chosen: int) -> Any:
        """Return the value of the chosen numbers; the nominal one if all are 0."""


@dataclass(frozen=True)
class NumberScale(Scale):
    """Numbers of the grid over an interval, see :func:`pytest_dura.search.space.on_grid`.

    Args:
        low: Least value.
        high: Greatest value.
        nominal: The simplest value; the nearest number within the interval stands for it.
    """

    low: float
    high: float
    nominal: float

    def count(self, *before: int) -> int:
        """Count the cells on either side of the nominal value, the nearest first; then parts."""
        return len(self._parts(before))

    def value(self, *chosen: int) -> float:
        """Return a number of the grid, or the nominal value as it was given."""
        return self._parts(chosen[:-1])[chosen[-1]][1]

    def _parts(self, chosen: tuple[int, ...]) -> list[Edges]:
        if not chosen:
            return self._cells
        begin, end = self._parts(chosen[:-1])[chosen[-1]]
        if begin == end:
            return [(begin, end)]
        points = self._between(begin, end, LEVELS - 1 - len(chosen))
        *nearer, last = zip([begin, *points], [*points, end], strict=True)
        return [last, *nearer]

    @cached_property
    def _cells(self) -> list[Edges]:
        centre = min(max(self.nominal, self.low), self.high)
        edges: list[Edges] = []
        for end in (self.high, self.low):
            points = self._between(centre, end, LEVELS - 1)
            edges += zip([centre, *points], [*points, end], strict=True)
        cells = [edge for edge in edges if edge[0] != edge[1]]
        digits = digits_of(self.low, self.high) + LEVELS

        def distance(cell: Edges) -> float:
            # Without rounding errors: of two cells as near, the one above comes first.
            return round(abs(cell[1] - centre), digits)

        return [(centre, centre), *sorted(cells, key=distance)]

    def _between(self, begin: float, end: float, fewer: int) -> list[float]:
        """List the numbers between two others that have so many digits fewer than the grid."""
        digits = digits_of(self.low, self.high) - fewer
        step = 10.0**-digits
        least, greatest = sorted((begin, end))
        numbers = range(math.floor(least / step), math.ceil(greatest / step) + 1)
        points = [round(number * step, digits) for number in numbers]
        points = [point for point in points if least < point < greatest]
        return points if begin < end else points[::-1]


@dataclass(frozen=True)
class ChoiceScale(Scale):
    """Unordered values, each a cell of its own.

    Args:
        values: The values.
        nominal: The simplest value; it need not be among them.
    """

    values: tuple[Any, ...]
    nominal: Any

    def count(self, *before: int) -> int:
        """Return the number of values, then 1."""
        return 1 if before else len(self.values)

    def value(self, *chosen: int) -> Any:
        """Return a value; the nominal one is first, the others follow in their order."""
        others = [value for value in self.values if value != self.nominal]
        ordered = [*(value for value in self.values if value == self.nominal), *others]
        return ordered[chosen[0]]


@dataclass(frozen=True)
class Scaled:
    """A parameter with a scale for each of its numbers.

    Args:
        path: The parameter's name.
        scales: Its scales.
        listed: Whether its value is a list.
    """

    path: str
    scales: tuple[Scale, ...]
    listed: bool = False

    def value(self, chosen: Sequence[Sequence[int]]) -> Any:
        """Return the value of the numbers chosen for each scale."""
        values = [scale.value(*each) for scale, each in zip(self.scales, chosen, strict=True)]
        return values if self.listed else values[0]


def scaled(parameter: Parameter) -> Scaled:
    """Make the scales of a parameter.

    Args:
        parameter: An interval, or one of several values.

    Raises:
        TypeError: For any other kind.
    """
    if isinstance(parameter, OneOf):
        return Scaled(parameter.path, (ChoiceScale(parameter.values, parameter.nominal),))
    if not isinstance(parameter, Interval):
        raise TypeError(f"{type(parameter).__name__} is no number and no choice")
    low, high, given = parameter.low, parameter.high, parameter.nominal
    if parameter.pieces is None:
        return Scaled(parameter.path, (NumberScale(low, high, _number(given)),))
    listed = isinstance(given, (list, tuple)) and len(given) == parameter.pieces
    nominal = given if listed else [given] * parameter.pieces
    scales = tuple(NumberScale(low, high, _number(value)) for value in nominal)
    return Scaled(parameter.path, scales, listed=True)


def _number(value: Any) -> float:
    """Return the nominal value, or 0 where the scenario has none, or no number."""
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if plain and math.isfinite(value) else 0.0


@dataclass(frozen=True)
class Omission:
    """A part of a case that may be left out.

    Args:
        path: Path of a variation, such as ``world.vehicles.0`` or ``faults.delay``.
        keys: Its place in the world; empty for a fault.
    """

    path: str
    keys: Keys = ()

    def covers(self, path: str) -> bool:
        """Whether a parameter belongs to this part."""
        return path.startswith(f"{self.path}.")


def omissions(case: Case, world: Mapping[str, Any]) -> tuple[Omission, ...]:
    """List what may be left out of a case: its faults first, then parts of its world.

    These are entries of lists, such as vehicles, and optional parts, such as random traffic; only
    where the simulator's class has a ``check_scenario`` that accepts the world without them.

    Args:
        case: The case.
        world: Its world, defaults filled in.
    """
    faults = [Omission(f"faults.{fault.id}") for fault in case.faults]
    simulator = case.scenario.simulator_spec()
    if world_checker(case.scenario, simulator) is None:
        return tuple(faults)

    def accepted(keys: Keys) -> bool:
        try:
            reduced = check_world(case.scenario, simulator, without_omissions(world, [keys]))
        except ConfigurationError:
            return False
        return isinstance(keys[-1], int) or value_at(reduced, keys) is None

    places = [keys for keys in _places(world, ()) if accepted(keys)]
    return (*faults, *(Omission(".".join(map(str, ("world", *place))), place) for place in places))


def without_omissions(world: Mapping[str, Any], places: Iterable[Keys]) -> dict[str, Any]:
    """Copy the world without some entries of lists, and with ``None`` for other parts."""
    edits = [(keys, ABSENT if isinstance(keys[-1], int) else None) for keys in places]
    return dict(with_values(world, edits))


def _places(data: Any, keys: Keys) -> Iterator[Keys]:
    """Yield places of entries of lists of mappings, and of mappings, not within entries."""
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield (*keys, key)
            yield from _places(value, (*keys, key))
        elif isinstance(value, (list, tuple)) and all(isinstance(each, Mapping) for each in value):
            for number in range(len(value)):
                yield (*keys, key, number)


Pick = Callable[[int], int]
"""Chooses one of so many numbers from 0, which is the simplest."""

SEEDS = 10_000
"""Number of seeds that may be drawn."""
OMISSION_ODDS = 8
"""A part of the case is left out once in so many times."""

_NOTHING = ChoiceScale((None,), None)
"""Stands for a number without a meaning: it has one value."""
_NO_PARAMETER = Scaled("", (_NOTHING,))
_STAGES = ("activation.at", "duration", "")
"""Parameters of a fault in the order of their choice; the last stands for all others."""


@dataclass(frozen=True)
class Slots:
    """The faults that are added.

    Args:
        choices: The faults to choose from.
        at_least: Least number of faults.
        at_most: Greatest number of faults.
    """

    choices: tuple[FaultChoice, ...] = ()
    at_least: int = 0
    at_most: int = 0

    def occupied(self, pick: Pick) -> Iterator[bool]:
        """Choose for each slot whether it has a fault."""
        for number in range(self.at_most):
            needed = number < self.at_least
            yield pick(1 if needed else 2) == 1 or needed

    def kinds(self, pick: Pick, occupied: Sequence[bool]) -> list[int | None]:
        """Choose the fault in each slot, as its place in ``choices``; ``None`` for no fault."""
        numbers = [pick(len(self.choices) if fault else 1) for fault in occupied]
        return [number if fault else None for number, fault in zip(numbers, occupied, strict=True)]

    def parameters(self, kinds: Sequence[int | None]) -> Iterator[tuple[int, Scaled]]:
        """Yield each fault's parameters with the number of its slot; always equally many."""
        for of_choices in self._stages:
            width = max(map(len, of_choices), default=0)
            for slot, kind in enumerate(kinds):
                inner = () if kind is None else of_choices[kind]
                for parameter in (*inner, *(_NO_PARAMETER,) * (width - len(inner))):
                    yield slot, parameter

    @cached_property
    def _stages(self) -> list[list[list[Scaled]]]:
        """The parameters of each choice, for each stage."""

        def stage(parameter: Parameter) -> str:
            return parameter.path if parameter.path in _STAGES else _STAGES[-1]

        return [
            [[scaled(each) for each in kind.inner if stage(each) == name] for kind in self.choices]
            for name in _STAGES
        ]


@dataclass(frozen=True)
class CaseDrawing:
    """Draws cases.

    Args:
        space: The case and its parameters.
        varied: The parameters of the case itself.
        slots: The faults that are added.
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
        """Take what the case's scenario varies, faults to add, and what may be left out.

        Args:
            case: The case.
            faults: Faults that may be added.
            at_least: Least number of added faults.
            at_most: Greatest number of added faults.
            leave_out: Whether anything may be left out.

        Raises:
            ConfigurationError: For faults that cannot be used, and impossible numbers of them.
        """
        if not 0 <= at_least <= at_most or (at_most and not faults and at_least):
            raise ConfigurationError(
                "so many faults cannot be drawn",
                key="at_most",
                found=f"at least {at_least}, at most {at_most}, of {len(faults)} given",
                expected="0 <= at_least <= at_most, and faults to choose from",
            )
        scenario = case.scenario
        simulator = scenario.simulator_spec()
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
        """Draw a case.

        Args:
            pick: Makes the choices; it is called equally often for every case.

        Raises:
            ConfigurationError: If the chosen values contradict each other.
        """
        occupied = list(self.slots.occupied(pick))
        left_out = [omission for omission in self.omissions if pick(OMISSION_ODDS) == 0]
        kinds = self.slots.kinds(pick, occupied)
        of_faults = list(self.slots.parameters(kinds))
        of_case = [_unless_left_out(parameter, left_out) for parameter in self.varied]
        drawn = _draw_values([*(parameter for _, parameter in of_faults), *of_case], pick)
        values: dict[str, Any] = {}
        for slot, kind in enumerate(kinds):
            inner = zip(of_faults, drawn, strict=False)
            own = {parameter.path: value for (number, parameter), value in inner if number == slot}
            fault = None if kind is None else self.slots.choices[kind].fault_with(own)
            values[f"{SLOT}{slot + 1}"] = fault
        for parameter, value in zip(of_case, drawn[len(of_faults) :], strict=True):
            if parameter.path:
                values[parameter.path] = value
        return self._reduced(self.space.case_with(values, pick(SEEDS)), left_out)

    def _reduced(self, case: SearchedCase, left_out: Sequence[Omission]) -> SearchedCase:
        """Leave parts out of a case, and check its world."""
        scenario, seed = case.scenario, case.scenario.seed
        simulator = scenario.simulator_spec()
        world = without_omissions(
            scenario.world, [omission.keys for omission in left_out if omission.keys]
        )
        check_world(scenario, simulator, world)
        if not left_out:
            return case
        assert seed is not None
        paths = {omission.path for omission in left_out}
        faults = [fault.plain() for fault in case.faults if f"faults.{fault.id}" not in paths]
        return make_searched_case(self.space.case, world, faults, seed)


def _unless_left_out(parameter: Scaled, left_out: Sequence[Omission]) -> Scaled:
    if any(part.covers(parameter.path) for part in left_out):
        return Scaled("", (_NOTHING,) * len(parameter.scales))
    return parameter


def _draw_values(parameters: Sequence[Scaled], pick: Pick) -> list[Any]:
    """Choose each value's distance from its simplest value first, then its digits."""
    chosen: list[list[list[int]]] = [[[] for _ in parameter.scales] for parameter in parameters]
    for _ in range(LEVELS):
        for parameter, numbers in zip(parameters, chosen, strict=True):
            for scale, before in zip(parameter.scales, numbers, strict=True):
                before.append(pick(scale.count(*before)))
    return [parameter.value(numbers) for parameter, numbers in zip(parameters, chosen, strict=True)]
