"""Falsification: limits and results of a search for violations, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pytest_dura.core.display import Shown, short_repr
from pytest_dura.core.errors import ConfigurationError

BUDGET = 200
SHRINK_BUDGET = 150


@dataclass(frozen=True)
class Limits:
    """Limits of a search.

    Args:
        budget: Simulations of the search.
        shrink: Simulations for making each counterexample simpler; 0 leaves it as it was found.
        at_most: Faults that may be added at once.
        baselines: Whether the trivial searchers are run by themselves beside a claim; only
            benchmarks, which run them in any case, do without.
    """

    budget: int = BUDGET
    shrink: int = SHRINK_BUDGET
    at_most: int = 1
    baselines: bool = True

    def __post_init__(self) -> None:
        """Refuse limits that make no sense.

        Raises:
            ConfigurationError: For a budget that is no whole number, or too small.
        """
        for name, least in (("budget", 1), ("shrink", 0), ("at_most", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ConfigurationError(
                    f"{name} is a whole number of at least {least}",
                    key=name,
                    found=value,
                    expected=f"{least} or more",
                )


Data = dict[str, Any]
SearchStatus = Literal["falsified", "not repeatable", "undecided", "nothing found"]


@dataclass(frozen=True, slots=True)
class ReplayCount:
    """Result of replaying a violation.

    Args:
        runs: Replays.
        violated: How many of them violated the requirement again.
        equal: How many had the digest of the first run.
    """

    runs: int
    violated: int
    equal: int

    @property
    def confirmed(self) -> bool:
        """Whether every replay was the same run again, and violated."""
        return 0 < self.runs == self.violated == self.equal


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of a counterexample that is not as the case has it.

    Args:
        path: Such as ``world.ego.speed``, or ``faults.delay``.
        value: What it is here; ``None`` for what was left out.
        nominal: What the case has there; ``None`` for nothing.
    """

    path: str
    value: Any
    nominal: Any


@dataclass(frozen=True, slots=True)
class Shrinking:
    """How a counterexample was made simpler.

    Args:
        before: Parameters that were not as the case has them.
        after: Those that still are not.
        simulations: Episodes that it took.
        budget: Episodes that it was allowed.
        finished: Whether nothing was left to try before the budget ended.
    """

    before: int
    after: int
    simulations: int
    budget: int
    finished: bool


@dataclass(frozen=True, slots=True)
class FoundCounterexample:
    """A violation that a search found, with its replays.

    Args:
        case: Id of the searched case.
        scenario: The scenario as plain data, with nothing left to draw but by its seed.
        seed: Of the episode.
        digest: Of the episode.
        margin: Robustness; ``None`` for a check that gives none.
        time: Seconds at which the requirement was violated first.
        detail: Why, in words.
        repeats: What came of replaying it.
        changes: Its parameters that are not as the case has them.
        shrinking: How it was made simpler; ``None`` if that was not asked for.
        file: The scenario file that keeps it, relative to the project; ``None`` for none.
        name: The name of the scenario in that file.
    """

    case: str
    scenario: Data
    seed: int
    digest: str
    margin: float | None
    time: float | None
    detail: str
    repeats: ReplayCount
    changes: tuple[ParameterChange, ...] = ()
    shrinking: Shrinking | None = None
    file: str | None = None
    name: str | None = None


@dataclass(frozen=True, slots=True)
class SearchOutcome:
    """Result of a search for one requirement.

    Args:
        requirement: Its id.
        check: Its formula or function.
        status: ``falsified`` for a violation that was confirmed, ``not repeatable`` for one whose
            replays differ, ``undecided`` where more than a fifth of the simulations are
            inconclusive, ``nothing found`` otherwise: never that it holds.
        simulations: Up to the first violation; all of them where there was none.
        searcher: Who proposed the violation; ``None`` for none.
        best: Least robustness of all simulations; ``None`` where none was measured.
        counterexample: The violation.
    """

    requirement: str
    check: str
    status: SearchStatus
    simulations: int
    searcher: str | None
    best: float | None
    counterexample: FoundCounterexample | None = None


@dataclass(frozen=True, slots=True)
class SearcherReport:
    """Simulations of one searcher, or of one baseline.

    Args:
        name: Its name.
        trivial: Whether it learns nothing from what it has seen.
        simulations: Its own simulations.
        best: Least robustness by requirement; ``None`` where none was measured.
        first: By requirement, its own simulations up to its first violation; ``None`` for none.
    """

    name: str
    trivial: bool
    simulations: int
    best: Mapping[str, float | None]
    first: Mapping[str, int | None]


@dataclass(frozen=True, slots=True)
class SpaceCoverage:
    """Which part of the search space was simulated, in tenths of each range and single choices.

    Args:
        parameters: By name, the share of its parts with any simulation.
        pairs: Of each two coordinates, in fifths: the mean share of their parts with any; ``None``
            for a space of one coordinate.
    """

    parameters: Mapping[str, float]
    pairs: float | None


@dataclass(frozen=True)
class Falsification(Shown):
    """Result of a search for violations of some requirements on a case.

    Its episodes were chosen where violations were expected: it holds no rate, and none can be made
    of it.

    Args:
        case: Id of the case.
        component: Name of the component under test.
        seed: From which all draws follow.
        budget: Simulations that it was allowed.
        simulations: Those that it took.
        refused: Points whose values contradict each other; none of them was simulated.
        unknown: Simulations that were inconclusive on some requirement.
        not_manifested: Simulations in which an added fault never came to act; they say what the
            case does without it.
        rule: How the budget is shared over the searchers.
        parameters: What it could change: ``{path, low, high}``, ``{path, choice}`` or
            ``{path, faults}`` by name.
        searchers: What each searcher did.
        baselines: What the trivial searchers come to by themselves, each with as many simulations
            as the search took.
        coverage: Which part of the space was simulated.
        outcomes: Requirement by requirement.
    """

    case: str
    component: str
    seed: int
    budget: int
    simulations: int
    refused: int
    unknown: int
    not_manifested: int
    rule: str
    parameters: tuple[Data, ...]
    searchers: tuple[SearcherReport, ...]
    baselines: tuple[SearcherReport, ...]
    coverage: SpaceCoverage
    outcomes: tuple[SearchOutcome, ...]

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "searched", self.case
        yield "component", self.component
        yield "simulations", f"{self.simulations} of {self.budget}"
        for outcome in self.outcomes:
            counterexample = outcome.counterexample
            detail = "" if counterexample is None else f": {counterexample.detail}"
            yield outcome.requirement, outcome.status + detail

    @property
    def violations(self) -> tuple[SearchOutcome, ...]:
        """The outcomes with a violation, confirmed or not."""
        return tuple(outcome for outcome in self.outcomes if outcome.counterexample is not None)

    def to_json(self) -> Data:
        """Plain data, with ``idle`` for ``not_manifested`` and ``word`` for an outcome's status."""
        data = _with_old_key(asdict(self), "not_manifested", "idle")
        data["outcomes"] = tuple(
            _with_old_key(outcome, "status", "word") for outcome in data["outcomes"]
        )
        return data


def _with_old_key(data: Data, name: str, key: str) -> Data:
    """The data with a field under the key that the record has for it, in its place."""
    return {key if field == name else field: value for field, value in data.items()}


Falsifier = Callable[..., Falsification]
