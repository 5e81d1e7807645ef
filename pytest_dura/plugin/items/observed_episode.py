"""ObservedEpisode: the episode that a test is given, which notes what the test reads of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pytest_dura.core.episode import Episode
from pytest_dura.core.measures import Value
from pytest_dura.evidence.text import one_line
from pytest_dura.requirements.checks import Check, check_name, read_formula
from pytest_dura.requirements.episode_verdicts import (
    JudgedEpisode,
    SealedColumns,
    evaluate_episode,
    judge_by_check,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self


_MOST_NAMES = 50
"""Names that are noted of a test and an episode."""
_IDENTIFYING = frozenset({"id", "spec", "digest", "searched"})
"""Attributes that identify the episode, and say nothing of what happened in it."""
_NOTING_METHODS = frozenset({"robustness", "satisfies", "margins", "signal", "ever", "of"})
"""Methods that note by themselves what they are called with."""


class Observations:
    """What a test has read of an episode: names of attributes, signals and checks."""

    def __init__(self) -> None:
        self.false: dict[str, None] = {}
        """Checks that the test evaluated and that did not hold."""
        self._seen: dict[str, None] = {}
        self._pauses = 0

    @property
    def names(self) -> list[str]:
        """Sorted names, without a table such as ``signals`` where one of its columns is named."""
        tables = {name.partition(".")[0] for name in self._seen if "." in name}
        return sorted(name for name in self._seen if name not in tables)

    @property
    def is_paused(self) -> bool:
        """Whether reads are not noted at present."""
        return self._pauses > 0

    def note(self, name: str) -> None:
        """Note a name that the test reads."""
        if not self.is_paused and len(self._seen) < _MOST_NAMES:
            self._seen[one_line(name, 200)] = None

    def checked(self, check: str, *, holds: bool) -> None:
        """Note a check that the test evaluates."""
        self.note(check)
        if not holds and not self.is_paused and len(self.false) < _MOST_NAMES:
            self.false[one_line(check, 200)] = None

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Context in which nothing is noted, since code of this package reads the episode."""
        self._pauses += 1
        try:
            yield
        finally:
            self._pauses -= 1

    def end(self) -> None:
        """Note nothing any more: the test has ended."""
        self._pauses += 1


class _NotedColumns(SealedColumns):
    def __init__(
        self, columns: Mapping[str, NDArray[Any]], name: str, observations: Observations
    ) -> None:
        super().__init__(columns)
        self._name, self._observations = name, observations

    def __getitem__(self, key: str) -> NDArray[Any]:
        self._observations.note(f"{self._name}.{key}")
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        self._observations.note(f"{self._name}.{key}")
        return super().get(key, default)


class ObservedEpisode(JudgedEpisode):
    """An episode that evaluates formulas, and notes in ``_observations`` what is read of it."""

    _observations: Observations
    _unobserved: JudgedEpisode
    """The same episode, for the package's own code: it notes nothing, and is quicker to read."""

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """Copy an episode, with nothing noted yet."""
        observed = super().of(episode)
        attributes, observations = vars(observed), Observations()
        for name in ("signals", "decisions"):
            attributes[name] = _NotedColumns(attributes[name], name, observations)
        attributes["digest"] = episode.digest  # computed once for all that look at the episode
        plain = vars(episode).get("_unobserved", episode)
        judged = isinstance(plain, JudgedEpisode)
        attributes["_unobserved"] = plain if judged else JudgedEpisode.of(plain)
        attributes["_observations"] = observations
        return observed

    def __getattribute__(self, name: str) -> Any:
        """Note the name that is read, and nothing that computing its value reads."""
        observations = object.__getattribute__(self, "__dict__").get("_observations")
        if (
            observations is None
            or observations.is_paused
            or name.startswith("_")
            or name in _NOTING_METHODS
        ):
            return super().__getattribute__(name)
        if name not in _IDENTIFYING:
            observations.note(name)
        with observations.pause():
            return super().__getattribute__(name)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Value:
            """Return a measure, whose name is noted already; computing it notes nothing."""
            observations = vars(self).get("_observations") or Observations()
            with observations.pause():
                return super().__getattr__(name)

    def __repr__(self) -> str:
        """See :meth:`Episode.__repr__`; it notes nothing."""
        with self._observations.pause():
            return super().__repr__()

    def _repr_html_(self) -> str:
        """See :meth:`Shown._repr_html_`; it notes nothing."""
        with self._observations.pause():
            return super()._repr_html_()

    def robustness(self, formula: str) -> float:
        """See :meth:`JudgedEpisode.robustness`."""
        evaluation, _ = evaluate_episode(read_formula(formula), self._unobserved)
        self._observations.checked(
            formula, holds=evaluation is not None and evaluation.status != "violated"
        )
        return -math.inf if evaluation is None else evaluation.robustness

    def margins(self, formula: str) -> NDArray[Any]:
        """See :meth:`JudgedEpisode.margins`."""
        self._observations.note(formula)
        with self._observations.pause():
            return super().margins(formula)

    def satisfies(self, check: Check) -> bool:
        """See :meth:`JudgedEpisode.satisfies`."""
        holds = judge_by_check(check, self._unobserved).status == "satisfied"
        self._observations.checked(check_name(check), holds=holds)
        return holds


def observations_of(episode: JudgedEpisode) -> Observations:
    """Return what a test has read of the episode that it was given."""
    observations: Observations | None = vars(episode).get("_observations")
    return Observations() if observations is None else observations
