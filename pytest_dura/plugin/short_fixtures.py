"""Short names of the fixtures, unless the ini setting ``dura_short_fixtures`` is false.

Each gives what the fixture of its long name gives; override either of the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.plugin.fixtures import (
    episode_runner,
    marked_campaign,
    marked_episode,
    use_roles,
)

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode


@pytest.fixture(scope="session")
def simulator(dura_simulator: Any) -> Any:
    """The simulator. Override it to run the scenarios in another one."""
    return dura_simulator


@pytest.fixture(scope="session")
def generator(dura_generator: Any) -> Any:
    """The component under test. Override it: return your class, a factory or a RoleSpec."""
    return dura_generator


@pytest.fixture(scope="session")
def safety_monitor(dura_safety_monitor: Any) -> Any:
    """The role that judges proposals. Override it; ``None`` switches it off."""
    return dura_safety_monitor


@pytest.fixture(scope="session")
def security_assessor(dura_security_assessor: Any) -> Any:
    """The role that watches for attacks. Override it; ``None`` switches it off."""
    return dura_security_assessor


@pytest.fixture(scope="session")
def performance_oracle(dura_performance_oracle: Any) -> Any:
    """The role that measures performance. Override it; ``None`` switches it off."""
    return dura_performance_oracle


@pytest.fixture(scope="session")
def fault_injector(dura_fault_injector: Any) -> Any:
    """The role that injects faults. Override it; ``None`` switches it off."""
    return dura_fault_injector


@pytest.fixture(scope="session")
def recovery_planner(dura_recovery_planner: Any) -> Any:
    """The role that replaces refused proposals. Override it; ``None`` switches it off."""
    return dura_recovery_planner


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
    """Let the runner run the roles that this item sees under their short names."""
    given = {
        "simulator": simulator,
        "generator": generator,
        "safety_monitor": safety_monitor,
        "security_assessor": security_assessor,
        "performance_oracle": performance_oracle,
        "fault_injector": fault_injector,
        "recovery_planner": recovery_planner,
    }
    use_roles(request, given)


@pytest.fixture(scope="session")
def orchestrator(dura_orchestrator: Runner) -> Runner:
    """Runs episodes and campaigns by name: ``orchestrator.run("intersection/nominal", seed=7)``."""
    return dura_orchestrator


@pytest.fixture(scope="session")
def run_episode(orchestrator: Runner) -> Callable[..., JudgedEpisode]:
    """A function that runs a case, given as such or by its name; session-scoped for Hypothesis."""
    return episode_runner(orchestrator)


@pytest.fixture
def episode(
    request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner
) -> JudgedEpisode:
    """One run of a case, for tests with the marker ``dura``."""
    return marked_episode(request, orchestrator)


@pytest.fixture
def campaign(request: pytest.FixtureRequest, _dura_roles: None, orchestrator: Runner) -> Campaign:
    """All runs of a case, for tests with the marker ``dura``; simulated when they are looked at."""
    return marked_campaign(request, orchestrator)


@pytest.fixture
def log(episode: JudgedEpisode) -> JudgedEpisode:
    """A recorded log as an episode, for tests with the marker ``dura(logs="drives/*.csv")``."""
    return episode
