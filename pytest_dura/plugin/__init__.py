"""The pytest plugin: hooks of a few lines, which hand over to one object per session.

Every pytest run of whoever has the package installed loads this module, so it imports nothing
heavy: what a session needs is imported when it is first used.
"""

from __future__ import annotations

import pytest

from pytest_dura.plugin.fixtures import (
    _dura_roles,
    campaign,
    dura_metrics,
    episode,
    fault_injector,
    generator,
    orchestrator,
    performance_oracle,
    recovery_planner,
    run_episode,
    safety_monitor,
    security_assessor,
    simulator,
)
from pytest_dura.plugin.hooks import SessionHooks
from pytest_dura.plugin.messages import apply_code_places
from pytest_dura.plugin.options import add_options
from pytest_dura.plugin.property_tests import register_profile
from pytest_dura.plugin.session import session_of

__all__ = [
    "_dura_roles",
    "campaign",
    "dura_metrics",
    "episode",
    "fault_injector",
    "generator",
    "orchestrator",
    "performance_oracle",
    "recovery_planner",
    "run_episode",
    "safety_monitor",
    "security_assessor",
    "simulator",
]

MARKERS = (
    (
        "dura(scenario, faults=None, runs=None, verdict=True): run the test on each run (fixture "
        "`episode`) or each case (fixture `campaign`) of these scenarios; `faults` replace the "
        "scenarios' own; verdict=False: the test decides nothing, and needs no verdict"
    ),
    (
        "falsify(requirement=None, budget=200, faults=(), at_most=1, shrink=150, seed=None): "
        "search the test's campaign for violations before its body runs"
    ),
    "requirement(id, text=None, kind='safety', source=''): the requirement that the test decides",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare options and ini settings."""
    add_options(parser)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> int | None:
    """Answer the options that run no tests, such as ``--dura-list``."""
    # Hypothesis looks for its profile in `pytest_configure`, which comes later.
    register_profile(config)
    apply_code_places(config)
    session = session_of(config)
    if not session.options.is_command:
        return None
    from pytest_dura.plugin.commands import run_command

    return run_command(session)


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers, and the hooks of this session."""
    for marker in MARKERS:
        config.addinivalue_line("markers", marker)
    session = session_of(config)
    config.add_cleanup(session.properties.begin())
    config.pluginmanager.register(SessionHooks(session), "dura-session")
