"""Check a scenario beyond its form: simulator, world, roles, faults, variation."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from itertools import islice, product
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError, did_you_mean, error_at
from pytest_dura.core.fault import Fault
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES, Role
from pytest_dura.core.simulator import CHANNELS, SIMULATORS
from pytest_dura.core.trust import check_registered
from pytest_dura.domains import Domain, check_role_name, domain_of, role_spec
from pytest_dura.library.fault_campaigns import MAX_CASES, Faults, ScenarioFaults, expand_campaign
from pytest_dura.library.planned_faults import (
    check_chains,
    parse_fault,
    parse_scenario_fault,
    without_injector,
)
from pytest_dura.library.scenario import (
    Scenario,
    channel_aliases,
    check_world,
    extreme_values,
    lacks_error,
    replace_value,
    simulator_class,
    split_path,
    world_checker,
)

if TYPE_CHECKING:
    from pytest_dura.library.cases import Case


def scenario_problems(scenario: Scenario) -> list[ConfigurationError]:
    """List all that keeps the scenario from running, each error with its file, line and key."""
    return check_scenario(scenario)[0]


def check_scenario(scenario: Scenario) -> tuple[list[ConfigurationError], ScenarioFaults | None]:
    """List the scenario's problems, and return its faults, which the checks read anyway.

    The faults are ``None`` if one of them cannot be used, and if they make too many cases: then
    :func:`~pytest_dura.library.cases.expand_cases` raises an error.
    """
    errors: list[ConfigurationError] = []

    def attempt(key: str, check: Callable[..., Any], *args: Any) -> Any:
        try:
            return check(*args)
        except ConfigurationError as error:
            errors.append(_error_at(scenario, error, key))
            return None

    try:
        domain = scenario.system
    except ConfigurationError as error:  # what follows depends on it
        return [_error_at(scenario, error, "domain")], None
    attempt("domain", _check_domain, scenario, domain)
    simulator = attempt("simulator", _simulator, scenario)
    world = None
    if simulator is not None:
        world = attempt("world", check_world, scenario, simulator, scenario.world)
    for role in scenario.roles:
        attempt(f"roles.{role}", _check_role, scenario, role, domain)
    read, faults = _check_faults(scenario, simulator, attempt)
    if world is None or faults is None:
        return errors, read
    for path in scenario.variation:
        key = f"variation.{path}"
        attempt(key, _check_variation, scenario, simulator, world, faults, path)
    for fault in () if errors else faults.values():
        attempt("variation", _check_together, scenario, fault)
    return errors, read


def _check_faults(
    scenario: Scenario, simulator: RoleSpec | None, attempt: Callable[..., Any]
) -> tuple[ScenarioFaults | None, dict[str, Fault] | None]:
    """Check the scenario's own faults and its campaigns; return both as far as they can be used."""
    faults = _own_faults(scenario, attempt)
    if faults is None:
        return None, None
    read = _campaigns(scenario, tuple(faults.values()), attempt)
    if read is not None:
        attempt("roles.fault_injector", _check_injector, scenario, read)
    if simulator is not None:
        attempt("faults", check_channels, simulator, list(faults.values()))
    return read, faults


def check_simulator_fits(case: Case, simulator: RoleSpec) -> None:
    """Check a case for another simulator than its scenario's, before anything runs.

    Raises:
        ConfigurationError: If the simulator is of another domain, refuses the world or an extreme
            of what varies in it, or lacks what the case needs.
    """
    scenario = case.scenario
    own, registered = scenario.system, SIMULATORS.name_of(simulator.path)
    # A simulator that is not registered may be one of any domain.
    if own is not None and registered is not None and domain_of(registered) is not own:
        raise ConfigurationError(
            f"{simulator.label} is no simulator of the domain {own.name!r}, which the scenario "
            f"{scenario.name!r} is of",
            file=scenario.file or None,
            line=scenario.line_of("simulator"),
            key="simulator",
            found=simulator.path,
            expected=f"a simulator of the domain {own.name!r}",
            remedy="leave the scenario out with --dura-select, or name another simulator",
        )
    world = check_world(scenario, simulator, scenario.world)
    for path, spread in scenario.variation.items():
        fault, inner = split_path(path)
        for value in () if fault else extreme_values(spread):
            check_world(scenario, simulator, replace_value(world, inner, value, create=True))
    check_channels(simulator, case.faults)


def check_channels(simulator: RoleSpec, faults: Iterable[Fault]) -> None:
    """Refuse faults of sensor channels that a simulator lacks.

    Raises:
        ConfigurationError: For the first one.
    """
    factory = simulator_class(simulator)
    lacks: Mapping[str, str] = getattr(factory, "lacks", {})
    for index, fault in enumerate(faults):
        channel = fault.target.partition(".")[0]
        reason = lacks.get(f"{CHANNELS}{channel}")
        if reason is not None:
            key = f"faults.{index}.target"
            raise lacks_error(factory, f"{CHANNELS}{channel}", fault.target, reason, key=key)


def _own_faults(scenario: Scenario, attempt: Callable[..., Any]) -> dict[str, Fault] | None:
    """Read the scenario's faults by id; ``None`` if one of them cannot be used."""
    faults = {
        entry.name: attempt(f"faults.{index}", parse_scenario_fault, scenario, index)
        for index, entry in enumerate(scenario.faults)
    }
    if None in faults.values():
        return None
    # With campaigns, the faults act in those combinations only.
    if not scenario.campaigns:
        attempt("faults", check_chains, list(faults.values()))
    return faults


def _campaigns(
    scenario: Scenario, own: Faults, attempt: Callable[..., Any]
) -> ScenarioFaults | None:
    """Expand the scenario's campaigns; each is checked, also if there are too many cases."""
    faults: list[list[Faults]] = []
    cases, complete = 0, True
    for index, campaign in enumerate(scenario.campaigns):
        expanded = attempt(f"campaigns.{index}", expand_campaign, scenario, own, campaign)
        cases += len(expanded or ())
        complete = complete and expanded is not None and cases <= MAX_CASES
        if complete:
            faults.append(expanded)
    return ScenarioFaults(own, tuple(faults)) if complete else None


def _check_injector(scenario: Scenario, read: ScenarioFaults) -> None:
    """Refuse faults where the injector is switched off."""
    is_off = "fault_injector" in scenario.roles and scenario.roles["fault_injector"] is None
    planned = [faults for campaign in read.campaigns for faults in campaign]
    if is_off and any(planned if scenario.campaigns else read.own):
        raise without_injector(scenario, scenario.name)


def _check_domain(scenario: Scenario, domain: Domain | None) -> None:
    """Refuse a named domain that is not that of the registered simulator."""
    own = domain_of(scenario.simulator.path)
    if own is not None and domain is not own:
        raise ConfigurationError(
            f"the simulator is one of the domain {own.name!r}",
            key="domain",
            found=scenario.domain,
            expected=own.name,
            remedy="leave the key out, or name a simulator of that domain",
        )


def _error_at(scenario: Scenario, error: ConfigurationError, key: str) -> ConfigurationError:
    if error.file:
        return error
    if error.key and error.key.startswith(f"{key}."):
        key = error.key
    return error_at(error, file=scenario.file, line=scenario.line_of(key), key=key)


def _simulator(scenario: Scenario) -> RoleSpec:
    spec = scenario.simulator_spec()
    channel_aliases(scenario)
    _check_parameters(spec)
    return spec


def _check_role(scenario: Scenario, role: str, domain: Domain | None) -> None:
    entry = scenario.roles[role]
    check_role_name(role, switched_off=entry is None)
    if entry is None:
        if role == "generator":
            raise ConfigurationError(
                "the generator cannot be switched off",
                found="null",
                expected="the component under test",
                remedy="name a generator, or leave the key out for the default one",
            )
        return
    spec = role_spec(role, RoleSpec(entry.path, entry.params), domain)
    if ":" in entry.path:
        check_registered(spec.path)
    _check_parameters(spec)
    factory = spec.factory()
    base = STANDARD_ROLES.get(role)
    if base is not None and inspect.isclass(factory) and not issubclass(factory, base):
        raise ConfigurationError(
            f"{spec.path} is not a {base.__name__}",
            found=spec.path,
            expected=f"a subclass of pytest_dura.{base.__name__}",
            remedy=f"derive it from pytest_dura.{base.__name__}, or name another class",
        )
    if inspect.isclass(factory) and issubclass(factory, Role):
        factory.check_params(spec.params, scenario.time_step)


def _check_parameters(spec: RoleSpec) -> None:
    """Refuse parameters that the class does not accept, without building anything."""
    factory = spec.factory()
    try:
        signature = inspect.signature(factory)
    except ValueError:  # some classes written in C have no signature
        return
    try:
        signature.bind(**spec.params)
    except TypeError as error:
        raise ConfigurationError(
            f"{spec.path} does not take these parameters: {error}",
            found=dict(spec.params),
            expected=f"{spec.label}{signature}",
            remedy="correct the parameters under `params`",
        ) from None


def _check_variation(
    scenario: Scenario,
    simulator: RoleSpec,
    world: dict[str, Any],
    faults: dict[str, Fault],
    path: str,
) -> None:
    fault, inner = split_path(path)
    values = extreme_values(scenario.variation[path])
    if fault:
        if fault not in faults:
            raise ConfigurationError(
                f"there is no fault {fault!r} in this scenario",
                found=fault,
                expected="one of " + ", ".join(faults) if faults else "a fault under `faults`",
                remedy=did_you_mean(fault, faults),
            )
        for value in values:
            varied = replace_value(faults[fault].plain(), inner, value)
            _try_fault(scenario, varied, path, value)
        return
    create = world_checker(scenario, simulator) is not None
    for value in values:
        varied = replace_value(world, inner, value, create=create)
        try:
            check_world(scenario, simulator, varied)
        except ConfigurationError as error:
            raise _impossible(path, value, error) from None


def _check_together(scenario: Scenario, fault: Fault) -> None:
    """Refuse values of a fault that are possible on their own and contradict each other."""
    prefix = f"faults.{fault.id}."
    paths = [path for path in scenario.variation if path.startswith(prefix)]
    corners = product(*(extreme_values(scenario.variation[path]) for path in paths))
    for values in islice(corners, 256) if len(paths) > 1 else ():
        varied: Any = fault.plain()
        for path, value in zip(paths, values, strict=True):
            varied = replace_value(varied, path.removeprefix(prefix), value)
        try:
            parse_fault(scenario, varied)
        except ConfigurationError as error:
            chosen = ", ".join(f"{p} = {v!r}" for p, v in zip(paths, values, strict=True))
            raise ConfigurationError(
                f"values that may be drawn contradict each other: {error.problem.splitlines()[0]}",
                key=f"variation.{paths[-1]}",
                found=chosen,
                expected=error.expected,
                remedy="choose ranges of which all values fit together",
            ) from None


def _try_fault(scenario: Scenario, fault: dict[str, Any], path: str, value: Any) -> None:
    try:
        parse_fault(scenario, fault)
    except ConfigurationError as error:
        raise _impossible(path, value, error) from None


def _impossible(path: str, value: Any, error: ConfigurationError) -> ConfigurationError:
    return ConfigurationError(
        f"{path} cannot take the value {value!r}: {error.problem.splitlines()[0]}",
        found=value,
        expected=error.expected,
        remedy="choose values that the scenario could hold itself",
    )
