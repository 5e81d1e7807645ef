"""What cannot be decided."""

from __future__ import annotations

import pytest


@pytest.mark.dura(scenario="corridor/free", runs=5)
@pytest.mark.requirement("OWN-1", text="Hardly ever touches anything.", kind="safety")
def test_too_few(campaign):
    campaign.require("always (gap > 0)", at_most=0.05)


@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("OWN-2", text="Is looked at in winter.", kind="safety")
def test_skips_one_run(episode):
    if episode.spec.run == 1:
        pytest.skip("too cold")


@pytest.mark.dura(scenario="corridor/free", runs=2)
def test_asks_nothing(campaign):
    pass
