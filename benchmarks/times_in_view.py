"""How long the risk is in view before the contact, and what would have saved the run.

Run: python benchmarks/times_in_view.py [--select 'intersection/sudden/*'] [--runs 200] [--jobs 2]

No planner under test is asked; the bounds of the scenarios rest on this. Each run of each scenario
is driven on the same seed by

- `keeps on`: 9 m/s, the pace of `proceed`, and it looks at nobody;
- `brakes at sight`: the same until a risk is in view, and from that tick on as hard as a dry road
  allows, 8 m/s2, until it stands, and stays there: no braking comes sooner or is harder;
- `comes slowly`: the same as the last, with 5 m/s, the pace of `proceed_cautiously`, throughout;
- the careful driver of UN Regulation 157.

A risk is in view from the first tick at which lidar reports a body that would be met within 6 s if
both kept their speed and the body its yaw rate. From there to the contact of `keeps on` it takes
the time to collision. Where it has none, nothing needs to be done. Otherwise braking alone saves
the run if `brakes at sight` has no contact; caution alone, if only `comes slowly` has none; and if
both have one, it is not saved.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from statistics import quantiles

from machine import machine, table

from pytest_dura.core import Episode, Orchestrator, RoleSpec
from pytest_dura.core.roles import Generator, RoleContext
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.driving import clearance_time
from pytest_dura.driving.maneuvers import COMFORT_BRAKING, MAX_BRAKING, Command, Maneuver
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.scene import Scene
from pytest_dura.library import Case, expand_cases, load_library

PACE, SLOWLY = 9.0, 5.0
"""m/s: of ``proceed`` and of ``proceed_cautiously``."""
TIME = 25.0
"""s; by then all have met who meet."""
_STARTING = 2.0
"""m/s2 with which a pace is taken up."""


class Paced(Generator):
    """Keeps a pace along its route, and says from when on a risk is in view.

    Args:
        pace: In m/s.
        brakes: Whether it brakes as hard as it can from then on.
    """

    def __init__(self, pace: float = PACE, *, brakes: bool = True) -> None:
        self.pace, self.brakes = pace, brakes
        self._risks = Predictor(6.0, 0.1)

    def reset(self, context: RoleContext) -> None:
        """Forget what was seen."""
        super().reset(context)
        self._risks.reset()
        self._in_view: set[str] = set()

    def propose(self, view: GeneratorView) -> Proposal:
        """Keep the pace, or brake; the explanation names who has become a risk at this tick."""
        scene = Scene.of(view.percept)
        self._risks.observe(view.index, scene.bodies)
        apart, near = self._risks.separations(scene, (0.0,), view.dt)
        fresh = set()
        if near.ids:
            met = (apart[0] < 0.0).any(axis=0)
            fresh = {name for name, hit in zip(near.ids, met, strict=True) if hit} - self._in_view
        self._in_view |= fresh
        text = " ".join(sorted(fresh))
        if self.brakes and self._in_view:
            return Proposal(Command(Maneuver.EMERGENCY_BRAKE, -MAX_BRAKING), text)
        rate = min(max((self.pace - scene.speed) / view.dt, -COMFORT_BRAKING), _STARTING)
        return Proposal(Command(Maneuver.PROCEED, rate), text)


DRIVERS: dict[str, RoleSpec] = {
    "keeps on": RoleSpec("times_in_view:Paced", {"brakes": False}),
    "brakes at sight": RoleSpec("times_in_view:Paced"),
    "comes slowly": RoleSpec("times_in_view:Paced", {"pace": SLOWLY}),
    "careful_driver": RoleSpec("careful_driver"),
}
Key = tuple[str, str, int]
"""Scenario, driver, run."""
Drive = tuple[bool, float | None, float]
"""Whether it has a contact, the time to collision of the risk, and when it has cleared."""


@cache
def _case(scenario: str) -> Case:
    (case,) = expand_cases(load_library([]).scenarios, select=[scenario])
    return case


def drive(job: tuple[Key, int]) -> tuple[Key, Drive]:
    """One run of one driver."""
    key, base_seed = job
    scenario, driver, number = key
    spec = _case(scenario).spec(
        number, base_seed, {"generator": DRIVERS[driver]}, policy="log_only"
    )
    if driver != "careful_driver":  # who stands does so to the end, and all others are gone
        spec = replace(spec, termination=replace(spec.termination, time_limit=TIME))
    episode = Orchestrator.build(spec, recorded=True).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    return key, (episode.collided, time_to_collision(episode), clearance_time(episode))


def time_to_collision(episode: Episode) -> float | None:
    """Seconds from when the risk is in view to the contact with it; ``None`` without either."""
    contact = next((event for event in episode.events if event.kind == "collision"), None)
    if contact is None or episode.recording is None:
        return None
    for tick, text in enumerate(episode.recording.explanations):
        if contact.subject in text.split():
            return contact.time - float(episode.time[tick])
    return None


def saved_by(drives: dict[str, Drive]) -> str:
    """What saves a run, of all drivers' drives of it."""
    if not drives["keeps on"][0]:
        return "no need"
    if not drives["brakes at sight"][0]:
        return "braking"
    return "caution" if not drives["comes slowly"][0] else "neither"


SAVED = ["no need", "braking", "caution", "neither"]
BANDS = [("below 0.8 s", 0.0, 0.8), ("0.8 to 1.5 s", 0.8, 1.5), ("1.5 to 4 s", 1.5, 4.1)]
BANDS += [("above", 4.1, math.inf)]
"""Of times to collision, which are multiples of 0.1 s; a careful driver needs 1.5 s."""
HEADERS = ["scenario", *SAVED, "time to collision s: least, quartiles, greatest"]
HEADERS += [*(name for name, _, _ in BANDS), "careful driver collides", "does not get through"]


def row(scenario: str, runs: list[dict[str, Drive]]) -> list[str]:
    """One scenario's cells, in the order of ``HEADERS``."""
    saved = Counter(saved_by(run) for run in runs)
    times = [time for run in runs if (time := run["keeps on"][1]) is not None]
    spread = "-"
    if len(times) > 1:
        spread = ", ".join(f"{each:.1f}" for each in (min(times), *quantiles(times), max(times)))
    parts = [sum(low <= time + 1e-6 < high for time in times) for _, low, high in BANDS]
    careful = [run["careful_driver"] for run in runs]
    stuck = sum(not hit and math.isnan(cleared) for hit, _, cleared in careful)
    counts = [*parts, sum(hit for hit, _, _ in careful), stuck]
    return [scenario, *(str(saved[name]) for name in SAVED), spread, *map(str, counts)]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--select", default="intersection/sudden/*")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    cases = expand_cases(load_library([]).scenarios, select=[options.select])
    numbers = range(options.runs)
    print(f"{machine()}\n\n{options.runs} runs a scenario, base seed {options.seed}\n", flush=True)
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for scenario in [case.scenario.name for case in cases]:
            keys = [(scenario, driver, n) for n in numbers for driver in DRIVERS]
            drives = dict(pool.map(drive, [(key, options.seed) for key in keys], chunksize=4))
            runs = [{d: drives[scenario, d, n] for d in DRIVERS} for n in numbers]
            rows.append(row(scenario, runs))
            print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    print(table(HEADERS, rows))


if __name__ == "__main__":
    main()
