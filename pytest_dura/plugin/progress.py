"""Progress of campaigns while they run: snapshots, the files of workers, and the hooks.

Workers of pytest-xdist have no terminal, and its channel carries its own events alone: they
write small files beside the evidence, which the controller reads.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.campaign.events import Progress
from pytest_dura.plugin import progress_display
from pytest_dura.plugin.progress_display import (
    DisplayMode,
    LiveScreen,
    ProgressLog,
    ProgressView,
    TerminalGuard,
    Ticker,
    capture_disabled,
    open_terminal,
)

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController


BOUND_SHARE = 1 / 500
"""Share of the time that goes into bounds, at most."""
LONGEST_BOUND_AGE = 10.0
"""Seconds after which a bound is made anew, whatever the last one took."""


class Snapshots:
    """Snapshots of running campaigns, with new bounds only as often as their cost allows.

    Args:
        clock: Seconds.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self.forget()

    def forget(self) -> None:
        """Forget the campaign, which has ended."""
        self._bounded: Progress | None = None
        self._due = -1.0

    def of(self, progress: Progress) -> Progress:
        """Return how far a campaign is, with its bound."""
        if self._bounded is None or self._bounded.judge is not progress.judge:
            self.forget()
        started = self._clock()
        if started >= self._due:
            self._bounded = progress.bounded()
            ended = self._clock()
            self._due = ended + min((ended - started) / BOUND_SHARE, LONGEST_BOUND_AGE)
            return self._bounded
        known = self._bounded
        # A bound from fewer runs with as many violations is greater, so it still holds.
        if known is None or known.violations != progress.violations:
            return progress
        return replace(progress, upper=known.upper, confidence=known.confidence)


WRITE_INTERVAL = 0.25
"""Seconds after which a worker writes again."""
_FILE_NAME = re.compile(r"([0-9a-f]{16})\.([A-Za-z0-9_-]{1,32})\.(json|tmp)")
_FIELDS = {field.name for field in fields(Progress)} - {"ended", "judge"}
_MOST_BYTES, _MOST_FILES, _LONGEST, _GREATEST = 4096, 256, 500, 10**9


class WorkerFile:
    """File in which a worker writes how far its campaign is.

    Args:
        folder: Where all workers do.
        token: Of the session, as its controller chose it.
        worker: Id of the worker.
        clock: Seconds.
        requests: Returns how many requests to language models this process has made.
    """

    def __init__(
        self,
        folder: Path,
        token: str,
        worker: str,
        clock: Callable[[], float] = perf_counter,
        requests: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._folder, self._clock, self._requests = folder, clock, requests
        self._file, self._begun = (folder / f"{token}.{worker}.{end}" for end in ("json", "tmp"))
        self._snapshots = Snapshots(clock)
        self._due: float | None = None
        self._written = False
        self._usable = True

    def begin(self) -> None:
        """Make the folder, by which the controller knows that campaigns are to come."""
        with suppress(OSError):  # without it there is no progress, which nothing depends on
            self._folder.mkdir(parents=True, exist_ok=True)

    def update(self, event: Progress) -> None:
        """Write the progress of a campaign that has run for a while; remove the file at its end."""
        if event.ended:
            self._end()
            return
        now = self._clock()
        if self._due is None:
            self._due = now + WRITE_INTERVAL
        elif now >= self._due and self._usable:
            self._due = now + WRITE_INTERVAL
            self._replace_file(replace(self._snapshots.of(event), requests=self._requests()))

    def _replace_file(self, progress: Progress) -> None:
        data = json.dumps({name: getattr(progress, name) for name in sorted(_FIELDS)}).encode()
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOFOLLOW", 0)
        try:
            handle = os.open(self._begun, flags, 0o644)
            try:
                os.write(handle, data)
            finally:
                os.close(handle)
            self._begun.replace(self._file)
        except OSError:  # there is no progress then, which nothing depends on
            self._usable = False
        else:
            self._written = True

    def _end(self) -> None:
        self._due = None
        self._snapshots.forget()
        if self._written:
            self._written = False
            with suppress(OSError):  # the controller removes what is left
                self._file.unlink()


def read_files(folder: Path, token: str) -> dict[str, Progress]:
    """Read the progress of each worker's campaign; what cannot be read is left out."""
    progress_of = {}
    for file, of_session, worker, end in _progress_files(folder):
        if of_session == token and end == "json":
            progress = _read_progress(file)
            if progress is not None:
                progress_of[worker] = progress
    return progress_of


def remove_files(folder: Path, worker: str | None = None) -> None:
    """Remove the files of all sessions, and the folder if nothing else is in it.

    Args:
        folder: The folder.
        worker: Remove the files of this worker alone.
    """
    # What cannot be removed does no harm: the token of a later session differs.
    with suppress(OSError):
        if folder.is_symlink():
            folder.unlink()
    for file, _, of_worker, _ in _progress_files(folder):
        if worker is None or worker == of_worker:
            with suppress(OSError):
                file.unlink()
    if worker is None:
        with suppress(OSError):
            folder.rmdir()


def _progress_files(folder: Path) -> list[tuple[Path, str, str, str]]:
    """List our files: path, token, worker, ending."""
    try:
        with os.scandir(folder) as entries:
            named = [(entry, _FILE_NAME.fullmatch(entry.name)) for entry in entries]
    except OSError:  # it is not there yet, or any more
        return []
    ours = [(Path(entry.path), match[1], match[2], match[3]) for entry, match in named if match]
    return ours[:_MOST_FILES]


def _read_progress(file: Path) -> Progress | None:
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(file, flags)
        try:
            text = os.read(handle, _MOST_BYTES + 1)
        finally:
            os.close(handle)
        return _checked_progress(json.loads(text)) if len(text) <= _MOST_BYTES else None
    except (OSError, ValueError, RecursionError):  # removed meanwhile, or no text of ours
        return None


def _checked_progress(data: Any) -> Progress | None:
    """Make progress of plain data, if every value is in its range."""
    if not (isinstance(data, dict) and set(data) == _FIELDS):
        return None
    counts = [data[name] for name in ("taken_over", "done", "budget")]
    optional = [data[name] for name in ("violations", "requests") if data[name] is not None]
    numbers = [*counts, *optional]
    shares = [data[name] for name in ("upper", "confidence") if data[name] is not None]
    is_valid = (
        all(_is_text(data[name]) for name in ("case", "subject"))
        and all(type(number) is int and 0 <= number <= _GREATEST for number in numbers)
        and counts == sorted(counts)
        and type(data["may_end_early"]) is bool
        and all(isinstance(share, float) and 0.0 <= share <= 1.0 for share in shares)
    )
    return Progress(**data) if is_valid else None


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST and value.isprintable()


class ProgressHooks:
    """Hooks that show this process's progress, or as a controller that of its workers.

    Args:
        config: The session's configuration.
        mode: How it is shown.
        folder: Where workers write theirs.
        interval: Seconds between the lines of a log.
        requests: Returns how many requests to language models this process has made.
    """

    def __init__(
        self,
        config: pytest.Config,
        mode: DisplayMode,
        folder: Path,
        interval: float,
        *,
        requests: Callable[[], int | None],
    ) -> None:
        self._config, self._mode, self._folder, self._interval = config, mode, folder, interval
        self._requests = requests
        self._reporter: Any = self._config.pluginmanager.getplugin("terminalreporter")
        self._distributed = self._config.pluginmanager.hasplugin("dsession")
        self._token = os.urandom(8).hex()
        self._guard: TerminalGuard | None = None
        self._screen: LiveScreen | None = None
        self._ticker: Ticker | None = None
        self._showing: ProgressView | None = None
        self._snapshots = Snapshots()
        self._own_progress: dict[str, Progress] = {}
        self._was_shown, self._due = True, 0.0

    def update(self, event: Progress) -> None:
        """Take in the progress of a campaign of this process."""
        if event.ended:
            self._own_progress = {}
            self._snapshots.forget()
            if self._screen is not None:
                self._screen.wipe()
        elif self._mode == "live":
            if self._was_shown:
                self._was_shown = False
                self._own_progress = {"": self._snapshots.of(event)}
                self._begin()
        elif perf_counter() >= self._due:
            self._due = perf_counter() + progress_display.LINES_INTERVAL
            self._own_progress = {"": self._snapshots.of(event)}
            # A log is written between two runs: another thread could not suspend the capture.
            self._begin().refresh()

    def _begin(self) -> ProgressView:
        if self._showing is None:
            surface = self._live() if self._mode == "live" else self._log()
            self._showing = ProgressView(surface, self._running_campaigns)
            if self._distributed or self._mode == "live":
                live, lines = progress_display.LIVE_INTERVAL, progress_display.LINES_INTERVAL
                self._ticker = Ticker(
                    self._showing.refresh, live if self._mode == "live" else lines
                )
        return self._showing

    def _running_campaigns(self) -> Mapping[str, Progress]:
        if self._distributed:
            return read_files(self._folder, self._token)
        self._was_shown = True
        requests = self._requests()
        return {
            place: replace(progress, requests=requests)
            for place, progress in self._own_progress.items()
        }

    def _live(self) -> LiveScreen:
        self._guard = TerminalGuard(self._config.get_terminal_writer())
        self._screen = LiveScreen(open_terminal(self._config), self._guard)
        return self._screen

    def _log(self) -> ProgressLog:
        if self._distributed:
            self._guard = TerminalGuard(self._config.get_terminal_writer())
            lock = self._guard.lock
            return ProgressLog(self._reporter, self._interval, perf_counter(), lambda: lock)
        uncaptured = partial(capture_disabled, self._config)
        return ProgressLog(self._reporter, self._interval, perf_counter(), uncaptured)

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: WorkerController) -> None:
        """Let a worker write its progress."""
        node.workerinput["dura_progress"] = self._token

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self) -> None:
        """Begin to read progress if workers are to run campaigns."""
        if self._folder.is_dir():
            self._begin()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: WorkerController) -> None:
        """Remove the file of a worker, also of one that was killed."""
        remove_files(self._folder, node.gateway.id)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_logstart(self) -> Generator[None, Any, Any]:
        """Let pytest write whole lines, which it writes in pieces."""
        return (yield from self._undisturbed())

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_logreport(self) -> Generator[None, Any, Any]:
        """Let pytest write whole lines."""
        return (yield from self._undisturbed())

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_logfinish(self) -> Generator[None, Any, Any]:
        """Let pytest write whole lines."""
        return (yield from self._undisturbed())

    def _undisturbed(self) -> Generator[None, Any, Any]:
        if self._guard is None:
            return (yield)
        with self._guard.lock:
            return (yield)

    def pytest_enter_pdb(self) -> None:
        """Leave the terminal to a debugger."""
        if self._screen is not None:
            self._screen.pause()

    def pytest_leave_pdb(self) -> None:
        """Take the terminal back."""
        if self._screen is not None:
            self._screen.resume()

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self) -> None:
        """End the display."""
        if self._ticker is not None:
            self._ticker.close()
        if self._screen is not None:
            self._screen.close()
        elif self._guard is not None:
            self._guard.remove()

    @pytest.hookimpl(trylast=True)
    def pytest_unconfigure(self) -> None:
        """Remove what workers left, which have ended by now."""
        if self._distributed:
            remove_files(self._folder)
