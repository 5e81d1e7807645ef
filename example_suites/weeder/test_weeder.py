"""What a file cannot say: the simulator's contract, searches, and figures of single runs."""

import pytest
from weeder.field import Command, Field

from pytest_dura import check_simulator

SENSORS = ("camera.distance", "camera.offset", "gnss.x", "gnss.y")
FAULTS = [{"type": kind, "target": target, "activation": {"at": 3.0}, "duration": 8.0}
          for target in SENSORS for kind in ("bias", "drift")]  # fmt: skip


def test_the_simulator_keeps_its_contract():
    world = Field.check_scenario({"confusion": 0.2, "slip": 0.3, "animal": {"x": 2.0}})
    check_simulator(Field, {"name": "a", "world": world}, [Command(0.4, 0.1, 1.0)] * 40)


@pytest.mark.dura(scenario="field/row", faults=["none"])
@pytest.mark.requirement("CROP-1")
def test_no_fault_of_one_sensor_costs_the_crop(campaign):
    campaign.falsify(budget=25, faults=FAULTS)


@pytest.mark.xfail(reason="the planner believes its camera", strict=True)
@pytest.mark.dura(scenario="field/unwatched", faults=["none"])
@pytest.mark.requirement("CROP-1")
def test_nor_without_a_monitor(campaign):
    campaign.falsify(budget=60, faults=FAULTS, shrink=40)


@pytest.mark.dura(scenario="field/fawn", runs=2)
@pytest.mark.requirement("ANI-1")
def test_it_stops_before_the_fawn_by_itself(episode):
    assert not episode.flagged
    assert episode.signal("animal_gap").min() > 1.0
