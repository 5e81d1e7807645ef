"""The domains that scenarios name by an alias: their simulator, default roles and short names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES


@dataclass(frozen=True)
class Domain:
    """Import paths only, so that naming a domain imports nothing of it.

    Args:
        simulator: Of the simulator's class.
        roles: Of the default roles, by role name.
        short_names: Of what has a short name, by role name. A role may be known by short names
            alone and be in no scenario by default.
        parameters: Of what has a short name, by that name: what it needs to know of the domain. A
            scenario's own come before them.
        world: Of the pydantic model of ``world``, for editors and for messages.
        signals: Of the names of the ground-truth signals.
        percept_signals: Of the names of the percept signals, without the prefix ``percept.``.
        proposal_signals: Of the names of what components' accounts come to, without the prefix
            ``proposal.``.
        channels: Of what the channels hold, by name; see ``pytest_dura.faults.model``.
        fault_targets: Of where a fault acts that names no target, by what its type can act on.
        concrete: Of a function of world, duration and seed that gives an equal world in which
            nothing is left to the seed. It gives a world of that kind back as it is.
    """

    simulator: str
    roles: Mapping[str, str] = field(default_factory=dict)
    short_names: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    world: str | None = None
    signals: str | None = None
    percept_signals: str | None = None
    proposal_signals: str | None = None
    channels: str | None = None
    fault_targets: str | None = None
    concrete: str | None = None


_PLANNERS = "pytest_dura.driving.roles.planners"
_RECOVERY = "pytest_dura.driving.roles.recovery"
_STL = "pytest_dura.requirements.monitoring.stl_monitor:StlSafetyMonitor"

DOMAINS: dict[str, Domain] = {
    "driving": Domain(
        simulator="pytest_dura.driving.highway:HighwaySimulator",
        roles={
            "generator": f"{_PLANNERS}:RuleBased",
            "safety_monitor": "pytest_dura.driving.roles.safety:SeparationMonitor",
            "security_assessor": "pytest_dura.driving.roles.security:PlausibilityAssessor",
            "fault_injector": "pytest_dura.faults.injector:CampaignInjector",
            "performance_oracle": "pytest_dura.driving.roles.performance:DrivingOracle",
            "recovery_planner": f"{_RECOVERY}:EmergencyBrake",
        },
        short_names={
            "generator": {
                "rule_based": f"{_PLANNERS}:RuleBased",
                "reactive": f"{_PLANNERS}:Reactive",
                "tactical": "pytest_dura.driving.roles.tactical:Tactical",
                "aggressive": f"{_PLANNERS}:Aggressive",
                "random": f"{_PLANNERS}:RandomPlanner",
                "llm": "pytest_dura.llm.driving.planner:LlmPlanner",
            },
            "safety_monitor": {"stl": _STL},
            "stl_monitor": {"stl": _STL},
            "recovery_planner": {
                "emergency_brake": f"{_RECOVERY}:EmergencyBrake",
                "safe_stop": f"{_RECOVERY}:SafeStop",
                "replan": f"{_RECOVERY}:Replan",
                "ignore_untrusted": f"{_RECOVERY}:IgnoreUntrusted",
                "alert": f"{_RECOVERY}:AlertOnly",
            },
            "residual_monitor": {
                "cusum": "pytest_dura.driving.roles.residuals:ResidualMonitor",
                "isolation_forest": "pytest_dura.driving.roles.learned:IsolationForestMonitor",
                "one_class_svm": "pytest_dura.driving.roles.learned:OneClassSvmMonitor",
            },
        },
        parameters={"stl": {"signals": "pytest_dura.driving.signals:percept_at"}},
        world="pytest_dura.driving.scenario:DrivingWorld",
        signals="pytest_dura.driving.signals:NAMES",
        percept_signals="pytest_dura.driving.signals:PERCEPT_NAMES",
        proposal_signals="pytest_dura.driving.explanations:SIGNALS",
        channels="pytest_dura.driving.sensors:CHANNELS",
        fault_targets="pytest_dura.driving.sensors:FAULT_TARGETS",
        concrete="pytest_dura.driving.scenario:concrete_world",
    )
}


def domain_of(simulator: str) -> Domain | None:
    """The domain of an alias or of a domain's own simulator; ``None`` for any other simulator."""
    if simulator in DOMAINS:
        return DOMAINS[simulator]
    return next((domain for domain in DOMAINS.values() if domain.simulator == simulator), None)


def simulator_spec(path: str, params: Mapping[str, object]) -> RoleSpec:
    """How to build the simulator that a scenario names.

    Raises:
        ConfigurationError: For a name that is neither an alias nor an import path.
    """
    if path in DOMAINS:
        return RoleSpec(DOMAINS[path].simulator, dict(params))
    if ":" in path:
        return RoleSpec(path, dict(params))
    raise ConfigurationError(
        f"unknown simulator {path!r}",
        key="simulator",
        found=path,
        expected=", ".join(sorted(DOMAINS)) + ", or an import path package.module:Class",
        remedy=did_you_mean(path, DOMAINS),
    )


def role_spec(role: str, spec: RoleSpec, domain: Domain | None) -> RoleSpec:
    """The spec with a short name, such as ``rule_based``, replaced by its import path.

    Raises:
        ConfigurationError: For a name that is neither known nor an import path.
    """
    if ":" in spec.path:
        return spec
    known = domain.short_names.get(role, {}) if domain is not None else {}
    if domain is not None and spec.path in known:
        return RoleSpec(known[spec.path], {**domain.parameters.get(spec.path, {}), **spec.params})
    names = ", ".join(sorted(known))
    raise ConfigurationError(
        f"unknown {role} {spec.path!r}",
        key=f"roles.{role}",
        found=spec.path,
        expected=f"{names}, or an import path package.module:Name"
        if names
        else "an import path package.module:Name",
        remedy=did_you_mean(spec.path, known) if known else "write package.module:Name",
    )


def check_role_name(role: str, *, switched_off: bool) -> None:
    """Refuse a role's name that is a standard one misspelt.

    A name of the user's own is welcome, unless it differs from a standard name by a letter or two,
    or is to be switched off: only what exists can be.

    Raises:
        ConfigurationError: With the name that was probably meant.
    """
    if role in STANDARD_ROLES or (not switched_off and not _misspelt(role)):
        return
    raise ConfigurationError(
        f"there is no role {role!r}" + (" to switch off" if switched_off else ""),
        key=f"roles.{role}",
        found=role,
        expected="one of " + ", ".join(STANDARD_ROLES) + ", or a name of your own",
        remedy=did_you_mean(role, STANDARD_ROLES),
    )


def _misspelt(role: str) -> bool:
    import difflib

    # `safety_monitor_2` is a second monitor; `safty_monitor` is a slip.
    if any(role.startswith(name) for name in STANDARD_ROLES):
        return False
    return bool(difflib.get_close_matches(role, STANDARD_ROLES, n=1, cutoff=0.85))
