"""What a simulation of a cheap plant costs under ``falsify``, beside the plant itself.

Run: python benchmarks/falsify_cost.py [--budget 40] [--repeats 5] [--profile]

The plant is the chasing cars at 0.1 s, 1,000 ticks. The requirement is one that no input violates,
so that each search uses its whole budget. The plain loop steps the same simulator and asks the same
component, without anything else. The loop of roles with the component alone is measured beside it.
A cart of as many samples is a black box, whose runs are simulated one by one and in batches.
All take turns, and the quickest of each counts, in time of the processor. ``--profile`` shows which
functions take it.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
from pathlib import Path
from time import process_time

import numpy as np
from falsification.cart_box import CART
from falsification.chasing_cars_domain import ChasingCars, Followers
from machine import machine, table

from pytest_dura import Runner
from pytest_dura.campaign import Limits
from pytest_dura.core import EpisodeSpec, Orchestrator, RoleSpec, Termination
from pytest_dura.core.percepts import Percept
from pytest_dura.core.state import GeneratorView
from pytest_dura.library import case_with_faults, load_library
from pytest_dura.requirements.model import Requirement
from pytest_dura.search import Objective
from pytest_dura.search.falsify import falsify

TICKS = 1000
NEVER = Requirement(
    "NEVER-1", text="No gap grows past all bounds.", kind="safety", check="always (d54 <= 1000000)"
)
BOX_NEVER = Requirement(
    "NEVER-2", text="The cart stays here.", kind="safety", check="always (x <= 1000000)"
)
WORLD = {"throttle": [0.5] * 20, "brake": [0.1] * 20}


def plain(count: int) -> float:
    """Seconds of the processor for one simulation without a loop of roles."""
    start = process_time()
    for _ in range(count):
        simulator, followers = ChasingCars(), Followers()
        simulator.set_time_step(0.1)
        ticks = [simulator.reset({"world": WORLD}, 0)]
        for _ in range(TICKS):
            tick = ticks[-1]
            view = GeneratorView(tick.index, tick.time, 0.1, Percept(tick.channels))
            ticks.append(simulator.step(followers.propose(view).action))
        simulator.signals(ticks)
    return (process_time() - start) / count


def alone(count: int) -> float:
    """Seconds of the processor for one simulation in the loop, without any other role."""
    spec = EpisodeSpec(
        "cars", 0, 0, RoleSpec.of(ChasingCars), {"generator": RoleSpec.of(Followers)},
        scenario={"world": WORLD}, time_step=0.1, time_budget=1.0,
        termination=Termination(0.1 * TICKS),
    )  # fmt: skip
    start = process_time()
    for _ in range(count):
        episode = Orchestrator(ChasingCars(), {"generator": Followers()}).run(spec)
    seconds = process_time() - start
    if episode.ticks != TICKS + 1 or episode.failure is not None:
        raise SystemExit(f"{episode.ticks} ticks, {episode.failure}")
    return seconds / count


def box_alone(count: int) -> float:
    """Seconds of the processor for one simulation of the black box by itself."""
    time, start = np.arange(TICKS + 1) * 0.1, process_time()
    for _ in range(count):
        CART.columns({"force": [0.5] * 20}, time)
    return (process_time() - start) / count


def searched(
    budget: int, seed: int, name: str = "chasing_cars", requirement: Requirement = NEVER
) -> float:
    """Seconds of the processor for one simulation of a search."""
    library = load_library([Path(__file__).parent / "falsification" / "scenarios"])
    runner = Runner(lambda: library, seed)
    case = case_with_faults(library.scenarios[name], "none")
    limits = Limits(budget, shrink=0, baselines=False)
    start = process_time()
    found = falsify(runner, case, [Objective(requirement)], limits=limits)
    seconds = process_time() - start
    if found.simulations != budget:
        raise SystemExit(f"{found.simulations} simulations, expected {budget}")
    return seconds / budget


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--budget", type=int, default=40)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--profile", action="store_true")
    options = arguments.parse_args()
    searched(2, 0)  # imports
    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(searched, options.budget, 1)
        pstats.Stats(profile).sort_stats("tottime").print_stats(40)
        return
    times = [
        (
            plain(options.budget),
            alone(options.budget),
            searched(options.budget, i),
            box_alone(options.budget),
            searched(options.budget, i, "black_box/cart", BOX_NEVER),
            searched(options.budget, i, "black_box/carts", BOX_NEVER),
        )
        for i in range(options.repeats)
    ]
    bare, looped, whole, box, by_one, by_many = (
        1e3 * min(column) for column in zip(*times, strict=True)
    )
    print(f"{machine()}\n")
    rows = [
        ["in the loop, with the component alone", looped, bare],
        ["under falsify", whole, bare],
        ["a black box under falsify", by_one, box],
        ["the same in batches", by_many, box],
    ]
    print(
        table(
            ["1,000 ticks", "ms", "plant alone, ms", "beside the plant, ms"],
            [
                [name, f"{each:.1f}", f"{plant:.1f}", f"{each - plant:.1f}"]
                for name, each, plant in rows
            ],
        )
    )


if __name__ == "__main__":
    main()
