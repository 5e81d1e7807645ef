"""The fixtures. Those named after a role are the extension point: override one to swap the role."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.session import session_of

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.core.episode import Episode
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.markers import Target
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode
    from pytest_dura.runner import Runner


@pytest.fixture(scope="session")
def simulator(request: pytest.FixtureRequest) -> RoleSpec:
    """The simulator. Override it to run the scenarios in another one."""
    return session_of(request.config).roles.default("simulator")


@pytest.fixture(scope="session")
def generator(request: pytest.FixtureRequest) -> RoleSpec:
    """The component under test. Override it: return your class, a factory or a RoleSpec."""
    return session_of(request.config).roles.default("generator")


@pytest.fixture(scope="session")
def safety_monitor(request: pytest.FixtureRequest) -> RoleSpec:
    """The role that judges proposals. Override it; ``None`` switches it off."""
    return session_of(request.config).roles.default("safety_monitor")


@pytest.fixture(scope="session")
def security_assessor(request: pytest.FixtureRequest) -> RoleSpec:
    """The role that watches for attacks. Override it; ``None`` switches it off."""
    return session_of(request.config).roles.default("security_assessor")


@pytest.fixture(scope="session")
def performance_oracle(request: pytest.FixtureRequest) -> RoleSpec:
    """The role that measures performance. Override it; ``None`` switches it off."""
    return session_of(request.config).roles.default("performance_oracle")


@pytest.fixture(scope="session")
def fault_injector(request: pytest.FixtureRequest) -> RoleSpec:
    """The role that injects faults. Override it; ``None`` switches it off."""
    return session_of(request.config).roles.default("fault_injector")


@pytest.fixture(scope="session")
def recovery_planner(request: pytest.FixtureRequest) -> RoleSpec:
    """The role that replaces refused proposals. Override it; ``None`` switches it off."""
    return session_of(request.config).roles.default("recovery_planner")


@pytest.fixture(scope="session")
def dura_metrics() -> Mapping[str, Callable[[Episode], float]]:
    """Metrics of your own: name to a function of the episode. Override it."""
    return {}


@pytest.fixture
def _dura_roles(  # noqa: PLR0917 - pytest passes them by name
    request: pytest.FixtureRequest,
    simulator: Any,
    generator: Any,
    safety_monitor: Any,
    security_assessor: Any,
    performance_oracle: Any,
    fault_injector: Any,
    recovery_planner: Any,
) -> None:
    """Let the runner run the roles that this item sees.

    The runner itself is session-scoped, so that Hypothesis may use it; a conftest deeper down may
    override a role for its own tests all the same.
    """
    given = {
        "simulator": simulator,
        "generator": generator,
        "safety_monitor": safety_monitor,
        "security_assessor": security_assessor,
        "performance_oracle": performance_oracle,
        "fault_injector": fault_injector,
        "recovery_planner": recovery_planner,
    }
    session = session_of(request.config)
    try:
        session.roles.use(given, session.runner)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None


@pytest.fixture(scope="session")
def orchestrator(
    request: pytest.FixtureRequest, dura_metrics: Mapping[str, Callable[[Episode], float]]
) -> Runner:
    """Runs episodes and campaigns by name: ``orchestrator.run("intersection/nominal", seed=7)``."""
    runner = session_of(request.config).runner
    runner.metrics = dura_metrics
    return runner


@pytest.fixture(scope="session")
def run_episode(orchestrator: Runner) -> Callable[..., JudgedEpisode]:
    """A function that runs a case, given as such or by its name; session-scoped for Hypothesis."""

    def run(case: Case | str, seed: int | None = None) -> JudgedEpisode:
        __tracebackhide__ = True
        if isinstance(case, str):
            return orchestrator.run(case, seed)
        return orchestrator.episode(case, seed=seed)

    return run


@pytest.fixture
def episode(
    request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner
) -> JudgedEpisode:
    """One run of a case, for tests with the marker ``dura``."""
    from pytest_dura.plugin.observed_episode import ObservedEpisode

    target = _target(request)
    try:
        simulated = orchestrator.episode(target.case, target.run, planned=target.planned)
        return ObservedEpisode.of(simulated)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None


def _target(request: pytest.FixtureRequest) -> Target:
    target: Target | None = getattr(request, "param", None)
    if target is None:
        error = ConfigurationError(
            f"the fixture `{request.fixturename}` needs to know which scenario to run",
            key="pytest.mark.dura",
            expected='a marker such as @pytest.mark.dura(scenario="intersection/nominal")',
            remedy="add the marker, or use the fixture `orchestrator`",
        )
        pytest.fail(str(error), pytrace=False)
    return target


@pytest.fixture
def campaign(request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner) -> Campaign:
    """All runs of a case, for tests with the marker ``dura``; simulated when they are looked at."""
    target = _target(request)
    return orchestrator.campaign(
        target.case,
        target.planned,
        target.requirement,
        until_decided=target.until_decided,
    )
