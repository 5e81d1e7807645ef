"""Cassette: one SQLite file with requests to language models, and their answers.

Several processes may share it. All that is read from it is checked first. Where it has no answer to
a request, :func:`explain_miss` names what differs from the nearest request that it has.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sqlite3
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from threading import RLock
from typing import Any, get_args

from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import (
    ComponentEnvironmentError,
    ConfigurationError,
    report_environment_error,
    shorten,
)
from pytest_dura.llm.port import Answer, Request, WireFailure

_ANSWER = Answer().to_json()
_REQUEST = Request("", ()).to_json()
_FAILURES = get_args(WireFailure)


def _answer_of(data: Mapping[str, Any]) -> Answer:
    """Make an answer of plain data.

    Raises:
        ValueError: If the data is no answer.
    """
    _need(set(data) == set(_ANSWER), "an answer has other entries")
    for name, usual in _ANSWER.items():
        if isinstance(usual, str):
            _need(isinstance(data[name], str), f"{name} of an answer is no text")
    _need(data["failure"] in _FAILURES, "an answer has a failure of no known class")
    seconds, usage = data["seconds"], data["usage"]
    fits = type(seconds) in (int, float) and math.isfinite(seconds) and seconds >= 0.0
    _need(fits, "seconds of an answer are no time")
    counts = isinstance(usage, dict) and all(type(count) is int for count in usage.values())
    _need(counts, "usage of an answer holds no counts")
    return Answer.from_json(data)


def _check_request(data: Mapping[str, Any]) -> None:
    """Check that plain data is a request, with texts or their digests.

    Raises:
        ValueError: If it is not.
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

    No character of a model's answer acts on a terminal.

    Args:
        file: The cassette, which stays as it is.

    Raises:
        ConfigurationError: If it is no cassette, or cannot be read.
    """
    cassette = Cassette(file, writable=False)
    try:
        for description in cassette.descriptions():
            yield _line({"described": description})
        for exchange in cassette.exchanges():
            yield _line({**vars(exchange), "answer": exchange.answer.to_json()})
    finally:
        cassette.close()


def _line(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


_MOST_COMPARED = 5000
"""Exchanges of a model that are compared with a request; a miss must not take minutes."""
LONGEST_MISS = 900
_LONGEST_SHOWN = 90
_PARAMETERS = ("structured", "temperature", "max_tokens", "seed", "sample")
_HEADING = re.compile(r"[\W_]*([A-Z][A-Z_]{2,29})(?:\W|$)")


class CassetteMissError(ComponentEnvironmentError):
    """Error for a request to which the cassette has no answer: in replay no server is asked."""

    def __init__(self, problem: str) -> None:
        super().__init__("cassette", problem)


def explain_miss(cassette: Cassette, request: Data, fingerprint: str) -> str:
    """Name what differs from the nearest recorded request, on one line of bounded length.

    The nearest one has the most messages in common, then the sample, then the most lines of the
    message that differs first. The text depends on the file and the request alone.

    Args:
        cassette: The cassette without the request.
        request: ``Request.to_json()``, without secrets as the recorded ones.
        fingerprint: Of the server that was to answer.

    Raises:
        ConfigurationError: If the cassette cannot be read.
    """
    best: Exchange | None = None
    best_score: tuple[int, ...] = ()
    compared = 0
    for exchange in cassette.exchanges(request["model"]):
        score = _likeness(exchange, request, fingerprint)
        if best is None or score > best_score:
            best, best_score = exchange, score
        compared += 1
        if compared == _MOST_COMPARED:
            break
    text = f"the cassette {cassette.file.name} has no answer to a request to {request['model']!r}"
    if best is None:
        models = sorted({str(description["model"]) for description in cassette.descriptions()})
        known = f"it knows {shorten(models)}" if len(cassette) else "it is empty"
        return _bounded(f"{text}: of this model it has none; {known}")
    differences = list(_differences(best, request, fingerprint))
    differs = "; ".join(differences) or "what was taken out of it as a secret"
    return _bounded(f"{text}; from the nearest of {compared} recorded ones it differs in {differs}")


def _bounded(text: str) -> str:
    return text if len(text) <= LONGEST_MISS else text[: LONGEST_MISS - 1] + "…"


def _likeness(exchange: Exchange, request: Data, fingerprint: str) -> tuple[int, ...]:
    recorded = exchange.request
    pairs = list(zip(recorded["messages"], request["messages"], strict=False))
    equal = sum(old == new for old, new in pairs)
    lines = next((_common(old, new) for old, new in pairs if old != new), 0)
    same = sum(recorded[name] == request[name] for name in (*_PARAMETERS, "schema"))
    sample = recorded["sample"] == request["sample"]
    return equal, sample, lines, same, exchange.fingerprint == fingerprint


def _common(old: Data, new: Data) -> int:
    """Number of lines that two messages have in common."""
    return len({*old["text"].splitlines()} & {*new["text"].splitlines()})


def _differences(exchange: Exchange, request: Data, fingerprint: str) -> Iterator[str]:
    recorded = exchange.request
    if exchange.fingerprint != fingerprint:
        yield f"the server's fingerprint ({_was(exchange.fingerprint, fingerprint)})"
    for name in _PARAMETERS:
        if recorded[name] != request[name]:
            yield f"{name} ({_was(recorded[name], request[name])})"
    if recorded["schema"] != request["schema"]:
        yield "the schema of the answer"
    before, now = recorded["messages"], request["messages"]
    if len(before) != len(now):
        yield f"the number of messages ({_was(len(before), len(now))})"
    for number, (old, new) in enumerate(zip(before, now, strict=False), start=1):
        if old != new:
            yield f"message {number} ({new['role']}), {_in_message(old, new)}"
            return


def _in_message(old: Data, new: Data) -> str:
    """What differs first in a message."""
    if old["role"] != new["role"]:
        return f"its role ({_was(old['role'], new['role'])})"
    if old["images"] != new["images"]:
        names = [
            str((image or other)["name"])
            for image, other in zip_longest(new["images"], old["images"])
            if image != other
        ]
        where = f"image {shorten(names[0])}"
        return where if old["text"] == new["text"] else f"{where}, and {_in_text(old, new)}"
    return _in_text(old, new)


def _in_text(old: Data, new: Data) -> str:
    before, now = old["text"].splitlines(), new["text"].splitlines()
    for number, (was, is_now) in enumerate(zip_longest(before, now)):
        if was != is_now:
            headings = (_HEADING.match(line) for line in reversed(now[: number + 1]))
            block = next((f", block {heading[1]}" for heading in headings if heading), "")
            return f"line {number + 1}{block} ({_was(*_from_difference(was, is_now))})"
    return "the ends of its lines"


def _from_difference(was: str | None, now: str | None) -> tuple[str | None, str | None]:
    """Two lines from shortly before their first difference, if that is far from the beginning."""
    if was is None or now is None:
        return was, now
    ends = (i for i, (old, new) in enumerate(zip(was, now, strict=False)) if old != new)
    begin = next(ends, min(len(was), len(now))) - _LONGEST_SHOWN // 3
    return (was, now) if begin <= 0 else (f"…{was[begin:]}", f"…{now[begin:]}")


def _was(recorded: Any, now: Any) -> str:
    return f"recorded {_shown(recorded)}, asked {_shown(now)}"


def _shown(value: Any) -> str:
    return "nothing" if value is None else shorten(value, _LONGEST_SHOWN)
