"""Secret: how a key can stand in a text, and how it is taken out."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from urllib.parse import quote, quote_plus

SHORTEST = 8
"""Characters of the shortest key that is taken for a secret."""
DUMMIES = frozenset(
    {
        "none", "null", "nil", "no", "na", "n/a", "empty", "dummy", "fake",
        "local", "test", "token", "key", "x", "xx", "xxx", "xxxx", "0",
        "1", "-", "ollama", "vllm", "secret", "sk", "apikey",
    }
)  # fmt: skip
"""Keys that stand for none; they are shown as they are."""
BLANK = "[key]"


class Scrubber:
    """Takes a key out of texts: as it is, percent-encoded, escaped in JSON, and in base64.

    In JSON any of its characters may be written by its number.

    Base64 of a longer text has the key at one of three offsets; the characters that depend on the
    key alone are looked for, which covers ``Bearer <key>`` and ``user:<key>`` too. Keys that are
    shorter than :data:`SHORTEST` are no secrets, and are left.
    """

    def __init__(self, key: str) -> None:
        forms = sorted(set(_forms(key)), key=len, reverse=True) if len(key) >= SHORTEST else []
        spelt = "".join(rf"(?:{re.escape(one)}|\\u(?i:{ord(one):04x}))" for one in key)
        self._pattern = re.compile("|".join([*map(re.escape, forms), spelt])) if forms else None

    def scrub(self, text: str) -> str:
        """The text without the key."""
        return text if self._pattern is None else self._pattern.sub(BLANK, text)


def _forms(key: str) -> Iterator[str]:
    """Every way in which the key may be written down."""
    yield key
    for encoded in (quote(key, safe=""), quote(key), quote_plus(key)):
        yield from (encoded, re.sub("%..", lambda found: found[0].lower(), encoded))
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
