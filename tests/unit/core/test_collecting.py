"""The collector looks less often while an episode runs, and as before once it is over."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from loops import run_loop
from thermostat import Controller, HeatMonitor

from pytest_dura import Assessment
from pytest_dura.core import RoleView
from pytest_dura.core.collector import MAX_YOUNG_OBJECTS, make_old, rare_collections, set_aside


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


def _is_old(value: object) -> bool:
    return any(each is value for each in gc.get_objects(generation=2))


def test_what_there_is_becomes_old_without_a_look_at_it() -> None:
    gc.unfreeze()  # what another test process has kept
    looks: list[str] = []
    gc.collect()  # so that Python's next look by itself is some hundred objects away
    gc.callbacks.append(lambda phase, _: looks.append(phase))
    try:
        kept = [object()]
        assert not _is_old(kept)
        make_old()
        assert _is_old(kept)
        assert gc.get_freeze_count() == 0
    finally:
        gc.callbacks.pop()
    assert not looks


def test_what_somebody_exempts_stays_exempt() -> None:
    gc.unfreeze()
    assert set_aside()
    try:
        exempt = gc.get_freeze_count()
        kept = [object()]
        make_old()
        assert not set_aside()
        assert gc.get_freeze_count() == exempt
        assert not _is_old(kept)
    finally:
        gc.unfreeze()
