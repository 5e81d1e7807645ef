"""Cases, their ids, and the specs of their episodes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from shaft import IN_SHAFT

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, Policy, RoleSpec, derive_seed
from pytest_dura.core import STANDARD_ROLES
from pytest_dura.domains import DOMAINS, role_spec
from pytest_dura.library import Case, Scenario, expand_cases

BIAS = {"type": "bias", "activation": {"at": 2.0}, "duration": 4.0}
DRIFT = {"type": "drift", "id": "slow", "activation": {"at": 1.0}}
VARIATION = {
    "world.floor": {"min": 4.0, "max": 8.0},
    "faults.bias.activation.at": {"min": 1.5, "max": 3.0},
}


def make(name: str = "cross", **fields: Any) -> Scenario:
    """A scenario of the lift, unless the fields name another simulator."""
    domain = {} if "simulator" in fields else IN_SHAFT
    return Scenario.model_validate({"name": name, "duration": 40.0, **domain, **fields})


def drive(**fields: Any) -> Scenario:
    """A scenario of the domain whose roles have short names."""
    return make(**{"simulator": "driving", **fields})


def ids(scenario: Scenario, faults: Any = None, select: Any = ()) -> list[str]:
    return [case.id for case in expand_cases([scenario], faults, select)]


def only(scenario: Scenario, faults: Any = None) -> Case:
    (case,) = expand_cases([scenario], faults)
    return case


@pytest.mark.parametrize(
    "own, faults, expected",
    [
        ([], None, ["cross"]),
        ([BIAS], None, ["cross"]),
        ([], ["none"], ["cross"]),
        ([BIAS], ["none"], ["cross+none"]),
        ([], ["bias"], ["cross+bias"]),
        ([BIAS], ["bias"], ["cross"]),
        ([BIAS], ["drift"], ["cross+drift"]),
        ([DRIFT], ["slow"], ["cross"]),
        ([DRIFT], ["drift"], ["cross+drift"]),
        ([BIAS, DRIFT], [["slow", "bias"]], ["cross"]),
        ([BIAS, DRIFT], ["bias"], ["cross+bias"]),
        (
            [],
            [["bias", "drift"]],
            ["cross+bias+drift"],
        ),
        (
            [],
            ["bias+drift"],
            ["cross+bias+drift"],
        ),
        ([], ["none", "bias", "none"], ["cross", "cross+bias"]),
        ([], [["bias", "bias"]], ["cross+bias"]),
        ([], [{**BIAS, "id": "near"}], ["cross+near"]),
        ([BIAS], [], []),
    ],
)
def test_case_ids(own: list[Any], faults: Any, expected: list[str]) -> None:
    assert ids(make(faults=own), faults) == expected


def test_cases_are_sorted_by_scenario_and_keep_the_order_of_campaigns() -> None:
    scenarios = [make("b"), make("a")]
    cases = expand_cases(scenarios, ["drift", "none"])
    assert [case.id for case in cases] == ["a+drift", "a", "b+drift", "b"]
    as_mapping = expand_cases({one.name: one for one in scenarios}, ["drift", "none"])
    assert as_mapping == cases


def test_a_case_carries_faults_with_defaults_and_requirements() -> None:
    case = only(make(faults=[BIAS], requirements=["SAF-1"]))
    (fault,) = case.faults
    assert fault.id == "bias"
    assert fault.target == "encoder.height"
    assert fault.parameters["offset"] == 1.0
    assert case.requirements == ("SAF-1",)


def test_a_name_means_the_scenarios_own_fault_before_the_catalogues() -> None:
    own = {**BIAS, "duration": 1.25}
    case = only(make(faults=[own, DRIFT]), ["bias"])
    assert case.faults[0].duration == 1.25


def test_an_unknown_fault() -> None:
    with pytest.raises(ConfigurationError) as caught:
        ids(make(), ["bais"])
    assert caught.value.key == "faults"
    assert caught.value.remedy == "did you mean 'bias'?"
    assert "drift" in str(caught.value.expected)


def test_none_stands_alone() -> None:
    with pytest.raises(ConfigurationError, match="'none' is a campaign by itself"):
        ids(make(), [["none", "bias"]])


def test_two_faults_of_one_id_need_names_of_their_own() -> None:
    with pytest.raises(ConfigurationError, match="two faults of one campaign"):
        ids(make(), [["bias", {**BIAS, "duration": 9.0}]])
    with pytest.raises(ConfigurationError, match="two fault campaigns make the same case"):
        ids(make(), ["bias", {**BIAS, "duration": 9.0}])


def test_a_case_is_selected_by_its_id_and_several_by_a_pattern() -> None:
    scenario = make(faults=[BIAS])
    faults = ["none", "bias", "drift"]
    every = ["cross+none", "cross", "cross+drift"]
    assert ids(scenario, faults, ["cross"]) == ["cross"], "the case alone, not those like it"
    assert ids(scenario, faults, ["cross*"]) == every
    assert ids(scenario, faults, ["*none", "*drift"]) == ["cross+none", "cross+drift"]
    with pytest.raises(ConfigurationError, match="no case matches 'cros'") as caught:
        ids(scenario, faults, ["cros"])
    assert caught.value.remedy == "did you mean 'cross'?"


def test_a_spec_is_plain_data_and_survives_json() -> None:
    scenario = make(faults=[BIAS], variation=VARIATION, policy="refine(2)")
    spec = only(scenario).spec(3, 7)
    assert EpisodeSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec
    assert spec.id == "cross#3"
    assert spec.policy == Policy("refine", 2)
    assert spec.termination.time_limit == 40.0
    assert spec.scenario["name"] == "cross"
    assert spec.scenario["world"]["start"] == 0.0  # as the domain's world has it


def test_what_a_scenario_says_of_time_and_end_reaches_the_spec() -> None:
    scenario = make(time_step=0.2, time_budget=None, end_at_violation=True)
    spec = only(scenario).spec(0, 1)
    assert (spec.time_step, spec.time_budget) == (0.2, None)
    assert spec.termination.violation


def test_arms_with_and_without_faults_share_seeds_and_worlds() -> None:
    scenario = make(faults=[BIAS], variation=VARIATION)
    arms = expand_cases([scenario], ["none", "bias", "drift"])
    specs = [case.spec(4, 11) for case in arms]
    assert {spec.seed for spec in specs} == {derive_seed(11, "cross", 4)}
    assert len({json.dumps(spec.scenario) for spec in specs}) == 1
    assert len({spec.key for spec in specs}) == 3


def test_variation_differs_between_runs_and_stays_in_its_range() -> None:
    scenario = make(faults=[BIAS], variation=VARIATION)
    specs = [only(scenario).spec(run, 1) for run in range(20)]
    floors = [spec.scenario["world"]["floor"] for spec in specs]
    times = [spec.faults[0].activation["at"] for spec in specs]
    assert len(set(floors)) == len(set(times)) == 20
    assert all(4.0 <= value <= 8.0 for value in floors)
    assert all(1.5 <= value <= 3.0 for value in times)
    assert max(floors) - min(floors) > 2.0


def test_a_path_more_shifts_no_other_path() -> None:
    floor = {"world.floor": {"min": 4.0, "max": 8.0}}
    first = make(variation=floor)
    both = make(variation={"world.start": {"min": 0.5, "max": 2.0}, **floor})
    one, two = (only(s).spec(0, 1).scenario["world"] for s in (first, both))
    assert one["floor"] == two["floor"]
    assert one["start"] != two["start"]


def test_a_choice_takes_every_value_at_some_time() -> None:
    floors = [4.0, 8.0]
    case = only(make(variation={"world.floor": {"choice": floors}}))
    drawn = {case.spec(run, 1).scenario["world"]["floor"] for run in range(20)}
    assert drawn == set(floors)


def test_specs_do_not_share_mutable_data() -> None:
    case = only(make(faults=[BIAS]))
    spec = case.spec(0, 1)
    spec.scenario["world"]["floor"] = -1  # type: ignore[index]
    spec.faults[0].activation["at"] = -1
    again = case.spec(0, 1)
    assert again.scenario["world"]["floor"] > 0
    assert again.faults[0].activation["at"] == 2.0


def test_a_seed_and_a_policy_can_be_given() -> None:
    spec = only(make()).spec(0, 1, seed=42, policy="log_only")
    assert spec.seed == 42
    assert spec.policy == Policy("log_only")


@pytest.mark.of_guest
def test_roles_given_come_before_the_scenarios_before_the_domains() -> None:
    scenario = drive(roles={"generator": "reactive", "safety_monitor": None, "watch": "my:Watch"})
    case = only(scenario)
    plain = case.spec(0, 1).roles
    assert plain["generator"].path == "pytest_dura.driving.roles.planners:Reactive"
    assert plain["fault_injector"].path == "pytest_dura.faults.injector:CampaignInjector"
    assert list(plain) == [*(name for name in STANDARD_ROLES if name != "safety_monitor"), "watch"]
    mine = {"generator": RoleSpec("a:B"), "safety_monitor": RoleSpec("a:S")}
    given = case.spec(0, 1, {**mine, "recovery_planner": None}).roles
    assert given["generator"] == RoleSpec("a:B")
    assert given["safety_monitor"] == RoleSpec("a:S")
    assert given["watch"] == RoleSpec("my:Watch")
    assert "recovery_planner" not in given
    assert "watch" not in case.spec(0, 1, {**mine, "watch": None}).roles
    with pytest.raises(ConfigurationError, match="no role 'wach' to switch off"):
        case.spec(0, 1, {**mine, "wach": None})


@pytest.mark.of_guest
@pytest.mark.parametrize("role", ["generator", "recovery_planner"])
def test_short_names_of_roles(role: str) -> None:
    names = DOMAINS["driving"].short_names[role]
    assert len(names) >= 4
    for name, path in names.items():
        given = only(drive()).roles({role: RoleSpec(name)})
        assert given[role].path == path
        in_a_file = only(drive(roles={role: name})).roles({})
        assert in_a_file[role].path == path


@pytest.mark.of_guest
@pytest.mark.parametrize(
    "role, slip, meant",
    [
        ("generator", "agressive", "did you mean 'aggressive'?"),
        ("recovery_planner", "safestop", "did you mean 'safe_stop'?"),
        (
            "recovery_planner",
            "aggressive",
            "use one of: alert, emergency_brake, ignore_untrusted, replan, safe_stop",
        ),
        ("safety_monitor", "safe_stop", "use one of: separation, stl"),
        ("performance_oracle", "safe_stop", "use one of: driving"),
        ("watch", "safe_stop", "write package.module:Name"),
    ],
)
def test_a_short_name_is_of_one_role(role: str, slip: str, meant: str) -> None:
    with pytest.raises(ConfigurationError, match=f"unknown {role} {slip!r}") as caught:
        only(drive()).spec(0, 1, {role: RoleSpec(slip)})
    assert caught.value.remedy == meant


@pytest.mark.of_guest
def test_the_short_name_of_the_stl_monitor_knows_what_the_domain_s_signals_are() -> None:
    formula = {"formula": "historically[0:0.5] (gap > 0.5)"}
    for role in ("safety_monitor", "stl_monitor"):
        given = only(drive(roles={role: {"path": "stl", "params": formula}})).roles({})[role]
        assert given.path.endswith(":StlSafetyMonitor")
        signals = "pytest_dura.driving.signals:percept_at"
        assert given.params == {**formula, "signals": signals}
    own = {**formula, "signals": None}
    assert role_spec("stl_monitor", RoleSpec("stl", own), DOMAINS["driving"]).params == own
    with pytest.raises(ConfigurationError, match="unknown stl_monitor 'stl'"):
        role_spec("stl_monitor", RoleSpec("stl", formula), None)


def test_iterations_of_a_scenario_end_its_episodes() -> None:
    assert only(make()).spec(0, 1).termination.iterations is None
    limited = make(iterations=15)
    assert only(limited).spec(0, 1).termination.iterations == 15
    assert limited.lasts == pytest.approx(1.5)
    episode = Orchestrator.build(only(limited).spec(0, 1)).run(only(limited).spec(0, 1))
    assert (episode.termination, episode.ticks) == ("iterations", 16)
    assert make(iterations=9999).lasts == make().lasts == 40.0
    late = {"type": "bias", "activation": {"at": 2.0}, "duration": 1.0}
    with pytest.raises(ConfigurationError, match="can only begin at 2 s, when the episode is over"):
        only(make(iterations=15, faults=[late]))


@pytest.mark.of_guest
def test_a_misspelt_role_given_from_outside() -> None:
    with pytest.raises(ConfigurationError) as caught:
        only(drive()).spec(0, 1, {"saftey_monitor": RoleSpec("a:B")})
    assert caught.value.remedy == "did you mean 'safety_monitor'?"


def test_another_simulator_has_no_default_roles() -> None:
    scenario = make(simulator="thermostat:Thermostat", world={"start": 3.0})
    with pytest.raises(ConfigurationError, match="no component under test") as caught:
        only(scenario).spec(0, 1)
    assert "`generator` fixture" in str(caught.value.remedy)
    spec = only(scenario).spec(0, 1, {"generator": RoleSpec("thermostat:Controller")})
    assert spec.simulator == RoleSpec("thermostat:Thermostat")
    assert spec.scenario["world"] == {"start": 3.0}
    assert list(spec.roles) == ["generator", "fault_injector"]


@pytest.mark.of_guest
def test_the_domains_simulator_by_its_path_has_the_domains_roles() -> None:
    scenario = drive(simulator=DOMAINS["driving"].simulator)
    assert only(scenario).spec(0, 1).roles == only(drive()).spec(0, 1).roles


def test_a_simulator_given_from_outside_replaces_the_scenarios() -> None:
    spec = only(make()).spec(0, 1, simulator=RoleSpec("thermostat:Thermostat"))
    assert spec.simulator.path == "thermostat:Thermostat"


@pytest.mark.parametrize("domain", dict(DOMAINS.items()).values(), ids=list(DOMAINS))
def test_everything_that_a_domain_names_can_be_built(domain: Any) -> None:
    assert RoleSpec(domain.simulator).create()
    for path in domain.default_roles.values():
        assert RoleSpec(path).create()
    needed = {"stl": {"formula": "historically[0:0.5] (gap > 0.5)"}}
    # Programs, devices and topics, which are checked where they are started.
    elsewhere = {"link", "device", "ros1", "ros2"}
    for role, names in domain.short_names.items():
        for name in set(names) - elsewhere:
            assert role_spec(role, RoleSpec(name, needed.get(name, {})), domain).create()
