"""CassetteFile: an SQLite file that several processes may share, opened with one clear error."""

from __future__ import annotations

import json
import os
import sqlite3
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.outside import OutsideError, told

APPLICATION = 0x44555241
"""``DURA`` in ASCII: what tells a cassette from other SQLite files."""
VERSION = 1
PATIENCE = 60.0
"""Seconds for which a process waits until another one has written."""
LONG = 0.5
"""Seconds after which what is done with the file was held up by others."""
_TABLES = """
CREATE TABLE texts (sha256 TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE exchanges (id INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, model TEXT NOT NULL,
    fingerprint TEXT NOT NULL, request TEXT NOT NULL, answer TEXT NOT NULL, created TEXT NOT NULL);
CREATE TABLE models (id INTEGER PRIMARY KEY, model TEXT NOT NULL, base_url TEXT NOT NULL,
    session TEXT NOT NULL, description TEXT NOT NULL, UNIQUE (model, base_url, session))
"""
_MADE_OF = "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name"


class CassetteFile:
    """The file behind a cassette.

    Args:
        file: Where it is.
        writable: Whether it is recorded into; it is made if it is missing. Else nothing about the
            file is changed, but that a write is undone in whose middle its process was ended.

    Raises:
        ConfigurationError: If it is missing, damaged, another program's or a newer version's.
    """

    def __init__(self, file: Path, *, writable: bool) -> None:
        self.file, self.writable = file, writable
        self._lock = RLock()
        if not writable and not file.is_file():
            raise self._error(
                "there is no such cassette",
                expected="a file that --dura-llm=record wrote",
                remedy="record one first, or name another with --dura-cassette",
            )
        if file.is_dir():
            raise self._error("the cassette is a directory", expected="a file")
        with self.errors():
            if writable:
                file.parent.mkdir(parents=True, exist_ok=True)
            else:
                self._undo_half_a_write()
            self._open = self._connected("rwc" if writable else "ro")
        # Also of a cassette that is dropped, whose connection Python 3.13 would warn of.
        self._let_go = weakref.finalize(self, self._open.close)
        try:
            with self.errors():
                # Waiting for the disk at each exchange takes longer than many a model. A process
                # that dies leaves a whole file all the same; a machine without power may not.
                self._open.execute("PRAGMA synchronous = OFF")
                self._begin()
        except BaseException:  # also on ctrl-C; it is raised again
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        self._let_go()
        if self.writable and self.file.is_file():
            with self.file.open("rb") as stream:
                os.fsync(stream.fileno())

    def _connected(self, mode: str) -> sqlite3.Connection:
        # Letters of a file's name may mean something in a URI.
        return sqlite3.connect(
            f"{self.file.absolute().as_uri()}?mode={mode}",
            timeout=PATIENCE, isolation_level=None, check_same_thread=False, uri=True,
        )  # fmt: skip

    def _undo_half_a_write(self) -> None:
        """Let SQLite put right what a process left that was ended while it wrote, if one was."""
        journal = Path(f"{self.file.resolve()}-journal")
        if not journal.is_file() or not journal.stat().st_size:
            return
        try:
            with closing(self._connected("rw")) as opened:
                opened.execute("SELECT COUNT(*) FROM sqlite_master")
        except sqlite3.OperationalError as error:
            raise self._error(
                f"the session that recorded it was ended while it wrote, which cannot be undone"
                f" here: {error}",
                expected="the right to write the cassette and its folder",
                remedy=f"copy it and {journal.name} to where they can be written, and name that",
            ) from None

    def _begin(self) -> None:
        known = self._open.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()[0]
        if self.writable and not known:
            with self.transaction() as execute:
                # Another process may have been quicker.
                if not execute("SELECT COUNT(*) FROM sqlite_master").fetchone()[0]:
                    for statement in _TABLES.split(";"):
                        execute(statement)
                    execute(f"PRAGMA application_id = {APPLICATION}")
                    execute(f"PRAGMA user_version = {VERSION}")
        if self._open.execute("PRAGMA application_id").fetchone()[0] != APPLICATION:
            raise self._error(
                "this file is no cassette",
                expected="a file that --dura-llm=record wrote",
                remedy="name another file with --dura-cassette; this one was left as it is",
            )
        version = self._open.execute("PRAGMA user_version").fetchone()[0]
        if version != VERSION:
            raise self._error(
                "this cassette has a form that this version of pytest-dura does not know",
                found=f"version {version}",
                expected=f"version {VERSION}",
                remedy="use the version of pytest-dura that recorded it, or record it again",
            )
        # What only bears a table's name may do anything, such as never end.
        with closing(sqlite3.connect(":memory:")) as usual:
            usual.executescript(_TABLES)
            if self._open.execute(_MADE_OF).fetchall() != usual.execute(_MADE_OF).fetchall():
                raise self.damaged("it is made of other tables than a cassette")
        sound = self._open.execute("PRAGMA quick_check(1)").fetchone()[0]
        if sound != "ok":
            raise self.damaged(str(sound))

    @contextmanager
    def transaction(self) -> Iterator[Callable[..., Any]]:
        """Context in which all is written or nothing; gives what carries out a statement."""
        with self._lock:
            try:
                self._open.execute("BEGIN IMMEDIATE")
                yield self._open.execute
                self._open.execute("COMMIT")
            except BaseException:  # also where a time limit ends it; it is raised again
                if self._open.in_transaction:
                    self._open.execute("ROLLBACK")
                raise

    def rows(self, statement: str, *values: Any) -> list[tuple[Any, ...]]:
        """What a statement finds.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        with self.errors(), self._lock:
            return self._open.execute(statement, values).fetchall()

    def value(self, text: Any) -> Any:
        """What a column of JSON holds.

        Raises:
            ConfigurationError: If it holds something else.
        """
        try:
            return json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise self.damaged(str(error)) from None

    def object(self, text: Any) -> Mapping[str, Any]:
        """What a column of JSON holds that is to be an object.

        Raises:
            ConfigurationError: If it holds something else.
        """
        found = self.value(text)
        if not isinstance(found, dict):
            raise self.damaged("an entry is no object")
        return found

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Context in which what SQLite and the system say against the file is one error of ours.

        A wait for other processes takes the component's time, too: where that ends meanwhile, it is
        not the component that was slow.

        Raises:
            ConfigurationError: In place of theirs.
        """
        start = time.monotonic()
        try:
            yield
        except (sqlite3.Error, OSError, ValueError) as error:
            if isinstance(error, sqlite3.OperationalError) and "locked" in str(error):
                raise self._locked() from None
            raise self.damaged(str(error)) from None
        except BaseException:  # it is raised again
            if time.monotonic() - start > LONG:
                told(OutsideError("cassette", str(self._locked())))
            raise

    def damaged(self, what: str) -> ConfigurationError:
        """The error for a file that is not as it was written, or cannot be got at."""
        deed = "written" if self.writable else "read"
        return self._error(
            f"the cassette cannot be {deed}: {what[:200]}",
            expected="a file that --dura-llm=record wrote, and the right to use it",
            remedy="restore it, or record it again into another file",
        )

    def _locked(self) -> ConfigurationError:
        return self._error(
            "other processes have kept the cassette locked for too long",
            remedy="let one session at a time record into it",
        )

    def _error(self, problem: str, **more: Any) -> ConfigurationError:
        return ConfigurationError(problem, file=str(self.file), key="--dura-cassette", **more)
