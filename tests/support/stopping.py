"""A plugin that interrupts a session after its last item, where the folder has a file ``stop``."""

from pathlib import Path

import pytest


@pytest.hookimpl(trylast=True)
def pytest_runtest_logfinish() -> None:
    """Interrupt the session, whose episodes are kept, once its last item is over."""
    if Path("stop").exists() and _LAST:
        Path("stop").unlink()
        pytest.exit("stopped")


_LAST: list[bool] = []


def pytest_runtest_protocol(nextitem: pytest.Item | None) -> None:
    """Note whether the item is the last one."""
    _LAST[:] = [] if nextitem is not None else [True]
