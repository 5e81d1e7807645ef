"""Episodes for the conformance kit of simulators, and whether two that should be equal are."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from pytest_dura.core.comparing import first_difference, leaves
from pytest_dura.core.findings import Findings
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick

PURE = "make the adapter a pure function of scenario, seed and actions"


@dataclass
class CheckedEpisode:
    """One episode: its ticks, what they were when they were new, and its signals."""

    ticks: list[Tick]
    copies: list[dict[str, Any]]
    signals: dict[str, Any]


@dataclass(frozen=True)
class EpisodeRuns:
    """Runs the same actions as often as need be.

    Args:
        findings: Where breaches go.
        fresh: Builds a simulator.
        scenario: The scenario to reset it with.
        actions: One per tick.
        seeds: The seed that is checked, and another one.
    """

    findings: Findings
    fresh: Callable[[], Simulator]
    scenario: Mapping[str, Any]
    actions: Sequence[Any]
    seeds: tuple[int, int]

    def episode(self, simulator: Simulator, seed: int, at: int | None = None) -> CheckedEpisode:
        """One episode; rendered at tick ``at``, if given."""
        ticks = [simulator.reset(self.scenario, seed)]
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if ticks[-1].index == at:
                simulator.render()
            if over(ticks[-1]):
                break
            ticks.append(simulator.step(simulator.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return CheckedEpisode(ticks, copies, leaves(simulator.signals(ticks)))

    def interleaved(self) -> CheckedEpisode:
        """One episode, stepped in turn with one of the other seed in another instance."""
        one, two = self.fresh(), self.fresh()
        ticks = [one.reset(self.scenario, self.seeds[0])]
        shadow = two.reset(self.scenario, self.seeds[1])
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if over(ticks[-1]):
                break
            if not over(shadow):
                shadow = two.step(two.check_action(action))
            ticks.append(one.step(one.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return CheckedEpisode(ticks, copies, leaves(one.signals(ticks)))

    def compare(self, one: CheckedEpisode, other: CheckedEpisode, who: str) -> None:
        """A breach if two episodes that should be equal are not."""
        for index, (left, right) in enumerate(zip(one.copies, other.copies, strict=False)):
            if (path := first_difference(left, right)) is not None:
                self.findings.breach(f"{who} differs at tick {index} in {path}", PURE)
                return
        if len(one.copies) != len(other.copies):
            ends = f"{len(one.copies)} and {len(other.copies)}"
            self.findings.breach(f"{who} ends at another tick: {ends} ticks", PURE)
        elif (path := first_difference(one.signals, other.signals)) is not None:
            self.findings.breach(f"{who} has another signal {path}", PURE)


def over(tick: Tick) -> bool:
    """Whether an episode is not stepped further."""
    return tick.critical is not None or tick.goal


@contextmanager
def other_global_randomness() -> Iterator[None]:
    """Other global random states for a while: what draws from them gives itself away."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the subject's sin
    random.seed(987654321)
    np.random.seed(987654321)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
