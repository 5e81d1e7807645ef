"""What the sensor's declared range and typical error mean for faults and searches."""

import pytest
from insulin_pump import Person, Pump

from pytest_dura import check_simulator


@pytest.mark.dura(scenario="insulin/day", faults=["drift"], runs=3)
@pytest.mark.requirement("LOW-1")
def test_a_drift_of_this_sensor_is_survived(campaign):
    """By default it ends at three typical errors, 27 mg/dL."""
    campaign.require()


@pytest.mark.dura(scenario="insulin/day", faults=["none"])
@pytest.mark.requirement("LOW-1")
def test_no_error_of_this_sensor_is_dangerous(campaign):
    """A search tries errors of up to ten typical ones."""
    campaign.falsify(faults=["drift", "bias", "noise", "gain"], budget=60)


def test_the_simulator_keeps_its_contract():
    """Equal seeds give equal ticks, and more."""
    world = {"glucose": 120.0, "meal": 100.0, "meal_at": 0.0}
    check_simulator(Person, {"name": "a", "world": world}, [Pump(16.0)] * 10, time_step=300.0)
