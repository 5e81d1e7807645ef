"""Misses: what differs from the nearest recorded request where a cassette has no answer."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from pytest_dura.core.errors import ComponentEnvironmentError, shorten
from pytest_dura.llm.cassette import Cassette, Data, Exchange
from pytest_dura.llm.port import REQUEST_EXTRAS

_MOST_COMPARED = 5000
"""Exchanges of a model that are compared with a request; a miss must not take minutes."""
LONGEST_MISS = 900
_LONGEST_SHOWN = 90
_PARAMETERS = ("structured", "temperature", "max_tokens", "seed", "sample", *REQUEST_EXTRAS)
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
    other = next(((old["text"], new["text"]) for old, new in pairs if old != new), ("", ""))
    lines = len({*other[0].splitlines()} & {*other[1].splitlines()})
    same = sum(_part(recorded, name) == _part(request, name) for name in (*_PARAMETERS, "schema"))
    sample = recorded["sample"] == request["sample"]
    return equal, sample, lines, same, exchange.fingerprint == fingerprint


def _part(request: Data, name: str) -> Any:
    return request.get(name, REQUEST_EXTRAS.get(name))


def _differences(exchange: Exchange, request: Data, fingerprint: str) -> Iterator[str]:
    recorded = exchange.request
    if exchange.fingerprint != fingerprint:
        yield f"the server's fingerprint ({_was(exchange.fingerprint, fingerprint)})"
    for name in _PARAMETERS:
        before, now = _part(recorded, name), _part(request, name)
        if before != now:
            yield f"{name} ({_was(before, now)})"
    if recorded["schema"] != request["schema"]:
        yield "the schema of the answer"
    earlier, later = recorded["messages"], request["messages"]
    if len(earlier) != len(later):
        yield f"the number of messages ({_was(len(earlier), len(later))})"
    for number, (old, new) in enumerate(zip(earlier, later, strict=False), start=1):
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
    for number, pair in enumerate(zip_longest(before, now)):
        was, is_now = pair
        if was != is_now:
            headings = (_HEADING.match(line) for line in reversed(now[: number + 1]))
            block = next((f", block {heading[1]}" for heading in headings if heading), "")
            where = f"line {number + 1}{block}"
            if was is None or is_now is None:
                return f"{where} ({_was(was, is_now)})"
            # Lines that differ far from their beginning are shown from shortly before that.
            ends = (i for i, (x, y) in enumerate(zip(was, is_now, strict=False)) if x != y)
            begin = next(ends, min(len(was), len(is_now))) - _LONGEST_SHOWN // 3
            if begin > 0:
                was, is_now = f"…{was[begin:]}", f"…{is_now[begin:]}"
            return f"{where} ({_was(was, is_now)})"
    return "the ends of its lines"


def _was(recorded: Any, now: Any) -> str:
    return f"recorded {_shown(recorded)}, asked {_shown(now)}"


def _shown(value: Any) -> str:
    return "nothing" if value is None else shorten(value, _LONGEST_SHOWN)
