from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pytest

from pytest_dura.campaign import Progress
from pytest_dura.plugin.session import progress
from pytest_dura.plugin.session.progress import (
    ProgressDisplay,
    ProgressWords,
    columns,
    duration,
    fitting,
)

PROGRESS = Progress(
    "intersection/congested", "SAF-2", 120, 400, True, violations=1, upper=0.046, confidence=0.95
)


def at(done, budget=100, taken_over=0):
    return Progress("room/warm", "T-1", done, budget, taken_over=taken_over)


def words(*steps, requests=lambda: None):
    """The line after these steps: progress and the time of each."""
    own = ProgressWords(requests)
    for one, now in steps:
        own.look(one, now)
    return own.line(*steps[-1])


def test_a_line_says_everything():
    assert words((replace(PROGRESS, done=0, upper=None), 0.0), (PROGRESS, 20.0)) == (
        "intersection/congested SAF-2: 120 of at most 400 runs, 1 violation, "
        "rate <= 4.6 % (95 %), at most 47 s left"
    )


def test_a_line_says_no_more_than_is_known():
    assert words((at(0, budget=1), 0.0)) == "room/warm T-1: 0 of 1 run"


def test_runs_that_were_at_hand_take_no_time():
    steps = (at(0), 0.0), (at(80, taken_over=80), 3.0), (at(82, taken_over=80), 4.0)
    assert words(*steps) == "room/warm T-1: 82 of 100 runs (80 taken over), 9 s left"


def test_requests_to_language_models_are_counted_by_the_second():
    asked = iter([10, 40])
    line = words((at(0), 0.0), (at(1), 4.0), requests=lambda: next(asked))
    assert line == "room/warm T-1: 1 of 100 runs, 7.5 requests/s, 6 min 36 s left"


@pytest.mark.parametrize(
    "seconds, shown",
    [(0.0, "1 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (125, "2 min 05 s"), (7260, "2 h 01 min")],
)
def test_durations(seconds, shown):
    assert duration(seconds) == shown


@pytest.mark.parametrize("room", [200, 80, 40, 14, 13, 2, 0, -3])
def test_no_line_is_wider_than_its_room(room):
    wide = "交差点/混雑" * 30 + "e\u0301"
    for text in ("intersection/congested SAF-2: 120 of at most 400 runs" * 5, wide):
        assert columns(fitting(text, room)) <= max(0, room)
        assert bool(fitting(text, room)) is (room > 13)


def test_a_name_writes_no_control_sequence_to_the_terminal():
    hostile = replace(PROGRESS, case="a\x1b[2Jb\nc")
    assert words((hostile, 0.0)).startswith("a?[2Jb?c SAF-2: ")


class Log:
    """Configuration of a session whose terminal is a list of lines."""

    width_of_current_line = 0
    currentfspath = None

    def __init__(self):
        self.lines = []
        self.pluginmanager = SimpleNamespace(
            getplugin=lambda name: self if name == "terminalreporter" else None
        )

    def get_terminal_writer(self):
        return self

    def line(self, text=""):
        self.lines.append(text)

    def flush(self):
        pass


def test_the_longer_a_session_lasts_the_rarer_are_the_lines_of_a_log(monkeypatch):
    now, log, written = 100.0, Log(), []
    monkeypatch.setattr(progress, "perf_counter", lambda: now)
    display = ProgressDisplay(log, 30.0, lambda: None)
    for second in range(2 * 3600):
        now = 100.0 + second
        display.update(at(second, 10**6))
        if len(log.lines) > len(written):
            written.append(second)
    assert written[:3] == [30, 60, 90]
    gaps = [later - earlier for earlier, later in pairwise(written)]
    assert gaps == sorted(gaps)
    assert gaps[-1] == progress.LONGEST_SILENCE
    assert log.lines[0].startswith("dura: room/warm T-1: 30 of 1000000 runs, 277 h")
