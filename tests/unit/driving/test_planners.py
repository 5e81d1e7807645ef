"""The four Generators: deterministic, on the percept alone, and wrong in the way they say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from roads import Views, car, car_on, channels_of, run, spec_of_drive, walker

from pytest_dura.core import (
    Generator,
    GeneratorView,
    Proposal,
    RoleContext,
    check_role,
    derive_seed,
)
from pytest_dura.driving import (
    MAX_ACCELERATION,
    MAX_BRAKING,
    Aggressive,
    Command,
    HighwaySimulator,
    Maneuver,
    RuleBased,
    acceleration_for,
)
from pytest_dura.driving.roles.planners import RandomPlanner, Reactive

FOUR = [RuleBased, Reactive, Aggressive, RandomPlanner]
WORLD: dict[str, Any] = {
    "ego": {"distance": 45.0, "speed": 8.0},
    "traffic": {"headway": 8.0},
    "pedestrians": [{"id": "P1", "start": 2.0}],
}


def ask(planner: Generator, *percepts: Any) -> tuple[Proposal, float]:
    """The proposal after these percepts, and the acceleration that it asks for."""
    planner.reset(RoleContext(1, 0.1))
    views = Views()
    for percept in percepts:
        proposal = planner.propose(views.generator(percept))
    speed, pose = percept["odometry"].speed, percept["localisation"]
    s, _ = percept["map"].route.project(pose.x, pose.y)
    return proposal, acceleration_for(Command.of(proposal.action), speed, 100.0 - s - 2.5)


@pytest.mark.parametrize("planner", FOUR)
def test_each_keeps_the_contract_of_a_role(planner: Any) -> None:
    check_role(planner, simulator=HighwaySimulator, scenario={"world": WORLD}, ticks=20)


class Guarded:
    """A view that has what a Generator may see, and fails where anything else is asked for."""

    def __init__(self, view: GeneratorView) -> None:
        self.index, self.time, self.dt, self.percept = view.index, view.time, view.dt, view.percept
        self.feedback = view.feedback


@pytest.mark.parametrize("planner", FOUR)
def test_each_sees_the_percept_and_no_ground_truth(planner: Any) -> None:
    view = Views().generator(channels_of(GHOST_AHEAD))
    assert not any(hasattr(view, name) for name in ("truth", "tick", "outputs", "percepts"))
    generator = planner()
    generator.reset(RoleContext(1, 0.1))
    expected = generator.propose(view)
    generator.reset(RoleContext(1, 0.1))
    assert generator.propose(Guarded(view)) == expected


@pytest.mark.parametrize("name", ["rule_based", "reactive", "aggressive", "random"])
def test_the_same_seed_gives_the_same_episode(name: str) -> None:
    spec = spec_of_drive(WORLD, generator=name, duration=8.0)
    one, other = run(spec), run(spec)
    assert one.failure is None
    assert one.digest == other.digest
    assert one.metrics.proposals == one.metrics.valid_proposals > 20


def test_random_draws_by_its_seed_and_holds_each_maneuver_for_half_a_second() -> None:
    def drawn(seed: int) -> list[str]:
        planner, views = RandomPlanner(), Views()
        planner.reset(RoleContext(seed, 0.1))
        return [str(planner.propose(views.generator(channels_of())).action) for _ in range(200)]

    one = drawn(1)
    assert drawn(1) == one
    assert drawn(2) != one
    assert set(one) == {maneuver.value for maneuver in Maneuver}
    assert all(len(set(one[i : i + 5])) == 1 for i in range(0, 200, 5))


def test_random_draws_do_not_depend_on_other_roles_or_the_road() -> None:
    def proposed(**options: Any) -> list[str]:
        found = run(spec_of_drive(generator="random", duration=3.0, **options))
        return found.decisions["proposed"].tolist()  # type: ignore[no-any-return]

    plain = proposed(world={})
    assert proposed(world={"traffic": {"headway": 9.0}}) == plain
    assert proposed(world={}, roles={"safety_monitor": None}) == plain
    assert derive_seed(5, "generator") != 5


def test_aggressive_never_gives_way() -> None:
    blocked = channels_of(car("V1", 2.0, 50.0), s=52.0)
    proposal, _ = ask(Aggressive(), blocked)
    assert proposal.action == Command(Maneuver.ACCELERATE)


GHOST_AHEAD = car("V9", 2.0, 50.0, -math.pi / 2)


def test_reactive_believes_a_ghost_that_radar_denies() -> None:
    empty = channels_of(s=52.0)
    ghost = channels_of(GHOST_AHEAD, s=52.0, radar=())
    assert ask(Reactive(), empty)[0].action.maneuver is Maneuver.PROCEED
    proposal, _ = ask(Reactive(), ghost)
    assert proposal.action.maneuver is Maneuver.EMERGENCY_BRAKE
    assert "V9" in proposal.explanation


def test_reactive_does_not_see_what_radar_alone_reports() -> None:
    radar_only = channels_of(s=52.0, radar=(GHOST_AHEAD,))
    assert ask(Reactive(), radar_only)[0].action.maneuver is Maneuver.PROCEED


def test_reactive_reacts_the_harder_the_nearer() -> None:
    maneuvers = [
        ask(Reactive(), channels_of(car("V1", 2.0, 59.0 - ahead), s=52.0))[0].action.maneuver
        for ahead in (55.0, 25.0, 12.0)
    ]
    assert maneuvers == [Maneuver.PROCEED, Maneuver.YIELD, Maneuver.EMERGENCY_BRAKE]


def test_rule_based_sees_a_car_that_radar_alone_reports() -> None:
    ahead = car("V1", 2.0, 45.0, -math.pi / 2)
    _, free = ask(RuleBased(), channels_of(s=52.0))
    _, seen = ask(RuleBased(), channels_of(ahead, s=52.0))
    _, radar_only = ask(RuleBased(), channels_of(s=52.0, radar=(ahead,)))
    assert seen < -1.0
    assert radar_only < -1.0
    assert free > -0.5


def test_rule_based_waits_for_a_car_on_the_crossing_road_that_radar_alone_reports() -> None:
    coming = car_on(1, "straight", 85.0, 8.0)
    proposal, _ = ask(RuleBased(), channels_of(s=95.0, speed=2.0, radar=(coming,)))
    assert "gives way" in proposal.explanation
    proposal, _ = ask(RuleBased(), channels_of(s=95.0, speed=2.0))
    assert "accepts the gap" in proposal.explanation


def test_rule_based_gives_way_and_says_to_whom() -> None:
    coming = car_on(3, "straight", 80.0, 8.0, name="V7")
    proposal, _ = ask(RuleBased(), channels_of(coming, s=95.0, speed=2.0))
    assert proposal.explanation == "gives way to V7"
    assert proposal.action.maneuver is Maneuver.WAIT


def test_rule_based_stops_for_a_pedestrian_on_its_path() -> None:
    crossing = channels_of(walker("P1", 3.5, 45.0, vx=-1.3), s=52.0, speed=8.0)
    proposal, acceleration = ask(RuleBased(), crossing)
    assert acceleration < -1.0
    assert "pedestrian" in proposal.explanation


def test_rule_based_crosses_an_empty_junction_swiftly_and_stops_for_nobody() -> None:
    episode = run(spec_of_drive({"ego": {"distance": 50.0}}, generator="rule_based", duration=30.0))
    assert episode.termination == "goal"
    assert episode.time[-1] < 15.0
    assert episode.signals["speed"].min() > 5.0
    assert not episode.flagged


def test_rule_based_asks_for_nothing_outside_the_envelope() -> None:
    rng = np.random.default_rng(4)
    planner, views = RuleBased(), Views()
    planner.reset(RoleContext(1, 0.1))
    for _ in range(150):
        bodies = [
            car(f"V{i}", *rng.uniform(-40, 40, 2), *rng.uniform([-4, 0], [4, 10])) for i in range(4)
        ]
        people = [walker("P1", *rng.uniform(-20, 20, 2), *rng.uniform(-1.5, 1.5, 2))]
        s, speed = float(rng.uniform(40, 150)), float(rng.uniform(0, 10))
        shown = channels_of(*bodies, *people, s=s, speed=speed, radar=bodies[1:])
        command = Command.of(planner.propose(views.generator(shown)).action)
        assert command.acceleration is not None
        assert -MAX_BRAKING <= command.acceleration <= MAX_ACCELERATION
        if command.maneuver is Maneuver.EMERGENCY_BRAKE:
            assert command.acceleration < 0.0
