"""A rare rate by multilevel splitting beside plain runs, and what each costs.

Run: python benchmarks/rare_rate.py [--plain 100000] [--runs 400] [--repetitions 20]

The plant is cheap: a mass on a damped spring that gusts push, 100 ticks of 0.1 s. The event is that
it is pushed beyond a distance. Plain runs are vectorised, with the same equations and the same law
of the gusts; splitting steps a simulator with snapshots tick by tick. A probability that plain runs
can still see is the check; of the last, they see next to nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from time import process_time
from typing import Any

import numpy as np
from machine import machine, table
from numpy.typing import NDArray

from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.rate_tests import lower_bound, upper_bound
from pytest_dura.search import Splitting

STEP, TICKS, STIFFNESS, DAMPING = 0.1, 100, 1.0, 0.4
DISTANCES = (2.2, 2.8, 3.6)


def moved(x: Any, v: Any, gust: Any) -> tuple[Any, Any]:
    """Advance position and speed by a tick."""
    v = v + STEP * (gust - STIFFNESS * x - DAMPING * v)
    return x + STEP * v, v


class Spring(Simulator):
    """The plant; its action is the gust, and a snapshot its state."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - it draws nothing
        """Begin at rest."""
        self._state = (0.0, 0.0, 0)
        return self._tick()

    def step(self, action: float) -> Tick:
        """Move on by a tick."""
        x, v, index = self._state
        x, v = moved(x, v, action)
        self._state = (x, v, index + 1)
        return self._tick()

    def _tick(self) -> Tick:
        x, _, index = self._state
        return Tick(index, index * STEP, {}, {"x": x}, {})

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Its position."""
        return {"x": np.array([tick.channels["x"] for tick in ticks])}

    def check_action(self, action: Any) -> float:
        """Any number."""
        return float(action)

    def fallback_action(self) -> float:
        """No gust."""
        return 0.0

    def snapshot(self) -> tuple[float, float, int]:
        """The state."""
        return self._state

    def restore(self, snapshot: Any) -> None:
        """Return to a state."""
        self._state = snapshot


def plain(count: int, distance: float, seed: int) -> int:
    """Count plain runs that come beyond a distance."""
    rng = np.random.default_rng(seed)
    x, v, beyond = np.zeros(count), np.zeros(count), np.zeros(count, bool)
    for _ in range(TICKS):
        x, v = moved(x, v, rng.normal(0.0, 2.0, count))
        beyond |= x >= distance
    return int(beyond.sum())


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--plain", type=int, default=100_000)
    arguments.add_argument("--runs", type=int, default=400)
    arguments.add_argument("--repetitions", type=int, default=20)
    options = arguments.parse_args()
    rows = []
    for distance in DISTANCES:
        count = plain(options.plain, distance, 1)
        low, high = (bound(count, options.plain, 0.975) for bound in (lower_bound, upper_bound))
        splitting = Splitting(
            Spring(),
            {},
            lambda _, rng: rng.normal(0.0, 2.0),
            lambda tick, distance=distance: distance - tick.channels["x"],  # type: ignore[misc]
            TICKS,
            options.runs,
            seed=1,
        )
        start = process_time()
        rate = splitting.estimate(options.repetitions)
        seconds = process_time() - start
        rows.append(
            [
                f"{distance:g}",
                f"{count} of {options.plain}: {low:.2g} to {high:.2g}",
                f"{rate.rate:.3g} ({rate.low:.2g} to {rate.high:.2g})",
                f"{len(rate.levels)}",
                f"{rate.ticks / TICKS:,.0f}",
                f"{seconds:.1f}",
            ]
        )
    print(f"{machine()}\n")
    heads = ["distance", "plain runs", "splitting", "levels", "as many ticks as runs", "s"]
    print(table(heads, rows))


if __name__ == "__main__":
    main()
