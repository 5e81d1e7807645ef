"""What all tests share."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from forked_workers import ForkedWorkers, decide_once
from garbage import freeze
from xdist import plugin as xdist_plugin

pytest_plugins = ["pytester", "chromium"]

# Dozens of tests start a Python: with this set, each would compile the package anew.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One more than there are cores: many tests wait for a process, a browser or a clock."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    detected: int = xdist_plugin.pytest_xdist_auto_num_workers(config)
    return detected + 1


LONG = {
    "test_a_session_whose_controller_was_killed_goes_on_where_it_was",
    "test_no_link_and_no_anchor_of_the_site_is_broken",
    "test_one_forged_field_is_found_whatever_field_it_is",
    "test_one_that_dies_is_infrastructure_and_the_next_run_has_another",
    "test_the_suite_passes_and_shows_what_each_assessor_detects",
    "test_the_suite_passes_on_each_road",
    "test_the_suite_passes_where_it_was_copied_to",
}
"""Tests of ten seconds and more, which come first: begun at the end, one is waited for alone."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.name.partition("[")[0] not in LONG)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: it is not searched for garbage again."""
    freeze()


@pytest.fixture(autouse=True, scope="module")
def _few_objects_to_search():
    """What earlier modules left is not searched again by pytest, which collects often."""
    freeze()


@pytest.fixture(autouse=True, scope="session")
def _modules_are_looked_at_once():
    """Where each of thousands of modules lies is not asked anew for each store of episodes."""
    from pytest_dura.execution import sources

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sources, "_is_own", decide_once(sources._is_own))
        yield


@pytest.fixture
def hears_keys():
    """Ctrl-C is heard, also where this process was started in the background, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def forked_workers():
    workers = ForkedWorkers(Path(__file__).with_name("plugin") / "project")
    yield workers
    workers.close()
