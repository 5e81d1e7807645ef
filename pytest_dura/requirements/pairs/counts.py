"""Pairs: what one requirement says of episodes and of their twins that lack something.

The twin has the same seed and lacks a role, such as the recovery planner, or the faults. The table
is neutral: which runs violated the requirement. What its cells mean depends on what the twins lack.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict

PairWord = Literal["only_with", "only_without", "both", "neither", "incomplete"]


@dataclass(frozen=True, slots=True)
class Pair:
    """The verdicts on an episode and on its twin.

    Args:
        with_it: Verdict on the episode that has what the twin lacks.
        without: Verdict on the twin.
        acted: Whether recovery acted in the episode that has it.

    Raises:
        ConfigurationError: If the two are not about the same requirement, component and run.
    """

    with_it: EpisodeVerdict
    without: EpisodeVerdict
    acted: bool = False

    def __post_init__(self) -> None:
        for what, own, twin in (
            ("requirement", self.with_it.requirement, self.without.requirement),
            ("component", self.with_it.component, self.without.component),
            ("run", _run(self.with_it), _run(self.without)),
        ):
            if own != twin:
                raise ConfigurationError(
                    f"the two verdicts of a pair are about one {what}",
                    key=what,
                    found=f"{own} and {twin}",
                    remedy="pair each episode with its twin of the same run and seed",
                )

    @property
    def word(self) -> PairWord:
        """Which runs violated it; ``incomplete`` if one of them is not known to."""
        words = self.with_it.verdict, self.without.verdict
        if not {"satisfied", "violated"}.issuperset(words) or (
            self.with_it.without_effect or self.without.without_effect
        ):
            return "incomplete"
        return _WORDS[words[0] == "violated", words[1] == "violated"]


_WORDS: dict[tuple[bool, bool], PairWord] = {
    (True, False): "only_with",
    (False, True): "only_without",
    (True, True): "both",
    (False, False): "neither",
}


@dataclass(frozen=True, slots=True)
class PairCounts:
    """How many pairs violated a requirement in which of their runs.

    The first five counts add up to ``pairs``. A pair with an invalid, missing or open run is
    incomplete, as what the other run came to cannot be compared; a violation in it stands in
    ``violated_with`` or ``violated_without`` all the same.

    Args:
        pairs: All pairs.
        only_with: Violated only with what the twins lack.
        only_without: Violated only without it.
        both: Violated in both runs.
        neither: Violated in neither.
        incomplete: One run is invalid, missing or open.
        acted_only_with: Those of ``only_with`` in which recovery acted; and so on.
        acted_only_without: As above.
        acted_both: As above.
        acted_neither: As above.
        violated_with: Violations with it, incomplete pairs included.
        violated_without: Violations without it, incomplete pairs included.
        p_value: Two-sided p-value of the exact McNemar test on the discordant pairs, against "it
            makes no difference to the rate of violations"; 1 if no pair is discordant. It holds
            for a number of pairs that did not depend on what they came to: of pairs that were run
            until a requirement was decided it may be too small.
    """

    pairs: int
    only_with: int
    only_without: int
    both: int
    neither: int
    incomplete: int
    acted_only_with: int
    acted_only_without: int
    acted_both: int
    acted_neither: int
    violated_with: int
    violated_without: int
    p_value: float

    @property
    def complete(self) -> int:
        """Pairs of which both runs were judged."""
        return self.pairs - self.incomplete

    @property
    def difference(self) -> float | None:
        """Rate of violations with it less that without it; ``None`` without a complete pair."""
        return (self.only_with - self.only_without) / self.complete if self.complete else None

    @property
    def prevented(self) -> int:
        """If the twins lack the recovery: violations that it prevented."""
        return self.only_without

    @property
    def introduced(self) -> int:
        """If the twins lack the recovery: violations that there are only because of it."""
        return self.only_with

    @property
    def futile(self) -> int:
        """If the twins lack the recovery: violations in both runs although it acted."""
        return self.acted_both

    @property
    def success_rate(self) -> float | None:
        """If the twins lack the recovery: how often it succeeded where it acted and had to.

        The share of violations that it prevented, of those that it prevented and those that it met
        in vain; ``None`` without any.
        """
        tried = self.acted_only_without + self.acted_both
        return self.acted_only_without / tried if tried else None

    @property
    def unheeded(self) -> int:
        """If the twins lack the recovery: violations in both runs in which it never acted."""
        return self.both - self.acted_both

    @property
    def unnecessary(self) -> int:
        """If the twins lack the recovery: it acted, and nothing happens without it either."""
        return self.acted_neither

    @property
    def unneeded(self) -> int:
        """If the twins lack the recovery: it never acted, and nothing happens in either run."""
        return self.neither - self.acted_neither

    @property
    def unexplained(self) -> int:
        """If the twins lack the recovery: runs that differ although it never acted.

        Equal seeds make such runs equal, so anything but 0 means that something besides the seed
        decides what happens, and that the whole table cannot be trusted.
        """
        discordant = self.only_with + self.only_without
        return discordant - self.acted_only_with - self.acted_only_without

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record, with what follows from it."""
        return {**asdict(self), "success_rate": self.success_rate}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> PairCounts:
        """The inverse of :meth:`to_json`; it passes over keys of others."""
        return cls(**{name: data[name] for name in cls.__dataclass_fields__})


def judge_pairs(pairs: Iterable[Pair]) -> PairCounts:
    """Count what the pairs came to.

    Raises:
        ConfigurationError: If a run stands in two pairs, or the pairs are about different
            requirements or components.
    """
    found = list(pairs)
    _check_one_claim(found)
    words = Counter(pair.word for pair in found)
    acted = Counter(pair.word for pair in found if pair.acted)
    return PairCounts(
        pairs=len(found),
        only_with=words["only_with"],
        only_without=words["only_without"],
        both=words["both"],
        neither=words["neither"],
        incomplete=words["incomplete"],
        acted_only_with=acted["only_with"],
        acted_only_without=acted["only_without"],
        acted_both=acted["both"],
        acted_neither=acted["neither"],
        violated_with=sum(pair.with_it.verdict == "violated" for pair in found),
        violated_without=sum(pair.without.verdict == "violated" for pair in found),
        p_value=_p_value(words["only_with"], words["only_without"]),
    )


def _p_value(only_with: int, only_without: int) -> float:
    from pytest_dura.requirements.statistics import mcnemar

    return mcnemar(only_with, only_without)


def _check_one_claim(pairs: list[Pair]) -> None:
    claims = sorted({(one.with_it.requirement, one.with_it.component) for one in pairs})
    if len(claims) > 1:
        raise ConfigurationError(
            "pairs are counted for one requirement and one component",
            found=" and ".join(f"{requirement} of {who}" for requirement, who in claims),
            remedy="count the pairs of each apart",
        )
    for side in ("with_it", "without"):
        times = Counter(getattr(pair, side).episode for pair in pairs)
        twice = sorted(episode for episode, count in times.items() if count > 1)
        if twice:
            # The same run twice would count as independent evidence in the test.
            raise ConfigurationError(
                "an episode stands in one pair only",
                found=", ".join(twice),
                remedy="keep one verdict per episode",
            )


def _run(verdict: EpisodeVerdict) -> str:
    """The number of the run, from the episode's id ``case#run``."""
    return verdict.episode.rpartition("#")[2]
