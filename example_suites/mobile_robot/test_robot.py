"""What a file cannot say: a search, and figures of single runs."""

import pytest


@pytest.mark.dura(scenario="room/posts", faults=["none"])
@pytest.mark.requirement("COL-1")
def test_no_place_of_the_posts_and_no_stuck_odometry_brings_it_down(campaign):
    campaign.falsify(budget=40, faults=["stuck-at"])


@pytest.mark.dura(scenario="field/rows", runs=2)
@pytest.mark.requirement("COL-1")
def test_it_keeps_a_hand_s_breadth_from_the_plants(episode):
    assert episode.arrival_time is not None
    assert episode.least_gap > 0.1
