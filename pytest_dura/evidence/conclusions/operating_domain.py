"""Coverage of what scenarios vary: single parameters, and their pairs.

All of it is counted over the draws of valid planned episodes, of which each adds a few numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations
from operator import attrgetter
from typing import Any

from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.evidence.case_model import (
    CasePlan,
    ChoiceEntry,
    ChoicesEntry,
    CombinationsEntry,
    PairEntry,
    ParameterEntry,
    RangeEntry,
)
from pytest_dura.evidence.episode_model import EpisodeEntry

_BINS = 10
"""Equal parts of a range, in which values are counted."""


class ParameterCoverage:
    """Counts the values of varied parameters in valid episodes.

    All cases of a scenario draw the same values from the same seed, so that each seed counts once.

    Args:
        cases: The record's cases; ``variation`` holds the ranges.
    """

    def __init__(self, cases: Iterable[CasePlan]) -> None:
        self._scenarios: dict[str, dict[str, _Spread | _Choices]] = {}
        self._counted: set[tuple[str, str, int]] = set()
        for case in cases:
            spreads = self._scenarios.setdefault(case.scenario, {})
            for path, variation in case.variation.items():
                if path not in spreads and isinstance(variation, RangeEntry):
                    spreads[path] = _Spread(variation)
                elif path not in spreads and isinstance(variation, ChoicesEntry):
                    spreads[path] = _Choices(variation)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode, if it is a planned and valid one."""
        if not episode.planned or episode.validity != "valid":
            return
        spec = episode.spec
        scenario = spec.scenario_name
        for path, spread in self._scenarios.get(scenario, {}).items():
            key = scenario, path, spec.seed
            if key not in self._counted:
                value = _drawn_value(spec, path)
                if value is not _ABSENT and spread.accepts(value):
                    self._counted.add(key)
                    spread.add(value)

    def entries(self) -> list[ParameterEntry]:
        """Return what came of each parameter."""
        return [
            spreads[path].entry(scenario, path)
            for scenario, spreads in sorted(self._scenarios.items())
            for path in sorted(spreads)
        ]


class _Spread:
    """Values drawn from an interval."""

    def __init__(self, variation: RangeEntry) -> None:
        self.low, self.high = float(variation.min), float(variation.max)
        self.least, self.greatest = math.inf, -math.inf
        self.bins = [0] * _BINS

    def accepts(self, value: Any) -> bool:
        """Whether a value is a number, or the numbers of an input over time."""
        return all(
            isinstance(element, (int, float)) and not isinstance(element, bool)
            for element in _elements(value)
        )

    def add(self, value: Any) -> None:
        for number in _elements(value):
            self.bins[_part(number, self.low, self.high, _BINS)] += 1
            self.least, self.greatest = min(self.least, number), max(self.greatest, number)

    def entry(self, scenario: str, parameter: str) -> ParameterEntry:
        drawn = sum(self.bins)
        # A range without width has a single part.
        parts = _BINS if self.high > self.low else 1
        return ParameterEntry(
            scenario=scenario,
            parameter=parameter,
            low=self.low,
            high=self.high,
            choices=None,
            drawn=drawn,
            least=self.least if drawn else None,
            greatest=self.greatest if drawn else None,
            bins=self.bins,
            covered=sum(count > 0 for count in self.bins) / parts,
        )


class _Choices:
    """Values drawn from a list."""

    def __init__(self, variation: ChoicesEntry) -> None:
        self.values: list[Any] = []
        for value in variation.choice:
            if not any(_same_value(value, known) for known in self.values):
                self.values.append(value)
        self.counts = [0] * len(self.values)

    def accepts(self, value: Any) -> bool:
        return any(_same_value(known, value) for known in self.values)

    def add(self, value: Any) -> None:
        for i, known in enumerate(self.values):
            if _same_value(known, value):
                self.counts[i] += 1

    def entry(self, scenario: str, parameter: str) -> ParameterEntry:
        return ParameterEntry(
            scenario=scenario,
            parameter=parameter,
            low=None,
            high=None,
            choices=[
                ChoiceEntry(value=value, count=count)
                for value, count in zip(self.values, self.counts, strict=True)
            ],
            drawn=sum(self.counts),
            least=None,
            greatest=None,
            bins=[],
            covered=sum(count > 0 for count in self.counts) / len(self.counts),
        )


_ABSENT = object()


def _drawn_value(spec: EpisodeSpec, path: str) -> Any:
    """Look up a path of a variation, ``world.x.y`` or ``faults.id.x``, in an episode's spec."""
    head, _, rest = path.partition(".")
    data: Any = spec.scenario.get("world")
    if head == "faults":
        name, _, rest = rest.partition(".")
        data = next((fault.plain() for fault in spec.faults if fault.id == name), _ABSENT)
    for key in rest.split("."):
        if isinstance(data, Mapping):
            data = data.get(key, _ABSENT)
        elif isinstance(data, (list, tuple)) and key.isdecimal() and int(key) < len(data):
            data = data[int(key)]
        else:
            return _ABSENT
    return data


def _part(number: float, low: float, high: float, parts: int) -> int:
    """Place of a number in so many equal parts of a range; a range without width has one."""
    share = (number - low) / (high - low) if high > low else 0.0
    return min(max(int(share * parts), 0), parts - 1)


def _elements(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _same_value(value: Any, other: Any) -> bool:
    # To Python, True equals 1; as values of a world they differ.
    return isinstance(value, bool) == isinstance(other, bool) and bool(value == other)


PAIR_PARTS = 5
"""Parts of a range where pairs are counted: the 25 cells of a pair can be filled by a campaign."""
MAX_PAIRED_CHOICES = 20
"""Values of a choice up to which it stands in pairs."""
MAX_PAIRS = 1000
"""Pairs that the record lists."""
_NO_PART = 255


class _Parts:
    """Equal parts of a range, or the values of a choice, and where a drawn value falls.

    Args:
        variation: Of one parameter.
    """

    def __init__(self, variation: RangeEntry | ChoicesEntry) -> None:
        self._range = variation if isinstance(variation, RangeEntry) else None
        self._values = [] if isinstance(variation, RangeEntry) else _Choices(variation).values
        flat = self._range is not None and not self._range.max > self._range.min
        self.number = len(self._values) if self._range is None else 1 if flat else PAIR_PARTS

    def part_of(self, value: Any) -> int | None:
        """Return the number of the part; ``None`` for what is no single value of it."""
        if self._range is None:
            return next(
                (i for i, known in enumerate(self._values) if _same_value(known, value)), None
            )
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return None
        return _part(value, float(self._range.min), float(self._range.max), self.number)


class CombinationCoverage:
    """Counts combinations of two parameters of a scenario, in fifths of ranges and single choices.

    Each seed of a scenario counts once; of its cases, one may draw what another leaves out.

    Args:
        cases: The record's cases; ``variation`` holds the ranges.
    """

    def __init__(self, cases: Iterable[CasePlan]) -> None:
        self._unpaired: set[tuple[str, str]] = set()
        by_scenario: dict[str, dict[str, _Parts]] = {}
        for case in cases:
            known = by_scenario.setdefault(case.scenario, {})
            for path, variation in case.variation.items():
                parts = _Parts(variation)
                over_time = isinstance(variation, RangeEntry) and variation.pieces is not None
                if over_time or parts.number > max(MAX_PAIRED_CHOICES, PAIR_PARTS):
                    self._unpaired.add((case.scenario, path))
                else:
                    known.setdefault(path, parts)
        self._parts = {
            scenario: dict(sorted(paths.items())) for scenario, paths in by_scenario.items()
        }
        self._draws: dict[str, dict[int, bytearray]] = {scenario: {} for scenario in by_scenario}
        """By scenario and seed, the part of each parameter."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode, if it is a planned and valid one."""
        if not episode.planned or episode.validity != "valid":
            return
        spec = episode.spec
        parts = self._parts.get(spec.scenario_name, {})
        if len(parts) < 2:
            return
        draws = self._draws[spec.scenario_name]
        drawn = draws.setdefault(spec.seed, bytearray([_NO_PART] * len(parts)))
        for place, (path, own) in enumerate(parts.items()):
            if drawn[place] == _NO_PART:
                value = _drawn_value(spec, path)
                part = None if value is _ABSENT else own.part_of(value)
                drawn[place] = _NO_PART if part is None else part

    def entry(self) -> CombinationsEntry | None:
        """Return what came of all pairs; ``None`` where no scenario varies two."""
        pairs = [pair for scenario in sorted(self._parts) for pair in self._pairs(scenario)]
        if not pairs:
            return None
        return CombinationsEntry(
            pairs=len(pairs),
            cells=sum(len(pair.counts) * len(pair.counts[0]) for pair in pairs),
            met=sum(pair.met for pair in pairs),
            unpaired=len(self._unpaired),
            worst=sorted(pairs, key=attrgetter("covered"))[:MAX_PAIRS],
        )

    def _pairs(self, scenario: str) -> Iterator[PairEntry]:
        parts, draws = self._parts[scenario], self._draws[scenario].values()
        for (i, first), (j, second) in combinations(enumerate(parts), 2):
            counts = [[0] * parts[second].number for _ in range(parts[first].number)]
            for drawn in draws:
                if _NO_PART not in (drawn[i], drawn[j]):
                    counts[drawn[i]][drawn[j]] += 1
            cells = [count for row in counts for count in row]
            met = sum(count > 0 for count in cells)
            yield PairEntry(
                scenario=scenario,
                first=first,
                second=second,
                drawn=sum(cells),
                met=met,
                counts=counts,
                covered=met / len(cells),
            )
