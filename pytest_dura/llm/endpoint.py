"""Endpoint: a server, a model of it, and what is sent there with each request.

The key, and secrets in headers and in the URL's query, are kept out of all texts.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from urllib.parse import SplitResult, parse_qsl, quote, quote_plus, urlsplit

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import NOTHING
from pytest_dura.llm.answers import refuse_constant

_SHORTEST = 8
"""Characters of the shortest key that is taken for a secret."""
_DUMMIES = frozenset(
    {
        "none", "null", "nil", "no", "na", "n/a", "empty", "dummy", "fake",
        "local", "test", "token", "key", "x", "xx", "xxx", "xxxx", "0",
        "1", "-", "ollama", "vllm", "secret", "sk", "apikey",
    }
)  # fmt: skip
"""Keys that stand for none; they are shown as they are."""
_SCRUBBED = "[key]"


class Scrubber:
    """Scrubber of keys out of texts: as they are, percent-encoded, escaped in JSON, and in base64.

    In JSON any of its characters may be written by its number.

    Base64 of a longer text has the key at one of three offsets; the characters that depend on the
    key alone are looked for, which covers ``Bearer <key>`` and ``user:<key>`` too. Keys that are
    shorter than :data:`_SHORTEST` are no secrets, and are left.
    """

    def __init__(self, *keys: str) -> None:
        secrets = [key for key in dict.fromkeys(keys) if len(key) >= _SHORTEST]
        forms = sorted({form for key in secrets for form in _forms(key)}, key=len, reverse=True)
        spelt = [
            "".join(rf"(?:{re.escape(char)}|\\u(?i:{ord(char):04x}))" for char in key)
            for key in secrets
        ]
        self._pattern = re.compile("|".join([*map(re.escape, forms), *spelt])) if forms else None

    def scrub(self, text: str) -> str:
        """The text without the keys."""
        return text if self._pattern is None else self._pattern.sub(_SCRUBBED, text)


def _forms(key: str) -> Iterator[str]:
    yield key
    for encoded in (quote(key, safe=""), quote(key), quote_plus(key)):
        yield from (encoded, re.sub("%..", lambda match: match[0].lower(), encoded))
    escaped = json.dumps(key)[1:-1]
    yield from (escaped, escaped.replace("/", "\\/"), json.dumps(escaped)[1:-1])
    for encode in (base64.b64encode, base64.urlsafe_b64encode):
        for before in (b"Bearer ", b"bearer ", b":", b""):
            yield encode(before + key.encode()).decode().rstrip("=")
        for offset in range(3):  # the characters whose six bits all come from the key
            encoded = encode(b"\0" * offset + key.encode()).decode()
            yield encoded[-(-offset * 8 // 6) : (offset + len(key)) * 8 // 6]


URL, MODEL, KEY = "DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY"
"""The environment variables."""
HEADERS, EXTRA_BODY = "DURA_LLM_HEADERS", "DURA_LLM_EXTRA_BODY"
"""The environment variables with further headers, and further fields of each request's body."""
ABOUT = "DURA_LLM_ABOUT"
"""The environment variable that describes the model in words, for header, record and cassette."""
_NO_KEY = "none"
"""The key where the server needs none; the SDK wants one that is not empty."""
_EXAMPLE = "http://127.0.0.1:11434/v1"
_LOCAL_REMEDY = f"unset {KEY}, or set it to `{_NO_KEY}`, where the server needs no key"
_LONGEST = 2000
_LONGEST_ABOUT = 200


_HEADER = re.compile(r"[!#$%&'*+.^_`|~0-9A-Za-z-]{1,100}")
_SECRET = re.compile(r"key|token|secret|auth|pass|cookie|credential|sig|session", re.IGNORECASE)
"""Names of headers, and of parts of a query, whose values are as secret as the key."""
_VERSION = "api-version"
"""The part of a query that is no secret."""
_OWN_HEADERS = frozenset(
    {
        "host", "content-length", "content-type", "transfer-encoding", "connection", "te",
        "trailer", "upgrade", "expect", "accept-encoding", "proxy-authorization",
    }
)  # fmt: skip
"""Headers that the transport sets, in lower case."""
_OWN_FIELDS = frozenset(
    {
        "model", "messages", "temperature", "max_tokens", "max_completion_tokens", "seed",
        "stream", "stream_options", "response_format", "tools", "tool_choice", "n",
    }
)  # fmt: skip
"""Fields of a body that a request sets itself, or that would give other than one answer."""


@dataclass(frozen=True, repr=False)
class Endpoint:
    """An OpenAI-compatible server, a model of it, and what is sent there with each request.

    No secret is in its ``repr``; :meth:`scrub` takes them out of texts of others.

    Args:
        base_url: Up to and with the version, such as ``http://127.0.0.1:11434/v1``; a query is sent
            with each request.
        model: Name of the model, as the server has it.
        key: Sent as a bearer token to this server alone.
        headers: Further headers, by name; an ``Authorization`` takes the place of the key.
        extra_body: Further fields of the body of each request, plain data without secrets.

    Raises:
        ConfigurationError: For a part that cannot be used.
    """

    base_url: str
    model: str
    key: str = _NO_KEY
    headers: Mapping[str, str] = NOTHING
    extra_body: Mapping[str, Any] = NOTHING

    def __post_init__(self) -> None:
        _check_url(self.base_url)
        if not self.model.strip() or not self.model.isprintable() or len(self.model) > _LONGEST:
            raise ConfigurationError(
                "the model's name is empty or cannot be printed",
                key=MODEL,
                found=self.model[:_LONGEST],
                expected="a name such as `llama3.1:8b`",
            )
        _check_key(self.key)
        _check_headers(self.headers)
        if own := own_fields(self.extra_body):
            raise ConfigurationError(
                f"{EXTRA_BODY} sets {', '.join(own)}, which a request sets itself",
                key=EXTRA_BODY,
                found=", ".join(own),
                expected="other fields of the body, such as `top_p` or `chat_template_kwargs`",
                remedy="leave them out; the planner has parameters for some of them",
            )
        for place, named in ((HEADERS, self.headers.items()), (URL, self.query)):
            for name, value in named:
                if _SECRET.search(name) and len(value) < _SHORTEST:
                    raise ConfigurationError(
                        f"the value of {name!r} has fewer than {_SHORTEST} characters, so that it"
                        " cannot be kept out of files: it would be taken for ordinary text",
                        key=place,
                        remedy="leave it out where the server does not need it",
                    )
        secrets = Scrubber(*self._secrets)
        extra = json.dumps(dict(self.extra_body))
        for name, value in ((URL, self.public), (MODEL, self.model), (EXTRA_BODY, extra)):
            if secrets.scrub(value) != value:
                raise ConfigurationError(
                    f"{name} holds the key, and stands in many a file",
                    key=name,
                    expected=f"the key in {KEY} alone",
                    remedy=f"take it out of {name}, or {_LOCAL_REMEDY}",
                )

    def __repr__(self) -> str:
        return f"Endpoint({self.public!r}, {self.model!r})"

    @classmethod
    def from_environment(cls, environ: Mapping[str, str]) -> Endpoint:
        """From ``DURA_LLM_BASE_URL``, ``DURA_LLM_MODEL``, ``DURA_LLM_API_KEY`` and so on.

        Raises:
            ConfigurationError: If one of the first two is missing, or one cannot be used.
        """
        names = (URL, MODEL, KEY, HEADERS, EXTRA_BODY)
        given = {name: environ.get(name, "").strip() for name in names}
        for name, example in ((URL, _EXAMPLE), (MODEL, "llama3.1:8b")):
            if not given[name]:
                raise ConfigurationError(
                    f"no language model is named: {name} is not set",
                    key=name,
                    expected=f"such as {example}",
                    remedy=f"set {URL} and {MODEL}, and {KEY} where the server needs a key",
                )
        return cls(
            given[URL],
            given[MODEL],
            given[KEY] or _NO_KEY,
            _headers_of(given[HEADERS]),
            _object_of(EXTRA_BODY, given[EXTRA_BODY] or "{}", "a JSON object"),
        )

    @cached_property
    def public(self) -> str:
        """The URL without user, password, query and fragment."""
        return _public(urlsplit(self.base_url))

    @cached_property
    def address(self) -> str:
        """The URL without its query."""
        return self.base_url.partition("?")[0]

    @cached_property
    def query(self) -> tuple[tuple[str, str], ...]:
        """Names and values of the URL's query."""
        return tuple(parse_qsl(urlsplit(self.base_url).query, keep_blank_values=True))

    @cached_property
    def sent_headers(self) -> dict[str, str]:
        """The headers that are sent, with the key where there is one."""
        given = any(name.casefold() == "authorization" for name in self.headers)
        own = {} if given or self.key == _NO_KEY else {"Authorization": f"Bearer {self.key}"}
        return own | dict(self.headers)

    def scrub(self, text: str) -> str:
        """The text with every form of the key, and of other secrets, replaced by ``[key]``."""
        return self._scrubber.scrub(text)

    @property
    def _secrets(self) -> list[str]:
        """The key, and the values of headers and of the query whose names say so."""
        named = [*self.headers.items(), *self.query]
        return [self.key, *_parts(value for name, value in named if _SECRET.search(name))]

    @cached_property
    def _scrubber(self) -> Scrubber:
        """Of all secrets; of values that may be some, unless they are in names that are shown."""
        named = [*self.headers.items(), *((k, v) for k, v in self.query if k != _VERSION)]
        shown = f"{self.public} {self.model}"
        maybe = [part for part in _parts(value for _, value in named) if part not in shown]
        return Scrubber(*self._secrets, *maybe)


def _parts(values: Iterable[str]) -> Iterator[str]:
    """Values, and what they are made of, such as the token in ``Bearer <token>``."""
    for value in values:
        yield from (value, *re.split(r"[\s;,]+", value))


def _headers_of(text: str) -> dict[str, str]:
    """Headers of a JSON object, or of lines such as ``Name: value``."""
    if text.startswith("{"):
        return _object_of(HEADERS, text, "a JSON object of texts")
    headers = {}
    for line in text.splitlines():
        name, colon, value = line.partition(":")
        if not line.strip():
            continue
        if not colon:
            raise _no_headers("has a line without a colon")
        headers[name.strip()] = value.strip()
    return headers


def _object_of(name: str, text: str, expected: str) -> dict[str, Any]:
    try:
        value = json.loads(text, parse_constant=refuse_constant)
    except (ValueError, RecursionError):  # its message would show a part of the text
        value = None
    if not isinstance(value, dict):
        raise ConfigurationError(
            f"{name} is no JSON object", key=name, expected=expected, remedy="check its quotes"
        )
    return value


def _no_headers(problem: str) -> ConfigurationError:
    return ConfigurationError(
        f"{HEADERS} {problem}",
        key=HEADERS,
        expected="lines such as `Name: value`, or a JSON object of texts, in ASCII",
        remedy="correct it; its values are not shown here",
    )


def _check_headers(headers: Mapping[str, str]) -> None:
    """Refuse headers that cannot be sent, or that are not the user's to choose."""
    for name, value in headers.items():
        if not _HEADER.fullmatch(name):
            raise _no_headers("has a name that no header has")
        if name.casefold() in _OWN_HEADERS:
            raise _no_headers(f"sets {name}, which the client sets itself")
        if not (isinstance(value, str) and value and value.isascii() and value.isprintable()):
            raise _no_headers(f"has a value of {name} that no header can hold")
        if len(value) > _LONGEST:
            raise _no_headers(f"has a value of {name} that is too long")
    if len({name.casefold() for name in headers}) < len(headers):
        raise _no_headers("names a header twice")


def own_fields(extra: Mapping[str, Any]) -> list[str]:
    """Fields of a body that a request sets itself, and no user can."""
    return sorted(_OWN_FIELDS & set(extra))


RETRIES, MOST_RETRIES = "DURA_LLM_RETRIES", 20
"""The environment variable with the number of retries of a request, and its greatest value."""


def retries_of(environ: Mapping[str, str]) -> int:
    """The greatest number of retries that an environment allows; 0 if it does not say.

    Raises:
        ConfigurationError: If it is not a number from 0 to 20.
    """
    text = environ.get(RETRIES, "").strip() or "0"
    if not re.fullmatch(r"[0-9]{1,3}", text) or int(text) > MOST_RETRIES:
        raise ConfigurationError(
            "the number of retries cannot be used",
            key=RETRIES,
            found=text[:80],
            expected=f"a whole number from 0 to {MOST_RETRIES}",
            remedy=f"correct it, or unset {RETRIES}",
        )
    return int(text)


def model_about(environ: Mapping[str, str]) -> str:
    """The description of the model in ``DURA_LLM_ABOUT``; empty if it is not set.

    Raises:
        ConfigurationError: If it is too long for a line, or cannot be printed.
    """
    text = environ.get(ABOUT, "").strip()
    if text and (not text.isprintable() or len(text) > _LONGEST_ABOUT):
        raise ConfigurationError(
            "the description of the model is too long or cannot be printed",
            key=ABOUT,
            found=text[:_LONGEST_ABOUT],
            expected=f"a line of at most {_LONGEST_ABOUT} characters",
            remedy=f"shorten it, or unset {ABOUT}",
        )
    return text


def _public(parts: SplitResult) -> str:
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}".rstrip("/")


def _check_url(url: str) -> None:
    """Refuse a URL that cannot be used; no message shows a password or a query."""

    def refused(problem: str, remedy: str, shown: str | None = None) -> ConfigurationError:
        return ConfigurationError(
            f"the base URL {problem}",
            key=URL,
            found=shown,
            expected=f"http:// or https://, a host and a path, such as {_EXAMPLE}",
            remedy=remedy,
        )

    if not url.isascii() or not url.isprintable() or re.search(r"\s|\\", url):
        raise refused("holds blanks or characters that no URL has", "write it without them")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise refused("cannot be read", "check its host and its port") from None
    if parts.scheme not in ("http", "https"):
        raise refused("has no scheme that can be used", "begin it with http:// or https://")
    if "@" in parts.netloc:
        raise refused("holds a user or a password", f"leave them out, and set {KEY}")
    shown = _public(parts)
    if not parts.hostname or port == 0:
        raise refused("names no host or port", "name the server's", shown)
    if "#" in url:
        raise refused("has a fragment", "end it with the path, or a query", shown)
    if parts.path.rstrip("/").endswith("/completions"):
        raise refused("goes too far", "leave out /chat/completions", shown)


def _check_key(key: str) -> None:
    """Refuse a key that no header can hold, or that cannot be kept out of texts."""
    if not key or not key.isascii() or not key.isprintable() or " " in key or len(key) > _LONGEST:
        raise ConfigurationError(
            "the key is empty, too long, or holds blanks or characters that no header can hold",
            key=KEY,
            remedy=_LOCAL_REMEDY,
        )
    if len(key) < _SHORTEST and key.casefold() not in _DUMMIES:
        raise ConfigurationError(
            f"the key has fewer than {_SHORTEST} characters, so that it cannot be kept out of"
            " files: it would be taken for ordinary text",
            key=KEY,
            remedy=_LOCAL_REMEDY,
        )
