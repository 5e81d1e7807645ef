"""PlausibilityAssessor: no false alarms, each pattern, and the classes of reaction."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from roads import SCENARIOS, SIX, Views, car, car_on, channels_of, run, spec_of_drive

from pytest_dura import Episode
from pytest_dura.core import (
    Assessed,
    Generator,
    Proposal,
    RoleContext,
    RoleSpec,
    SecurityAssessment,
    check_role,
)
from pytest_dura.driving import Command, HighwaySimulator, Maneuver, PlausibilityAssessor
from pytest_dura.faults import parse_fault
from pytest_dura.library import expand_cases, load_scenarios

SEEDS = range(4)


def alerts_of(episode: Episode) -> list[tuple[float, str, str]]:
    """Time, subject and pattern of each alert."""
    return [
        (event.time, event.subject, event.detail.split(":")[0])
        for event in episode.events
        if event.kind == "alert"
    ]


class Looker:
    """An assessor that is shown percepts one by one."""

    def __init__(self, *faults: Any) -> None:
        self.assessor, self.views = PlausibilityAssessor(), Views()
        self.assessor.reset(RoleContext(1, 0.1, {}, faults))

    def look(self, percept: Any, action: Any = "proceed") -> SecurityAssessment:
        return self.assessor.run(self.views.role(percept, action))

    def patterns(self, percept: Any, action: Any = "proceed") -> list[tuple[str, str]]:
        return [(alert.pattern, alert.subject) for alert in self.look(percept, action).alerts]


def test_it_keeps_the_contract_of_a_role() -> None:
    world = {"traffic": {"headway": 6.0}}
    faults = (parse_fault({"type": "ghost-obstacle", "activation": {"at": 1.0}}),)
    context = RoleContext(1, 0.1, {"world": world}, faults)
    check_role(
        PlausibilityAssessor,
        simulator=HighwaySimulator,
        scenario={"world": world},
        context=context,
        ticks=30,
    )


@pytest.mark.parametrize("name", SIX)
def test_no_false_alarms_in_clean_episodes(name: str) -> None:
    scenarios = load_scenarios([SCENARIOS / "intersection"])
    (case,) = expand_cases([scenarios[name]], ["none"])
    for run_number in SEEDS:
        episode = run(case.spec(run_number, 2024))
        assert episode.failure is None
        assert alerts_of(episode) == []


@pytest.mark.parametrize("seed", range(3))
def test_no_false_alarms_while_everybody_turns(seed: int) -> None:
    turns = {"left": 1.0, "straight": 0.01, "right": 1.0}
    world = {
        "ego": {"distance": 30.0, "speed": 6.0, "turn": "left"},
        "traffic": {"headway": 5.0, "turns": turns, "arms": ["west", "north", "east", "south"]},
    }
    for generator in ("rule_based", "random"):
        spec = spec_of_drive(world, generator=generator, seed=seed, duration=25.0)
        episode = run(spec)
        assert episode.failure is None
        assert alerts_of(episode) == []


def test_an_object_from_nowhere_is_alerted_at_once() -> None:
    looker = Looker()
    known = car_on(1, "straight", 60.0, 8.0)
    assert looker.patterns(channels_of(known)) == [], "the first percept has no before"
    ghost = car("V9", 2.0, 40.0)
    found = looker.patterns(channels_of(known, ghost))
    assert ("object_from_nowhere", "V9") in found
    assert ("object_from_nowhere", "V1") not in found
    verdict = Looker()
    verdict.look(channels_of())
    assert verdict.look(channels_of(ghost)).verdict is Assessed.WARNING


@pytest.mark.parametrize(
    "newcomer",
    [car_on(0, "straight", 0.5, 8.0), car_on(1, "straight", 5.0, 8.0), car("V1", 2.0, -18.5)],
    ids=["behind, at the road's end", "side road's end", "comes into reach"],
)
def test_newcomers_at_the_edge_are_nothing_special(newcomer: Any) -> None:
    looker = Looker()
    looker.look(channels_of())
    assert looker.patterns(channels_of(newcomer)) == []


def moving(steps: float, **change: Any) -> Any:
    """A car that drives east at 8 m/s, after so many tenths of a second, as reported."""
    body = car("V1", -30.0 + 0.8 * steps, 2.0, 0.0, 8.0)
    return replace_body(body, **change)


def replace_body(body: Any, **change: Any) -> Any:
    return body._replace(**change)


def test_a_velocity_that_contradicts_displacement_is_alerted_at_the_next_tick() -> None:
    looker = Looker()
    for step in range(3):
        assert looker.patterns(channels_of(moving(step))) == []
    lying = moving(3, vx=2.0)
    found = looker.patterns(channels_of(lying, radar=[lying]))
    assert found == [("velocity_contradicts_displacement", "V1")]
    jumped = moving(9)
    found = Looker()
    found.look(channels_of(moving(0)))
    assert found.patterns(channels_of(jumped)) == [("velocity_contradicts_displacement", "V1")]


def test_small_differences_of_velocity_are_within_what_turning_gives() -> None:
    looker = Looker()
    for step in range(5):
        assert looker.patterns(channels_of(moving(step, vy=2.5))) == []


@pytest.mark.parametrize(
    "lidar, radar, subject",
    [
        ([], [car("X", 2.0, 40.0)], "radar"),
        ([car("V1", 2.0, 40.0)], [], "V1"),
        ([car("V1", 2.0, 40.0)], [car("V1", 6.0, 40.0)], "V1"),
        ([car("V1", 2.0, 40.0, -math.pi / 2, 8.0)], [car("V1", 2.0, 40.0)], "V1"),
    ],
    ids=["radar alone", "lidar alone", "places apart", "rates apart"],
)
def test_lidar_against_radar_is_alerted_when_it_lasts(
    lidar: list[Any], radar: list[Any], subject: str
) -> None:
    looker = Looker()
    percept = channels_of(*lidar, radar=radar)
    assert looker.patterns(percept) == [], "one tick may be noise"
    still = [body._replace(x=body.x + body.vx * 0.1, y=body.y + body.vy * 0.1) for body in lidar]
    found = looker.patterns(channels_of(*still, radar=radar))
    assert ("lidar_contradicts_radar", subject) in found


def test_agreement_in_between_starts_the_count_anew() -> None:
    looker = Looker()
    body = car("V1", 2.0, 40.0)
    for shown in ([], [body], [], [body], []):
        assert looker.patterns(channels_of(body, radar=shown)) == []


def test_an_object_at_the_edge_of_reach_need_not_be_confirmed() -> None:
    looker = Looker()
    for _ in range(4):
        assert looker.patterns(channels_of(car("V1", 2.0, -18.0), radar=[])) == []


@pytest.mark.parametrize(
    "action, told",
    [
        (Command(Maneuver.PROCEED, 4.5), "asks for 4.5"),
        (Command(Maneuver.WAIT, -9.0), "asks for -9.0"),
        (Command(Maneuver.EMERGENCY_BRAKE, 1.0), "says emergency_brake and asks for 1.0"),
    ],
)
def test_a_command_outside_its_envelope_is_alerted(action: Command, told: str) -> None:
    looker = Looker()
    (alert,) = looker.look(channels_of(), action).alerts
    assert (alert.pattern, alert.subject) == ("command_outside_envelope", "generator")
    assert told in alert.detail


@pytest.mark.parametrize(
    "action",
    [*Maneuver, Command(Maneuver.PROCEED, 4.0), Command(Maneuver.EMERGENCY_BRAKE, -8.0)],
    ids=str,
)
def test_commands_within_the_envelope_are_fine(action: Any) -> None:
    assert Looker().patterns(channels_of(), action) == []


def test_a_lasting_suspicion_is_alerted_once_and_anew_after_a_quiet_second() -> None:
    looker = Looker()
    wild, calm = Command(Maneuver.PROCEED, 9.0), Command(Maneuver.PROCEED, 0.0)
    told = [len(looker.look(channels_of(), wild).alerts) for _ in range(20)]
    assert told == [1] + [0] * 19
    for _ in range(12):
        assert looker.look(channels_of(), calm).alerts == ()
    assert len(looker.look(channels_of(), wild).alerts) == 1


def test_a_refined_proposal_is_checked_and_the_percept_is_not_judged_twice() -> None:
    looker = Looker()
    looker.look(channels_of())
    ghost = channels_of(car("V9", 2.0, 40.0))
    first = looker.look(ghost, Command(Maneuver.PROCEED, 9.0))
    assert {alert.pattern for alert in first.alerts} == {
        "object_from_nowhere",
        "command_outside_envelope",
    }
    again = looker.assessor.run(looker.views.again("wait"))
    assert again.score == -1.0, (
        "the suspicion about the percept stands, that of the command is gone"
    )
    assert again.alerts == ()
    unconfirmed = Looker()
    unconfirmed.look(channels_of(car("V9", 2.0, 40.0), radar=[]))
    for action in ("wait", "proceed", "wait"):
        refined = unconfirmed.assessor.run(unconfirmed.views.again(action))
        assert refined.alerts == (), "three looks at one tick are no three ticks"


def test_it_directs_what_it_is_planned_to_direct() -> None:
    mine = parse_fault(
        {
            "type": "ghost-obstacle",
            "activation": {"at": 0.5, "every": 1.0, "by": "security_assessor"},
        }
    )
    other = parse_fault({"type": "trajectory-spoof", "activation": {"at": 0.5}})
    looker = Looker(mine, other)
    directed = [looker.look(channels_of()).directives for _ in range(30)]
    assert [index for index, names in enumerate(directed) if names] == [4, 14, 24]
    assert set(directed) == {(), ("ghost-obstacle",)}


GHOST = {"type": "ghost-obstacle", "activation": {"at": 2.0}, "duration": 3.0}
SPOOF = {"type": "trajectory-spoof", "activation": {"at": 2.0}, "duration": 3.0}
WORLD: dict[str, Any] = {
    "ego": {"distance": 80.0, "speed": 8.0},
    "vehicles": [{"id": "E", "arm": "east", "distance": 70.0}],
}


class Reader(Generator):
    """Reads lidar and does what :meth:`act` says."""

    def propose(self, view: Any) -> Proposal:
        """Look, and act."""
        _ = view.percept["lidar"]
        return Proposal(Command(self.act(view)))

    def act(self, view: Any) -> Maneuver:
        """Drive on."""
        return Maneuver.PROCEED


class Alternating(Reader):
    """Brakes and goes by turns once there is somebody new."""

    def act(self, view: Any) -> Maneuver:
        """Every other tick."""
        seen = len(view.percept["lidar"]) > 1
        return Maneuver.EMERGENCY_BRAKE if seen and view.index % 2 else Maneuver.PROCEED


class Frozen(Reader):
    """Stops for ever once it has seen somebody new."""

    def reset(self, context: Any) -> None:
        """Thaw."""
        self._frozen = False

    def act(self, view: Any) -> Maneuver:
        """Stand."""
        self._frozen |= len(view.percept["lidar"]) > 1
        return Maneuver.EMERGENCY_BRAKE if self._frozen else Maneuver.PROCEED


def reactions(generator: str, fault: Any = GHOST) -> list[str]:
    spec = spec_of_drive(WORLD, generator=RoleSpec(generator), faults=[fault], duration=14.0)
    episode = run(spec)
    assert episode.failure is None
    return [event.detail for event in episode.events if event.kind == "reaction"]


@pytest.mark.parametrize(
    "generator, expected",
    [
        ("pytest_dura.driving.roles.planners:Aggressive", "unaffected"),
        ("test_plausibility:Reader", "unaffected"),
        ("pytest_dura.driving.roles.planners:Reactive", "follows the fake"),
        ("test_plausibility:Alternating", "erratic"),
        ("test_plausibility:Frozen", "frozen"),
    ],
)
def test_each_class_of_reaction_is_reached(generator: str, expected: str) -> None:
    assert reactions(generator) == [expected]


@pytest.mark.parametrize("fault", [GHOST, SPOOF], ids=["ghost", "spoof"])
@pytest.mark.parametrize("seed", range(3))
def test_attacks_are_detected_soon_after_their_effect(fault: Any, seed: int) -> None:
    world = {**WORLD, "traffic": {"headway": 8.0}}
    spec = spec_of_drive(
        world,
        generator=RoleSpec("test_plausibility:Reader"),
        faults=[fault],
        seed=seed,
        duration=8.0,
    )
    episode = run(spec)
    (record,) = episode.faults
    assert record.detected_at is not None
    assert record.manifested_at is not None
    assert 0.0 <= record.detected_at - record.manifested_at <= 0.2 + 1e-9
    assert record.detected_by is not None
    times = [time for time, _, _ in alerts_of(episode)]
    assert min(times) >= 2.0 - 1e-9
    assert np.max(times) <= 2.0 + 3.0 + 0.3


def test_the_patterns_of_the_two_attacks() -> None:
    def patterns(fault: Any) -> set[str]:
        spec = spec_of_drive(
            WORLD, generator=RoleSpec("test_plausibility:Reader"), faults=[fault], duration=8.0
        )
        return {pattern for _, _, pattern in alerts_of(run(spec))}

    assert patterns(GHOST) == {"object_from_nowhere", "lidar_contradicts_radar"}
    assert patterns(SPOOF) == {"velocity_contradicts_displacement", "lidar_contradicts_radar"}


def test_an_alert_alone_does_not_start_recovery() -> None:
    episode = run(
        spec_of_drive(
            {"ego": {"distance": 90.0, "speed": 4.0}},
            generator=RoleSpec("test_plausibility:Reader"),
            faults=[{**GHOST, "parameters": {"ahead": 60.0}}],
            duration=4.0,
            policy="recover",
        )
    )
    assert alerts_of(episode)
    assert not episode.flagged
    assert (episode.decisions["source"] == "proposal").all()
    assert replace(SecurityAssessment(), verdict=Assessed.WARNING).verdict < Assessed.UNSAFE


@pytest.mark.parametrize("escalate", [False, True])
def test_a_suspicion_starts_recovery_only_where_it_escalates(escalate: bool) -> None:
    assessor = RoleSpec(
        "pytest_dura.driving.roles.security:PlausibilityAssessor", {"escalate": escalate}
    )
    roles = {"security_assessor": assessor, "safety_monitor": None}
    spec = spec_of_drive(
        WORLD, generator="aggressive", faults=[GHOST], policy="recover", roles=roles, duration=6.0
    )
    episode = run(spec)
    assert episode.metrics.alerts > 0
    recoveries = [event.time for event in episode.events if event.kind == "recovery"]
    assert bool(recoveries) == escalate
    assert not escalate or recoveries[0] == pytest.approx(2.0), "where the ghost appears"
