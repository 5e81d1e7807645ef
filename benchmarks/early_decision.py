"""How many episodes it takes to decide "collides in at most 5 %", in the simulator.

Run: python benchmarks/early_decision.py [--budget 200] [--scenario NAME]

Each planner is judged on the same seeds by each method, until it has decided or the budget is used
up. A fixed number of runs ends early only where the rest cannot change its verdict.
"""

from __future__ import annotations

import argparse
from time import perf_counter

from machine import machine, table

from pytest_dura import Requirement, RoleSpec, Runner
from pytest_dura.domains import DOMAINS
from pytest_dura.library import load_library
from pytest_dura.requirements import Method

LIMIT, P0 = 0.05, 0.01
PLANNERS = (("rule_based", True), ("aggressive", False))
METHODS: tuple[tuple[Method, float | None], ...] = (
    ("fixed", None),
    ("sprt", P0),
    ("e-process", None),
)


def judged(planner: str, *, recovers: bool, scenario: str, budget: int) -> list[list[str]]:
    """One row per method; each simulates its own episodes, on the same seeds."""
    library = load_library([])
    roles: dict[str, RoleSpec | None]
    roles = {"generator": RoleSpec(DOMAINS["driving"].short_names["generator"][planner])}
    if not recovers:
        roles["recovery_planner"] = None
    name = planner if recovers else f"{planner}, no recovery"
    rows = []
    for method, p0 in METHODS:
        requirement = Requirement(
            "RATE", check="always (gap > 0)", at_most=LIMIT, method=method, p0=p0
        )
        campaign = Runner(lambda: library, roles=roles).campaign(
            scenario, budget, until_decided=True
        )
        began = perf_counter()
        found = campaign.judge(requirement)
        seconds = perf_counter() - began
        counts = [found.run, found.violations, found.saved]
        rows.append([name, method, found.verdict, *map(str, counts), f"{seconds:.1f}"])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--scenario", default="intersection/conflicting-traffic")
    options = parser.parse_args()
    print(machine())
    print(f"\n{options.scenario}, at most {LIMIT:g}, budget {options.budget}, base seed 0\n")
    rows = [
        row
        for planner, recovers in PLANNERS
        for row in judged(
            planner, recovers=recovers, scenario=options.scenario, budget=options.budget
        )
    ]
    head = ["planner", "method", "verdict", "runs", "violations", "saved", "s"]
    print(table(head, rows))


if __name__ == "__main__":
    main()
