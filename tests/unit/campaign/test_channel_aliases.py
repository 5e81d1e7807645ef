"""Second names of channels in faults and conditions: the same case, episode and digest."""

from __future__ import annotations

from typing import Any

import pytest
from roads import run
from thermostat import Controller, Thermostat

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, RoleSpec
from pytest_dura.library import Case, Scenario, expand_cases
from pytest_dura.library.checks import scenario_problems


def cases_of(name: str, chosen: Any = None, **fields: Any) -> list[Case]:
    """Cases of a scenario in which ``CHANNEL`` is this name."""

    def named(data: Any) -> Any:
        if isinstance(data, str):
            return data.replace("CHANNEL", name)
        if isinstance(data, dict):
            return {key: named(value) for key, value in data.items()}
        return [named(each) for each in data] if isinstance(data, list) else data

    scenario = Scenario.model_validate(
        {"name": "cross", "simulator": "driving", "duration": 6.0, **named(fields)}
    )
    assert scenario_problems(scenario) == []
    return expand_cases([scenario], named(chosen))


GHOST = {"type": "ghost-obstacle", "target": "CHANNEL", "activation": {"at": 1.0}}
WHEN = {
    "type": "bias",
    "target": "odometry.speed",
    "activation": {"when": "odometry.speed > 1 and CHANNEL.count >= 1"},
    "duration": {"until": "abs(odometry.speed) < 0.5 and CHANNEL.count > 9", "at_most": 3.0},
}
DIRECTED = GHOST | {"activation": {"when": "CHANNEL.count >= 1", "by": "security_assessor"}}


@pytest.mark.parametrize(
    "faults",
    [
        [GHOST],
        [WHEN],
        [DIRECTED],
        [{"fault": {"type": "delay", "activation": {"at": 1.0}},
          "grid": {"target": ["CHANNEL", "radar"]}}],
        [{"fault": {"type": "delay", "target": "CHANNEL", "activation": {"at": 1.0}},
          "sample": {"parameters.s": {"min": 0.1, "max": 0.5}}, "count": 2}],
    ],
    ids=["target", "conditions", "directed", "grid", "sample"],
)  # fmt: skip
def test_faults_by_either_name_make_the_same_cases(faults: Any) -> None:
    own, second = cases_of("lidar", faults), cases_of("objects", faults)
    assert [(case.id, case.faults) for case in own] == [(case.id, case.faults) for case in second]
    assert [case.spec(0, 5).key for case in own] == [case.spec(0, 5).key for case in second]
    assert "objects" not in str([case.faults for case in second])


def test_a_varied_target_is_drawn_as_the_same_channel() -> None:
    varied = {"faults.late.target": {"choice": ["CHANNEL", "radar"]}}
    late = {"type": "delay", "id": "late", "target": "radar", "activation": {"at": 1.0}}
    cases = [cases_of(name, faults=[late], variation=varied)[0] for name in ("lidar", "objects")]
    keys = [[case.spec(number, 5).key for number in range(6)] for case in cases]
    assert keys[0] == keys[1]
    targets = {case.spec(number, 5).faults[0].target for case in cases for number in range(6)}
    assert targets == {"lidar", "radar"}


def test_an_episode_attacked_by_either_name_has_one_digest() -> None:
    own, second = (run(cases_of(name, [GHOST])[0].spec(0, 5)) for name in ("lidar", "objects"))
    assert own.digest == second.digest
    assert second.faults[0].target == "lidar"
    assert second.faults[0].manifested_at is not None


def test_a_target_that_is_neither_name_is_refused_as_before() -> None:
    fault = GHOST | {"target": "object"}
    scenario = Scenario.model_validate({"name": "c", "simulator": "driving", "duration": 6.0})
    with pytest.raises(ConfigurationError, match="there is no channel 'object'"):
        expand_cases([scenario], [fault])


def test_an_alias_of_no_channel_ends_no_run_but_the_session() -> None:
    class Misnamed(Thermostat):
        channel_aliases = {"warmth": "thermometre"}  # noqa: RUF012 - as the base declares it

    spec = EpisodeSpec("room/x", 0, 1, RoleSpec("thermostat:Thermostat"), {})
    with pytest.raises(ConfigurationError, match="there is no channel 'thermometre'"):
        Orchestrator(Misnamed(), {"generator": Controller()}).run(spec)
