"""What pytest-rerunfailures tries again."""

from __future__ import annotations

import pytest


@pytest.mark.dura(scenario="corridor/wall")
@pytest.mark.requirement("GAP-1")
def test_never_passes(campaign):
    campaign.require()


@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("GAP-1")
def test_passes_later(campaign, fails_first):
    campaign.require()
    assert not fails_first, "the first attempt"


@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("OWN-1", text="Each run stays away.")
def test_each_run_passes_later(episode, fails_first):
    assert not fails_first
    assert not episode.collided


@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("GO-1")
def test_passes_at_once(campaign):
    campaign.require()
