"""What a file cannot say: the simulator's contract, searches, and figures of single runs."""

import pytest
from arm.cell import Cell, Joints
from arm.roles import protective_distance

from pytest_dura import check_simulator

SCANNER = ["loss", "freeze", "drift", "gain", "bias", "stuck-at", "latency"]


def test_the_simulator_keeps_its_contract():
    world = Cell.check_scenario({"delay": 0.5})
    check_simulator(Cell, {"name": "a", "world": world}, [Joints(0.8, -0.4)] * 30)


def test_the_protective_distance_is_the_sum_of_its_parts():
    """By hand, at 1.5 m/s: 1.6 (0.2 + 0.3) + 1.5 0.2 + 1.5 0.3 / 2 + 0.85 + 0.1 m."""
    assert protective_distance(1.5, (1.5, 0.0)) == pytest.approx(2.275)


@pytest.mark.dura(scenario="cell/visit", faults=["none"])
@pytest.mark.requirement("CON-1")
def test_no_fault_of_one_of_two_scanners_leads_to_a_blow(campaign):
    campaign.falsify(budget=30, faults=SCANNER)


@pytest.mark.xfail(reason="one scanner can report a person as far away who is near", strict=True)
@pytest.mark.dura(scenario="cell/one-scanner", faults=["none"])
@pytest.mark.requirement("CON-1")
def test_nor_where_there_is_one_scanner(campaign):
    campaign.falsify(budget=60, faults=["freeze", "stuck-at"], shrink=40)


@pytest.mark.dura(scenario="cell/visit", runs=2)
@pytest.mark.requirement("SEP-1")
def test_it_slows_down_by_itself_and_is_not_stopped(episode):
    assert not episode.flagged
    assert episode.parts >= 3
