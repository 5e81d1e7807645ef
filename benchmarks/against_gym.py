"""Ticks per second against a plain gym.make loop at 10 Hz with as many vehicles.

Run: python benchmarks/against_gym.py [--episodes 6]

Both on one core, in turns. Ours is the whole loop with all six roles; theirs is
gym.make("intersection-v0") stepped at 10 Hz with an idle agent and no roles at all.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from time import perf_counter

import gymnasium
import highway_env  # noqa: F401 - registers the environments
from machine import machine, table

from pytest_dura.core import Orchestrator
from pytest_dura.library import expand_cases, load_library


def ours(seed: int) -> tuple[float, int, float]:
    """Seconds, ticks and mean number of vehicles of a congested episode in our loop."""
    (case,) = expand_cases(load_library([]).scenarios, select=["intersection/congested"])
    spec = case.spec(seed, base_seed=0)
    orchestrator = Orchestrator.build(spec)
    start = perf_counter()
    episode = orchestrator.run(spec)
    seconds = perf_counter() - start
    bodies = [len(tick.truth["bodies"]) + 1 for tick in orchestrator.state.ticks]
    return seconds, episode.ticks - 1, statistics.mean(bodies)


def theirs(seed: int, ticks: int, vehicles: float) -> tuple[float, float]:
    """Seconds and mean number of vehicles of as many ticks of the plain loop.

    Its number of vehicles is held near ours by spawning while there are fewer.
    """
    config = {
        "simulation_frequency": 10,
        "policy_frequency": 10,
        "duration": 10_000,
        "initial_vehicle_count": round(vehicles),
        "spawn_probability": 0.0,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # gymnasium recommends a newer version of the environment
        env = gymnasium.make("intersection-v0", config=config)
    env.reset(seed=seed)
    road = env.unwrapped
    count, seconds = [], 0.0
    for _ in range(ticks):
        if len(road.road.vehicles) < vehicles:
            road._spawn_vehicle(spawn_probability=1.0)
        start = perf_counter()
        env.step(1)
        seconds += perf_counter() - start
        count.append(len(road.road.vehicles))
    env.close()
    return seconds, statistics.mean(count)


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--episodes", type=int, default=6)
    options = arguments.parse_args()
    rows, our_seconds, their_seconds, total = [], 0.0, 0.0, 0
    for seed in range(options.episodes):
        mine, ticks, vehicles = ours(seed)
        plain, plain_vehicles = theirs(seed, ticks, vehicles)
        our_seconds, their_seconds, total = our_seconds + mine, their_seconds + plain, total + ticks
        rows.append([
            str(seed), str(ticks), f"{vehicles:.1f}", f"{plain_vehicles:.1f}",
            f"{ticks / mine:.0f}", f"{ticks / plain:.0f}", f"{plain / mine:.2f}",
        ])  # fmt: skip
    rows.append([
        "all", str(total), "", "", f"{total / our_seconds:.0f}", f"{total / their_seconds:.0f}",
        f"**{their_seconds / our_seconds:.2f}**",
    ])  # fmt: skip
    print(machine(), "\n")
    headers = ["episode", "ticks", "vehicles (ours)", "vehicles (plain)", "ours, ticks/s",
               "plain, ticks/s", "times faster"]  # fmt: skip
    print(table(headers, rows))


if __name__ == "__main__":
    main()
