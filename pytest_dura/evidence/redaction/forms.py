"""The forms in which a known secret may stand in a text: as it is, escaped or encoded."""

from __future__ import annotations

import base64
import html
import json
import shlex
import string
from collections.abc import Iterator
from urllib.parse import quote, quote_plus


def forms(value: str) -> set[str]:
    """The value itself, escaped for JSON, Python, shells, HTML and URLs, and in hexadecimal."""
    quoted = shlex.quote(value)
    found = {value, value.strip(), quoted if quoted == value else quoted[1:-1]}
    found |= {html.escape(value), html.escape(value, quote=False)}
    # Data within data is escaped twice.
    for ascii_only in (True, False):
        once = json.dumps(value, ensure_ascii=ascii_only)[1:-1]
        found |= {once, json.dumps(once, ensure_ascii=ascii_only)[1:-1]}
    found.add(repr(value)[1:-1])
    found.add(value.encode("unicode_escape").decode("ascii"))
    data = _bytes(value)
    for safe in ("", "/", "/:=&?"):
        for encoded in (quote(data, safe=safe), quote_plus(data, safe=safe)):
            found |= {encoded, _small_hex(encoded)}
    found |= {data.hex(), data.hex().upper()}
    return found


def base64_cores(value: str) -> set[str]:
    """What the base64 of any text with this value in it contains, in both alphabets.

    Three bytes make four characters, so that it depends on where the value begins; characters
    that its neighbours have a share in are left out.
    """
    data = _bytes(value)
    found = set()
    for offset in range(3):
        encoded = base64.b64encode(b"\0" * offset + data).decode("ascii")
        core = encoded[(0, 2, 3)[offset] : (offset + len(data)) * 8 // 6]
        for one in (core, core.translate(_URL_SAFE)):
            found |= {one, quote(one, safe="")}
    return found


def around(text: str, begin: int, end: int) -> tuple[int, int]:
    """The whole of the base64 that a core is part of."""
    left = len(text[:begin].rstrip(_BASE64))
    return left, len(text) - len(text[end:].lstrip(_BASE64 + "="))


def pieces(value: str, text: str, shortest: int) -> Iterator[tuple[int, int]]:
    """Where a text holds the beginning or the end of a value, cut off with dots.

    Args:
        value: The value.
        text: The text.
        shortest: Characters that a piece has at least.
    """
    head, tail = value[:shortest], value[-shortest:]
    start = text.find(head)
    while start >= 0:
        end = start + _common(value, text[start : start + len(value)])
        if text.startswith(_DOTS, end):
            yield start, end
        start = text.find(head, start + 1)
    start = text.find(tail)
    while start >= 0:
        end = start + len(tail)
        begin = end - _common(value[::-1], text[max(0, end - len(value)) : end][::-1])
        if text.endswith(_DOTS, 0, begin):
            yield begin, end
        start = text.find(tail, start + 1)


_DOTS = ("...", "…")
_BASE64 = string.ascii_letters + string.digits + "+/-_%"
_URL_SAFE = str.maketrans("+/", "-_")


def _common(one: str, other: str) -> int:
    """Length of the common beginning."""
    pairs = zip(one, other, strict=False)
    return next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(one), len(other)))


def _bytes(value: str) -> bytes:
    # What no UTF-8 can hold came from the environment as bytes.
    return value.encode("utf-8", "surrogateescape" if _fits(value) else "backslashreplace")


def _fits(value: str) -> bool:
    return all(not "\ud800" <= one <= "\udfff" or "\udc80" <= one <= "\udcff" for one in value)


def _small_hex(text: str) -> str:
    """The same with ``%2f`` for ``%2F``."""
    head, *rest = text.split("%")
    return "%".join([head, *(one[:2].lower() + one[2:] for one in rest)])
