"""What excuses a failure."""

from __future__ import annotations

import pytest


@pytest.mark.dura(scenario="corridor/wall")
@pytest.mark.requirement("GAP-1")
@pytest.mark.xfail(reason="ticket 7")
def test_expected(campaign):
    campaign.require()


@pytest.mark.dura(scenario="corridor/wall")
@pytest.mark.requirement("OWN-1", text="Each run stays away.")
@pytest.mark.xfail(reason="ticket 8", strict=True)
def test_each_run(episode):
    assert not episode.collided


@pytest.mark.dura(scenario="corridor/broken")
@pytest.mark.requirement("GAP-1")
@pytest.mark.xfail(reason="ticket 9")
def test_undecided(campaign):
    campaign.require()


@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
@pytest.mark.xfail(reason="ticket 10")
def test_unexpected_pass(campaign):
    campaign.require()


@pytest.mark.dura(scenario="corridor/biased")
@pytest.mark.requirement("GAP-1")
@pytest.mark.skip(reason="ticket 11")
def test_skipped(campaign):
    campaign.require()


@pytest.mark.dura(scenario="corridor/rated", runs=2)
@pytest.mark.requirement("OWN-2", text="Succeeds in the end.")
def test_retried(campaign, fails_first):
    campaign.require("always (x < 9)")
    assert not fails_first, "the first attempt"
