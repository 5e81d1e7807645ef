"""Cassette: one SQLite file with requests to language models, and their answers.

Several processes may share it. All that is read from it is checked first.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
import weakref
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    ConfigurationError,
    report_environment_error,
)
from pytest_dura.llm.port import REQUEST_EXTRAS, Answer, Request

_REQUEST = Request("", ()).to_json()


def _check_request(data: Mapping[str, Any]) -> None:
    """Check that plain data is a request, with texts or their digests.

    Raises:
        ValueError: If it is not.
    """
    _need(set(data) - set(REQUEST_EXTRAS) == set(_REQUEST), "a request has other entries")
    _need(isinstance(data["messages"], list), "a request has no list of messages")
    for message in data["messages"]:
        _need(
            isinstance(message, dict)
            and set(message) == {"role", "text", "images"}
            and isinstance(message["text"], str)
            and isinstance(message["images"], list)
            and all(isinstance(image, dict) and "name" in image for image in message["images"]),
            "a message of a request is none",
        )


def _check_description(data: Mapping[str, Any]) -> None:
    """Check that plain data describes a model.

    Raises:
        ValueError: If it does not.
    """
    for name, value in data.items():
        kind = dict if name == "capabilities" else str
        _need(isinstance(value, kind), f"{name} of a model is no {kind.__name__}")
    _need("model" in data and "base_url" in data, "a model has no name or no server")


def _need(met: bool, problem: str) -> None:
    if not met:
        raise ValueError(problem)


_APPLICATION = 0x44555241
"""``DURA`` in ASCII: what tells a cassette from other SQLite files."""
VERSION = 1
PATIENCE = 60.0
"""Seconds for which a process waits while another one writes."""
LONG = 0.5
"""Seconds after which an operation on the file counts as held up by other processes."""
_TABLES = """
CREATE TABLE texts (sha256 TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE exchanges (id INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, model TEXT NOT NULL,
    fingerprint TEXT NOT NULL, request TEXT NOT NULL, answer TEXT NOT NULL, created TEXT NOT NULL);
CREATE TABLE models (id INTEGER PRIMARY KEY, model TEXT NOT NULL, base_url TEXT NOT NULL,
    session TEXT NOT NULL, description TEXT NOT NULL, UNIQUE (model, base_url, session))
"""
_CONTENTS = "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name"


class CassetteFile:
    """File of a cassette.

    Args:
        file: Its path.
        writable: Whether it is recorded into; it is made if it is missing. Otherwise the file stays
            as it is, but for a write that its process did not finish, which is undone.

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
                self._undo_write()
            self._open = self._connected("rwc" if writable else "ro")
        # Also of a cassette that is dropped, whose connection Python 3.13 would warn of.
        self._close = weakref.finalize(self, self._open.close)
        try:
            with self.errors():
                # Waiting for the disk at each exchange takes longer than many a model. A process
                # that dies leaves a whole file all the same; a machine without power may not.
                self._open.execute("PRAGMA synchronous = OFF")
                self._check()
        except BaseException:  # also on ctrl-C; it is raised again
            self.close()
            raise

    def close(self) -> None:
        """Close the file; what was recorded is on the disk then."""
        self._close()
        if self.writable and self.file.is_file():
            with self.file.open("rb") as stream:
                os.fsync(stream.fileno())

    def _connected(self, mode: str) -> sqlite3.Connection:
        # `as_uri` escapes what has a meaning in URIs.
        return sqlite3.connect(
            f"{self.file.absolute().as_uri()}?mode={mode}",
            timeout=PATIENCE, isolation_level=None, check_same_thread=False, uri=True,
        )  # fmt: skip

    def _undo_write(self) -> None:
        """Let SQLite undo the write of a process that was ended in the middle of it."""
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

    def _check(self) -> None:
        """Make the tables of a new file, and check those of any other."""
        tables = self._open.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()[0]
        if self.writable and not tables:
            with self.transaction() as execute:
                # Another process may have been quicker.
                if not execute("SELECT COUNT(*) FROM sqlite_master").fetchone()[0]:
                    for statement in _TABLES.split(";"):
                        execute(statement)
                    execute(f"PRAGMA application_id = {_APPLICATION}")
                    execute(f"PRAGMA user_version = {VERSION}")
        if self._open.execute("PRAGMA application_id").fetchone()[0] != _APPLICATION:
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
        # A view with a table's name may do anything, such as never end.
        with closing(sqlite3.connect(":memory:")) as empty:
            empty.executescript(_TABLES)
            if self._open.execute(_CONTENTS).fetchall() != empty.execute(_CONTENTS).fetchall():
                raise self.damaged("it is made of other tables than a cassette")
        result = self._open.execute("PRAGMA quick_check(1)").fetchone()[0]
        if result != "ok":
            raise self.damaged(str(result))

    @contextmanager
    def transaction(self) -> Iterator[Callable[..., Any]]:
        """Context that writes all of its statements or none; gives the function to execute them."""
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
        """Rows of a query.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        with self.errors(), self._lock:
            return self._open.execute(statement, values).fetchall()

    def value(self, text: Any) -> Any:
        """Value of a column of JSON.

        Raises:
            ConfigurationError: If it is no JSON.
        """
        try:
            return json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise self.damaged(str(error)) from None

    def object(self, text: Any) -> Mapping[str, Any]:
        """Object of a column of JSON.

        Raises:
            ConfigurationError: If it is no JSON object.
        """
        value = self.value(text)
        if not isinstance(value, dict):
            raise self.damaged("an entry is no object")
        return value

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Context that turns errors of SQLite and the system into one of ours.

        A wait for other processes takes the component's time, too: where that ends meanwhile, an
        environment error is reported, since the component was not slow.

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
                report_environment_error(ComponentEnvironmentError("cassette", str(self._locked())))
            raise

    def damaged(self, detail: str) -> ConfigurationError:
        """Make the error for a file that is damaged, or cannot be opened."""
        verb = "written" if self.writable else "read"
        return self._error(
            f"the cassette cannot be {verb}: {detail[:200]}",
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


Data = Mapping[str, Any]


@dataclass(frozen=True)
class Exchange:
    """Request and its answer.

    Args:
        key: Of :meth:`pytest_dura.llm.port.Request.key`.
        fingerprint: Of the server that answered.
        request: ``Request.to_json()``, without secrets.
        answer: The answer.
        created: Time, in ISO 8601.
    """

    key: str
    fingerprint: str
    request: Data
    answer: Answer
    created: str


class Cassette(CassetteFile):
    """Exchanges by key. The first exchange that is stored under a key stays.

    A request that timed out is asked again where the budget is larger, and its answer takes the
    place of the time-out.

    Texts and schemas are stored once each, by their SHA-256; of images there is the SHA-256 alone.
    Every text is kept as JSON in ASCII: models answer what no encoding takes, such as half a
    surrogate pair.
    """

    def find(self, key: str) -> Answer | None:
        """The answer that is stored under a key.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        rows = self.rows("SELECT answer FROM exchanges WHERE key = ?", key)
        return self._answer(rows[0][0]) if rows else None

    def add(self, exchange: Exchange) -> Answer:
        """Store an exchange, unless there is one under its key.

        Returns:
            The answer that is stored now: that of another process, if it was quicker.

        Raises:
            ConfigurationError: If the file cannot be written.
        """
        texts: dict[str, str] = {}

        def kept(value: Any) -> str:
            digest = text_digest(value)
            texts[digest] = _json(value)
            return digest

        whole = exchange.request
        messages = [{**message, "text": kept(message["text"])} for message in whole["messages"]]
        request = {**whole, "messages": messages, "schema": kept(whole["schema"])}
        with self.errors(), self.transaction() as execute:
            for text in sorted(texts.items()):
                execute("INSERT OR IGNORE INTO texts VALUES (?, ?)", text)
            before = self.find(exchange.key)
            if before is not None and before.failure == "timeout":
                execute("DELETE FROM exchanges WHERE key = ?", (exchange.key,))
            execute(
                "INSERT OR IGNORE INTO exchanges (key, model, fingerprint, request, answer,"
                " created) VALUES (?, ?, ?, ?, ?, ?)",
                (
                    exchange.key,
                    _json(whole["model"]),
                    _json(exchange.fingerprint),
                    _json(request),
                    _json(exchange.answer.to_json()),
                    exchange.created,
                ),
            )
        stored = self.find(exchange.key)
        assert stored is not None
        return stored

    def describe(self, description: Data, session: str) -> Data:
        """Store the description of a model and its server, unless this session has one already.

        Args:
            description: Plain data with at least ``model`` and ``base_url``.
            session: The session's id.

        Returns:
            The description that is stored now.

        Raises:
            ConfigurationError: If the file cannot be written.
        """
        key = _json(description["model"]), _json(description["base_url"]), session
        with self.errors(), self.transaction() as execute:
            execute(
                "INSERT OR IGNORE INTO models (model, base_url, session, description)"
                " VALUES (?, ?, ?, ?)",
                (*key, _json(description)),
            )
        stored = self.described(description["model"], description["base_url"], session)
        assert stored is not None
        return stored

    def described(self, model: str, base_url: str, session: str) -> Data | None:
        """The description that the session stored of a model, if any.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        rows = self.rows(
            "SELECT description FROM models WHERE model = ? AND base_url = ? AND session = ?",
            _json(model),
            _json(base_url),
            session,
        )
        return self._description(rows[0][0]) if rows else None

    def descriptions(self) -> list[Data]:
        """Descriptions of all models, in the order in which they were stored.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        rows = self.rows("SELECT description FROM models ORDER BY id")
        return [self._description(row[0]) for row in rows]

    def drop_failures(self, classes: Collection[str]) -> Counter[str]:
        """Remove exchanges that failed, all of them or, where that is not possible, none.

        Args:
            classes: The classes of failures to remove.

        Returns:
            The number of removed exchanges by class.

        Raises:
            ConfigurationError: If the file cannot be read or written.
        """
        dropped: Counter[str] = Counter()
        with self.errors(), self.transaction() as execute:
            rows = execute("SELECT id, answer FROM exchanges").fetchall()
            for number, answer in rows:
                failure = self._answer(answer).failure
                if failure and failure in classes:
                    execute("DELETE FROM exchanges WHERE id = ?", (number,))
                    dropped[failure] += 1
        return dropped

    def __len__(self) -> int:
        return int(self.rows("SELECT COUNT(*) FROM exchanges")[0][0])

    def exchanges(self, model: str | None = None) -> Iterator[Exchange]:
        """The exchanges in the order in which they were stored.

        Args:
            model: Of this model alone, if given.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        last = 0
        while rows := self.rows(
            "SELECT id, key, fingerprint, request, answer, created FROM exchanges"
            " WHERE id > ? AND (? IS NULL OR model = ?) ORDER BY id LIMIT 100",
            last,
            *[None if model is None else _json(model)] * 2,
        ):
            last = rows[-1][0]
            for _, key, fingerprint, request, answer, created in rows:
                yield Exchange(
                    str(key),
                    str(self.value(fingerprint)),
                    self._with_texts(self._checked(self.object(request), _check_request)),
                    self._answer(answer),
                    str(created),
                )

    def text(self, sha256: str) -> Any:
        """A text or schema by its SHA-256.

        Raises:
            ConfigurationError: If it is not in the file.
        """
        rows = self.rows("SELECT text FROM texts WHERE sha256 = ?", sha256)
        if not rows:
            raise self.damaged("it lacks a text of an exchange")
        return self.value(rows[0][0])

    def _with_texts(self, request: Data) -> Data:
        messages = [
            {**message, "text": self.text(message["text"])} for message in request["messages"]
        ]
        whole = {**request, "messages": messages, "schema": self.text(request["schema"])}
        return self._checked(whole, _check_request)

    def _description(self, text: Any) -> Data:
        return self._checked(self.object(text), _check_description)

    def _checked(self, data: Data, check: Callable[[Data], Any]) -> Data:
        try:
            check(data)
        except ValueError as error:
            raise self.damaged(str(error)) from None
        return data

    def _answer(self, text: Any) -> Answer:
        data = self.object(text)
        try:
            return Answer.from_json(data)
        except ValueError as error:
            raise self.damaged(f"an entry of an answer is none: {error}") from None


def text_digest(value: Any) -> str:
    """SHA-256 of a text or schema, by which it is stored."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _json(value: Any) -> str:
    return canonical(value).decode("ascii")


def cassette_lines(file: Path) -> Iterator[str]:
    """Lines of JSON in ASCII: the models that were described, then the exchanges, in their order.

    No character of a model's answer acts on a terminal.

    Args:
        file: The cassette, which stays as it is.

    Raises:
        ConfigurationError: If it is no cassette, or cannot be read.
    """
    with closing(Cassette(file, writable=False)) as cassette:
        for description in cassette.descriptions():
            yield json.dumps({"described": description}, sort_keys=True)
        for exchange in cassette.exchanges():
            data = {**vars(exchange), "answer": exchange.answer.to_json()}
            yield json.dumps(data, sort_keys=True)


def drop_failures(file: Path, classes: Collection[str]) -> tuple[Counter[str], int]:
    """Remove exchanges of a cassette that failed; a session that records asks for them again.

    Args:
        file: The cassette.
        classes: The classes of failures to remove.

    Returns:
        The number of removed exchanges by class, and of those that are left.

    Raises:
        ConfigurationError: If it is no cassette, or cannot be written; then it stays as it is.
    """
    Cassette(file, writable=False).close()  # one that is missing is not made
    with closing(Cassette(file, writable=True)) as cassette:
        return cassette.drop_failures(classes), len(cassette)
