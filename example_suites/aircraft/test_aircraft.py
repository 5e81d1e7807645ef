"""What a file cannot say: the simulator's contract, searches, and figures of single runs."""

import pytest
from aircraft.flight import C172, Controls

from pytest_dura import check_simulator

PITOT = ["freeze", "drift", "bias", "stuck-at"]


def test_the_simulator_keeps_its_contract():
    """Equal seeds give equal ticks, also in turbulence, and more."""
    world = C172.check_scenario({"assigned": 5000.0, "wind": 10.0, "turbulence": 4.0})
    check_simulator(C172, {"name": "a", "world": world}, [Controls(-0.1, 0.05, 0.8)] * 30)


@pytest.mark.dura(scenario="flight/climb", faults=["none"])
@pytest.mark.requirement("STALL-1")
def test_no_fault_of_the_pitot_tube_stalls_it(campaign):
    campaign.falsify(budget=20, faults=PITOT)


@pytest.mark.xfail(reason="the autopilot trusts one pitot tube", strict=True)
@pytest.mark.dura(scenario="flight/unprotected", faults=["none"])
@pytest.mark.requirement("STALL-1")
def test_nor_without_protection(campaign):
    campaign.falsify(budget=60, faults=PITOT)


@pytest.mark.dura(scenario="flight/static-blocked", runs=2)
@pytest.mark.requirement("TERR-1")
def test_a_blocked_static_port_costs_altitude_and_no_speed(episode):
    assert episode.signal("height").min() > 1000.0
    assert episode.signal("airspeed").min() > 70.0
