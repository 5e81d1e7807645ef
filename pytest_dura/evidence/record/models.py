"""Models: the language models that components of a session asked, and how often."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

Data = dict[str, Any]

_COUNTS = ("asked", "reused", "injected", "missed")
_NAMES = ("component", "model", "fingerprint", "prompts", "base_url", "mode")


class Models:
    """Gathers what the processes of a session tell. The same may be told twice."""

    def __init__(self) -> None:
        self._told: dict[tuple[Any, ...], dict[str, Data]] = {}

    def add(self, models: Iterable[Mapping[str, Any]]) -> None:
        """What one process has asked since it began; what it told before is part of that.

        Args:
            models: Of :class:`pytest_dura.evidence.record.item_report.ItemReport`.
        """
        for one in models:
            known = self._told.setdefault(tuple(one[name] for name in _NAMES), {})
            before = known.get(one["process"])
            if before is None or _total(one) >= _total(before):
                known[one["process"]] = dict(one)

    def to_json(self) -> list[Data]:
        """The record's key ``models``, sorted, without the cassette."""
        found = []
        for key in sorted(self._told, key=str):
            told = self._told[key]
            first = told[min(told)]
            counts = {name: sum(one[name] for one in told.values()) for name in _COUNTS}
            plain = {name: value for name, value in first.items() if name != "process"}
            found.append({**plain, **counts, "cassette": None})
        return found


def _total(one: Mapping[str, Any]) -> int:
    return sum(one[name] for name in _COUNTS)
