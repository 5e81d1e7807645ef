"""Pairs of runs with equal seeds: with something, and without it."""

from __future__ import annotations

import pytest


@pytest.mark.dura(scenario="corridor/harm")
def test_harm(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > 0)")


@pytest.mark.dura(scenario="corridor/help")
def test_help(campaign):
    pairs = campaign.paired(without="recovery_planner")
    assert pairs.counts("always (gap > 0)").only_without == 3
    pairs.require("always (gap > 0)")


@pytest.mark.dura(scenario="corridor/help")
def test_rate(campaign):
    campaign.paired(without="recovery_planner").require(
        "always (gap > 0.1)", at_most=0.1, confidence=0.9
    )


@pytest.mark.dura(scenario="corridor/harm")
def test_cost(campaign):
    pairs = campaign.paired(without="recovery_planner")
    pairs.require(measure="corridor:farthest", change_at_most=0.5)


@pytest.mark.dura(scenario="corridor/biased")
def test_fault(campaign):
    pairs = campaign.paired(without="faults")
    pairs.require(measure="corridor:farthest", change_at_most=1.0)
