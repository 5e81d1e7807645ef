"""Options, markers and fixtures, until a session uses the package: see :class:`Waiting`."""

from __future__ import annotations

import gc
import sys
from typing import TYPE_CHECKING

import pytest

from pytest_dura.plugin import event_hook, fixtures, short_fixtures
from pytest_dura.plugin.options import (
    SET_ASIDE,
    WAITING,
    add_options,
    asks_for_session,
    short_names,
)

if TYPE_CHECKING:
    from pytest_dura.plugin.hooks import SessionHooks

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
    (
        "requirement(id, text=None, kind='safety', source='', mitigates=()): "
        "the requirement that the test decides"
    ),
)
_IMPORTED_BY_ALL = "pytest_dura.core.errors"
"""Module that every part of the package imports, and nothing that waits for a session does."""


def pytest_addhooks(pluginmanager: pytest.PytestPluginManager) -> None:
    """Declare the hook that users implement."""
    pluginmanager.add_hookspecs(event_hook)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare options and ini settings."""
    add_options(parser)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> int | None:
    """Answer the options that run no tests, such as ``--dura-list``."""
    # Hypothesis looks for its profile in `pytest_configure`, which comes later.
    if not asks_for_session(config):
        return None
    from pytest_dura.plugin.hooks import run_command

    return run_command(config)


def pytest_configure(config: pytest.Config) -> None:
    """Register markers and fixtures, and what waits for a session that uses the package."""
    # Added before pytest's own, it comes after them, of which one looks for garbage.
    config.add_cleanup(lambda: gc.unfreeze() if config.stash.get(SET_ASIDE, False) else None)
    for marker in MARKERS:
        config.addinivalue_line("markers", marker)
    register = config.pluginmanager.register
    register(fixtures, "dura-fixtures")
    if short_names(config):
        register(short_fixtures, "dura-short-fixtures")
    if asks_for_session(config):
        from pytest_dura.plugin.hooks import begin

        begin(config)
    else:
        register(Waiting(config), WAITING)


class Waiting:
    """Hooks that wait for the first use of the package in a session that does not use it.

    Beginning is safe at any time: without anything of the package, a session that has begun does
    nothing.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionstart(self, session: pytest.Session) -> None:
        """Begin where workers collect: what they need is sent before they have collected."""
        if self._config.pluginmanager.hasplugin("dsession"):
            self.begin(session)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Begin with the first test that uses the package."""
        definition = metafunc.definition
        names = ("dura", "falsify")
        if _is_imported(metafunc) or any(definition.get_closest_marker(name) for name in names):
            self.begin(definition.session).pytest_generate_tests(metafunc)

    def pytest_itemcollected(self, item: pytest.Item) -> None:
        """Begin with the first item that uses the package, and that no function became."""
        if _is_imported(item) or any(marker.name == "dura" for marker in item.own_markers):
            self.begin(item.session).pytest_itemcollected(item)

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Begin where a conftest has marked items after they were collected."""
        marked = (any(mark.name == "dura" for mark in item.own_markers) for item in session.items)
        if any(marked):
            self.begin(session).pytest_collection_finish(session)

    def begin(self, session: pytest.Session) -> SessionHooks:
        """Begin the session, in the middle of a hook that its own hooks have missed."""
        from pytest_dura.plugin.hooks import begin

        return begin(self._config, session)


def _is_imported(test: pytest.Item | pytest.Metafunc) -> bool:
    """Whether the test uses one of our fixtures, or something has imported the package."""
    return "dura_metrics" in getattr(test, "fixturenames", ()) or _IMPORTED_BY_ALL in sys.modules
