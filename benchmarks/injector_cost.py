"""What an armed but inactive injector costs: ten faults that never begin, against none.

Run: python benchmarks/injector_cost.py [--runs 2] [--repeats 5]

The same episodes are run with ten faults of each plan and with none, in turns. The injector is
timed by itself, in all that the loop asks of it; what it takes beyond one without faults is given
as a share of a whole tick of the same loop, Generator included. Times are those of the processor,
and the quickest of each counts. That the episode stays the same is checked.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from time import process_time_ns
from typing import Any

from machine import machine, table

from pytest_dura import Fault
from pytest_dura.core import Episode, EpisodeSpec, Orchestrator
from pytest_dura.driving import FAULT_TARGETS
from pytest_dura.faults import CampaignInjector, parse_fault
from pytest_dura.library import expand_cases, load_library

NEVER = 1e6
"""s; later than any episode ends."""

ACTIVATIONS: dict[str, dict[str, Any]] = {
    "at": {"at": NEVER},
    "every": {"at": NEVER, "every": 1.0},
    "when": {"when": "odometry.speed > 99 and lidar.count >= 1"},
    "probability": {"probability": 1e-12},
    "rate": {"rate": 1e-12},
    "after": {"after": {"fault": "fault-0"}},
}
PLANS: dict[str, list[str]] = {
    "none": [],
    "ten `at`": ["at"] * 10,
    "mix of all": [*ACTIVATIONS, "at", "when", "rate", "at"],
    "ten `when`": ["when"] * 10,
    "ten `rate`": ["rate"] * 10,
}  # fmt: skip
TYPES = ("bias", "noise", "freeze", "ghost-obstacle", "gnss-jump", "loss-of-effectiveness")


class TimedInjector(CampaignInjector):
    """Adds up the time of all that the loop asks of it."""

    def __init__(self) -> None:
        self.nanoseconds = 0

    def _timed(self, call: Callable[..., Any], *args: Any) -> Any:
        start = process_time_ns()
        found = call(*args)
        self.nanoseconds += process_time_ns() - start
        return found

    def run(self, view: Any) -> Any:
        """Timed."""
        return self._timed(super().run, view)

    def corrupt(self, channels: Any, time: float) -> Any:
        """Timed."""
        return self._timed(super().corrupt, channels, time)

    def corrupt_command(self, action: Any, time: float) -> Any:
        """Timed."""
        return self._timed(super().corrupt_command, action, time)


def planned(names: list[str]) -> tuple[Fault, ...]:
    """Faults of several types, activated as these names say."""
    return tuple(
        parse_fault(
            {
                "type": TYPES[index % len(TYPES)],
                "id": f"fault-{index}",
                "activation": ACTIVATIONS[name],
                "duration": 1.0,
            },
            FAULT_TARGETS,
        )
        for index, name in enumerate(names)
    )


def measured(spec: EpisodeSpec) -> tuple[float, float, Episode]:
    """Nanoseconds of the injector and of the whole loop, and the episode."""
    orchestrator = Orchestrator.build(spec)
    injector = TimedInjector()
    orchestrator.injector = injector
    orchestrator.assessors = [
        (name, injector if name == "fault_injector" else role, owed)
        for name, role, owed in orchestrator.assessors
    ]
    orchestrator.roles["fault_injector"] = injector
    start = process_time_ns()
    episode = orchestrator.run(spec)
    return injector.nanoseconds, process_time_ns() - start, episode


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=2, help="episodes per scenario")
    arguments.add_argument("--repeats", type=int, default=5, help="times each is repeated")
    arguments.add_argument("--select", default="*", help="scenarios, as a glob")
    options = arguments.parse_args()
    plans = {name: planned(names) for name, names in PLANS.items()}
    spent, whole, ticks = dict.fromkeys(plans, 0.0), 0.0, 0
    for case in expand_cases(load_library([]).scenarios, ["none"], [options.select]):
        for run in range(options.runs):
            spec = case.spec(run, base_seed=0)
            best: dict[str, list[tuple[float, float]]] = {name: [] for name in plans}
            for _ in range(options.repeats):
                traces = set()
                for name, faults in plans.items():
                    own, total, episode = measured(replace(spec, faults=faults))
                    assert not any(fault.activations for fault in episode.faults)
                    traces.add(episode.signals["progress"].tobytes())
                    best[name].append((own, total))
                assert len(traces) == 1, "an inactive injector changed the episode"
            for name, found in best.items():
                spent[name] += min(own for own, _ in found)
            whole += min(total for _, total in best["none"])
            ticks += episode.ticks - 1
    print(machine(), f"\n{ticks} ticks, {options.runs} episodes a scenario\n")
    print(f"a tick of the loop without faults: {whole / ticks / 1e3:.0f} us\n")
    rows = [
        [
            name,
            f"{spent[name] / ticks / 1e3:.1f}",
            f"{(spent[name] - spent['none']) / ticks / 1e3:.1f}",
            f"**{(spent[name] - spent['none']) / whole:.1%}**",
        ]
        for name in plans
    ]
    print(table(["planned", "injector, us/tick", "more than none", "share of a tick"], rows))


if __name__ == "__main__":
    main()
