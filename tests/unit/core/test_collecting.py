"""The collector looks less often while an episode runs, and as before once it is over."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from loops import run_loop
from thermostat import Controller, HeatMonitor

from pytest_dura import Assessment
from pytest_dura.core import RoleView
from pytest_dura.core.collector import MAX_YOUNG_OBJECTS, rare_collections


@pytest.fixture(autouse=True)
def _threshold() -> Iterator[None]:
    was, before = gc.isenabled(), gc.get_threshold()
    gc.enable()
    gc.set_threshold(700, 11, 12)
    yield
    gc.set_threshold(*before)
    if not was:
        gc.disable()


def test_it_looks_less_often_meanwhile() -> None:
    with rare_collections():
        assert gc.isenabled()
        assert gc.get_threshold() == (MAX_YOUNG_OBJECTS, 11, 12)
    assert gc.get_threshold() == (700, 11, 12)


def test_an_error_restores_it_as_well() -> None:
    with pytest.raises(ZeroDivisionError), rare_collections():
        _ = 1 / 0
    assert gc.get_threshold() == (700, 11, 12)


@pytest.mark.parametrize("young", [0, MAX_YOUNG_OBJECTS, 5 * MAX_YOUNG_OBJECTS])
def test_a_collector_that_looks_no_more_often_is_left_alone(young: int) -> None:
    gc.set_threshold(young, 11, 12)
    with rare_collections():
        assert gc.get_threshold() == (young, 11, 12)
        with rare_collections():
            pass
        assert gc.get_threshold() == (young, 11, 12)
    assert gc.get_threshold() == (young, 11, 12)


def test_nested_contexts_restore_it_at_the_end_of_the_outer() -> None:
    with rare_collections():
        with rare_collections():
            pass
        assert gc.get_threshold() == (MAX_YOUNG_OBJECTS, 11, 12)
    assert gc.get_threshold() == (700, 11, 12)


def test_what_others_set_meanwhile_stays() -> None:
    with rare_collections():
        gc.set_threshold(50, 5, 5)
    assert gc.get_threshold() == (50, 5, 5)


class Noting(HeatMonitor):
    """Notes after how many new objects the collector looks."""

    def __init__(self, *, fails: bool) -> None:
        super().__init__()
        self.fails, self.noted = fails, set[int]()

    def run(self, view: RoleView) -> Assessment:
        self.noted.add(gc.get_threshold()[0])
        if self.fails:
            raise OSError("broken")
        return super().run(view)


@pytest.mark.parametrize("fails", [False, True])
def test_so_it_is_during_an_episode_and_not_after_it(fails: bool) -> None:
    monitor = Noting(fails=fails)
    episode = run_loop(Controller(), seconds=1.0, safety_monitor=monitor)
    assert (episode.failure is not None) is fails
    assert monitor.noted == {MAX_YOUNG_OBJECTS}
    assert gc.get_threshold() == (700, 11, 12)
