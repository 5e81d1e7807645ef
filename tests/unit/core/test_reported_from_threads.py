"""What a component's own threads report and draw reaches the loop, as from the component itself."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from pytest_dura import stream
from pytest_dura.core import ComponentEnvironmentError, environment_errors, report_environment_error
from pytest_dura.core.seeding import recording_draws


def in_a_thread(call: Callable[[], object]) -> None:
    thread = threading.Thread(target=call)
    thread.start()
    thread.join()


@pytest.mark.parametrize("run", [in_a_thread, lambda call: call()], ids=["thread", "call"])
def test_an_environment_error_is_reported_to_the_innermost_context(run) -> None:
    error = ComponentEnvironmentError("cassette", "it has no such answer")
    with environment_errors() as outer, environment_errors() as inner:
        run(lambda: report_environment_error(error))
    assert (outer, inner) == ([], [error])
    assert report_environment_error(error) is error
    assert (outer, inner) == ([], [error])


@pytest.mark.parametrize("run", [in_a_thread, lambda call: call()], ids=["thread", "call"])
def test_a_draw_is_recorded_in_every_context_that_is_open(run) -> None:
    with recording_draws() as outer:
        with recording_draws() as inner:
            run(lambda: stream(7, "noise").normal())
        with recording_draws() as later:
            run(lambda: stream(7, "noise"))
    assert (outer.any, inner.any, later.any) == (True, True, False)
