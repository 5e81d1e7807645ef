"""The language models of a session as lines of Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.text import code, name


def model_lines(models: Sequence[Mapping[str, Any]], most: int) -> Iterator[str]:
    """A line for each entry of the record's key ``models``.

    Args:
        models: The entries.
        most: So many of them; a last line tells how many are left out.
    """
    yield from map(_line, models[:most])
    if len(models) > most:
        yield f"- and {len(models) - most} more language models"


def _line(one: Mapping[str, Any]) -> str:
    can = one["capabilities"] or {}
    level = _name(str(can.get("structured", "unknown")))
    kept = "enforced" if can.get("enforced") else "not enforced"
    about = f" ({_name(one['about'])})" if one["about"] else ""
    told = (
        f"- language model of {_name(one['component'])}: {_name(one['model'])}{about} at "
        f"{_name(one['base_url'])}, {one['mode']}, structured output {level} ({kept}), "
        f"fingerprint {_name(one['fingerprint'])}; {one['asked']} answers from the server, "
        f"{one['reused']} from the cassette, {one['injected']} injected faults, "
        f"{one['missed']} missed"
    )
    tape = one["cassette"]
    if tape is None:
        return told
    return f"{told}; cassette {_name(tape['file'])}, SHA-256 {_name(tape['sha256'])}"


def _name(text: str | None) -> str:
    return code(name(text or "")) or "-"
