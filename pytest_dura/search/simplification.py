"""Simplification: a counterexample as choices, each from the simplest to its own value."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.catalogue import BY_CHANCE, fault_class
from pytest_dura.faults.parts import Choices, Span, spans_of
from pytest_dura.library.cases import SearchedCase, make_searched_case
from pytest_dura.library.scenario import Choice, Range
from pytest_dura.search.differences import (
    ABSENT,
    REQUIRED,
    Keys,
    Nominal,
    dotted_path,
    has_entries,
    is_list,
    match_entries,
    value_at,
    with_value,
)

Values = tuple[Any, ...]

_TINY = 1e-6
"""Nothing is gained between numbers below it: they would become smaller without end."""


def simpler_values(value: Any, nominal: Any, limits: tuple[float, float] | None = None) -> Values:
    """From the simplest value to the found one.

    Args:
        value: The found value; plain data.
        nominal: The simplest value.
        limits: What the case allows where rounding leads past the found value; ``None`` where
            nothing is declared.
    """
    if not (_is_number(value) and _is_number(nominal)):
        return _unique([nominal, value])
    if value == nominal:
        return (value,)
    if max(abs(value), abs(nominal)) < _TINY:
        return (nominal, value)
    low, high = (-math.inf, math.inf) if limits is None else limits
    nearer = [item for item, behind in _nearer(value, nominal) if not behind or low <= item <= high]
    if isinstance(value, int) and isinstance(nominal, int):
        nearer = [int(item) for item in nearer if item == int(item)]
    return _unique([nominal, *nearer, value])


def rounded_values(value: Any) -> Values:
    """A number with one to three digits, and as it is; anything else alone."""
    if not _is_number(value) or value == 0:
        return (value,)
    exponent = math.floor(math.log10(abs(value)))
    found = [type(value)(round(float(value), places - exponent)) for places in range(3)]
    return _unique([*found, value])


def _nearer(value: float, nominal: float) -> Iterator[tuple[float, bool]]:
    """Numbers between the two, ever finer ones next to the value, and whether one is behind it."""
    exponent = math.floor(math.log10(max(abs(value), abs(nominal))))
    last, onwards = nominal, 1 if value > nominal else -1
    for parts in (2, 10, 100):
        step = 10.0**exponent / parts
        number = math.floor(onwards * last / step + 1e-9)
        while (
            onwards * (item := round(onwards * (number + 1) * step, 2 - exponent)) < onwards * value
        ):
            if item != last:
                yield item, False
            last, number = item, number + 1
        if item == value:
            return
        if parts > 2:
            yield item, True


def _is_number(value: Any) -> bool:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return plain and math.isfinite(value)


def _unique(values: Iterable[Any]) -> Values:
    found: list[Any] = []
    for value in values:
        if not any(type(value) is type(known) and value == known for known in found):
            found.append(value)
    return tuple(found)


Edit = tuple[Keys, Any]
_RANKS = ("fault", "entry", "part", "begin", "duration", "strength", "world", "seed")
_TIMES: dict[Keys, str] = {("activation", "at"): "begin", ("duration",): "duration"}


@dataclass(frozen=True)
class Knob:
    """One thing that can be made simpler.

    Args:
        rank: What it is, in the order of preference.
        keys: Where it is: ``("world", ...)``, ``("faults", 0, ...)`` or ``("seed",)``.
        values: From the simplest to the found one; ``ABSENT`` leaves it out.
    """

    rank: str
    keys: Keys
    values: Values


@dataclass(frozen=True)
class Simplification:
    """What can be made simpler of a counterexample, and the case that comes of it.

    Args:
        nominal: What it is compared with.
        found: The counterexample.
    """

    nominal: Nominal
    found: SearchedCase

    @cached_property
    def data(self) -> dict[str, Any]:
        """World, faults and seed of what was found."""
        scenario = self.found.scenario
        return {
            "world": self.nominal.checked(scenario.world),
            "faults": [dict(fault) for fault in self.found.faults],
            "seed": scenario.seed or 0,
        }

    @cached_property
    def knobs(self) -> tuple[Knob, ...]:
        """Everything that can be made simpler, in the order of preference."""
        indices = [knob for i in range(len(self.found.faults)) for knob in self._fault(i)]
        indices += self._inside(self.data["world"], self.nominal.world, ())
        indices.append(Knob("seed", ("seed",), _once(self.nominal.seed, self.data["seed"])))
        return tuple(
            sorted(
                (item for item in indices if len(item.values) > 1),
                key=lambda k: _RANKS.index(k.rank),
            )
        )

    def made(self, places: Sequence[int]) -> SearchedCase:
        """The case with each knob at a place of its values.

        Raises:
            ConfigurationError: If the values contradict each other.
        """
        data = self.data
        kept: list[Edit] = []
        gone: list[Edit] = []
        for knob, place in zip(self.knobs, places, strict=True):
            if place < len(knob.values) - 1:
                value = knob.values[place]
                nothing = value is ABSENT or value is None
                (gone if nothing else kept).append((knob.keys, value))
        # What goes goes last, and from the last to the first: places in lists stay what they are.
        for keys, value in (*kept, *sorted(gone, key=lambda edit: _order(edit[0]), reverse=True)):
            data = with_value(data, keys, value)
        world = self.nominal.checked(data["world"])
        return make_searched_case(self.nominal.case, world, data["faults"], data["seed"])

    def _fault(self, index: int) -> Iterator[Knob]:
        fault = self.data["faults"][index]
        place: Keys = ("faults", index)
        yield Knob("fault", place, (ABSENT, fault))
        before, own = self.nominal.fault(fault)
        spans = spans_of(fault_class(fault["type"]))
        for key in fault:
            if key in (BY_CHANCE, "id", "type"):
                continue
            for keys, value, plain in _values(fault[key], before.get(key), (key,)):
                rank = _TIMES.get(keys, "strength")
                if own or isinstance(plain, str) or plain is None:
                    path = f"faults.{fault['id']}.{dotted_path(keys)}"
                    yield Knob(rank, (*place, *keys), self._declared(value, plain, path))
                else:
                    yield Knob(rank, (*place, *keys), self._milder(rank, keys, value, plain, spans))

    def _milder(
        self, rank: str, keys: Keys, value: Any, plain: Any, spans: Mapping[str, Span | Choices]
    ) -> Values:
        """The values of an added fault: later, shorter, of less effect."""
        scenario = self.nominal.case.scenario
        last = scenario.lasts - scenario.time_step
        if rank == "begin":
            # What begins with the last tick has no effect: it is left out instead.
            return simpler_values(value, last, (0.0, last))[1:]
        if rank == "duration":
            return simpler_values(value, scenario.time_step, (scenario.time_step, scenario.lasts))
        span = spans.get(dotted_path(keys))
        if isinstance(span, Span) and isinstance(value, (int, float)):
            return simpler_values(value, type(value)(span.neutral), (span.low, span.high))
        return simpler_values(value, span.values[0] if isinstance(span, Choices) else plain)

    def _inside(
        self, found: Any, nominal: Any, keys: Keys, *, added: bool = False
    ) -> Iterator[Knob]:
        """What can be made simpler of a part of the world."""
        spread = self._spread(f"world.{dotted_path(keys)}")
        if isinstance(spread, Choice) and not has_entries(found):
            yield Knob("world", ("world", *keys), self._choices(found, nominal, keys, spread))
        elif isinstance(found, Mapping):
            yield from self._mapping(found, nominal, keys, added)
        elif has_entries(found):
            for _, index, other in match_entries(found, nominal):
                if index is not None:
                    place: Keys = (*keys, index)
                    yield Knob("entry", ("world", *place), (ABSENT, found[index]))
                    yield from self._inside(found[index], other, place, added=other is ABSENT)
        elif is_list(found) and (
            not is_list(nominal) or len(found) == len(nominal) or isinstance(spread, Range)
        ):
            plain = nominal if is_list(nominal) else [nominal] * len(found)
            plain = plain if len(plain) == len(found) else [None] * len(found)
            for i, (item, other) in enumerate(zip(found, plain, strict=True)):
                yield from self._inside(item, other, (*keys, i), added=added)
        elif found != nominal and not _left_out(found, nominal):
            yield Knob("world", ("world", *keys), self._world_values(found, nominal, keys, added))

    def _mapping(
        self, found: Mapping[str, Any], nominal: Any, keys: Keys, added: bool
    ) -> Iterator[Knob]:
        world = self.data["world"]
        if keys and isinstance(keys[-1], str) and self.nominal.may_be_none(world, keys):
            yield Knob("part", ("world", *keys), (None, found))
        for key in found:
            if not (added and key == "id"):
                other = value_at(nominal, (key,))
                yield from self._inside(found[key], other, (*keys, key), added=added)

    def _world_values(self, found: Any, nominal: Any, keys: Keys, added: bool) -> Values:
        path = f"world.{dotted_path(keys)}"
        if added:
            nominal = self.nominal.default(self.data["world"], keys)
            if nominal is REQUIRED:
                return rounded_values(found)
            if nominal is ABSENT:
                return (ABSENT, *rounded_values(found))
        if nominal is ABSENT or nominal is None:
            # An input that the scenario does not have: the nearer to none, the simpler.
            nominal = type(found)(0) if isinstance(found, (int, float)) else nominal
        return self._declared(found, nominal, path)

    def _declared(self, found: Any, nominal: Any, path: str) -> Values:
        """Simpler values; where the scenario varies the path, only what it may become there."""
        spread = self._spread(path)
        if isinstance(spread, Choice):
            return _before(found, nominal, spread.choice)
        if spread is None:
            return simpler_values(found, nominal)
        if isinstance(nominal, (int, float)):
            nominal = min(max(nominal, spread.min), spread.max)
        return simpler_values(found, nominal, (spread.min, spread.max))

    def _choices(self, found: Any, nominal: Any, keys: Keys, spread: Choice) -> Values:
        """The choices for a part of the world, defaults filled in as in what was found."""
        world, filled = self.data["world"], []
        for item in spread.choice:
            with suppress(ConfigurationError):
                filled.append(value_at(self.nominal.checked(with_value(world, keys, item)), keys))
        return _before(found, nominal, filled)

    def _spread(self, path: str) -> Range | Choice | None:
        """What the scenario declares for a path, or for the list that it is a number of."""
        declared = self.nominal.case.scenario.variation
        outer = declared.get(path.rpartition(".")[0])
        return declared.get(path) or (outer if isinstance(outer, Range) else None)


def _values(found: Any, nominal: Any, keys: Keys) -> Iterator[tuple[Keys, Any, Any]]:
    """What differs, value by value: where, the found one, the other."""
    if (
        isinstance(found, Mapping)
        and isinstance(nominal, Mapping)
        and found.keys() == nominal.keys()
    ):
        for key in found:
            yield from _values(found[key], nominal[key], (*keys, key))
    elif found != nominal:
        yield keys, found, nominal


def _before(found: Any, nominal: Any, choices: Sequence[Any]) -> Values:
    """The nominal value first, if it is one of them, then the others in order up to the found."""
    ordered = [choice for choice in choices if choice == nominal]
    ordered += [choice for choice in choices if choice != nominal]
    return (*takewhile(lambda item: item != found, ordered), found)


def _left_out(found: Any, nominal: Any) -> bool:
    """Whether nothing is left of what the case has: it is not to come back."""
    part = isinstance(nominal, Mapping) or has_entries(nominal)
    return part and (found is None or (is_list(found) and not found))


def _once(*values: Any) -> Values:
    return tuple(dict.fromkeys(values))


def _order(keys: Keys) -> tuple[tuple[bool, Any], ...]:
    return tuple((isinstance(key, str), key) for key in keys)
