"""The fixtures. Those named after a role are the extension point: override one to swap the role.

All begin with ``dura_``; :mod:`pytest_dura.plugin.short_fixtures` has their short names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.core.episode import Episode
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.items.markers import Target
    from pytest_dura.plugin.session.session import DuraSession
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode


def _session_of(request: pytest.FixtureRequest) -> DuraSession:
    """Return the session, which begins here where a test asks for a fixture while it runs."""
    from pytest_dura.plugin.hooks import begin

    return begin(request.config, request.session).session


@pytest.fixture(scope="session")
def _dura_session(request: pytest.FixtureRequest) -> DuraSession:
    """The session: each ``request`` of a fixture is made anew for each test, and takes its time."""
    return _session_of(request)


@pytest.fixture(scope="session")
def dura_simulator(_dura_session: DuraSession) -> RoleSpec:
    """The simulator. Override it to run the scenarios in another one."""
    return _dura_session.roles.default("simulator")


@pytest.fixture(scope="session")
def dura_generator(_dura_session: DuraSession) -> RoleSpec:
    """The component under test. Override it: return your class, a factory or a RoleSpec."""
    return _dura_session.roles.default("generator")


@pytest.fixture(scope="session")
def dura_safety_monitor(_dura_session: DuraSession) -> RoleSpec:
    """The role that judges proposals. Override it; ``None`` switches it off."""
    return _dura_session.roles.default("safety_monitor")


@pytest.fixture(scope="session")
def dura_security_assessor(_dura_session: DuraSession) -> RoleSpec:
    """The role that watches for attacks. Override it; ``None`` switches it off."""
    return _dura_session.roles.default("security_assessor")


@pytest.fixture(scope="session")
def dura_performance_oracle(_dura_session: DuraSession) -> RoleSpec:
    """The role that measures performance. Override it; ``None`` switches it off."""
    return _dura_session.roles.default("performance_oracle")


@pytest.fixture(scope="session")
def dura_fault_injector(_dura_session: DuraSession) -> RoleSpec:
    """The role that injects faults. Override it; ``None`` switches it off."""
    return _dura_session.roles.default("fault_injector")


@pytest.fixture(scope="session")
def dura_recovery_planner(_dura_session: DuraSession) -> RoleSpec:
    """The role that replaces refused proposals. Override it; ``None`` switches it off."""
    return _dura_session.roles.default("recovery_planner")


@pytest.fixture(scope="session")
def dura_metrics() -> Mapping[str, Callable[[Episode], float]]:
    """Metrics of your own: name to a function of the episode. Override it."""
    return {}


@pytest.fixture
def _dura_roles(  # noqa: PLR0917 - pytest passes them by name
    request: pytest.FixtureRequest,
    dura_simulator: Any,
    dura_generator: Any,
    dura_safety_monitor: Any,
    dura_security_assessor: Any,
    dura_performance_oracle: Any,
    dura_fault_injector: Any,
    dura_recovery_planner: Any,
) -> None:
    """Let the runner run the roles that this item sees.

    The runner itself is session-scoped, so that Hypothesis may use it; a conftest deeper down may
    override a role for its own tests all the same.
    """
    given = {
        "simulator": dura_simulator,
        "generator": dura_generator,
        "safety_monitor": dura_safety_monitor,
        "security_assessor": dura_security_assessor,
        "performance_oracle": dura_performance_oracle,
        "fault_injector": dura_fault_injector,
        "recovery_planner": dura_recovery_planner,
    }
    use_roles(request, given)


def use_roles(request: pytest.FixtureRequest, given: dict[str, Any]) -> None:
    """Let the runner run what the role fixtures of an item returned, by role."""
    from pytest_dura.core.errors import ConfigurationError

    session = _session_of(request)
    try:
        session.roles.check_names(request)
        session.roles.use(given, session.runner)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None


@pytest.fixture(scope="session")
def dura_orchestrator(
    _dura_session: DuraSession, dura_metrics: Mapping[str, Callable[[Episode], float]]
) -> Runner:
    """Runs episodes and campaigns by name: ``orchestrator.run("intersection/nominal", seed=7)``."""
    runner = _dura_session.runner
    runner.metrics = dura_metrics
    return runner


@pytest.fixture(scope="session")
def dura_run_episode(dura_orchestrator: Runner) -> Callable[..., JudgedEpisode]:
    """A function that runs a case, given as such or by its name; session-scoped for Hypothesis."""
    return episode_runner(dura_orchestrator)


def episode_runner(orchestrator: Runner) -> Callable[..., JudgedEpisode]:
    """Make the function that runs a case."""

    def run(case: Case | str, seed: int | None = None) -> JudgedEpisode:
        __tracebackhide__ = True
        if isinstance(case, str):
            return orchestrator.run(case, seed)
        return orchestrator.episode(case, seed=seed)

    return run


@pytest.fixture
def dura_episode(
    request: pytest.FixtureRequest, _dura_roles: None, dura_orchestrator: Runner
) -> JudgedEpisode:
    """One run of a case, for tests with the marker ``dura``."""
    return marked_episode(request, dura_orchestrator)


@pytest.fixture
def dura_log(dura_episode: JudgedEpisode) -> JudgedEpisode:
    """A recorded log as an episode, for tests with the marker ``dura(logs="drives/*.csv")``."""
    return dura_episode


def marked_episode(request: pytest.FixtureRequest, orchestrator: Runner) -> JudgedEpisode:
    """Run the episode that the marker of a test names."""
    from pytest_dura.core.errors import ConfigurationError
    from pytest_dura.plugin.items.observed_episode import ObservedEpisode

    target = _target(request)
    try:
        simulated = orchestrator.episode(target.case, target.run, planned=target.planned)
        return ObservedEpisode.of(simulated)
    except ConfigurationError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None


def _target(request: pytest.FixtureRequest) -> Target:
    from pytest_dura.core.errors import ConfigurationError

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
def dura_campaign(
    request: pytest.FixtureRequest, _dura_roles: None, dura_orchestrator: Runner
) -> Campaign:
    """All runs of a case, for tests with the marker ``dura``; simulated when they are looked at."""
    return marked_campaign(request, dura_orchestrator)


def marked_campaign(request: pytest.FixtureRequest, orchestrator: Runner) -> Campaign:
    """Return the campaign that the marker of a test names."""
    target = _target(request)
    return orchestrator.campaign(
        target.case,
        target.planned,
        target.requirement,
        until_decided=target.until_decided,
    )
