"""What it saves to end episodes once every requirement is decided, and what looking costs.

Run: python benchmarks/early_end.py [--runs 8] [--repeats 3] [--scenario NAME]

The episodes of each row are judged by one requirement: whole ones, and on the same seeds such as
may end early, in turns; the quickest of each counts. A requirement with a window is decided at its
end; one that must always hold is decided by a violation alone, so that with a careful planner every
look is in vain, and its share of the time is the price. The verdicts of both are compared.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

from machine import machine, table

from pytest_dura import Orchestrator, Requirement, RoleSpec, Simulator, Termination, Tick
from pytest_dura.domains import DOMAINS
from pytest_dura.library import Case, expand_cases, load_library
from pytest_dura.requirements import RequirementJudge, judge_episode

PLANNERS = DOMAINS["driving"].short_names["generator"]
ASKED = (
    ("rule_based", "always[0:5] (gap > 0)"),
    ("rule_based", "eventually (cleared >= 1)"),
    ("rule_based", "always (gap > 0)"),
    ("aggressive", "always (speed <= 9)"),
    ("aggressive", "always (gap >= 0.5)"),
)


class Found(NamedTuple):
    """Verdicts of the episodes, their ticks, how many ended early, seconds of all and of looks."""

    words: list[str]
    ticks: int
    early: int
    seconds: float
    looking: float


class Timed(RequirementJudge):
    """Says how long it took to look whether all is decided."""

    seconds = 0.0

    def decided(self, simulator: Simulator, ticks: list[Tick], *, violated: bool) -> bool:
        """The same, timed."""
        begun = perf_counter()
        found = super().decided(simulator, ticks, violated=violated)
        self.seconds += perf_counter() - begun
        return found


def run(case: Case, planner: str, asked: Requirement, runs: int, *, decided: bool) -> Found:
    """All episodes of a case, which is judged by one requirement."""
    roles: dict[str, RoleSpec | None] = {"generator": RoleSpec(PLANNERS[planner])}
    roles["recovery_planner"] = None
    seconds, looking, episodes = 0.0, 0.0, []
    for number in range(runs):
        spec = case.spec(number, 0, roles)
        # To reach the goal is decided at the goal: without that rule there is more to save.
        end = Termination(spec.termination.time_limit, goal=False, decided=decided)
        judge = Timed([asked])
        loop = Orchestrator.build(spec, judge)
        begun = perf_counter()
        episodes.append(loop.run(replace(spec, termination=end)))
        seconds += perf_counter() - begun
        looking += judge.seconds
        loop.simulator.close()
    words = [judge_episode(asked, one).verdict for one in episodes]
    early = sum(one.termination == "decided" for one in episodes)
    return Found(words, sum(one.ticks for one in episodes), early, seconds, looking)


def row(case: Case, planner: str, check: str, runs: int, repeats: int) -> list[str]:
    """Whole episodes against such as may end early."""
    asked = Requirement("ASKED", check=check)
    found: dict[bool, list[Found]] = {False: [], True: []}
    for turn in range(2 * repeats):
        decided = turn % 4 in (1, 2)  # neither always comes first
        found[decided].append(run(case, planner, asked, runs, decided=decided))
    whole, early = (min(found[one], key=lambda two: two.seconds) for one in (False, True))
    return [
        planner, f"`{check}`", f"{early.early} of {runs}", f"{whole.ticks}", f"{early.ticks}",
        f"{whole.seconds:.2f}", f"{early.seconds:.2f}", f"{early.seconds / whole.seconds:.2f}",
        f"{early.looking / early.seconds:.1%}", "yes" if early.words == whole.words else "NO",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--scenario", default="intersection/conflicting-traffic")
    options = parser.parse_args()
    (case,) = expand_cases(load_library([]).scenarios, select=[options.scenario])
    print(machine())
    print(f"\n{options.scenario}, {options.runs} runs, base seed 0, no recovery\n")
    run(case, ASKED[0][0], Requirement("WARM", check="always (gap > 0)"), 1, decided=True)
    rows = [row(case, planner, check, options.runs, options.repeats) for planner, check in ASKED]
    head = ["planner", "requirement", "ended early", "ticks", "ticks with it", "s", "s with it",
            "ratio", "looking", "same verdicts"]  # fmt: skip
    print(table(head, rows))


if __name__ == "__main__":
    main()
