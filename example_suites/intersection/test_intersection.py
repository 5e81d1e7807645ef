"""Requirements on the planner of this suite, as tests on single episodes and on campaigns."""

from __future__ import annotations

import pytest

from pytest_dura import Bench, Campaign, JudgedEpisode


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


def test_by_hand(orchestrator: Bench) -> None:
    """Any seed, with everything at hand that the episode recorded."""
    episode = orchestrator.run("intersection/nominal", seed=7)
    assert episode.signal("speed").max() <= 10.5
    assert all(event.kind != "component_failure" for event in episode.events)
