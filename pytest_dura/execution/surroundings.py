"""Surroundings of an episode in another process, and what it printed, logged and warned of there.

Warning filters, levels of loggers and a measurement of coverage go there with a call; what came of
them comes back with its result and is shown in the process that asked, as if it had happened there:
to ``capsys``, ``caplog``, the summary of warnings and the coverage of pytest-cov.
"""

from __future__ import annotations

import base64
import importlib
import logging
import random
import re
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

_ABSENT = frozenset({"pytest", "_pytest"})
"""Packages whose warnings no process raises that runs no tests; their import takes long."""
_MOST_RECORDS = 1000
"""Log records, and warnings, of one call that are kept."""
_KEPT = ("name", "levelno", "levelname", "pathname", "filename", "module", "lineno", "funcName",
         "created", "msecs", "process", "processName")  # fmt: skip
"""Attributes of a log record that are plain data."""
_RUN_OPTIONS = ("branch", "source", "include", "omit")


def surroundings() -> dict[str, Any]:
    """Describe those of this process as they are now, as plain data."""
    loggers = logging.root.manager.loggerDict.items()
    levels = {name: int(getattr(each, "level", 0)) for name, each in loggers}
    return {
        "filters": warning_filters(),
        "levels": {"": logging.root.level} | {name: each for name, each in levels.items() if each},
        "coverage": _coverage_options(),
    }


class StateOfProcess:
    """What a component may change in a process so that later episodes are other ones."""

    def __init__(self) -> None:
        self._folder, self._threads = Path.cwd(), threading.active_count()
        self._functions = {
            module: {name: each for name, each in vars(module).items() if callable(each)}
            for module in (random, time)
        }

    def restore(self) -> list[str]:
        """Restore functions that were replaced since; returns in words all that has changed."""
        changed = []
        if Path.cwd() != self._folder:
            changed.append("another working directory")
        if (more := threading.active_count() - self._threads) > 0:
            changed.append("a thread" if more == 1 else f"{more} threads")
        for module, before in self._functions.items():
            for name, function in before.items():
                if vars(module).get(name) is not function:
                    changed.append(f"another {module.__name__}.{name}")
                    setattr(module, name, function)
        return changed


def warning_filters() -> list[list[Any]]:
    """Describe the filters of this process as they are now, the first one to apply first.

    Returns:
        Of each, what :func:`warnings.filterwarnings` takes: action, pattern of the message, module
        and name of the category, pattern of the module, and line.
    """
    described: list[list[Any]] = []
    for action, message, category, module, line in warnings.filters:
        for each in category if isinstance(category, tuple) else (category,):
            if each.__module__.partition(".")[0] not in _ABSENT:
                place = [each.__module__, each.__qualname__]
                described.append([action, _pattern(message), *place, _pattern(module), line])
    return described


@contextmanager
def applied(given: Mapping[str, Any] | None) -> Iterator[dict[str, Any]]:
    """Context in which the surroundings of another process apply.

    Args:
        given: See :func:`surroundings`; ``None`` for those of this process.

    Yields:
        What is logged, warned of and executed meanwhile, which is complete at the end.
    """
    seen: dict[str, Any] = {}
    if given is None:
        yield seen
        return
    measured = _begin_coverage(given["coverage"])
    with _filtered(given["filters"]) as caught, _logging(given["levels"]) as records:
        try:
            yield seen
        finally:
            seen["log"] = records
            seen["warnings"] = [_plain_warning(each) for each in caught[:_MOST_RECORDS]]
            if measured is not None:
                measured.stop()
                seen["coverage"] = base64.b64encode(measured.get_data().dumps()).decode()


@dataclass(frozen=True)
class Captured:
    """What a call in another process printed, logged, warned of and executed.

    Args:
        stdout: What it printed.
        stderr: The same, of the other stream.
        seen: See :func:`applied`; empty for a process that ended.
    """

    stdout: str
    stderr: str
    seen: Mapping[str, Any]

    def show(self) -> None:
        """Print, log and warn of the same here, and count what was executed."""
        for stream, text in ((sys.stdout, self.stdout), (sys.stderr, self.stderr)):
            if text:
                stream.write(text)
        for data in self.seen.get("log", ()):
            record = logging.makeLogRecord(data)
            logger = logging.getLogger(record.name)
            if logger.isEnabledFor(record.levelno):
                logger.handle(record)
        with warnings.catch_warnings():
            warnings.simplefilter("always")  # what is an error has been raised there
            for text, module, name, file, line in self.seen.get("warnings", ()):
                category = _category(module, name) or UserWarning
                try:
                    warnings.warn_explicit(text, category, file, line)
                except Exception:  # a class of a user's own may take other arguments
                    warnings.warn_explicit(f"{name}: {text}", UserWarning, file, line)
        measured, current = self.seen.get("coverage"), _measurement()
        if measured is not None and current is not None:
            there = importlib.import_module("coverage").CoverageData(no_disk=True)
            there.loads(base64.b64decode(measured))
            current.get_data().update(there)


def _coverage_options() -> dict[str, Any] | None:
    """How this process measures coverage; ``None`` if it does not."""
    current = _measurement()
    if current is None:
        return None
    options = {name: current.get_option(f"run:{name}") for name in _RUN_OPTIONS}
    return {**options, "config_file": current.config.config_file or False}


def _measurement() -> Any:
    """The measurement of coverage that runs in this process, if one does."""
    module = sys.modules.get("coverage")
    return None if module is None else module.Coverage.current()


def _begin_coverage(options: Mapping[str, Any] | None) -> Any:
    if options is None:
        return None
    module = importlib.import_module("coverage")
    measured = module.Coverage(data_file=None, messages=False, **options)
    # The warnings are of a process that is measured as a whole.
    slugs = ["no-data-collected", "module-not-imported", "module-not-measured", "no-sysmon"]
    measured.set_option("run:disable_warnings", slugs)
    measured.start()
    return measured


class _Records(logging.Handler):
    """Handler that keeps records as plain data.

    Args:
        kept: Where they are kept.
    """

    def __init__(self, kept: list[dict[str, Any]]) -> None:
        super().__init__()
        self._kept = kept

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record, with its traceback as text."""
        if len(self._kept) >= _MOST_RECORDS:
            return
        try:
            data = {name: getattr(record, name) for name in _KEPT}
            data["msg"] = record.getMessage()
            if record.exc_info:
                data["exc_text"] = logging.Formatter().formatException(record.exc_info)
            self._kept.append(data)
        except Exception:  # the arguments of a record are of the user's own classes
            self.handleError(record)


@contextmanager
def _logging(levels: Mapping[str, int]) -> Iterator[list[dict[str, Any]]]:
    """Context in which loggers have these levels, and their records are kept."""
    records: list[dict[str, Any]] = []
    handler = _Records(records)
    before = {name: logging.getLogger(name).level for name in levels}
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
    logging.root.addHandler(handler)
    try:
        yield records
    finally:
        logging.root.removeHandler(handler)
        for name, level in before.items():  # the next call may come from other surroundings
            logging.getLogger(name).setLevel(level)


@contextmanager
def _filtered(filters: Sequence[Sequence[Any]]) -> Iterator[list[warnings.WarningMessage]]:
    """Context in which these filters apply, and no others; yields the warnings that are shown."""
    categories = [_category(module, name) for _, _, module, name, _, _ in filters]
    with warnings.catch_warnings(record=True) as caught:
        warnings.resetwarnings()
        for (action, text, _, _, module, line), category in zip(filters, categories, strict=True):
            if category is not None:
                warnings.filterwarnings(action, text, category, module, line, append=True)
        yield caught


def _plain_warning(shown: warnings.WarningMessage) -> list[Any]:
    category, text = shown.category, ""
    with suppress(Exception):  # the text of a class of the user's own
        text = str(shown.message)
    return [text, category.__module__, category.__qualname__, shown.filename, shown.lineno]


def _category(module: str, name: str) -> type[Warning] | None:
    """Find a class of warnings; ``None`` where no code can raise it, since it is not there."""
    try:
        return reduce(getattr, name.split("."), importlib.import_module(module))  # type: ignore[return-value]
    except (ImportError, AttributeError):  # such as of a conftest.py
        return None


def _pattern(text: re.Pattern[str] | str | None) -> str:
    """Return the pattern of a filter; Python's own filters compare whole names."""
    if text is None:
        return ""
    return text.pattern if isinstance(text, re.Pattern) else rf"{re.escape(text)}\Z"
