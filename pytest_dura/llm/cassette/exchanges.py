"""Cassette: exchanges with language models, by their content."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.llm.cassette.file import CassetteFile
from pytest_dura.llm.cassette.stored import answer_of, check_description, check_request
from pytest_dura.llm.port import Answer

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
        found = self.rows("SELECT answer FROM exchanges WHERE key = ?", key)
        return self._answer(found[0][0]) if found else None

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
            for one in sorted(texts.items()):
                execute("INSERT OR IGNORE INTO texts VALUES (?, ?)", one)
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
        found = self.rows(
            "SELECT description FROM models WHERE model = ? AND base_url = ? AND session = ?",
            _json(model),
            _json(base_url),
            session,
        )
        return self._description(found[0][0]) if found else None

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
                    self._with_texts(self._checked(self.object(request), check_request)),
                    self._answer(answer),
                    str(created),
                )

    def text(self, sha256: str) -> Any:
        """A text or schema by its SHA-256.

        Raises:
            ConfigurationError: If it is not in the file.
        """
        found = self.rows("SELECT text FROM texts WHERE sha256 = ?", sha256)
        if not found:
            raise self.damaged("it lacks a text of an exchange")
        return self.value(found[0][0])

    def _with_texts(self, request: Data) -> Data:
        messages = [{**one, "text": self.text(one["text"])} for one in request["messages"]]
        found = {**request, "messages": messages, "schema": self.text(request["schema"])}
        return self._checked(found, check_request)

    def _description(self, text: Any) -> Data:
        return self._checked(self.object(text), check_description)

    def _checked(self, data: Data, check: Callable[[Data], Any]) -> Data:
        """The same data, seen to be what it should be."""
        try:
            check(data)
        except ValueError as error:
            raise self.damaged(str(error)) from None
        return data

    def _answer(self, text: Any) -> Answer:
        return answer_of(self._checked(self.object(text), answer_of))


def text_digest(value: Any) -> str:
    """SHA-256 of a text or schema, by which it is stored."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _without_texts(request: Data, texts: dict[str, str]) -> dict[str, Any]:
    """The request with digests in the places of texts, which are put into ``texts``."""

    def kept(value: Any) -> str:
        digest = text_digest(value)
        texts[digest] = _json(value)
        return digest

    messages = [{**one, "text": kept(one["text"])} for one in request["messages"]]
    return {**request, "messages": messages, "schema": kept(request["schema"])}


def _json(value: Any) -> str:
    return canonical(value).decode("ascii")
