"""ObservedEpisode: the episode that a test is given, which notes what the test looks at."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pytest_dura.core.episode import Episode
from pytest_dura.evidence.text import one_line
from pytest_dura.requirements.checks import Check, check_name, read_formula
from pytest_dura.requirements.verdicts.episodes import (
    JudgedEpisode,
    SealedColumns,
    evaluate_episode,
    judged,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self


MOST = 50
"""Names that are noted of a test and an episode."""
_IDENTITY = frozenset({"id", "spec", "digest", "searched"})
"""Attributes that tell which episode it is, and nothing of what happened in it."""
_ASKING = frozenset({"robustness", "satisfies", "signal", "ever", "of"})
"""Methods, which note themselves what they are asked for."""


class Observations:
    """What a test has looked at: attributes, signals and checks of an episode, each by its name."""

    def __init__(self) -> None:
        self.false: dict[str, None] = {}
        """Checks that the test asked for and that did not hold."""
        self._seen: dict[str, None] = {}
        self._closed = 0

    @property
    def names(self) -> list[str]:
        """The names, sorted; the table of signals goes without saying where one of them is."""
        tables = {name.partition(".")[0] for name in self._seen if "." in name}
        return sorted(name for name in self._seen if name not in tables)

    @property
    def closed(self) -> bool:
        """Whether what is read now is not noted."""
        return self._closed > 0

    def note(self, name: str) -> None:
        """The test looks at what has this name."""
        if not self.closed and len(self._seen) < MOST:
            self._seen[one_line(name, 200)] = None

    def checked(self, check: str, *, holds: bool) -> None:
        """The test asks whether a check holds."""
        self.note(check)
        if not holds and not self.closed and len(self.false) < MOST:
            self.false[one_line(check, 200)] = None

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Within it, our own code reads the episode."""
        self._closed += 1
        try:
            yield
        finally:
            self._closed -= 1

    def end(self) -> None:
        """The test has ended; whoever reads the episode from now on is not the test."""
        self._closed += 1


class _NotedColumns(SealedColumns):
    def __init__(
        self, columns: Mapping[str, NDArray[Any]], name: str, observations: Observations
    ) -> None:
        super().__init__(columns)
        self._name, self._looks = name, observations

    def __getitem__(self, key: str) -> NDArray[Any]:
        self._looks.note(f"{self._name}.{key}")
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        self._looks.note(f"{self._name}.{key}")
        return super().get(key, default)


class ObservedEpisode(JudgedEpisode):
    """An episode that answers to formulas, and notes what it is asked for in ``_looks``."""

    _looks: Observations

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """The same episode, of which nothing was looked at yet."""
        observed = super().of(episode)
        own, observations = vars(observed), Observations()
        for name in ("signals", "decisions"):
            own[name] = _NotedColumns(own[name], name, observations)
        own["digest"] = episode.digest  # computed once for all that look at the episode
        own["_looks"] = observations
        return observed

    def __getattribute__(self, name: str) -> Any:
        """Note what is asked for; what answering it reads is not noted."""
        observations = object.__getattribute__(self, "__dict__").get("_looks")
        if observations is None or observations.closed or name.startswith("_") or name in _ASKING:
            return super().__getattribute__(name)
        if name not in _IDENTITY:
            observations.note(name)
        with observations.pause():
            return super().__getattribute__(name)

    def __repr__(self) -> str:
        """Short: pytest shows the arguments of a test that fails."""
        own = vars(self)
        return f"<episode {self.id}, {own['termination']} after {len(own['time'])} ticks>"

    def robustness(self, formula: str) -> float:
        """See :meth:`JudgedEpisode.robustness`."""
        with self._looks.pause():
            evaluation, _ = evaluate_episode(read_formula(formula), self)
        self._looks.checked(
            formula, holds=evaluation is not None and evaluation.status != "violated"
        )
        return -math.inf if evaluation is None else evaluation.robustness

    def satisfies(self, check: Check) -> bool:
        """See :meth:`JudgedEpisode.satisfies`."""
        with self._looks.pause():
            holds = judged(check, self)[0] == "satisfied"
        self._looks.checked(check_name(check), holds=holds)
        return holds


def observations_of(episode: JudgedEpisode) -> Observations:
    """What a test has looked at of the episode that it was given."""
    observations: Observations | None = vars(episode).get("_looks")
    return Observations() if observations is None else observations
