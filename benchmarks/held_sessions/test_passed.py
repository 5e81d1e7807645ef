"""What a project asks of a component that does well."""

from __future__ import annotations

import pytest
from hypothesis import given

from pytest_dura import strategies


@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("OWN-1", text="Each run stays away.", kind="safety", mitigates=["H-2"])
def test_each_run(episode):
    assert not episode.collided
    assert episode.robustness("always (gap >= 0.5)") > 0


@pytest.mark.dura(scenario="corridor/free", runs=20)
@pytest.mark.requirement("OWN-2", text="Rarely touches anything.", kind="safety")
def test_rate(campaign):
    campaign.require("always (gap > 0)", at_most=0.9)


@pytest.mark.dura(scenario="corridor/biased", runs=2)
@pytest.mark.requirement("OWN-3", text="Keeps half a metre.", kind="safety")
def test_own_check(campaign):
    campaign.require("corridor:half_a_metre")


def test_by_hand(orchestrator):
    assert not orchestrator.run("corridor/free", seed=7).collided


@pytest.mark.dura(verdict=False)
@given(case=strategies.cases("corridor/free"))
def test_holds_everywhere(case, run_episode):
    assert not run_episode(case).collided
