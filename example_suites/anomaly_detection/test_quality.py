"""What each assessor detects, on the same seeds with and without the attack. It decides nothing."""

from __future__ import annotations

from statistics import median

import pytest
from anomaly_assessor import AnomalyAssessor
from test_detection import ATTACKS

from pytest_dura import Campaign, SecurityAssessor
from pytest_dura.driving import PlausibilityAssessor
from pytest_dura.requirements import judge_alerts, monitor_timeline

ASSESSORS = {"learned": AnomalyAssessor, "rules": PlausibilityAssessor}


@pytest.fixture(scope="session", params=ASSESSORS)
def security_assessor(request: pytest.FixtureRequest) -> type[SecurityAssessor]:
    return ASSESSORS[request.param]


@pytest.mark.dura(scenario="intersection/congested", faults=ATTACKS, runs=3, verdict=False)
def test_quality(campaign: Campaign, request: pytest.FixtureRequest) -> None:
    pairs = campaign.paired(without="faults")
    quality = judge_alerts(monitor_timeline(episode) for pair in pairs for episode in pair)
    attacked = quality.true_positives + quality.false_negatives
    free = quality.false_positives + quality.true_negatives
    print(
        f"| {campaign.case.id} | {request.node.callspec.params['security_assessor']}"
        f" | {quality.true_positives} of {attacked}"
        f" | {f'{median(quality.delays):.1f}' if quality.delays else '-'}"
        f" | {quality.false_positives} of {free} | {quality.hours:.2f} |"
    )
