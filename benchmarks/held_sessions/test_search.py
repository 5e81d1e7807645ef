"""Searches for counterexamples, of which one is successful."""

from __future__ import annotations

import pytest


@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
def test_search(campaign):
    campaign.falsify(budget=60)


@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.falsify("always (x < 50)", budget=10)
def test_marked(campaign):
    pass
