"""Progress of campaigns while they run: one line, with the time that is left.

In a terminal the line stands behind what pytest has written, and the cursor before it: pytest
writes its next result over it. A log has whole lines, rarer and rarer. Workers of pytest-xdist,
which have no terminal, send theirs over its channel to the controller, whose main thread shows
them. So nothing of pytest's own output is held back, repeated or written from another thread.
"""

from __future__ import annotations

import os
import sys
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from math import isinf
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.text import without_commands
from pytest_dura.evidence.text import counted

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController

    from pytest_dura.campaign.events import Progress

REFRESH = 0.5
"""Seconds between two lines in a terminal, or of a worker."""
SILENCE_SHARE, LONGEST_SILENCE = 0.1, 300.0
"""The longer a session lasts, the longer until the next line of a log: so much of what passed, but
no longer than that, or twice the interval: CI services end what is silent."""
_EVENT = "dura_progress"
_LEAST_ROOM = 12  # columns, below which a part of a line says nothing
Requests = Callable[[], int | None]
"""Returns how many requests of guests this process has made; ``None`` for none."""


class ProgressWords:
    """Words on how far the running campaign is."""

    def __init__(self, requests: Requests) -> None:
        self._requests = requests
        self._begun = 0.0, 0
        """When the simulated runs of the campaign began, and the requests by then."""

    def look(self, progress: Progress, now: float) -> None:
        """Note when the simulated runs of a campaign begin; called before each of its runs."""
        if progress.done == progress.taken_over:
            self._begun = now, self._requests() or 0

    def line(self, progress: Progress, now: float) -> str:
        """Say how many runs are over, what came of them, and how long the others will take."""
        progress = progress.bounded()
        most = "at most " if progress.may_end_early else ""
        taken = f" ({progress.taken_over} taken over)" if progress.taken_over else ""
        parts = [f"{progress.done} of {most}{counted(progress.budget, 'run')}{taken}"]
        if progress.violations is not None:
            parts.append(counted(progress.violations, "violation"))
        if progress.upper is not None and progress.confidence is not None:
            share = f"{100 * progress.upper:.3g} % ({100 * progress.confidence:g} %)"
            parts.append(f"rate <= {share}")
        simulated, requests = progress.done - progress.taken_over, self._requests()
        begun, earlier = self._begun
        if simulated and now > begun:
            if requests is not None:
                rate = (requests - earlier) / (now - begun)
                parts.append(f"{rate:.0f} requests/s" if rate >= 10 else f"{rate:.2g} requests/s")
            left = (now - begun) / simulated * (progress.budget - progress.done)
            parts.append(f"{most}{duration(left)} left")
        # Escape sequences in a name would act on the terminal.
        name = f"{progress.case} {progress.subject}".rstrip()
        name = "".join(each if each.isprintable() else "?" for each in name)
        return f"{without_commands(name)}: {', '.join(parts)}"


def duration(seconds: float) -> str:
    """Write a duration in its two largest units."""
    minutes, rest = divmod(max(1, round(seconds)), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"


def columns(text: str) -> int:
    """Count the columns that a terminal needs for a text."""
    wide = sum(unicodedata.east_asian_width(each) in "WF" for each in text)
    return len(text) + wide - sum(map(bool, map(unicodedata.combining, text)))


def fitting(text: str, room: int) -> str:
    """Cut a text to so many columns, its beginning first; empty where it would say nothing."""
    if columns(text) <= room:
        return text
    while columns(text) > room - 2 >= _LEAST_ROOM:
        text = text[1:]
    return f"..{text}" if room - 2 >= _LEAST_ROOM else ""


class WorkerProgress:
    """Sends the line of a worker to the controller; empty once its campaign has ended."""

    def __init__(self, config: pytest.Config, requests: Requests) -> None:
        plugins: Any = config.pluginmanager.get_plugins()
        self._send = next(each.sendevent for each in plugins if hasattr(each, "sendevent"))
        self._worker = vars(config)["workerinput"]["workerid"]
        self._words, self._due, self._sent = ProgressWords(requests), 0.0, False

    def update(self, event: Progress) -> None:
        """Take in the progress of a campaign of this worker."""
        now = perf_counter()
        self._words.look(event, now)
        if now >= self._due or (event.ended and self._sent):
            line = "" if event.ended else self._words.line(event, now)
            self._due, self._sent = now + REFRESH, bool(line)
            self._send(_EVENT, worker=self._worker, line=line)


class ProgressDisplay:
    """Shows the progress of this process, or as a controller that of its workers.

    ``interval`` is the least number of seconds between lines of a log, and ``None`` in a terminal.
    """

    def __init__(self, config: pytest.Config, interval: float | None, requests: Requests) -> None:
        self._config, self._interval = config, interval
        self._words = ProgressWords(requests)
        self._lines: dict[str, str] = {}
        """By worker; empty for this process."""
        self._begun = self._due = 0.0
        self._drawn = 0
        """Columns that are drawn behind pytest's cursor."""

    def update(self, event: Progress) -> None:
        """Take in the progress of a campaign of this process."""
        self._words.look(event, perf_counter())
        if event.ended:
            self._lines.clear()
            self._wipe()
        elif self._is_due():
            self._lines[""] = self._words.line(event, perf_counter())
            self._show()

    def _is_due(self) -> bool:
        """Whether a line is to be written, the first of a log after one interval."""
        self._begun = self._begun or perf_counter()
        return perf_counter() >= max(self._due, self._begun + (self._interval or 0.0))

    def _show(self) -> None:
        now = perf_counter()
        lines = [f"{place} {line}".lstrip() for place, line in sorted(self._lines.items())]
        if self._interval is None:
            self._due = now + REFRESH
            self._draw(lines)
            return
        longest = max(LONGEST_SILENCE, 2 * self._interval)
        self._due = now + max(self._interval, min(SILENCE_SHARE * (now - self._begun), longest))
        with self._uncaptured() as writer:
            reporter: Any = self._config.pluginmanager.getplugin("terminalreporter")
            at = reporter.currentfspath
            if writer.width_of_current_line:
                writer.line()
            writer.line(f"dura: {'; '.join(lines)}")
            writer.flush()
            # Dots of the same file go on below; what stands before a single result is repeated.
            reporter.currentfspath = at if isinstance(at, Path) else None

    def _draw(self, lines: Sequence[str]) -> None:
        """Write lines behind the cursor, over those that are there, and go back."""
        with self._uncaptured() as writer:
            writer.flush()
            # A full line moves the cursor on.
            room = writer.fullwidth - writer.width_of_current_line + 1
            share = room // max(1, len(lines)) - 2
            shown = "; ".join(filter(None, (fitting(line, share) for line in lines)))
            width = columns(shown)
            rest = max(0, self._drawn - width)
            self._drawn = max(self._drawn, width)  # an interruption may come in between
            line = shown + " " * rest + "\b" * (width + rest)
            os.write(sys.stdout.fileno(), line.encode(sys.stdout.encoding, "replace"))
            self._drawn = width

    def _wipe(self) -> None:
        if self._drawn:
            self._draw(())

    @contextmanager
    def _uncaptured(self) -> Iterator[Any]:
        """Context with pytest's writer in which standard output is that of the session."""
        capture: Any = self._config.pluginmanager.getplugin("capturemanager")
        with nullcontext() if capture is None else capture.global_and_fixture_disabled():
            yield self._config.get_terminal_writer()

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: WorkerController) -> None:
        """Let a worker send its progress, which passes the controller's own queue."""
        node.workerinput[_EVENT] = True
        dsession: Any = self._config.pluginmanager.getplugin("dsession")
        setattr(dsession, f"worker_{_EVENT}", self._received)
        receive = node.process_from_remote

        def receive_progress(call: Any) -> None:
            ours = isinstance(call, tuple) and call[0] == _EVENT
            (node.putevent if ours else receive)(call)

        node.process_from_remote = receive_progress

    def _received(self, worker: str, line: str) -> None:
        self._lines[worker] = line
        self._lines = {place: each for place, each in self._lines.items() if each}
        if not self._lines:
            self._wipe()
        elif self._is_due():
            self._show()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        """Leave the line to pytest, as all of the hooks below do."""
        self._wipe()

    pytest_runtest_logreport = pytest_runtest_logfinish = pytest_runtest_logstart
    pytest_enter_pdb = pytest_keyboard_interrupt = pytest_sessionfinish = pytest_runtest_logstart

    @pytest.hookimpl(optionalhook=True, tryfirst=True)
    def pytest_testnodedown(self, node: WorkerController) -> None:
        """Forget a worker, also one that was killed."""
        self._lines.pop(node.gateway.id, None)
        self._wipe()


def make_progress(
    config: pytest.Config, interval: float, requests: Requests
) -> WorkerProgress | ProgressDisplay | None:
    """Make what follows the progress of a process; ``None`` where nothing shows it, as under -q."""
    if hasattr(config, "workerinput"):
        return WorkerProgress(config, requests) if _EVENT in config.workerinput else None
    reporter: Any = config.pluginmanager.getplugin("terminalreporter")
    if reporter is None or config.getoption("verbose") < 0:
        return None
    # Without capture, and with live logs, tests write into the terminal at any time.
    written = config.getoption("capture", "no") in ("no", "tee-sys") or config.getini("log_cli")
    plain = os.environ.get("TERM", "dumb") == "dumb" or os.environ.get("CI")
    live = reporter.isatty and not written and not plain
    if not live and isinf(interval):
        return None
    display = ProgressDisplay(config, None if live else interval, requests)
    config.pluginmanager.register(display, "dura-progress")
    return display
