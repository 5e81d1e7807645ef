"""Endpoint: a server, a model of it, and its key, which is kept out of all texts."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from urllib.parse import SplitResult, quote, quote_plus, urlsplit

from pytest_dura.core.errors import ConfigurationError

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
    """Scrubber of a key out of texts: as it is, percent-encoded, escaped in JSON, and in base64.

    In JSON any of its characters may be written by its number.

    Base64 of a longer text has the key at one of three offsets; the characters that depend on the
    key alone are looked for, which covers ``Bearer <key>`` and ``user:<key>`` too. Keys that are
    shorter than :data:`_SHORTEST` are no secrets, and are left.
    """

    def __init__(self, key: str) -> None:
        forms = sorted(set(_forms(key)), key=len, reverse=True) if len(key) >= _SHORTEST else []
        spelt = "".join(rf"(?:{re.escape(char)}|\\u(?i:{ord(char):04x}))" for char in key)
        self._pattern = re.compile("|".join([*map(re.escape, forms), spelt])) if forms else None

    def scrub(self, text: str) -> str:
        """The text without the key."""
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
        for offset in range(3):
            yield _inner(encode(b"\0" * offset + key.encode()).decode(), offset, len(key))


def _inner(encoded: str, offset: int, length: int) -> str:
    """The characters of base64 whose six bits all come from the key."""
    first = -(-offset * 8 // 6)
    return encoded[first : (offset + length) * 8 // 6]


URL, MODEL, KEY = "DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY"
"""The environment variables."""
ABOUT = "DURA_LLM_ABOUT"
"""The environment variable that describes the model in words, for header, record and cassette."""
_NO_KEY = "none"
"""The key where the server needs none; the SDK wants one that is not empty."""
_EXAMPLE = "http://127.0.0.1:11434/v1"
_LOCAL_REMEDY = f"unset {KEY}, or set it to `{_NO_KEY}`, where the server needs no key"
_LONGEST = 2000
_LONGEST_ABOUT = 200


@dataclass(frozen=True)
class Endpoint:
    """An OpenAI-compatible server, a model of it, and the key.

    The key is in no ``repr``; :meth:`scrub` takes it out of texts of others.

    Args:
        base_url: Up to and with the version, such as ``http://127.0.0.1:11434/v1``.
        model: Name of the model, as the server has it.
        key: Sent as a bearer token to this server alone.

    Raises:
        ConfigurationError: For a URL, a name or a key that cannot be used.
    """

    base_url: str
    model: str
    key: str = field(default=_NO_KEY, repr=False)

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
        for name, value in ((URL, self.base_url), (MODEL, self.model)):
            if self.scrub(value) != value:
                raise ConfigurationError(
                    f"{name} holds the key, and stands in many a file",
                    key=name,
                    expected=f"the key in {KEY} alone",
                    remedy=f"take it out of {name}, or {_LOCAL_REMEDY}",
                )

    @classmethod
    def from_environment(cls, environ: Mapping[str, str]) -> Endpoint:
        """From ``DURA_LLM_BASE_URL``, ``DURA_LLM_MODEL`` and ``DURA_LLM_API_KEY``.

        Raises:
            ConfigurationError: If one of the first two is missing, or one cannot be used.
        """
        given = {name: environ.get(name, "").strip() for name in (URL, MODEL, KEY)}
        for name, example in ((URL, _EXAMPLE), (MODEL, "llama3.1:8b")):
            if not given[name]:
                raise ConfigurationError(
                    f"no language model is named: {name} is not set",
                    key=name,
                    expected=f"such as {example}",
                    remedy=f"set {URL} and {MODEL}, and {KEY} where the server needs a key",
                )
        return cls(given[URL], given[MODEL], given[KEY] or _NO_KEY)

    @cached_property
    def public(self) -> str:
        """The URL without user, password, query and fragment."""
        return _public(urlsplit(self.base_url))

    def scrub(self, text: str) -> str:
        """The text with every form of the key replaced by ``[key]``."""
        return self._scrubber.scrub(text)

    @cached_property
    def _scrubber(self) -> Scrubber:
        return Scrubber(self.key)


def model_about(environ: Mapping[str, str]) -> str:
    """The description of the model in ``DURA_LLM_ABOUT``; empty if it is not set.

    Raises:
        ConfigurationError: If it is too long for a line, or cannot be printed.
    """
    text = environ.get(ABOUT, "").strip()
    if text and (not text.isprintable() or len(text) > _LONGEST_ABOUT):
        raise ConfigurationError(
            "what is said about the model is too long or cannot be printed",
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
    if parts.query or parts.fragment:
        raise refused("has a query or a fragment", "end it with the path", shown)
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
