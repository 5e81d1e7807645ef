"""A key of a scenario that nothing would read is refused, wherever a script gives it."""

from __future__ import annotations

import pytest
from thermostat import Controller, Thermostat

from pytest_dura import EpisodeSpec, RoleSpec, check_role, check_simulator
from pytest_dura.core import ConfigurationError

PART = RoleSpec("thermostat:Thermostat")
USES = {
    "spec": lambda scenario: EpisodeSpec("room/a", 0, 0, PART, {}, scenario=scenario),
    "simulator": lambda scenario: check_simulator(Thermostat, scenario, [1.0] * 10),
    "role": lambda scenario: check_role(Controller, simulator=Thermostat, scenario=scenario),
}


@pytest.mark.parametrize("use", USES)
def test_it_is_refused_with_the_key_and_what_is_known(use) -> None:
    with pytest.raises(ConfigurationError) as caught:
        USES[use]({"wrld": {"start": 15.0}})
    error = caught.value
    assert (error.key, error.found) == ("scenario.wrld", "wrld")
    assert error.expected == "one of name, duration, iterations, world"
    assert error.remedy == "did you mean 'world'?"


@pytest.mark.parametrize("use", ["spec", "simulator"])
def test_what_stands_beside_the_scenario_is_named_as_such(use) -> None:
    with pytest.raises(ConfigurationError, match=r"the parameter time_step=\.\.\. beside"):
        USES[use]({"time_step": 0.5})


def test_what_the_simulator_reads_belongs_into_the_world() -> None:
    with pytest.raises(ConfigurationError, match="put what the simulator reads in `world`"):
        USES["spec"]({"traffic": {}})
