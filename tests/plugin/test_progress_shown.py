"""Progress as it is seen: in a terminal, in a log, and with workers."""

from __future__ import annotations

import contextlib
import gc
import os
import pty
import re
import signal
import sys
import traceback

import pytest
from forked_workers import AVAILABLE
from terminals import Terminal

from pytest_dura.plugin.session import progress

SLOW = """
import os, time
import pytest
import corridor

def pytest_configure(config):
    if hasattr(config, "workerinput"):
        from pytest_dura.plugin.session import progress
        progress.REFRESH = 0.005

reset = corridor.Corridor.reset
def slow_reset(self, scenario, seed):
    time.sleep(0.01)
    return reset(self, scenario, seed)
corridor.Corridor.reset = slow_reset
"""
"""Campaigns take a moment, and workers send often."""
LINE = re.compile(
    r"corridor/free GO-1: \d of 3 runs(?: \(\d taken over\))?, 0 violations(?:, \d+ s left)?"
)


@pytest.fixture
def slow(project, monkeypatch):
    project.write("conftest.py", SLOW)
    for name in ("CI", "NO_COLOR", "COLUMNS", "LINES", "FORCE_COLOR", "PY_COLORS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress, "REFRESH", 0.005)
    ini = project.path / "pytest.ini"
    ini.write_text(ini.read_text() + "\ndura_progress_interval = 0.004\n")
    return project


def in_terminal(project, *arguments, until=None):
    """What a session in a terminal writes, and its exit code.

    Args:
        project: The project.
        arguments: Of pytest.
        until: Interrupt it once this was written.
    """
    sys.stdout.flush()
    child, handle = pty.fork()
    if not child:
        code = 99
        try:
            os.chdir(project.path)
            sys.path.insert(0, str(project.path))
            sys.stdin, sys.stdout, sys.stderr = map(os.fdopen, range(3), ("r", "w", "w"))
            sys.__stdout__, sys.__stderr__ = sys.stdout, sys.stderr
            signal.signal(signal.SIGINT, signal.default_int_handler)
            gc.callbacks.clear()  # that of Hypothesis swallows an interruption that meets it
            code = int(pytest.main(["-p", "no:cacheprovider", *arguments]))
            sys.stdout.flush()
        except BaseException:  # a copy of the process ends here, whatever it met; it is printed
            traceback.print_exc()
        finally:
            os._exit(code)
    seen = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while chunk := os.read(handle, 4096):
            seen += chunk
            if until is not None and until in seen:
                os.kill(child, signal.SIGINT)
                until = None
    os.close(handle)
    return seen.decode(), os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def everything(text):
    """All that is to be read in the end, but for what differs from session to session."""
    terminal = Terminal(80, 24)
    terminal.feed(text.replace("\t", " "))
    return [re.sub(r"\d+\.\d+s", "", line).strip("= ") for line in terminal.everything]


DRAWN = re.compile(r"\x1b(?!\[[\d;]*m)")
"""An escape sequence that does not set a colour."""
needs_forks = pytest.mark.skipif(not AVAILABLE, reason="a process may not be forked here")


@needs_forks
@pytest.mark.parametrize("more", [[], ["-v"], ["-n", "2"]], ids=["dots", "names", "workers"])
def test_a_terminal_shows_progress_and_nothing_of_it_stays(slow, more, monkeypatch, forked_workers):
    forked_workers.arguments()  # they are begun in this process, if they are not yet
    arguments = ["corridor/free", "corridor/tight::GAP-1", *more]
    seen, code = in_terminal(slow, *arguments)
    assert code == 0, seen
    # Where two workers share the width, names are cut.
    name = r"(gw\d )?corridor/free G[AP]*O?-1:" + (r"|\.\.[^;]*" if more[:1] == ["-n"] else "")
    assert re.search(rf"({name}) [12] of 3 runs, 0 violations", seen)
    if more[:1] != ["-n"]:
        monkeypatch.setattr(progress, "make_progress", lambda *_: None)
        plain, _ = in_terminal(slow, *arguments)
        assert "3 runs, 0 violations" not in plain
        assert everything(seen) == everything(plain)
    assert not any(" of 3 runs, " in line for line in everything(seen))
    assert not DRAWN.search(seen)


@needs_forks
@pytest.mark.parametrize(
    "arguments, environment",
    [(["-q"], {}), (["-s"], {}), ([], {"TERM": "dumb"}), ([], {"CI": "true"})],
    ids=["quiet", "uncaptured", "dumb", "ci"],
)
def test_whole_lines_where_nothing_can_be_overwritten(slow, monkeypatch, arguments, environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    seen, code = in_terminal(slow, "corridor/free::GO-1", *arguments)
    assert code == 0, seen
    assert "\b" not in seen
    assert not DRAWN.search(seen)
    assert bool(LINE.search(seen)) is (arguments != ["-q"])


@needs_forks
def test_an_interrupted_session_leaves_no_progress_behind(slow):
    slow.write("conftest.py", SLOW.replace("0.01)", "0.3)"))
    seen, code = in_terminal(slow, "corridor/free", "--dura-runs=500", until=b"1 of 500")
    assert code == pytest.ExitCode.INTERRUPTED, seen
    assert not any(" of 500 runs, " in line for line in everything(seen)), seen


def lines(result):
    return [line for line in result.outlines if re.match("dura: (gw0 )?corridor/", line)]


@pytest.mark.parametrize("more", [[], ["-n", "1"]], ids=["plain", "n1"])
def test_a_log_has_whole_lines_and_the_rest_goes_on_below(slow, more):
    result = slow.run("corridor/free::GO-1", *more)
    result.assert_outcomes(passed=1)
    found = lines(result)
    assert found
    assert all(LINE.fullmatch(line.removeprefix("dura: ").removeprefix("gw0 ")) for line in found)
    last = max(at for at, line in enumerate(result.outlines) if line in found)
    assert re.match(r"\.\s+\[100%\]", result.outlines[last + 1]), result.outlines[last:]


def test_a_log_of_names_has_the_name_of_each_result_beside_it(slow):
    result = slow.run("corridor/free::GO-1", "-v")
    assert lines(result)
    assert any(re.match(r"corridor/free::GO-1 PASSED +\[100%\]", one) for one in result.outlines)


@pytest.mark.parametrize("interval, more", [("30", []), ("never", []), ("0.004", ["-q"])])
def test_a_short_or_quiet_session_has_no_lines(slow, interval, more):
    ini = slow.path / "pytest.ini"
    ini.write_text(ini.read_text().replace("0.004", interval))
    result = slow.run("corridor/free", *more)
    assert result.ret == 0
    assert lines(result) == []


def test_an_interval_that_is_none_is_refused(slow):
    ini = slow.path / "pytest.ini"
    ini.write_text(ini.read_text().replace("0.004", "often"))
    result = slow.run("corridor/free")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "dura_progress_interval takes a number of seconds" in result.stderr.str()


def test_workers_send_the_progress_of_test_functions_too(slow):
    slow.write(
        "test_free.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=40)\n"
        "@pytest.mark.requirement('T-1', text='Lives', kind='safety')\n"
        "def test_it(campaign): campaign.require('always (gap > 0)', at_most=0.9)\n",
    )
    result = slow.run("-n", "1")
    result.assert_outcomes(passed=1)
    line = r"dura: gw0 corridor/free T-1: \d+ of 40 runs"
    assert all(re.match(line, one) for one in lines(result))
    assert any("rate <= " in one for one in lines(result))


def test_a_session_of_others_is_left_alone(slow):
    slow.write("test_plain.py", "def test_one(): pass\n")
    assert slow.run("-n", "1").ret == 0
    assert not (slow.path / "dura-evidence").exists()
