"""What one requirement says of a campaign: all episodes of a case, with one component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.episodes import EpisodeVerdict
from pytest_dura.requirements.statistics import METHOD, lower_bound, runs_needed, upper_bound

CampaignWord = Literal["supported", "violated", "undecided"]

MAX_INVALID_SHARE = 0.2
"""Share of invalid episodes above which a campaign says nothing."""
MIN_VALID_PROPOSALS = 0.5
"""Share of valid proposals below which a claim would rest on the recovery, not on the component."""


@dataclass(frozen=True, slots=True)
class Bound:
    """The one-sided upper confidence bound on the rate of violations, over valid episodes.

    ``upper`` is ``None`` without a valid episode; ``at_most`` is the rate that was to be
    supported, ``None`` where every episode must satisfy the requirement.
    """

    confidence: float
    upper: float | None
    method: str = METHOD
    at_most: float | None = None


@dataclass(frozen=True, slots=True)
class Counterexample:
    """An episode that violated the requirement, when first, and by how much (negative margin)."""

    episode: str
    time: float | None
    margin: float | None


@dataclass(frozen=True, slots=True)
class CampaignVerdict:
    """Verdict and all counts that it rests on.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        component: Name of the component under test.
        verdict: ``supported``, ``violated`` or ``undecided``.
        reason: Why, in words; names every obstacle of an undecided campaign.
        planned: Episodes that were planned.
        run: Episodes that were run, missing and invalid ones included.
        episodes: Valid episodes: those that satisfied or violated the requirement.
        violations: Episodes that violated it.
        invalid: Episodes that say nothing of it.
        missing: Episodes that an infrastructure error ended.
        vacuous: Episodes that satisfied it because its condition never held.
        bound: Bound on the rate of violations.
        margin: Worst robustness over valid episodes.
        counterexamples: The violating episodes, the largest violation first.
    """

    requirement: str
    case: str
    component: str
    verdict: CampaignWord
    reason: str
    planned: int
    run: int
    episodes: int
    violations: int
    invalid: int
    missing: int
    vacuous: int
    bound: Bound
    margin: float | None
    counterexamples: tuple[Counterexample, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        return asdict(self) | {"counterexamples": [asdict(one) for one in self.counterexamples]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CampaignVerdict:
        """The inverse of :meth:`to_json`."""
        examples = tuple(Counterexample(**one) for one in data["counterexamples"])
        return cls(**{**data, "bound": Bound(**data["bound"]), "counterexamples": examples})


def judge_campaign(
    requirement: str,
    case: str,
    verdicts: Sequence[EpisodeVerdict],
    *,
    planned: int,
    component: str | None = None,
    at_most: float | None = None,
    confidence: float = 0.95,
) -> CampaignVerdict:
    """The verdict of a requirement on the episodes of a case.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        verdicts: One per episode that was run. Of several attempts at one episode a violation
            counts before anything else, and otherwise the last one.
        planned: Episodes that were planned.
        component: The component's name, for a campaign of which nothing was run.
        at_most: Greatest acceptable rate of violations; ``None`` accepts none at all.
        confidence: One-sided confidence of the bound on that rate.

    Raises:
        ConfigurationError: For a rate or a confidence outside (0, 1), and for verdicts on
            different components.
    """
    for name, value in (("at_most", at_most), ("confidence", confidence)):
        if value is not None and not 0.0 < value < 1.0:
            raise ConfigurationError(
                f"{name} lies strictly between 0 and 1",
                key=name,
                found=value,
                expected="a share such as 0.05",
                remedy="leave at_most out where every episode must satisfy the requirement",
            )
    components = sorted({one.component for one in verdicts} | ({component} if component else set()))
    if len(components) > 1:
        raise ConfigurationError(
            "a campaign judges one component",
            key=requirement,
            found=", ".join(components),
            remedy="judge the episodes of each component apart",
        )
    tally = _Tally.of(_last_attempts(verdicts), planned)
    word, reason = _decide(tally, at_most, confidence)
    upper = upper_bound(tally.violations, tally.valid, confidence) if tally.valid else None
    margins = [one.margin for one in tally.judged if one.margin is not None]
    return CampaignVerdict(
        requirement=requirement,
        case=case,
        component=components[0] if components else "none",
        verdict=word,
        reason=reason,
        planned=planned,
        run=tally.run,
        episodes=tally.valid,
        violations=tally.violations,
        invalid=tally.invalid,
        missing=tally.missing,
        vacuous=0,
        bound=Bound(confidence, upper, METHOD, at_most),
        margin=min(margins) if margins else None,
        counterexamples=_counterexamples(tally.judged),
    )


@dataclass(frozen=True, slots=True)
class _Tally:
    planned: int
    run: int
    judged: tuple[EpisodeVerdict, ...]
    violations: int
    invalid: int
    missing: int
    proposals: int
    valid_proposals: int

    @classmethod
    def of(cls, verdicts: Sequence[EpisodeVerdict], planned: int) -> _Tally:
        words = [one.verdict for one in verdicts]
        return cls(
            planned=planned,
            run=len(words),
            judged=tuple(one for one in verdicts if one.verdict in ("satisfied", "violated")),
            violations=words.count("violated"),
            invalid=words.count("invalid"),
            missing=words.count("missing"),
            proposals=sum(one.proposals for one in verdicts),
            valid_proposals=sum(one.valid_proposals for one in verdicts),
        )

    @property
    def valid(self) -> int:
        return len(self.judged)

    def obstacles(self) -> list[str]:
        """Everything for which this campaign cannot support a claim."""
        found = []
        if self.run < self.planned:
            found.append(f"only {self.run} of {self.planned} planned episodes were run")
        if self.missing:
            found.append(f"{self.missing} of {self.run} episodes are missing (infrastructure)")
        if self.run and self.invalid / self.run > MAX_INVALID_SHARE:
            share = f"more than {MAX_INVALID_SHARE:.0%}"
            found.append(f"{self.invalid} of {self.run} episodes are invalid, {share}")
        if not self.valid:
            found.append("no episode was valid")
        if self.valid_proposals < MIN_VALID_PROPOSALS * self.proposals:
            asked = f"{self.valid_proposals} of {self.proposals} ticks"
            found.append(f"the component made a valid proposal at only {asked}")
        return found


def _last_attempts(verdicts: Sequence[EpisodeVerdict]) -> list[EpisodeVerdict]:
    latest: dict[str, EpisodeVerdict] = {}
    for one in verdicts:
        before = latest.get(one.episode)
        if before is None or before.verdict != "violated":
            latest[one.episode] = one
    return list(latest.values())


def _decide(tally: _Tally, at_most: float | None, confidence: float) -> tuple[CampaignWord, str]:
    counts = f"{tally.violations} of {tally.valid} valid episodes violated it"
    if at_most is None and tally.violations:
        return "violated", counts
    if at_most is not None and tally.violations:
        # What was not run or is missing counts as satisfied here: it may not make a violation.
        open_runs = tally.missing + max(0, tally.planned - tally.run)
        lower = lower_bound(tally.violations, tally.valid + open_runs, confidence)
        if lower > at_most:
            return "violated", (
                f"{counts}: at {confidence:g} confidence the rate is above {lower:.3g}, "
                f"and at most {at_most:g} is allowed"
            )
    obstacles = tally.obstacles()
    if obstacles:
        return "undecided", "; ".join(obstacles)
    if at_most is None:
        return "supported", f"all {tally.valid} valid episodes satisfied it"
    return _decide_rate(tally, at_most, confidence, counts)


def _decide_rate(
    tally: _Tally, at_most: float, confidence: float, counts: str
) -> tuple[CampaignWord, str]:
    upper = upper_bound(tally.violations, tally.valid, confidence)
    reason = f"{counts}: at {confidence:g} confidence the rate is at most {upper:.3g}"
    if upper <= at_most:
        return "supported", reason
    reason += f", which does not support {at_most:g}"
    needed = runs_needed(at_most, confidence, tally.violations)
    return "undecided", f"{reason}; {needed} episodes with {tally.violations} violations would"


def _counterexamples(judged: Sequence[EpisodeVerdict]) -> tuple[Counterexample, ...]:
    violated = [one for one in judged if one.verdict == "violated"]
    violated.sort(key=lambda one: (one.margin if one.margin is not None else 0.0, one.episode))
    return tuple(Counterexample(one.episode, one.time, one.margin) for one in violated)
