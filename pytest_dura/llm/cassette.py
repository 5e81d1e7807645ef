"""The cassette: one SQLite file with what a language model was asked and what it answered.

Several processes may share it. What it holds is checked before anything rests on it.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sqlite3
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from typing import Any, get_args

from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    ConfigurationError,
    report_environment_error,
)
from pytest_dura.llm.port import Answer, Request, WireFailure

_ANSWER = Answer().to_json()
_REQUEST = Request("", ()).to_json()
_FAILURES = get_args(WireFailure)


def _answer_of(data: Mapping[str, Any]) -> Answer:
    """The answer that plain data holds.

    Raises:
        ValueError: If it is none.
    """
    _need(set(data) == set(_ANSWER), "an answer has other entries")
    for name, usual in _ANSWER.items():
        if isinstance(usual, str):
            _need(isinstance(data[name], str), f"{name} of an answer is no text")
    _need(data["failure"] in _FAILURES, "an answer has a failure of no known class")
    seconds, usage = data["seconds"], data["usage"]
    fits = type(seconds) in (int, float) and math.isfinite(seconds) and seconds >= 0.0
    _need(fits, "seconds of an answer are no time")
    counts = isinstance(usage, dict) and all(type(item) is int for item in usage.values())
    _need(counts, "usage of an answer holds no counts")
    return Answer.from_json(data)


def _check_request(data: Mapping[str, Any]) -> None:
    """See that plain data is a request whose texts are digests or texts.

    Raises:
        ValueError: If it is none.
    """
    _need(set(data) == set(_REQUEST), "a request has other entries")
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
    """See that plain data describes a model.

    Raises:
        ValueError: If it does not.
    """
    for name, value in data.items():
        kind = dict if name == "capabilities" else str
        _need(isinstance(value, kind), f"{name} of a model is no {kind.__name__}")
    _need("model" in data and "base_url" in data, "a model has no name or no server")


def _need(met: bool, otherwise: str) -> None:
    if not met:
        raise ValueError(otherwise)


_APPLICATION = 0x44555241
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
        value = self.value(text)
        if not isinstance(value, dict):
            raise self.damaged("an entry is no object")
        return value

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
                report_environment_error(ComponentEnvironmentError("cassette", str(self._locked())))
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


Data = Mapping[str, Any]


@dataclass(frozen=True)
class Exchange:
    """What was asked and answered.

    Args:
        key: Of :meth:`pytest_dura.llm.port.Request.key`.
        fingerprint: Of the server that answered.
        request: ``Request.to_json()``, without secrets.
        answer: What came back.
        created: When, in ISO 8601.
    """

    key: str
    fingerprint: str
    request: Data
    answer: Answer
    created: str


class Cassette(CassetteFile):
    """Exchanges by key. What was stored first under a key stays.

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
        request = _without_texts(exchange.request, texts)
        with self.errors(), self.transaction() as execute:
            for text in sorted(texts.items()):
                execute("INSERT OR IGNORE INTO texts VALUES (?, ?)", text)
            execute(
                "INSERT OR IGNORE INTO exchanges (key, model, fingerprint, request, answer,"
                " created) VALUES (?, ?, ?, ?, ?, ?)",
                (
                    exchange.key,
                    _json(exchange.request["model"]),
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
        """Store what a model's server is, unless this session has it already.

        Args:
            description: Plain data with at least ``model`` and ``base_url``.
            session: The session's id.

        Returns:
            What is stored now.

        Raises:
            ConfigurationError: If the file cannot be written.
        """
        told = _json(description["model"]), _json(description["base_url"]), session
        with self.errors(), self.transaction() as execute:
            execute(
                "INSERT OR IGNORE INTO models (model, base_url, session, description)"
                " VALUES (?, ?, ?, ?)",
                (*told, _json(description)),
            )
        stored = self.described(description["model"], description["base_url"], session)
        assert stored is not None
        return stored

    def described(self, model: str, base_url: str, session: str) -> Data | None:
        """What the session stored of a model, if it did.

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
        """What is stored of all models, in the order in which it was.

        Raises:
            ConfigurationError: If the file cannot be read.
        """
        rows = self.rows("SELECT description FROM models ORDER BY id")
        return [self._description(row[0]) for row in rows]

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
        found = {**request, "messages": messages, "schema": self.text(request["schema"])}
        return self._checked(found, _check_request)

    def _description(self, text: Any) -> Data:
        return self._checked(self.object(text), _check_description)

    def _checked(self, data: Data, check: Callable[[Data], Any]) -> Data:
        """The same data, seen to be what it should be."""
        try:
            check(data)
        except ValueError as error:
            raise self.damaged(str(error)) from None
        return data

    def _answer(self, text: Any) -> Answer:
        return _answer_of(self._checked(self.object(text), _answer_of))


def text_digest(value: Any) -> str:
    """SHA-256 of a text or schema, by which it is stored."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _without_texts(request: Data, texts: dict[str, str]) -> dict[str, Any]:
    """The request with digests in the places of texts, which are put into ``texts``."""

    def kept(value: Any) -> str:
        digest = text_digest(value)
        texts[digest] = _json(value)
        return digest

    messages = [{**message, "text": kept(message["text"])} for message in request["messages"]]
    return {**request, "messages": messages, "schema": kept(request["schema"])}


def _json(value: Any) -> str:
    return canonical(value).decode("ascii")


def cassette_lines(file: Path) -> Iterator[str]:
    """Lines of JSON in ASCII: the models that were described, then the exchanges, in their order.

    Whatever a model answered, no character of it acts on a terminal.

    Args:
        file: The cassette, which stays as it is.

    Raises:
        ConfigurationError: If it is none, or cannot be read.
    """
    cassette = Cassette(file, writable=False)
    try:
        for description in cassette.descriptions():
            yield _line({"described": description})
        for exchange in cassette.exchanges():
            told = {key: value for key, value in vars(exchange).items() if key != "answer"}
            yield _line({**told, "answer": exchange.answer.to_json()})
    finally:
        cassette.close()


def _line(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
