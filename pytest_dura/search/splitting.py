"""Multilevel splitting: the rate of a rare event, where a simulator offers snapshots.

A rare event is reached over levels, each of which is not rare from the one before: runs that reach
a level are continued from their snapshots there, with new draws, until they reach the next one or
end (fixed effort; Garvels, "The splitting method in rare event simulation", 2000). The product of
the shares is an unbiased estimate, whatever the levels; levels decide its spread alone.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import stream
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.rate_tests import upper_bound

Act = Callable[[Tick, np.random.Generator], Any]
"""Chooses the action of a tick; chance after the begin is drawn from the generator alone."""
Margin = Callable[[Tick], float]
"""How far a tick is from the event, 0 or less where it happens."""

_SHARE = 0.2
"""Share of pilot runs that reach the next level: about the one of the least spread."""
_MOST_LEVELS = 40
CONFIDENCE = 0.95


@dataclass(frozen=True)
class RareRate:
    """The rate of an event, with the interval of independent repetitions.

    Args:
        rate: Mean of the repetitions.
        low: Lower end of the interval, Student's t of the repetitions; at least 0.
        high: Upper end. Where no repetition reached the event it is the exact upper bound on the
            rate of the first level, which is far too great, and true.
        levels: Margins of the levels, the last of them 0.
        shares: Of each level, the share of runs that reach it from the one before, over all
            repetitions.
        ticks: Ticks that were simulated, the pilot's among them.
        repetitions: Estimates, each with runs of its own.
    """

    rate: float
    low: float
    high: float
    levels: tuple[float, ...]
    shares: tuple[float, ...]
    ticks: int
    repetitions: tuple[float, ...]


@dataclass
class Splitting:
    """Estimates how often an event happens in a simulator whose chance is in its actions.

    Args:
        simulator: One that has snapshots.
        scenario: What it is reset with.
        act: Chooses the actions.
        margin: How far from the event a tick is.
        ticks: Ticks of a run after the first one.
        runs: Runs of each level.
        seed: From which all draws follow.
    """

    simulator: Simulator
    scenario: Any
    act: Act
    margin: Margin
    ticks: int
    runs: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be split.

        Raises:
            ConfigurationError: For a simulator without snapshots, and too few runs or ticks.
        """
        for name, least in (("runs", 2), ("ticks", 1)):
            if getattr(self, name) < least:
                raise ConfigurationError(
                    f"splitting needs at least {least} {name}", key=name, found=getattr(self, name)
                )
        self._simulated = 0
        self.simulator.reset(self.scenario, 0)
        try:
            self.simulator.snapshot()
        except NotImplementedError:
            kind = type(self.simulator).__name__
            raise ConfigurationError(
                f"the simulator {kind} has no snapshots to continue runs from",
                key="simulator",
                found=kind,
                expected="a simulator with `snapshot` and `restore`",
                remedy="give it both, or estimate the rate by plain runs",
            ) from None

    def estimate(self, repetitions: int = 10, levels: Sequence[float] | None = None) -> RareRate:
        """Estimate the rate.

        Args:
            repetitions: Independent estimates, at least 2, whose spread gives the interval.
            levels: Falling margins above 0; by default those of a pilot, whose runs enter no
                estimate.

        Raises:
            ConfigurationError: For fewer repetitions, and levels that do not fall to above 0.
        """
        if repetitions < 2:
            raise ConfigurationError(
                "one estimate has no spread",
                key="repetitions",
                found=repetitions,
                expected="2 or more",
            )
        self._simulated = 0
        above = self._pilot() if levels is None else tuple(levels)
        chosen = (*above, 0.0)
        if any(a <= b for a, b in itertools.pairwise(chosen)):
            raise ConfigurationError(
                "levels are margins that fall, all above 0",
                key="levels",
                found=", ".join(f"{level:g}" for level in above),
                expected="such as 3, 2, 1",
            )
        reached = [self._pass(chosen, f"splitting:{i}") for i in range(repetitions)]
        rates = [float(np.prod(shares)) for shares in reached]
        mean, spread = statistics.fmean(rates), statistics.stdev(rates) / repetitions**0.5
        from scipy.special import stdtrit

        reach = float(stdtrit(repetitions - 1, (1.0 + CONFIDENCE) / 2.0)) * spread
        shares = tuple(statistics.fmean(column) for column in zip(*reached, strict=True))
        if mean == 0.0:  # no spread, and no less probable for that: the first level bounds it
            begun = self.runs * repetitions
            reach = upper_bound(round(shares[0] * begun), begun, (1.0 + CONFIDENCE) / 2.0)
        return RareRate(
            mean,
            max(mean - reach, 0.0),
            mean + reach,
            chosen,
            shares,
            self._simulated,
            tuple(rates),
        )

    def _pass(self, levels: Sequence[float], name: str) -> list[float]:
        """Pass through the levels once; the share of runs that reach each."""
        rng, starts = stream(self.seed, name), None
        shares = []
        for level in levels:
            starts = self._entrances(rng, starts, level)[0]
            shares.append(len(starts) / self.runs)
            if not starts:
                return shares + [0.0] * (len(levels) - len(shares))
        return shares

    def _pilot(self) -> tuple[float, ...]:
        """Choose levels so that about the same share of runs reaches each from the one before."""
        rng, starts, levels = stream(self.seed, "splitting:pilot"), None, list[float]()
        for _ in range(_MOST_LEVELS):
            least = self._entrances(rng, starts, 0.0)[1]
            level = float(np.quantile(least, _SHARE))
            if level <= 0.0 or (levels and level >= levels[-1]):
                break
            levels.append(level)
            starts = self._entrances(rng, starts, level)[0]
            if not starts:
                break
        return tuple(levels)

    def _entrances(
        self, rng: np.random.Generator, starts: Sequence[_Start] | None, level: float
    ) -> tuple[list[_Start], list[float]]:
        """Run on from entrances of the last level; return those of this one, and least margins."""
        entrances, least = [], []
        for _ in range(self.runs):
            if starts is None:
                tick = self.simulator.reset(self.scenario, int(rng.integers(2**63)))
            else:
                start = starts[int(rng.integers(len(starts)))]
                self.simulator.restore(start.snapshot)
                tick = start.tick
            lowest = self.margin(tick)
            while lowest > level and tick.index < self.ticks and not tick.critical:
                tick = self.simulator.step(self.simulator.check_action(self.act(tick, rng)))
                self._simulated += 1
                lowest = min(lowest, self.margin(tick))
            least.append(lowest)
            if lowest <= level:
                entrances.append(_Start(self.simulator.snapshot(), tick))
        return entrances, least


@dataclass(frozen=True, slots=True)
class _Start:
    snapshot: object
    tick: Tick
