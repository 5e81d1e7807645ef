"""Tool confidence: requirements on recovery and monitor are violated by what they are about."""

from __future__ import annotations

from functools import cache

import pytest
from conclusions import concluded
from entries import make

from pytest_dura import CampaignVerdict, RoleSpec, Runner
from pytest_dura.core.codec import encode
from pytest_dura.evidence import Effectiveness
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.library import Range, Scenario, expand_cases, load_library
from pytest_dura.qualification import Gate, Qualification, planned_mutants

PLANNERS = {
    "REC-1": RoleSpec("reactive"),
    **dict.fromkeys(["REC-2", "REC-3", "REC-4"], RoleSpec("rule_based")),
    **dict.fromkeys(["REC-5", "MON-1"], RoleSpec("defects:BlindToPedestrians")),
}
"""`reactive` gives recovery much to do; it would keep it in control for long as it is. Who sees no
pedestrian needs it in each run."""
SCENARIO = Scenario(
    name="nobody-brakes",
    simulator="driving",
    duration=30.0,
    runs=4,
    world={
        "ego": {"distance": 50.0, "speed": 8.0, "turn": "straight"},
        "traffic": {"headway": 9.0, "arms": ["west", "east"]},
        "courtesy": "none",
    },
    requirements=("REC-1", "REC-2", "REC-3"),
)
"""Nobody brakes for a car that stands in the junction."""
ALONE = Scenario(
    name="alone",
    simulator="driving",
    duration=30.0,
    runs=5,
    world={"ego": {"distance": 50.0, "speed": 8.0}},
    variation={"world.ego.distance": Range(min=45.0, max=60.0)},
    requirements=("REC-4",),
)
"""Nobody is there. Fewer runs could not decide a rate of one half."""
WALKER = Scenario(
    name="walker",
    simulator="driving",
    duration=8.0,
    runs=15,
    world={
        "ego": {"distance": 45.0, "speed": 8.0},
        "pedestrians": [{"id": "P1", "arm": "south", "offset": 8.0, "start": 2.3}],
    },
    variation={"world.pedestrians.0.start": Range(min=2.25, max=2.35)},
    requirements=("SAF-1", "REC-5", "MON-1"),
)
"""14 runs without a failure are needed to decide a share of 80 %."""
NEVER_FORGIVES = RoleSpec("defects:NeverForgives")
DEFECTS = {
    "REC-1": {
        "recovery_planner": RoleSpec("defects:StandsInTheJunction"),
        "safety_monitor": NEVER_FORGIVES,
    },
    "REC-2": {"safety_monitor": NEVER_FORGIVES},
    "REC-3": {"safety_monitor": NEVER_FORGIVES},
    "REC-4": {"generator": RoleSpec("unreliable:HalfInvalid")},
    "REC-5": {"recovery_planner": RoleSpec("alert")},
    "MON-1": {
        "safety_monitor": RoleSpec(
            "pytest_dura.qualification.mutants.monitor:AlwaysSafe",
            {"of": {"path": "pytest_dura.driving.roles.safety:SeparationMonitor", "params": {}}},
        )
    },
}


@cache
def judged(requirement: str, *, defective: bool = False) -> CampaignVerdict:
    library = load_library([])
    roles = {"generator": PLANNERS[requirement]} | (DEFECTS[requirement] if defective else {})
    bench = Runner(lambda: library, roles=roles)
    (scenario,) = [one for one in (SCENARIO, ALONE, WALKER) if requirement in one.requirements]
    return bench.campaign(expand_cases([scenario])[0]).judge(library.requirements[requirement])


@pytest.mark.parametrize("requirement", DEFECTS)
def test_the_defect_violates_the_requirement_and_the_default_roles_do_not(requirement):
    assert judged(requirement).verdict == "supported"
    assert judged(requirement, defective=True).verdict == "violated"


def test_the_pairs_tell_what_the_recovery_introduced():
    sound, defective = judged("REC-1").pairs, judged("REC-1", defective=True).pairs
    assert sound.only_with == sound.only_without == 0
    assert sound.acted_neither > 0, "recovery must act for the comparison to say anything"
    assert defective.only_with > 0 == defective.only_without


def test_a_recovery_that_only_does_harm_is_seen_as_such_in_the_record():
    verdicts = [make(ItemVerdict, **encode(judged("REC-1", defective=True)))]
    (found,) = concluded(Effectiveness, verdicts=verdicts)["effectiveness"]
    assert found["finding"] == "introduced"
    assert found["detail"].startswith("nothing to prevent: 0 violations of REC-1 without it")
    assert "; of 4 pairs, introduced" in found["detail"]


def test_what_a_monitor_warned_of_counts_for_it_though_recovery_prevents_nothing():
    """And where its component needs no monitor, there is nothing to know of it."""
    library = load_library([])
    for roles, verdict in (
        ({"generator": PLANNERS["MON-1"], **DEFECTS["REC-5"]}, "supported"),
        ({"generator": RoleSpec("rule_based")}, "undecided"),
    ):
        bench = Runner(lambda: library, roles=roles)
        campaign = bench.campaign(expand_cases([WALKER])[0])
        assert campaign.judge(library.requirements["MON-1"]).verdict == verdict


def test_every_requirement_on_recovery_or_monitor_has_a_seeded_defect():
    known = load_library([]).requirements.values()
    assert {one.id for one in known if one.kind == "recovery"} | {"MON-1"} == set(DEFECTS)


@pytest.mark.parametrize(
    "name, requirement",
    [("safety_monitor.always_safe", "MON-1"), ("recovery_planner.nothing", "REC-5")],
)
def test_qualification_provokes_what_the_default_planner_never_needs(name, requirement):
    """With it alone, pairs hold nothing to warn of and nothing to prevent; three runs decide no
    rate either. What counts is a run of a provoker that violates it with the defect alone."""
    library = load_library([])
    scenario = library.scenarios["intersection/sudden/leader-brakes"]
    gate = Gate(expand_cases([scenario])[0], (library.requirements[requirement],))
    (mutant,) = (each for each in planned_mutants([gate]) if each.name == name)
    result = Qualification(Runner(lambda: library), [gate], runs=1).qualify(mutant)
    assert result.status == "caught"
    assert {(kill.requirement, kill.provoker) for kill in result.kills} == {
        (requirement, "aggressive")
    }
