from __future__ import annotations

import random
from dataclasses import replace
from types import SimpleNamespace

import pytest

from pytest_dura.campaign import Progress
from pytest_dura.plugin.progress import BOUND_SHARE, LONGEST_BOUND_AGE, Snapshots
from pytest_dura.plugin.progress_display import (
    LEAST_SAMPLES,
    PACE_WINDOW,
    Board,
    Pace,
    Row,
    Throughput,
    columns,
    duration,
    log_line,
    short_line,
    terminal_line,
)

PROGRESS = Progress(
    "intersection/congested", "SAF-2", 120, 400, True, violations=1, upper=0.046, confidence=0.95
)
ROW = Row("", PROGRESS, 6.2, 45.2)


def at(done, budget=100, taken_over=0, subject="T-1"):
    return Progress("room/warm", subject, done, budget, taken_over=taken_over)


def test_a_sentence_says_everything():
    assert log_line(ROW) == (
        "intersection/congested SAF-2: 120 of at most 400 runs, 1 violation, "
        "rate <= 4.6 % (95 %), 6.2 runs/s, at most 45 s left"
    )


def test_a_sentence_says_no_more_than_is_known():
    assert log_line(Row("", at(0, budget=1), None, None)) == "room/warm T-1: 0 of 1 run"
    fixed = replace(PROGRESS, may_end_early=False, violations=0, upper=None, taken_over=50)
    assert log_line(Row("", fixed, 0.05, 5600.0)) == (
        "intersection/congested SAF-2: 120 of 400 runs (50 taken over), 0 violations, "
        "3 runs/min, 1 h 33 min left"
    )


@pytest.mark.parametrize(
    "seconds, said",
    [(0.0, "1 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (125, "2 min 05 s"), (7260, "2 h 01 min")],
)
def test_durations(seconds, said):
    assert duration(seconds) == said


@pytest.mark.parametrize("width", [200, 119, 118, 80, 40, 10, 2, 1, 0])
def test_no_line_is_wider_than_its_terminal(width):
    wide = replace(PROGRESS, case="交差点/混雑" * 3 + "e\u0301")
    for row in (ROW, Row("gw0", PROGRESS, 6.2, 45.2), Row("", wide, 6.2, 45.2)):
        assert columns(terminal_line(row, width)) <= width


def test_a_narrow_line_is_brief_and_a_wide_one_is_a_sentence():
    assert terminal_line(ROW, 119) == log_line(ROW)
    assert terminal_line(ROW, 118) == short_line(ROW)
    assert short_line(ROW) == (
        "intersection/congested SAF-2 120/400, 1 violation, <= 4.6 %, 6.2/s, <= 45 s left"
    )
    assert terminal_line(replace(ROW, place="gw1"), 20) == "gw1 intersection/c.."
    assert columns("混") == 2


def test_a_name_writes_no_control_sequence_to_the_terminal():
    row = replace(ROW, progress=replace(PROGRESS, case="a\x1b[2Jb\nc"))
    assert log_line(row).startswith("a?[2Jb?c SAF-2: ")


def test_there_is_no_rate_before_a_run_has_ended():
    pace = Pace(at(0), 10.0)
    pace.add(at(0), 11.0)
    assert (pace.rate(11.0), pace.left(100, 11.0)) == (None, None)
    pace.add(at(1), 12.0)
    assert pace.rate(12.0) == pytest.approx(0.5)
    assert pace.left(99, 12.0) == pytest.approx(198.0)


def test_the_time_left_falls_while_a_run_is_under_way_and_grows_once_it_takes_too_long():
    pace = Pace(at(0), 0.0)
    pace.add(at(1), 10.0)
    assert pace.left(9, 15.0) == pytest.approx(85.0)
    assert pace.left(9, 20.0) == pytest.approx(80.0)
    assert pace.rate(20.0) == pytest.approx(0.1)
    assert pace.rate(40.0) == pytest.approx(1 / 30)
    assert pace.left(9, 40.0) == pytest.approx(240.0)


def test_the_rate_is_that_of_late():
    pace, now = Pace(at(0), 0.0), 0.0
    for done in range(1, 101):
        now = done / 10
        pace.add(at(done, 1000), now)
    for done in range(101, 121):
        now += 1.0
        pace.add(at(done, 1000), now)
    assert pace.rate(now) == pytest.approx(1.0)


def test_of_slow_runs_some_are_remembered_beyond_the_window():
    pace, random_ = Pace(at(0), 0.0), random.Random(0)
    now = 0.0
    for done in range(1, 40):
        now += 3 * PACE_WINDOW * random_.choice([0.5, 1.5])
        pace.add(at(done), now)
    assert pace.rate(now) == pytest.approx(1 / (3 * PACE_WINDOW), rel=0.5)
    assert pace.rate(now) != pytest.approx(1 / (1.5 * PACE_WINDOW), rel=0.01)
    assert LEAST_SAMPLES > 2


def test_runs_that_were_at_hand_do_not_count():
    pace = Pace(at(0), 0.0)
    pace.add(at(80, taken_over=80), 0.2)
    assert pace.rate(0.2) is None
    pace.add(at(82, taken_over=80), 1.2)
    assert pace.rate(1.2) == pytest.approx(2.0)
    assert pace.left(18, 1.2) == pytest.approx(9.0)


def test_a_board_has_a_pace_for_each_place_and_each_campaign():
    board = Board()
    board.rows({"gw10": at(0), "gw2": at(0)}, 0.0)
    rows = board.rows({"gw10": at(1), "gw2": at(4)}, 1.0)
    assert [(row.place, row.rate) for row in rows] == [("gw2", 4.0), ("gw10", 1.0)]
    assert [row.left for row in rows] == [24.0, 99.0]
    (row,) = board.rows({"gw2": at(5, subject="T-2")}, 2.0)
    assert row.rate is None
    # The same again from its beginning, as a test function may ask for it.
    (row,) = board.rows({"gw2": at(0, subject="T-2")}, 3.0)
    assert row.rate is None


class Clock:
    """Stands still, but for what somebody does with it."""

    now = 100.0

    def __call__(self):
        return self.now


class Running:
    """A campaign whose bound takes its time: the judge of its progress."""

    requirement = SimpleNamespace(confidence=0.95)

    def __init__(self, clock, cost):
        self.clock, self.cost, self.bounds = clock, cost, 0
        self.told = replace(PROGRESS, upper=None, confidence=None, done=0, violations=0, judge=self)

    @property
    def upper(self):
        self.clock.now += self.cost
        self.bounds += 1
        return 1.0 / (1 + self.told.done)


def test_a_bound_is_made_as_seldom_as_its_cost_asks_for():
    clock = Clock()
    snapshots, running = Snapshots(clock), Running(clock, cost=0.001)
    begun = clock.now
    while clock.now < begun + 50.0:
        snapshots.of(running.told)
        clock.now += 0.2
    assert running.bounds * running.cost <= 1.1 * BOUND_SHARE * 50.0
    assert running.bounds > 50


def test_a_bound_of_fewer_runs_is_shown_while_it_still_holds():
    clock = Clock()
    snapshots, running = Snapshots(clock), Running(clock, cost=100.0)
    assert snapshots.of(running.told).upper == 1.0
    running.told = replace(running.told, done=9)
    assert (snapshots.of(running.told).done, snapshots.of(running.told).upper) == (9, 1.0)
    running.told = replace(running.told, violations=1)
    assert snapshots.of(running.told).upper is None
    clock.now += LONGEST_BOUND_AGE
    assert snapshots.of(running.told).upper == 0.1
    assert running.bounds == 2


def test_a_bound_is_of_its_own_campaign():
    clock = Clock()
    snapshots = Snapshots(clock)
    first, second = Running(clock, cost=100.0), Running(clock, cost=100.0)
    snapshots.of(first.told)
    second.told = replace(second.told, done=3)
    assert snapshots.of(second.told).upper == 0.25


def test_requests_per_second_are_those_of_the_last_seconds():
    throughput = Throughput(window=10.0)
    assert throughput.rate(None, 0.0) is None
    assert throughput.rate(100, 0.0) is None
    assert throughput.rate(120, 4.0) == pytest.approx(5.0)
    assert throughput.rate(140, 8.0) == pytest.approx(5.0)
    for second in range(9, 30):
        rate = throughput.rate(140, float(second))
    assert rate == 0.0


def test_a_place_that_asks_language_models_says_how_often():
    board = Board()
    first, second = (replace(at(done), requests=requests) for done, requests in ((0, 10), (1, 40)))
    assert board.rows({"": first}, 0.0)[0].requests is None
    (row,) = board.rows({"": second}, 4.0)
    assert row.requests == pytest.approx(7.5)
    assert ", 7.5 requests/s, " in log_line(row)
    assert ", 7.5 req/s, " in short_line(row)
    assert "req" not in log_line(replace(row, requests=None))
