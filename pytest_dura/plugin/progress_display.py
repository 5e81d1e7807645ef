"""Display of progress: live below pytest's output in a terminal, or as lines in a log."""

from __future__ import annotations

import os
import sys
import unicodedata
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, RLock, Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, Protocol, TextIO

from pytest_dura.core.text import without_commands

if TYPE_CHECKING:
    import pytest

    from pytest_dura.campaign.events import Progress


PACE_WINDOW = 10.0
"""Seconds that are looked back."""
LEAST_SAMPLES = 6
"""Looks at which there was something new that are kept however long ago they were."""


class Pace:
    """Pace of one campaign: samples of its progress over time.

    Runs that were at hand when the campaign began say nothing of those that are simulated, and do
    not count.

    Args:
        progress: How far the campaign is at the first look.
        now: Seconds of any clock that runs evenly, as in all methods.
    """

    def __init__(self, progress: Progress, now: float) -> None:
        self._campaign = progress.case, progress.subject
        self._samples = deque([(now, progress.done)])

    def is_of(self, progress: Progress) -> bool:
        """Whether this is the same campaign, further on."""
        same = self._campaign == (progress.case, progress.subject)
        return same and progress.done >= self._samples[-1][1]

    def add(self, progress: Progress, now: float) -> None:
        """Add a sample of the progress."""
        samples = self._samples
        if 0 < progress.done <= progress.taken_over:
            samples.clear()
        if not samples or progress.done > samples[-1][1]:
            samples.append((now, progress.done))
        while len(samples) > LEAST_SAMPLES and now - samples[1][0] > PACE_WINDOW:
            samples.popleft()

    def rate(self, now: float) -> float | None:
        """Runs per second; ``None`` until a run has ended that began after the first sample.

        The run that is under way may take as long as one took lately before it slows the rate.
        """
        (begun, first), (latest, last) = self._samples[0], self._samples[-1]
        if last == first or latest <= begun:
            return None
        usual = (latest - begun) / (last - first)
        return (last - first) / (max(latest, now - usual) - begun)

    def left(self, remaining: int, now: float) -> float | None:
        """Seconds for so many runs, including the one under way; ``None`` as above."""
        rate = self.rate(now)
        if rate is None:
            return None
        under_way = min(1.0, rate * (now - self._samples[-1][0]))
        return max(0.0, remaining - under_way) / rate


class Throughput:
    """Requests per second over the last seconds, at one place.

    Args:
        window: Seconds that are looked back.
    """

    def __init__(self, window: float = PACE_WINDOW) -> None:
        self._window = window
        self._samples: deque[tuple[float, int]] = deque()

    def rate(self, requests: int | None, now: float) -> float | None:
        """Requests per second by now; ``None`` where there are none, and at the first look.

        Args:
            requests: Made so far, of the same process at each look.
            now: Seconds of a clock that runs evenly.
        """
        if requests is None:
            return None
        samples = self._samples
        samples.append((now, requests))
        while len(samples) > 2 and now - samples[1][0] >= self._window:
            samples.popleft()
        begun, first = samples[0]
        return (requests - first) / (now - begun) if now > begun else None


WIDE = 119
"""Columns from which on there is room for a sentence."""
MINUTE, HOUR = 60, 3600
SLOW, FAST = 0.1, 10.0
"""Runs per second below which there are more in a minute, and above which no decimal matters."""


@dataclass(frozen=True, slots=True)
class Row:
    """Progress of a campaign that runs, as it is shown.

    Args:
        place: The worker that runs it; empty for this process.
        progress: How far it is.
        rate: Runs per second, where that is known.
        left: Seconds for the rest of its budget, where that is known.
        requests: Requests to language models per second, where any are made.
    """

    place: str
    progress: Progress
    rate: float | None
    left: float | None
    requests: float | None = None


def log_line(row: Row) -> str:
    """Write all figures, as in a log."""
    progress, parts = row.progress, [_runs(row.progress)]
    if progress.violations is not None:
        parts.append(_violations(progress.violations))
    if progress.upper is not None and progress.confidence is not None:
        parts.append(f"rate <= {_percent(progress.upper)} ({100 * progress.confidence:g} %)")
    if row.rate is not None:
        parts.append(_speed(row.rate, " runs"))
    if row.requests is not None:
        parts.append(_speed(row.requests, " requests"))
    if row.left is not None:
        most = "at most " if progress.may_end_early else ""
        parts.append(f"{most}{duration(row.left)} left")
    return f"{_campaign_name(progress)}: {', '.join(parts)}"


def short_line(row: Row) -> str:
    """Write the same figures in fewer characters."""
    progress = row.progress
    parts = [f"{progress.done}/{progress.budget}"]
    if progress.violations is not None:
        parts.append(_violations(progress.violations))
    if progress.upper is not None:
        parts.append(f"<= {_percent(progress.upper)}")
    if row.rate is not None:
        parts.append(_speed(row.rate, ""))
    if row.requests is not None:
        parts.append(_speed(row.requests, " req"))
    if row.left is not None:
        parts.append(f"{'<= ' if progress.may_end_early else ''}{duration(row.left)} left")
    return f"{_campaign_name(progress)} {', '.join(parts)}"


def terminal_line(row: Row, width: int) -> str:
    """Write as much as fits into so many columns of a terminal."""
    place = f"{row.place} " if row.place else ""
    text = place + log_line(row)
    # Below that width, the line would change form with every digit more or less.
    if width < WIDE or columns(text) > width:
        text = place + short_line(row)
    return text if columns(text) <= width else _cut(text, width)


def duration(seconds: float) -> str:
    """Write a duration in its two largest units."""
    whole = max(1, round(seconds))
    if whole < MINUTE:
        return f"{whole} s"
    if whole < HOUR:
        return f"{whole // MINUTE} min {whole % MINUTE:02} s"
    return f"{whole // HOUR} h {whole % HOUR // MINUTE:02} min"


def columns(text: str) -> int:
    """Count the columns that a terminal needs for a text."""
    return sum(map(_columns, text))


def _columns(character: str) -> int:
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def _cut(text: str, width: int) -> str:
    kept, room = "", width - 2
    for character in text:
        room -= _columns(character)
        if room < 0:
            break
        kept += character
    return (kept + "..")[: max(width, 0)]


def _campaign_name(progress: Progress) -> str:
    # Escape sequences in a name would act on the terminal.
    name = f"{progress.case} {progress.subject}".rstrip()
    name = "".join(character if character.isprintable() else "?" for character in name)
    return without_commands(name)


def _runs(progress: Progress) -> str:
    most = "at most " if progress.may_end_early else ""
    runs = "run" if progress.budget == 1 else "runs"
    taken = f" ({progress.taken_over} taken over)" if progress.taken_over else ""
    return f"{progress.done} of {most}{progress.budget} {runs}{taken}"


def _violations(number: int) -> str:
    return f"{number} violation{'s' * (number != 1)}"


def _speed(rate: float, noun: str) -> str:
    if rate < SLOW:
        return f"{MINUTE * rate:.2g}{noun}/min"
    decimals = 2 if rate < 1.0 else 1 if rate < FAST else 0
    return f"{rate:.{decimals}f}{noun}/s"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


class Board:
    """Rows of the running campaigns, whose pace it follows."""

    def __init__(self) -> None:
        self._paces: dict[str, Pace] = {}
        self._throughputs: defaultdict[str, Throughput] = defaultdict(Throughput)

    def rows(self, campaigns: Mapping[str, Progress], now: float) -> list[Row]:
        """Return a row per place, in the order of their names.

        Args:
            campaigns: The campaign that runs at each place.
            now: Seconds of a clock that runs evenly.
        """
        self._paces = {
            place: self._pace(place, progress, now) for place, progress in campaigns.items()
        }
        rows = []
        for place in sorted(campaigns, key=lambda place: (len(place), place)):  # gw2 before gw10
            progress, pace = campaigns[place], self._paces[place]
            remaining = progress.budget - progress.done
            requests = self._throughputs[place].rate(progress.requests, now)
            left = pace.left(remaining, now)
            rows.append(Row(place, progress, pace.rate(now), left, requests))
        return rows

    def _pace(self, place: str, progress: Progress, now: float) -> Pace:
        pace = self._paces.get(place)
        if pace is None or not pace.is_of(progress):
            return Pace(progress, now)
        pace.add(progress, now)
        return pace


def _wipe_nothing() -> None:
    """Do nothing before pytest writes, as long as nothing is drawn."""


class TerminalGuard:
    """Guards pytest's terminal writer: wipes what is drawn before pytest writes, then flushes.

    Args:
        writer: Pytest's terminal writer, of which two methods are replaced.
    """

    def __init__(self, writer: Any) -> None:
        self.lock = RLock()
        self.before_write: Callable[[], None] = _wipe_nothing
        self._writer = writer
        for name in ("write", "write_raw"):
            if hasattr(writer, name):
                setattr(writer, name, self._guarded(getattr(writer, name)))

    def _guarded(self, write: Callable[..., None]) -> Callable[..., None]:
        def guarded(*arguments: Any, **options: Any) -> None:
            with self.lock:
                self.before_write()
                write(*arguments, **options)
                # What waited in a buffer would come out below what is drawn meanwhile.
                self._writer.flush()

        return guarded

    def remove(self) -> None:
        """Restore pytest's own methods."""
        for name in ("write", "write_raw"):
            vars(self._writer).pop(name, None)


SAVE, RESTORE = "\x1b7", "\x1b8"
_WIPE = "\x1b[J"
"""From the cursor to the end of the screen."""
_DOWN = "\x1bD"
"""One line down in the same column; the screen scrolls where there is none."""
_UP = "\x1b[{}A"
_USUAL_SIZE = os.terminal_size((80, 24))


class LiveScreen:
    """Draws rows below the line that pytest is writing, and wipes them before pytest goes on.

    The cursor is always left where pytest has it. Whoever draws does so in one write.

    Args:
        stream: The terminal, past any capture.
        guard: Between pytest and the terminal.
    """

    def __init__(self, stream: TextIO, guard: TerminalGuard) -> None:
        self._stream, self._guard = stream, guard
        self._drawn: list[str] = []
        self._paused = False
        guard.before_write = self._wipe

    def show(self, rows: Sequence[Row], now: float) -> None:  # noqa: ARG002 - a log waits
        """Draw these rows in place of those that are there."""
        size = self._size()
        # A line that is full moves the cursor on in some terminals.
        lines = [terminal_line(row, size.columns - 1) for row in rows[: max(0, size.lines - 2)]]
        with self._guard.lock:
            if self._paused or lines == self._drawn:
                return
            if lines:
                self._draw(lines)
            else:
                self._wipe()

    def wipe(self) -> None:
        """Wipe what is drawn."""
        with self._guard.lock:
            self._wipe()

    def pause(self) -> None:
        """Wipe what is drawn and draw nothing, since a debugger writes."""
        with self._guard.lock:
            self._wipe()
            self._paused = True

    def resume(self) -> None:
        """Draw again."""
        self._paused = False

    def close(self) -> None:
        """Wipe what is drawn, and draw nothing any more."""
        self.pause()
        self._guard.remove()
        self._stream.close()

    def _draw(self, lines: list[str]) -> None:
        below = "".join(f"\r\n{line}" for line in lines)
        room = _DOWN * len(lines) + _UP.format(len(lines))
        self._write(f"{_WIPE}{room}{SAVE}{below}{RESTORE}")
        self._drawn = lines

    def _wipe(self) -> None:
        if self._drawn:
            self._drawn = []
            self._write(_WIPE)

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()

    def _size(self) -> os.terminal_size:
        try:
            size = os.get_terminal_size(self._stream.fileno())
        except OSError:
            return _USUAL_SIZE
        # A terminal that does not know its size reports 0.
        return os.terminal_size(
            (size.columns or _USUAL_SIZE.columns, size.lines or _USUAL_SIZE.lines)
        )


_SILENCE_SHARE = 0.1
"""The longer a session lasts, the longer until the next line: so much of what has passed."""
LONGEST_SILENCE = 300.0
"""But no longer than that, or twice the interval: CI services end what is silent."""


class ProgressLog:
    """Writes a line per campaign, the first after one interval.

    Args:
        reporter: Pytest's terminal reporter.
        interval: Seconds between lines, at least.
        begun: When the first campaign began.
        uncaptured: Context in which pytest's reporter reaches the log, and nobody else writes.
    """

    def __init__(
        self,
        reporter: Any,
        interval: float,
        begun: float,
        uncaptured: Callable[[], AbstractContextManager[Any]],
    ) -> None:
        self._reporter, self._interval, self._begun = reporter, interval, begun
        self._uncaptured = uncaptured
        self._due = begun + interval

    def show(self, rows: Sequence[Row], now: float) -> None:
        """Write the rows, if a line is due."""
        if now < self._due or not rows:
            return
        longest = max(LONGEST_SILENCE, 2 * self._interval)
        self._due = now + max(self._interval, min(_SILENCE_SHARE * (now - self._begun), longest))
        with self._uncaptured():
            self._write([f"dura: {log_line(row)}" for row in rows])

    def _write(self, lines: Sequence[str]) -> None:
        """Write lines on lines of their own."""
        reporter = self._reporter
        writer, at = reporter.config.get_terminal_writer(), reporter.currentfspath
        if writer.width_of_current_line:
            writer.line()
        for line in lines:
            writer.line(line)
        writer.flush()
        # Dots of the same file go on below; what stands before a single result is written again.
        reporter.currentfspath = at if isinstance(at, Path) else None


DisplayMode = Literal["live", "lines"]

LIVE_INTERVAL = 0.2
"""Seconds between two refreshes of a terminal."""
LINES_INTERVAL = 0.5
"""Seconds between two refreshes of a log, few of which write a line."""


def display_mode(config: pytest.Config) -> DisplayMode | None:
    """Return how this process shows progress; ``None`` if it does not, as under ``-q``."""
    reporter = config.pluginmanager.getplugin("terminalreporter")
    if reporter is None or hasattr(config, "workerinput") or config.getoption("verbose") < 0:
        return None
    # Without capture, tests write into the terminal at any time.
    live = (
        bool(reporter.isatty)
        and os.name == "posix"
        and os.environ.get("TERM", "dumb") != "dumb"
        and not os.environ.get("CI")
        and config.getoption("capture", "no") not in ("no", "tee-sys")
    )
    return "live" if live else "lines"


class Surface(Protocol):
    """Display that shows rows."""

    def show(self, rows: Sequence[Row], now: float) -> None:
        """Show these rows, or wait until a line is due."""


class ProgressView:
    """Shows the running campaigns on a surface, at each refresh.

    Args:
        surface: Shows it.
        campaigns: The campaigns that run, by the place where they do.
        clock: Seconds.
    """

    def __init__(
        self,
        surface: Surface,
        campaigns: Callable[[], Mapping[str, Progress]],
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self._surface, self._campaigns, self._clock = surface, campaigns, clock
        self._board = Board()

    def refresh(self) -> None:
        """Show the present progress."""
        now = self._clock()
        self._surface.show(self._board.rows(self._campaigns(), now), now)


class Ticker:
    """Calls a function at intervals, in a thread that ends with the session.

    Args:
        refresh: Called each time; an error of the operating system ends it.
        interval: Seconds in between.
    """

    def __init__(self, refresh: Callable[[], None], interval: float) -> None:
        self._refresh, self._interval = refresh, interval
        self._over = Event()
        self._thread = Thread(target=self._run, name="dura-progress", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        # If the terminal is gone, pytest itself reports that.
        with suppress(OSError):
            while not self._over.wait(self._interval):
                self._refresh()

    def close(self) -> None:
        """End the thread."""
        self._over.set()
        self._thread.join()


def capture_disabled(config: pytest.Config) -> AbstractContextManager[Any]:
    """Context in which standard output is that of the session."""
    capture = config.pluginmanager.getplugin("capturemanager")
    context: AbstractContextManager[Any] = (
        nullcontext() if capture is None else capture.global_and_fixture_disabled()
    )
    return context


def open_terminal(config: pytest.Config) -> TextIO:
    """Open the terminal again, past any capture.

    Raises:
        OSError: If standard output has no file beneath it.
    """
    with capture_disabled(config):
        handle = os.dup(sys.stdout.fileno())
        return os.fdopen(handle, "w", encoding=sys.stdout.encoding, errors="replace", newline="")
