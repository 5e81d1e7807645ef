"""The components under test of a session, as the evidence record describes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.core.episode import canonical

Data = Mapping[str, Any]


class Components:
    """Descriptions by name. One name may stand for a class with several sets of parameters."""

    def __init__(self) -> None:
        self._known: dict[str, dict[bytes, Data]] = {}
        self._sources: dict[str, Mapping[str, str]] = {}

    def add(self, component: Data) -> None:
        """Take in a description: ``name``, ``path``, ``params`` and what else there is."""
        key = canonical([component.get("path"), component.get("params"), component])
        self._known.setdefault(component["name"], {}).setdefault(key, component)

    def add_sources(self, sources: Mapping[str, Mapping[str, str]]) -> None:
        """Take in what digests of components are made of; see ItemReport."""
        self._sources.update(sources)

    @property
    def names(self) -> list[str]:
        """Of all components."""
        return list(self._known)

    def problems(self) -> Iterator[str]:
        """Names that stand for several classes, and verdicts go by the name."""
        for name, several in self._known.items():
            paths = sorted({str(one.get("path")) for one in several.values()})
            if len(paths) > 1:
                yield (
                    f"infrastructure: several components are called {name}, and verdicts go by "
                    f"that name: {', '.join(paths)}; rename all but one, or test them in sessions "
                    "of their own"
                )

    def to_json(self) -> dict[str, Any]:
        """The first one by name, with all ``others`` and the ``sources`` of them all."""
        told = [one for name in sorted(self._known) for _, one in sorted(self._known[name].items())]
        first: dict[str, Any] = dict(told[0]) if told else {"name": None, "version": None}
        if len(told) > 1:
            first["others"] = told[1:]
        if self._sources:
            first["sources"] = {key: self._sources[key] for key in sorted(self._sources)}
        return first
