from __future__ import annotations

import io
import os
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from terminals import Terminal

from pytest_dura.campaign import Progress
from pytest_dura.plugin import progress_display
from pytest_dura.plugin.progress_display import (
    LiveScreen,
    ProgressLog,
    ProgressView,
    Row,
    TerminalGuard,
    Ticker,
    log_line,
    short_line,
)


class Stream(io.StringIO):
    """What is written goes to a terminal, as soon as it is flushed."""

    def __init__(self, terminal):
        super().__init__()
        self.terminal, self.waiting = terminal, ""

    def write(self, text):
        self.waiting += text
        return len(text)

    def flush(self):
        self.terminal.feed(self.waiting)
        self.waiting = ""


@pytest.fixture
def terminal():
    return Terminal(80, 6)


@pytest.fixture
def writer(terminal):
    return pytest.importorskip("_pytest._io").TerminalWriter(Stream(terminal))


@pytest.fixture
def display(terminal, writer, monkeypatch):
    size = os.terminal_size((terminal.columns, terminal.rows))
    monkeypatch.setattr(LiveScreen, "_size", lambda _: size)
    return LiveScreen(Stream(terminal), TerminalGuard(writer))


def row(done=3, place="gw0"):
    return Row(place, Progress("room/warm", "T-1", done, 9), 2.0, 3.0)


def shown(done, place="gw0"):
    return f"{place} {short_line(row(done))}"


def test_rows_stand_below_what_pytest_is_writing(terminal, writer, display):
    writer.write("tests/test_one.py ")
    writer.flush()
    display.show([row(3), row(4, "gw1")], 0.0)
    assert terminal.screen == ["tests/test_one.py", shown(3), shown(4, "gw1")]
    display.show([row(5), row(4, "gw1")], 0.2)
    assert terminal.screen == ["tests/test_one.py", shown(5), shown(4, "gw1")]
    display.show([row(5)], 0.4)
    assert terminal.screen == ["tests/test_one.py", shown(5)]
    writer.write(".")
    assert terminal.screen == ["tests/test_one.py ."]
    display.show([row(6)], 0.6)
    writer.line(" done")
    assert terminal.screen == ["tests/test_one.py . done"]
    display.show([row(7)], 0.8)
    display.show([], 1.0)
    assert terminal.screen == ["tests/test_one.py . done"]


def test_at_the_bottom_the_screen_scrolls_and_nothing_is_lost(terminal, writer, display):
    lines = [f"line {number}" for number in range(20)]
    for number, line in enumerate(lines):
        writer.write(line)
        display.show([row(1), row(number % 9, "gw1")], number / 5)
        assert terminal.screen[-3:] == [line, shown(1), shown(number % 9, "gw1")]
        writer.line("")
    assert terminal.everything == lines


def test_a_low_terminal_shows_fewer_rows(terminal, writer, display):
    writer.write("dots ...")
    display.show([row(1, f"gw{number}") for number in range(9)], 0.0)
    assert terminal.screen == ["dots ...", *(shown(1, f"gw{number}") for number in range(4))]
    display.wipe()
    assert terminal.everything == ["dots ..."]


def test_what_others_write_in_between_leaves_nothing_of_the_rows(terminal, writer, display):
    writer.write("path ")
    display.show([row(1)], 0.0)
    terminal.feed("printed\nand more")
    display.show([row(2)], 0.2)
    assert terminal.screen == ["path printed", "and more", shown(2)]


def test_nothing_is_written_twice(display, terminal):
    written = []
    terminal.feed = written.append
    for _ in range(3):
        display.show([row(1)], 0.0)
    assert len(written) == 1
    display.wipe()
    display.wipe()
    assert len(written) == 2


def test_a_debugger_has_the_terminal_for_itself(terminal, writer, display):
    writer.write("path ")
    display.show([row(1)], 0.0)
    display.pause()
    display.show([row(2)], 0.2)
    assert terminal.screen == ["path"]
    display.resume()
    display.show([row(3)], 0.4)
    assert terminal.screen == ["path", shown(3)]


def test_afterwards_pytest_writes_by_itself(terminal, writer, display):
    display.show([row(1)], 0.0)
    display.close()
    assert terminal.screen == [""]
    assert not {"write", "write_raw"} & set(vars(writer))
    writer.line("all passed")
    writer.flush()
    assert terminal.screen == ["all passed"]


def test_the_size_is_that_of_the_terminal_or_the_usual_one(terminal, writer):
    assert (
        LiveScreen(Stream(terminal), TerminalGuard(writer))._size() == progress_display._USUAL_SIZE
    )


@pytest.fixture
def written():
    return io.StringIO()


@pytest.fixture
def lines_of(written):
    writer = pytest.importorskip("_pytest._io").TerminalWriter(written)
    config = SimpleNamespace(get_terminal_writer=lambda: writer)
    reporter = SimpleNamespace(config=config, currentfspath=None, tw=writer)
    reporter.log = ProgressLog(reporter, 30.0, 100.0, threading.RLock)
    return reporter


def times(reporter, written, seconds, interval=0.5):
    """When lines came, in seconds since the beginning."""
    found = []
    for step in range(int(seconds / interval)):
        before = len(written.getvalue())
        reporter.log.show([row(1, "")], 100.0 + step * interval)
        if len(written.getvalue()) > before:
            found.append(step * interval)
    return found


def test_a_log_has_its_first_line_after_the_interval(lines_of, written):
    assert times(lines_of, written, 30) == []
    assert times(lines_of, written, 200) == [30.0, 60.0, 90.0, 120.0, 150.0, 180.0]
    assert set(written.getvalue().splitlines()) == {f"dura: {log_line(row(1))}"}


def test_in_long_sessions_lines_become_rarer_but_a_log_is_never_silent_for_long(lines_of, written):
    found = times(lines_of, written, 8 * 3600, interval=5.0)
    gaps = [later - earlier for earlier, later in pairwise(found)]
    assert gaps == sorted(gaps)
    assert gaps[0] == 30.0
    assert gaps[-1] <= progress_display.LONGEST_SILENCE + 5.0
    assert sum(time <= 3600 for time in found) < 40


def test_an_interval_beyond_the_longest_is_kept(lines_of, written):
    lines_of.log = ProgressLog(lines_of, 1000.0, 100.0, threading.RLock)
    assert times(lines_of, written, 3500, interval=10.0) == [1000.0, 2000.0, 3000.0]


def test_nothing_is_written_while_nothing_runs(lines_of, written):
    lines_of.log.show([], 1000.0)
    assert written.getvalue() == ""
    lines_of.log.show([row(1, "")], 1001.0)
    assert written.getvalue() != ""


def test_a_line_of_a_log_stands_alone_and_dots_go_on_below(lines_of, written):
    lines_of.tw.write("test_one.py ..")
    lines_of.currentfspath = Path("test_one.py")
    lines_of.log.show([row(1), row(2)], 500.0)
    lines_of.tw.write(".")
    expected = ["test_one.py ..", f"dura: {log_line(row(1))}", f"dura: {log_line(row(2))}", "."]
    assert written.getvalue().splitlines() == expected
    assert lines_of.currentfspath == Path("test_one.py")
    assert lines_of.tw.width_of_current_line == 1


def test_the_name_of_a_single_result_is_written_again_below_a_line(lines_of):
    lines_of.tw.write("test_one.py::test_it ")
    lines_of.currentfspath = "test_one.py::test_it "
    lines_of.log.show([row(1)], 500.0)
    assert lines_of.currentfspath is None


def test_a_look_shows_what_is_found_at_the_rate_it_was_seen_at():
    rows, progress, now = [], [Progress("room/warm", "T-1", 0, 9)], [0.0]
    surface = SimpleNamespace(show=lambda found, _: rows.append(found))
    showing = ProgressView(surface, lambda: {"": progress[0]}, lambda: now[0])
    showing.refresh()
    progress[0], now[0] = replace(progress[0], done=3), 1.5
    showing.refresh()
    assert [(one.rate, one.left) for (one,) in rows] == [(None, None), (2.0, 3.0)]


def test_a_ticker_looks_until_it_is_closed_and_no_longer():
    seen, enough = [], threading.Event()

    def look():
        seen.append(1)
        if len(seen) >= 3:
            enough.set()

    ticker = Ticker(look, 0.001)
    assert enough.wait(10)
    ticker.close()
    number = len(seen)
    assert not any(one.name == "dura-progress" for one in threading.enumerate())
    assert len(seen) == number


def test_a_ticker_ends_when_the_terminal_is_gone():
    def look():
        raise OSError("no terminal")

    ticker = Ticker(look, 0.0)
    ticker._thread.join(10)
    assert not ticker._thread.is_alive()
    ticker.close()
