"""What each detector costs a tick, on the percepts of one recorded episode.

Run: python benchmarks/detector_cost.py [--scenario NAME] [--seed 0] [--repeats 20]

The episode is simulated once, and each detector is shown it again and again: the least time over
the repeats is what it costs where nothing else keeps the machine busy.
"""

from __future__ import annotations

import argparse
from time import perf_counter

from detection_table import DRIVING, MONITORS
from machine import machine, table

from pytest_dura.core import Orchestrator, Percept, Role, RoleContext, RoleSpec, StateManager, Tick
from pytest_dura.driving import Command, Maneuver
from pytest_dura.library import expand_cases, load_library

KEEP = Command(Maneuver.PROCEED, 0.0)


def seconds(detector: Role, ticks: list[Tick], percepts: list[Percept], dt: float) -> float:
    """What a detector takes for all ticks, without the proposal."""
    state, spent = StateManager(dt), 0.0
    for tick, percept in zip(ticks, percepts, strict=True):
        state.update(tick, percept)
        view = state.role_view()
        began = perf_counter()
        detector.run(view)
        spent += perf_counter() - began
        state.decide(KEEP, "proposal")
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="intersection/congested")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    (case,) = expand_cases([load_library([]).scenarios[options.scenario]], ["none"])
    spec = case.spec(0, options.seed)
    orchestrator = Orchestrator.build(spec)
    orchestrator.run(spec)
    ticks, percepts = orchestrator.state.ticks, orchestrator.state.percepts
    context = RoleContext(0, spec.time_step, spec.scenario)
    rows = []
    roles = {"plausibility": RoleSpec(DRIVING.default_roles["security_assessor"]), **MONITORS}
    for name, role in roles.items():
        detector, least = role.create(), float("inf")
        for _ in range(options.repeats):
            detector.reset(context)
            least = min(least, seconds(detector, ticks, percepts, spec.time_step))
        rows.append([name, f"{least / len(ticks) * 1e6:.0f}"])
    print(f"{machine()}\n\n{options.scenario}, {len(ticks)} ticks\n")
    print(table(["detector", "us/tick"], rows))


if __name__ == "__main__":
    main()
