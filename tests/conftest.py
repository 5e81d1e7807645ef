"""What all tests share."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from forked_workers import ForkedWorkers
from garbage import freeze

pytest_plugins = ["pytester", "chromium"]

# Dozens of tests start a Python: with this set, each would compile the package anew.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: it is not searched for garbage again."""
    freeze()


@pytest.fixture(autouse=True, scope="module")
def _few_objects_to_search():
    """What earlier modules left is not searched again by pytest, which collects often."""
    freeze()


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
