"""What the rates of violations did since a baseline, verdict by verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from pytest_dura.evidence.baseline.claims import Claim
from pytest_dura.evidence.baseline.conditions import changed_conditions
from pytest_dura.requirements.statistics import (
    ComparisonWord,
    compare_counts,
    compare_pairs,
    comparison_word,
    holm,
)
from pytest_dura.requirements.verdicts.judging import MAX_INVALID_SHARE

SEQUENTIAL = ("sprt", "e-process")
"""Methods under which the number of episodes depends on what they show."""
N_DEPENDED = "n depended on the outcome"

BaselineWord = Literal["better", "worse", "no evidence of a change", "new", "gone", "no comparison"]


@dataclass(frozen=True)
class BaselineComparison:
    """One requirement on one case, now and in the baseline.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        component: Component under test now; ``None`` for what is gone.
        baseline_component: That of the baseline; ``None`` for what is new.
        word: What is said of it, after Holm's correction.
        reason: Why there is no comparison.
        uncorrected: The word that this comparison alone would have got.
        confidence: The requirement's own, of the words.
        violations: Violating episodes now.
        episodes: Valid episodes now.
        baseline_violations: Violating episodes of the baseline.
        baseline_episodes: Valid episodes of the baseline.
        test: ``McNemar`` for runs of equal seeds, ``Fisher`` for others; both exact.
        only_now: For McNemar, seeds that violate it now alone.
        only_baseline: For McNemar, seeds that violated it in the baseline alone.
        p_worse: One-sided p-value against "the rate is not higher than the baseline's"; 1 where
            the outcome itself kept the two from being compared.
        p_better: One-sided p-value against "the rate is not lower than the baseline's".
        p_worse_holm: Adjusted for all comparisons of the session.
        p_better_holm: Adjusted for all comparisons of the session.
    """

    requirement: str
    case: str
    component: str | None
    baseline_component: str | None
    word: BaselineWord
    reason: str = ""
    uncorrected: ComparisonWord | None = None
    confidence: float | None = None
    violations: int | None = None
    episodes: int | None = None
    baseline_violations: int | None = None
    baseline_episodes: int | None = None
    test: Literal["McNemar", "Fisher"] | None = None
    only_now: int | None = None
    only_baseline: int | None = None
    p_worse: float | None = None
    p_better: float | None = None
    p_worse_holm: float | None = None
    p_better_holm: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        return asdict(self)


def compare_claims(claims: Sequence[Claim], baseline: Sequence[Claim]) -> list[BaselineComparison]:
    """What stands in both records compared, and the rest listed, by case and requirement.

    The words hold together: Holm's correction keeps the probability of any false "worse" in the
    session at the requirements' level, and that of any false "better" apart from it.

    Args:
        claims: Of the new record.
        baseline: Of the record it is held against.
    """
    found = []
    for own, other in _matched(claims, baseline):
        if own is not None and other is not None:
            found.append(_compared(own, other))
        elif own is not None:
            found.append(BaselineComparison(own.requirement, own.case, own.component, None, "new"))
        elif other is not None:
            found.append(
                BaselineComparison(other.requirement, other.case, None, other.component, "gone")
            )
    found.sort(key=lambda one: (one.case, one.requirement))
    return _corrected(found)


def _corrected(found: list[BaselineComparison]) -> list[BaselineComparison]:
    """The words after Holm's correction over everything with a p-value."""
    family = [i for i, one in enumerate(found) if one.p_worse is not None]
    worse = holm([found[i].p_worse or 0.0 for i in family])
    better = holm([found[i].p_better or 0.0 for i in family])
    for i, p_worse, p_better in zip(family, worse, better, strict=True):
        one = replace(found[i], p_worse_holm=p_worse, p_better_holm=p_better)
        if one.uncorrected is not None and one.confidence is not None:
            one = replace(one, word=comparison_word(p_better, p_worse, one.confidence))
        found[i] = one
    return found


def _compared(own: Claim, other: Claim) -> BaselineComparison:
    """The comparison before any correction."""
    told = BaselineComparison(
        requirement=own.requirement,
        case=own.case,
        component=own.component,
        baseline_component=other.component,
        word="no comparison",
        confidence=own.confidence,
        violations=own.violations,
        episodes=own.episodes,
        baseline_violations=other.violations,
        baseline_episodes=other.episodes,
    )
    obstacle = _other_question(own, other)
    if obstacle:
        return replace(told, reason=obstacle)
    obstacle = _outcome_in_the_way(own, other)
    if obstacle:
        # Were it left out, how many tests the correction counts would depend on what they show.
        return replace(told, reason=obstacle, p_worse=1.0, p_better=1.0)
    if own.seeds is not None and own.seeds == other.seeds:
        only_now = len(own.violating - other.violating)
        only_baseline = len(other.violating - own.violating)
        found = compare_pairs(only_now, only_baseline, own.confidence)
        told = replace(told, test="McNemar", only_now=only_now, only_baseline=only_baseline)
    else:
        counts = own.violations, own.episodes, other.violations, other.episodes
        found = compare_counts(*counts, own.confidence)
        told = replace(told, test="Fisher")
    return replace(
        told,
        word=found.word,
        uncorrected=found.word,
        p_worse=found.p_worse,
        p_better=found.p_better,
    )


def _other_question(own: Claim, other: Claim) -> str:
    """Why the two cannot be compared, whatever they came to; empty if they can."""
    # Nothing is known of the check of a test that never ran.
    if own.run and other.run and own.check != other.check:
        return f"the check changed from {other.check!r} to {own.check!r}"
    changed = changed_conditions(own.conditions, other.conditions)
    if changed:
        more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
        return f"the scenario changed: {', '.join(changed[:3])}{more}"
    sequential = [one.method for one in (own, other) if one.method in SEQUENTIAL]
    return f"{N_DEPENDED} ({sequential[0]})" if sequential else ""


def _outcome_in_the_way(own: Claim, other: Claim) -> str:
    """Why what was run is not enough for a comparison; empty if it is.

    A campaign that may end early and did not is compared. Such campaigns are among those that a
    fixed number of runs would have left with the same counts, so that a false word is no more
    likely than with a fixed number.
    """
    for whose, one in (("", own), ("of the baseline ", other)):
        if one.saved:
            return f"{N_DEPENDED} ({one.saved} of {one.planned} runs {whose}saved)"
        if one.run < one.planned:
            return f"only {one.run} of {one.planned} planned runs {whose}were run"
        if not one.episodes:
            return f"no valid episodes {whose}".rstrip()
        # A violation counts in an invalid episode too, a satisfaction does not: the rate of what
        # is left would be that of a selection.
        if one.run - one.episodes > MAX_INVALID_SHARE * one.run:
            return f"only {one.episodes} of {one.run} runs {whose}are valid"
    return ""


def _matched(
    claims: Sequence[Claim], baseline: Sequence[Claim]
) -> Iterator[tuple[Claim | None, Claim | None]]:
    """Each claim with its counterpart, both at most once; ``None`` where there is none.

    A requirement may be decided on one case several times: for two components, or by two tests.
    Those that agree in the most are matched first, and only where there is no second candidate.
    """
    left, right = list(claims), list(baseline)
    for key in MATCHED_BY:
        for own in list(left):
            mine = [one for one in left if key(one) == key(own)]
            others = [one for one in right if key(one) == key(own)]
            if len(mine) == len(others) == 1:
                left.remove(own)
                right.remove(others[0])
                yield own, others[0]
    yield from ((own, None) for own in left)
    yield from ((None, other) for other in right)


MATCHED_BY: tuple[Callable[[Claim], tuple[str, ...]], ...] = (
    lambda one: (one.requirement, one.case, one.component, one.item, one.check),
    lambda one: (one.requirement, one.case, one.item, one.check),
    lambda one: (one.requirement, one.case, one.component, one.check),
    lambda one: (one.requirement, one.case),
)
