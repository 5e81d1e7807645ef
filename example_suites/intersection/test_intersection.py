"""Requirements on the planner of this suite, as tests on single episodes and on campaigns."""

from __future__ import annotations

import pytest

from pytest_dura import Campaign, JudgedEpisode, Runner


@pytest.mark.dura(scenario="intersection/nominal", runs=5)
@pytest.mark.requirement("SAF-1")
def test_never_collides(episode: JudgedEpisode) -> None:
    """One test case per run; the message of a failure holds the command that replays the run."""
    assert not episode.collided
    assert episode.robustness("always (gap >= 0.5)") > 0


@pytest.mark.dura(scenario="intersection/nominal", faults=["none", "ghost-obstacle"], runs=5)
@pytest.mark.requirement("OWN-1", text="Is through within 40 s, ghost or not", kind="performance")
def test_gets_through(episode: JudgedEpisode) -> None:
    """Two cases, with and without the attack, on the same seeds."""
    assert episode.ever("cleared")


@pytest.mark.dura(scenario="intersection/conflicting-traffic", runs=60)
@pytest.mark.requirement("OWN-2", text="Collides in at most 5 % of the crossings", kind="safety")
def test_collision_rate(campaign: Campaign) -> None:
    """One test case for 60 runs: 59 without a collision support 5 % at 95 % confidence."""
    campaign.require("always (gap > 0)", at_most=0.05, confidence=0.95)


@pytest.mark.dura(
    scenario="intersection/conflicting-traffic", runs={"until": "decided", "at_most": 100}
)
@pytest.mark.requirement("OWN-3", text="Comes near others in at most 5 %", kind="safety")
def test_near_misses(campaign: Campaign) -> None:
    """Runs end as soon as the rate is decided: after 74 without a near miss, or a few with many."""
    campaign.require("always (gap >= 0.5)", at_most=0.05, confidence=0.95)


@pytest.mark.dura(scenario="intersection/ghost-obstacle", runs=5)
@pytest.mark.requirement("OWN-4", text="A ghost costs it at most 20 s", kind="security")
def test_what_a_ghost_costs(campaign: Campaign) -> None:
    """Each run beside one of the same seed without the attack; only the difference is judged."""
    clearance = "pytest_dura.driving.measures:clearance_time"
    campaign.paired(without="faults").require(measure=clearance, change_at_most=20.0)


def test_by_hand(orchestrator: Runner) -> None:
    """Any seed, with everything at hand that the episode recorded."""
    episode = orchestrator.run("intersection/nominal", seed=7)
    assert episode.signal("speed").max() <= 10.5
    assert all(event.kind != "component_failure" for event in episode.events)
