"""Pairs of episodes of equal seeds, with something and without it: verdicts, counts, changes.

The twin has the same seed and lacks a role, such as the recovery planner, or the faults. The table
is neutral: which runs violated the requirement. What its cells mean depends on what the twins lack.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from pytest_dura.core.boundary import Boundary
from pytest_dura.core.codec import Count, Number, Share
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.requirements.checks import check_name, load_function
from pytest_dura.requirements.comparison import mcnemar
from pytest_dura.requirements.episode_verdicts import EpisodeStatus, EpisodeVerdict
from pytest_dura.requirements.model import Paired, Requirement
from pytest_dura.requirements.runs import Run

RECOVERY = "recovery_planner"
_UNCOUNTED: tuple[Literal["missing", "invalid", "open"], ...] = ("missing", "invalid", "open")
_ROUNDING = 1e-9
"""Share of the greatest value by which a growth may miss the bound and still equals it: times are
multiples of a time step that has no exact float, such as 8.3 s and 6.3 s."""


def check_comparison(requirement: Requirement) -> None:
    """Refuse a requirement on pairs that does not say, or says twice, what is compared.

    Raises:
        ConfigurationError: Without a check and a measure, with both, and for a measure without a
            bound on its change or such a bound without a measure.
    """
    paired = requirement.paired
    if paired is None:
        return
    measure, bound = paired.measure, paired.change_at_most
    check_second_run(paired)
    given = {"check": requirement.check, "measure": measure}
    named = [f"{key} {value}" for key, value in given.items() if value]
    if len(named) != 1:
        raise ConfigurationError(
            "pairs are compared by a check or by a measure",
            key="paired.measure" if named else "check",
            found=" and ".join(named) or "neither",
            expected="one of them",
            remedy="leave one out" if named else "add `check`, or `measure` and `change_at_most`",
        )
    if bool(measure) != (bound is not None):
        raise ConfigurationError(
            "`measure` and `change_at_most` go together",
            key="paired.change_at_most",
            found=measure or bound,
            expected="both or neither",
            remedy="add the other one" if measure else "add `measure`, or leave the bound out",
        )


def check_second_run(paired: Paired) -> None:
    """Refuse pairs whose second run is two things, or nothing.

    Raises:
        ConfigurationError: Unless one of ``without`` and ``reference`` is given, or both for what
            recovery has to prevent.
    """
    if paired.prevents and paired.without == RECOVERY and not paired.measure:
        return
    sides = {"without": paired.without, "reference": paired.reference}
    named = [f"{key} {value}" for key, value in sides.items() if value]
    if len(named) != 1:
        raise ConfigurationError(
            "the second run of a pair lacks something, or is that of a reference",
            key="paired.reference" if named else "paired.without",
            found=" and ".join(named) or "neither",
            expected="one of `without` and `reference`, or a check that `recovery_planner` has to "
            "prevent from being violated where a reference avoids it",
            remedy="leave one out" if named else "add `without` or `reference`",
        )


def pair_verdict(with_it: EpisodeVerdict, without: EpisodeVerdict) -> EpisodeVerdict:
    """Verdict on a pair: it violates a check that is violated with something, satisfied without.

    The margin is that of the implication "satisfied without it implies satisfied with it". A pair
    of which one run is missing or invalid is so itself: there is nothing to compare. One in which
    the check's condition held in neither run is vacuous.

    Args:
        with_it: Verdict on the episode.
        without: Verdict on its twin of the same seed.
    """
    statuses = with_it.verdict, without.verdict
    uncounted = next((name for name in ("missing", "invalid") if name in statuses), None)
    if uncounted is not None:
        return _as_side(with_it, with_it if with_it.verdict == uncounted else without, uncounted)
    if "open" in statuses and statuses[0] != "satisfied" and statuses[1] != "violated":
        return _as_side(with_it, with_it if statuses[0] == "open" else without, "open")
    if (with_it.without_effect or without.without_effect) and statuses != ("violated", "satisfied"):
        # Nothing was violated only with it, and the runs are no sample of runs with the fault.
        side = with_it if with_it.without_effect else without
        return _as_side(with_it, side, "invalid")
    margins = with_it.margin, without.margin
    margin = None
    if margins[0] is not None and margins[1] is not None:
        margin = max(margins[0], -margins[1])
    if statuses == ("violated", "satisfied"):
        detail = f"violated only with it: {with_it.detail}"
        return replace(with_it, margin=margin, detail=detail)
    detail = f"{statuses[0]} with it, {statuses[1]} without it"
    vacuous = with_it.vacuous and without.vacuous
    return replace(
        with_it, verdict="satisfied", margin=margin, time=None, detail=detail, vacuous=vacuous
    )


def prevention_verdict(
    with_it: EpisodeVerdict, without: EpisodeVerdict, reference: EpisodeVerdict
) -> EpisodeVerdict:
    """Verdict on what recovery prevents: it violates what is violated with and without it.

    Only where the reference satisfies it: otherwise there is nothing to prevent, which is vacuous.

    Args:
        with_it: Verdict on the episode with recovery.
        without: Verdict on its twin without.
        reference: Verdict on the reference's run of the same seed.
    """
    sides = with_it, without, reference
    for uncounted in _UNCOUNTED:
        side = next((each for each in sides if each.verdict == uncounted), None)
        if side is not None:
            return _as_side(with_it, side, uncounted)
    side = next((each for each in sides if each.without_effect), None)
    if side is not None:
        return _as_side(with_it, side, "invalid")
    detail = f"{without.verdict} without it, {reference.verdict} by the reference"
    if without.verdict != "violated" or reference.verdict != "satisfied":
        return replace(
            with_it, verdict="satisfied", margin=None, time=None, detail=detail, vacuous=True
        )
    return replace(with_it, detail=f"{with_it.verdict} with it, {detail}", vacuous=False)


def _as_side(
    with_it: EpisodeVerdict, side: EpisodeVerdict, verdict: EpisodeStatus
) -> EpisodeVerdict:
    """The pair as invalid, missing or open as one of its runs is."""
    twin = "" if side is with_it else f", in {side.episode}"
    return replace(
        with_it,
        verdict=verdict,
        margin=None,
        time=None,
        detail=f"{side.detail}{twin}",
        without_effect=False,
        ended=side.ended,
    )


def change_verdict(
    requirement: Requirement,
    run: Run,
    twin: Run,
    values: tuple[float | None, float | None],
) -> EpisodeVerdict:
    """Whether a measure grew by more than is acceptable.

    A value that is not finite stands for "never", which is more than any number: an episode
    without a value whose twin has one violates the requirement, and a pair without any says
    nothing.

    Args:
        requirement: A requirement on pairs with a bound on the change.
        run: The run.
        twin: The run of the same seed without something.
        values: The measure of both; ``None`` of a run that is invalid or missing, or not whole.
    """
    assert requirement.paired is not None
    bound = requirement.paired.change_at_most
    assert bound is not None
    status, margin, detail = _compared(run, twin, values, bound)
    return EpisodeVerdict(
        requirement=requirement.id,
        episode=run.episode,
        component=run.component,
        verdict=status,
        margin=margin,
        time=None,
        detail=detail,
        proposals=run.proposals,
        valid_proposals=run.valid_proposals,
        not_manifested=run.not_manifested,
    )


def _compared(
    run: Run, twin: Run, values: tuple[float | None, float | None], bound: float
) -> tuple[EpisodeStatus, float | None, str]:
    own, other = values
    if own is None or other is None:
        uncounted = [
            side
            for side in (run, twin)
            if side.validity != "valid" or side.termination == "decided"
        ]
        missing = [side for side in uncounted if side.failure is not None]
        side = [*missing, *uncounted][0]
        why = side.failure or side.invalid_reason or "ended before its time, once all was decided"
        detail = f"{why}, in {side.episode}"
        return ("missing" if missing else "invalid"), None, detail
    if not math.isfinite(own):
        if not math.isfinite(other):
            return "invalid", None, "the measure has no value in either run"
        return "violated", None, f"the measure has no value, and {other:.4g} without"
    if not math.isfinite(other):
        return "satisfied", None, f"the measure is {own:.4g}, and has no value without"
    detail = f"the measure is {own:.4g}, and {other:.4g} without: {own - other:+.4g}"
    margin = bound - (own - other)
    if abs(margin) <= _ROUNDING * max(abs(own), abs(other), abs(bound)):
        margin = 0.0
    return ("satisfied" if margin >= 0 else "violated"), margin, detail


def measured(measure: str | Callable[[Episode], float], episode: Episode) -> float:
    """The measure of an episode; NaN for none.

    Raises:
        ConfigurationError: If the function cannot be imported, fails, or returns no number.
    """
    function = load_function(measure) if isinstance(measure, str) else measure
    try:
        with Boundary() as boundary:
            return float(function(episode))
    except ConfigurationError:
        raise
    except BaseException as error:
        boundary.let_pass(error)
        name = check_name(measure)
        raise ConfigurationError(
            f"the measure {name} failed on {episode.id}: {describe_error(error)}",
            key="paired.measure",
            found=name,
            expected="a function of an episode to a number",
            remedy="mend the function; let it return NaN where there is no value",
        ) from error


PairStatus = Literal["only_with", "only_without", "both", "neither", "incomplete"]


@dataclass(frozen=True, slots=True)
class Pair:
    """The verdicts on an episode and on its twin.

    Args:
        with_it: Verdict on the episode that has what the twin lacks.
        without: Verdict on the twin.
        acted: Whether recovery acted in the episode that has it.
        reference: Verdict on a third run, that of a reference; ``None`` without one.

    Raises:
        ConfigurationError: If the two are not about the same requirement, component and run.
    """

    with_it: EpisodeVerdict
    without: EpisodeVerdict
    acted: bool = False
    reference: EpisodeVerdict | None = None

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
    def status(self) -> PairStatus:
        """Which runs violated it; ``incomplete`` if that is unknown of one of them."""
        statuses = self.with_it.verdict, self.without.verdict
        sides = [self.with_it, self.without, *([self.reference] if self.reference else [])]
        if any(
            side.verdict not in {"satisfied", "violated"} or side.without_effect for side in sides
        ):
            return "incomplete"
        return _STATUSES[statuses[0] == "violated", statuses[1] == "violated"]

    @property
    def unavoidable(self) -> bool:
        """Whether it is violated without it, and by the reference as well."""
        own = self.status in {"only_without", "both"}
        return own and self.reference is not None and self.reference.verdict == "violated"


_STATUSES: dict[tuple[bool, bool], PairStatus] = {
    (True, False): "only_with",
    (False, True): "only_without",
    (True, True): "both",
    (False, False): "neither",
}


@dataclass(frozen=True, slots=True)
class PairCounts:
    """Counts of pairs by the runs that violated a requirement.

    `only_with` to `incomplete` add up to `pairs`. A pair with an invalid, missing or open run is
    incomplete, as what the other run came to cannot be compared; a violation in it stands in
    `violated_with` or `violated_without` all the same.
    """

    pairs: Count
    """All pairs."""
    only_with: Count
    """Violated only with what the second run lacks."""
    only_without: Count
    """Violated only without it."""
    both: Count
    """Violated in both runs."""
    neither: Count
    """Violated in neither."""
    incomplete: Count
    """One run is invalid, missing or open."""
    acted_only_with: Count
    """Those of `only_with` in which recovery acted."""
    acted_only_without: Count
    """Those of `only_without`."""
    acted_both: Count
    """Those of `both`."""
    acted_neither: Count
    """Those of `neither`."""
    violated_with: Count
    """Violations with it, incomplete pairs included."""
    violated_without: Count
    """Violations without it, incomplete pairs included."""
    p_value: Share | None
    """Two-sided p-value of the exact McNemar test on the discordant pairs, against "it makes no
    difference to the rate of violations"; 1 if no pair is discordant. It holds for a number of
    pairs that did not depend on what they came to: of pairs that were run until a requirement was
    decided it may be too small. Null for a sum over cases, whose pairs are not of one kind."""
    reference_without: Count = 0
    """Of the violations without it, those that a reference has as well; 0 without a third run."""
    reference_both: Count = 0
    """Of those in both runs, those that a reference has as well; 0 without a third run."""

    @property
    def to_prevent(self) -> int:
        """If a third run is a reference's: violations without it that the reference avoids."""
        return self.only_without + self.both - self.reference_without

    @property
    def prevented_of_these(self) -> int:
        """Of :attr:`to_prevent`, those that there are not with it."""
        return self.to_prevent - (self.both - self.reference_both)

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


@dataclass(frozen=True, slots=True)
class PairTable(PairCounts):
    """What the two runs of each pair came to."""

    without: str = ""
    """`faults`, or the role that the second runs lack; empty where they are a reference's."""
    case: str = ""
    """Id of the case of the second runs."""
    reference: str = ""
    """The component that takes the place of the component under test in the second runs, or in
    third ones where the second ones lack a role; empty without one. What both violate was not
    avoidable for it either."""

    @property
    def avoidable(self) -> int:
        """If the twins are a reference's: violations that it avoids."""
        return self.only_with

    @property
    def unavoidable(self) -> int:
        """Violations that the reference has as well, of those that there are with recovery."""
        return self.reference_both if self.without else self.both


def judge_pairs(pairs: Iterable[Pair]) -> PairCounts:
    """Count what the pairs came to.

    Raises:
        ConfigurationError: If a run stands in two pairs, or the pairs are about different
            requirements or components.
    """
    all_pairs = list(pairs)
    _check_one_claim(all_pairs)
    counts = Counter(pair.status for pair in all_pairs)
    acted = Counter(pair.status for pair in all_pairs if pair.acted)
    return PairCounts(
        pairs=len(all_pairs),
        only_with=counts["only_with"],
        only_without=counts["only_without"],
        both=counts["both"],
        neither=counts["neither"],
        incomplete=counts["incomplete"],
        acted_only_with=acted["only_with"],
        acted_only_without=acted["only_without"],
        acted_both=acted["both"],
        acted_neither=acted["neither"],
        violated_with=sum(pair.with_it.verdict == "violated" for pair in all_pairs),
        violated_without=sum(pair.without.verdict == "violated" for pair in all_pairs),
        p_value=mcnemar(counts["only_with"], counts["only_without"]),
        reference_without=sum(pair.unavoidable for pair in all_pairs),
        reference_both=sum(pair.unavoidable and pair.status == "both" for pair in all_pairs),
    )


def _check_one_claim(pairs: list[Pair]) -> None:
    claims = sorted({(pair.with_it.requirement, pair.with_it.component) for pair in pairs})
    if len(claims) > 1:
        raise ConfigurationError(
            "pairs are counted for one requirement and one component",
            found=" and ".join(
                f"{requirement} of {component}" for requirement, component in claims
            ),
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


@dataclass(frozen=True, slots=True)
class Change:
    """The change of a measure in each pair: its value with it less its value without it.

    A pair has a change only if both of its runs have a finite value. Which pairs do not, and why,
    is kept: an attack after which the car never clears the junction gives no clearance time, and a
    mean over the other pairs alone would hide exactly that.
    """

    measure: str
    """Import path of the measure."""
    pairs: tuple[str, ...]
    """The first episode of each pair."""
    values: tuple[Number | None, ...]
    """For each pair the measure less that of its twin, in its unit; null for none."""
    lost: tuple[str, ...]
    """Pairs with a value in the second run only."""
    gained: tuple[str, ...]
    """Pairs with a value in the first run only."""
    valueless: tuple[str, ...]
    """Pairs without a value in either run."""
    incomplete: tuple[str, ...]
    """Pairs of which a run is invalid, missing or not whole."""
    n: Count
    """Pairs that have a change."""
    mean: Number | None
    """Of the changes; null without any."""
    median: Number | None
    """Of the changes; null without any."""
    max: Number | None
    """The greatest change; null without any."""
    max_pair: str | None
    """The first pair that has it; null without any."""
    min: Number | None
    """The least change; null without any."""
    min_pair: str | None
    """The first pair that has it; null without any."""
    p_value: Share
    """Two-sided p-value of the exact sign test on the changes, against "growing is as likely as
    shrinking": pairs in which nothing changed do not count; 1 without others."""

    @classmethod
    def between(
        cls, measure: str, sides: Mapping[str, tuple[float | None, float | None]]
    ) -> Change:
        """From the values with it and without it, by id of the pair.

        Args:
            measure: Name of the measure.
            sides: ``(with it, without it)``. ``None`` is a run that was not measured: it is
                invalid or missing. NaN, or an infinite number, is a run that has no value.
        """
        kinds: dict[str, list[str]] = {}
        changes: dict[str, float] = {}
        for pair, (own, twin) in sides.items():
            kind, value = _compare(own, twin)
            kinds.setdefault(kind, []).append(pair)
            if value is not None:
                changes[pair] = value
        known = list(changes.values())
        max_pair = max(changes, key=changes.__getitem__, default=None)
        min_pair = min(changes, key=changes.__getitem__, default=None)
        return cls(
            measure,
            tuple(sides),
            tuple(changes.get(pair) for pair in sides),
            lost=tuple(kinds.get("lost", ())),
            gained=tuple(kinds.get("gained", ())),
            valueless=tuple(kinds.get("valueless", ())),
            incomplete=tuple(kinds.get("incomplete", ())),
            n=len(known),
            mean=statistics.fmean(known) if known else None,
            median=statistics.median(known) if known else None,
            max=None if max_pair is None else changes[max_pair],
            max_pair=max_pair,
            min=None if min_pair is None else changes[min_pair],
            min_pair=min_pair,
            # The same binomial distribution with probability 1/2.
            p_value=mcnemar(sum(each > 0 for each in known), sum(each < 0 for each in known)),
        )

    @property
    def changes(self) -> list[float]:
        """The changes there are."""
        return [value for value in self.values if value is not None]


@dataclass(frozen=True, slots=True)
class ChangeTable:
    """By how much a measure differs in each pair."""

    without: str
    """`faults`, or the role that the second runs lack; empty where they are a reference's."""
    case: str
    """Id of the case of the second runs."""
    change: Change
    """The changes, and their summary."""
    reference: str = ""
    """The component that takes the place of the component under test in the second runs; empty
    without one."""


def _compare(own: float | None, twin: float | None) -> tuple[str, float | None]:
    if own is None or twin is None:
        return "incomplete", None
    has_own, has_twin = math.isfinite(own), math.isfinite(twin)
    if has_own and has_twin:
        return "changed", own - twin
    if has_twin:
        return "lost", None
    return ("gained" if has_own else "valueless"), None
