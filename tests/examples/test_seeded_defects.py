"""Tool confidence: each built-in requirement is violated by the defect that it is about.

Each row sets a component with one seeded defect beside a sound one in the same world, in the real
simulator and without a recovery that could hide the defect. The whole catalogue judges both: the
sound one violates nothing, the defective one the requirement and only what follows from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
from handmade import handmade
from roads import spec_of_drive

from pytest_dura import Episode, RoleSpec
from pytest_dura.execution import run_episode
from pytest_dura.library import load_library
from pytest_dura.requirements import (
    Requirement,
    change_verdict,
    judge_episode,
    measured,
    pair_verdict,
)
from pytest_dura.requirements.runs import Run

RULE_BASED = RoleSpec("pytest_dura.driving.roles.planners:RuleBased")


CAREFUL = RoleSpec("pytest_dura.driving.roles.careful:CarefulDriver")


def defect(name: str, **params: Any) -> RoleSpec:
    return RoleSpec(f"defects:{name}", params)


@dataclass(frozen=True)
class Row:
    """A world, a sound component and a defective one, and what else the defect must violate.

    ``car`` is the defective car's simulator, where the defect is none of the component.
    """

    world: Mapping[str, Any]
    defective: RoleSpec
    sound: RoleSpec = RULE_BASED
    also: frozenset[str] = frozenset()
    faults: Sequence[Mapping[str, Any]] = ()
    duration: float = 62.0
    car: RoleSpec | None = None

    def run(self, *, defective: bool, attacked: bool = True) -> Episode:
        generator = self.defective if defective else self.sound
        car = self.car if defective else None
        return self.drive(generator, self.faults if attacked else (), car)

    def drive(
        self, generator: RoleSpec, faults: Sequence[Any] = (), car: RoleSpec | None = None
    ) -> Episode:
        spec = spec_of_drive(self.world, generator=generator, faults=faults, duration=self.duration)
        return run_episode(spec if car is None else replace(spec, simulator=car))


PEDESTRIAN = {
    "ego": {"distance": 45.0, "speed": 8.0},
    "pedestrians": [{"id": "P1", "arm": "south", "offset": 8.0, "start": 2.3}],
}
LEADER = {
    "ego": {"distance": 60.0, "speed": 9.0},
    "vehicles": [
        {"id": "LEADER", "arm": "south", "distance": 30.0},
        {"id": "WEST", "arm": "west", "distance": 45.0},
        {"id": "EAST", "arm": "east", "distance": 65.0},
    ],
}
PRIORITY = {"vehicles": [{"id": "WEST", "arm": "west", "distance": 60.0}]}
VICTIM = {
    "vehicles": [{"id": "VICTIM", "arm": "east", "distance": 55.0}],
    "courtesy": "none",
}
GHOST = {"type": "ghost-obstacle", "target": "lidar", "activation": {"at": 2.0}, "duration": 4.0}
SPOOF = {"type": "trajectory-spoof", "target": "lidar", "activation": {"at": 2.0}, "duration": 5.0}
HIDE = {
    "type": "object-miss", "target": "lidar", "activation": {"at": 0.0}, "duration": 8.0,
    "parameters": {"probability": 1.0},
}  # fmt: skip
NEVER_CLEARS = frozenset({"PERF-1", "PERF-5", "PERF-6"})
DELAYED = frozenset({"SEC-2", "SEC-4"})
COLLIDES = NEVER_CLEARS | {"SAF-1", "SAF-2", "SAF-5"}
STOPS_HARD = defect("StopsHard")

ROWS: dict[str, Row] = {
    "SAF-1": Row(PEDESTRIAN, defect("BlindToPedestrians"), also=COLLIDES),
    "SAF-2": Row(PEDESTRIAN, defect("StopsTooClose")),
    "SAF-3": Row(LEADER, defect("BrakesLate")),
    "SAF-4": Row(PRIORITY, defect("NeverGivesWay")),
    "SAF-5": Row(PEDESTRIAN, defect("BlindToPedestrians"), also=COLLIDES),
    "SEC-1": Row(VICTIM, defect("TrustsLidar"), also=COLLIDES | DELAYED, faults=[SPOOF]),
    "SEC-2": Row({}, defect("FreezesAtGhosts"), also=NEVER_CLEARS | DELAYED, faults=[GHOST]),
    "SEC-3": Row(PRIORITY, defect("TrustsLidar"), also=frozenset({"SAF-4"}), faults=[HIDE]),
    "SEC-4": Row({}, defect("FreezesAtGhosts"), also=NEVER_CLEARS | DELAYED, faults=[GHOST]),
    "PERF-1": Row({}, defect("AtSpeed", speed=8.0, stop_before=5.0), also=NEVER_CLEARS),
    "PERF-2": Row({}, STOPS_HARD, STOPS_HARD, car=defect("BrakesTooHard")),
    "PERF-3": Row({}, STOPS_HARD, STOPS_HARD, car=defect("BrakesAtOnce")),
    "PERF-4": Row(
        {"ego": {"distance": 20.0, "speed": 3.0, "turn": "right"}},
        defect("AtSpeed", speed=7.0),
        defect("AtSpeed", speed=3.0),
    ),
    "PERF-5": Row({}, defect("AtSpeed", speed=1.2)),
    "PERF-6": Row({}, defect("AtSpeed", speed=0.95), also=frozenset({"PERF-5"}), duration=90.0),
}
"""One row for each requirement of the built-in catalogue."""

ELSEWHERE = ("REC-", "MON-", "PERF-7", "SIM-")
"""Prefixes of the requirements whose seeded defects have a table of their own, or a test."""


@pytest.fixture(scope="module")
def catalogue() -> dict[str, Requirement]:
    return dict(load_library([]).requirements)


def judged(
    row: Row, catalogue: Mapping[str, Requirement], *, defective: bool
) -> tuple[Episode, dict[str, str]]:
    """An episode, and what it says of the catalogue's requirements with a row.

    Those on pairs compare it with its twin without the attack, where there is one.
    """
    episode = row.run(defective=defective)
    twin = row.run(defective=defective, attacked=False)
    assert episode.failure is twin.failure is None
    verdicts = {}
    for name in ROWS:
        requirement = catalogue[name]
        if requirement.paired is None:
            verdicts[name] = judge_episode(requirement, episode).verdict
        elif requirement.paired.reference:
            verdicts[name] = judged_pair(requirement, episode, row.drive(CAREFUL, row.faults))
        elif row.faults:
            verdicts[name] = judged_pair(requirement, episode, twin)
    return episode, verdicts


def judged_pair(requirement: Requirement, episode: Episode, twin: Episode) -> str:
    assert requirement.paired is not None
    measure = requirement.paired.measure
    if not measure:
        sides = (judge_episode(requirement, run) for run in (episode, twin))
        return pair_verdict(*sides).verdict
    values = measured(measure, episode), measured(measure, twin)
    return change_verdict(requirement, Run.of(episode), Run.of(twin), values).verdict


@pytest.mark.parametrize("requirement", sorted(ROWS))
def test_the_defect_violates_the_requirement_and_the_sound_component_none(
    requirement: str, catalogue: dict[str, Requirement]
) -> None:
    row = ROWS[requirement]
    _, sound = judged(row, catalogue, defective=False)
    assert set(sound.values()) == {"satisfied"}, sound
    defective, words = judged(row, catalogue, defective=True)
    violated = {name for name, word in words.items() if word == "violated"}
    assert violated == {requirement} | row.also
    # What was to hold always is open after a crash, which is critical; nothing else is undecided.
    others = {"satisfied", "open"} if defective.termination == "critical" else {"satisfied"}
    assert {words[name] for name in words.keys() - violated} <= others, words


@pytest.mark.parametrize("requirement", ["SAF-3", "SAF-4"])
def test_where_the_condition_holds_it_is_not_satisfied_in_vain(
    requirement: str, catalogue: dict[str, Requirement]
) -> None:
    sound = ROWS[requirement].run(defective=False)
    assert not judge_episode(catalogue[requirement], sound).vacuous
    alone = run_episode(spec_of_drive({}, generator=RULE_BASED))
    assert judge_episode(catalogue[requirement], alone).vacuous


def test_every_requirement_has_a_seeded_defect(catalogue: dict[str, Requirement]) -> None:
    assert {name for name in catalogue if not name.startswith(ELSEWHERE)} == set(ROWS)


def test_who_brakes_hard_needs_a_reason(
    catalogue: dict[str, Requirement],
) -> None:
    requirement = catalogue["PERF-7"]
    needless = run_episode(spec_of_drive({}, generator=STOPS_HARD))
    assert judge_episode(requirement, needless).verdict == "violated"
    needed = run_episode(spec_of_drive(LEADER, generator=defect("BrakesLate")))
    braking = needed.signal("acceleration") < -5.0
    assert braking.any()
    verdict = judge_episode(requirement, needed)
    assert (verdict.verdict, verdict.vacuous) == ("satisfied", False)
    gentle = run_episode(spec_of_drive({}, generator=RULE_BASED))
    assert judge_episode(requirement, gentle).verdict == "satisfied"


@pytest.mark.parametrize("before, verdict", [(20, "satisfied"), (21, "violated")])
def test_the_reason_may_lie_two_seconds_before(
    before: int, verdict: str, catalogue: dict[str, Requirement]
) -> None:
    acceleration, ttc = [0.0] * 40, [10.0] * 40
    acceleration[30], ttc[30 - before] = -6.0, 3.9
    episode = handmade(40, acceleration=acceleration, ttc=ttc)
    assert judge_episode(catalogue["PERF-7"], episode).verdict == verdict
