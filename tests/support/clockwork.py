"""A simulator in which everything happens at the tick that its scenario names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura import Simulator, Tick, stream


class Clockwork(Simulator):
    """Reaches its goal, breaks down and stops when the script says so; ``level`` counts the ticks.

    After a tick at which it broke down or stopped (``truncated``) it cannot be stepped.
    ``noise`` is drawn from the stream ``world``, and ``power`` is what was carried out last.
    """

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        self._world, self._stream = scenario.get("world", {}), stream(seed, "world")
        self._index, self._power = 0, 0.0
        return self._tick()

    def step(self, action: Any) -> Tick:
        if self._index in (self._world.get("critical"), self._world.get("truncated")):
            raise RuntimeError("stepped after its end")
        self._index, self._power = self._index + 1, float(action)
        return self._tick()

    def _tick(self) -> Tick:
        truth = {
            "level": float(self._index),
            "power": self._power,
            "noise": float(self._stream.random()),
        }
        return Tick(
            self._index,
            self._index * self.time_step,
            truth,
            {"level": float(self._index), "power": self._power},
            goal=self._index == self._world.get("goal"),
            critical="broke" if self._index == self._world.get("critical") else None,
            truncated=self._index == self._world.get("truncated"),
        )

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        return {name: [tick.truth[name] for tick in ticks] for name in ticks[0].truth}

    def fallback_action(self) -> float:
        return -1.0
