"""Baseline: an earlier record, and how the rates of violations changed since, by verdict.

Only campaigns that ran under the same conditions are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.bundle import RECORD_FILE, open_record
from pytest_dura.evidence.conclusions.verdicts import Runs, VerdictLines, judged_runs, question_key
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.requirements.campaign_judge import MAX_INVALID_SHARE
from pytest_dura.requirements.comparison import (
    BaselineComparison,
    ComparedBaseline,
    compare_counts,
    compare_pairs,
    comparison_status,
    holm,
)
from pytest_dura.requirements.model import Requirement

_CONDITION_KEYS = ("simulator", "scenario", "faults", "termination", "time_step", "time_budget")
"""Keys of an episode's spec. Roles and policy are left out: they may be what is compared."""


@dataclass(frozen=True)
class Conditions:
    """Conditions of an episode, apart from the component under test and the other roles.

    Args:
        seed: The episode's seed.
        values: Simulator, world, faults, duration, time step and budget, by dotted path.
    """

    seed: int
    values: Mapping[str, Any]

    @classmethod
    def of(cls, spec: EpisodeSpec) -> Conditions:
        """Read them from an episode's spec."""
        values = {key: plain_data(getattr(spec, key)) for key in _CONDITION_KEYS}
        # The role that puts the faults into effect belongs to the faults.
        values["fault_injector"] = plain_data(spec.roles.get("fault_injector"))
        return cls(spec.seed, dict(_leaves("", values)))

    def differences(self, other: Conditions) -> list[str]:
        """List the dotted paths at which the values differ, sorted."""
        return sorted(_different(self.values, other.values))


def _changed_conditions(
    first_runs: Mapping[int, Conditions], second_runs: Mapping[int, Conditions]
) -> list[str]:
    """List the dotted paths of conditions in which two campaigns on a case differ.

    Runs of equal seeds must have equal conditions. Without such runs, a value that is the same in
    all runs of each campaign must be the same in both; one that varies between runs cannot be
    compared, since a record holds the drawn values and not the range that they come from.

    Args:
        first_runs: By the run's number.
        second_runs: By the run's number.
    """
    shared = [
        run
        for run in first_runs
        if run in second_runs and first_runs[run].seed == second_runs[run].seed
    ]
    if shared:
        pairs = ((first_runs[run].values, second_runs[run].values) for run in shared)
        return sorted(set().union(*(_different(*pair) for pair in pairs)))
    if not (first_runs and second_runs):
        return []
    first, second = (next(iter(runs.values())).values for runs in (first_runs, second_runs))
    varying = _varying(first_runs.values()) | _varying(second_runs.values())
    return sorted(_different(first, second) - varying)


def _leaves(path: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, Mapping):
        inner = list(value.items())
    elif isinstance(value, (list, tuple)):
        inner = [(str(i), nested) for i, nested in enumerate(value)]
    else:
        return [(path, value)]
    prefix = f"{path}." if path else ""
    leaves = [leaf for key, nested in inner for leaf in _leaves(f"{prefix}{key}", nested)]
    return leaves or [(path, ())]


_ABSENT = object()


def _different(first: Mapping[str, Any], second: Mapping[str, Any]) -> set[str]:
    paths = {*first, *second}
    return {path for path in paths if first.get(path, _ABSENT) != second.get(path, _ABSENT)}


def _varying(runs: Collection[Conditions]) -> set[str]:
    first = next(iter(runs)).values
    return {path for run in runs for path in _different(first, run.values)}


_MAX_COUNT = 10**9
"""More runs than any session has; the tests on counts compute in floating point."""


@dataclass(frozen=True)
class Claim:
    """The counts of one verdict, and what they were counted on.

    Args:
        requirement: Id of the requirement.
        case: Id of the case.
        component: Name of the component under test.
        item: Node id of the test.
        check: What was judged, a comparison of pairs included: the same text, the same question.
        method: Method of the decision.
        confidence: One-sided confidence of the requirement.
        planned: Episodes that were planned.
        run: Episodes that were run.
        saved: Planned episodes that were not run because the verdict stood without them.
        episodes: Valid episodes.
        violations: Those that violated the requirement; an open one is not known to.
        judged: Whether each run that it rests on violated it, by number; ``None`` of one that is
            not valid.
        conditions: Of the case's planned runs, by number.
    """

    requirement: str
    case: str
    component: str
    item: str
    check: str
    method: str
    confidence: float
    planned: int
    run: int
    saved: int
    episodes: int
    violations: int
    judged: Mapping[int, bool | None]
    conditions: Mapping[int, Conditions]

    @property
    def by_seed(self) -> Mapping[int, bool | None] | None:
        """Whether the run of each seed violated it; ``None`` unless all of its runs are valid."""
        runs = self.judged.keys() & self.conditions.keys()
        if len(runs) < self.run or None in self.judged.values():
            return None
        return {self.conditions[run].seed: self.judged[run] for run in sorted(runs)}


def claims_of(record: SessionRecord) -> list[Claim]:
    """Read the claims of a record, in its order.

    Raises:
        ValueError: For counts that contradict each other.
    """
    lines = VerdictLines.of(record.head)
    runs = Runs(lines.cases, lines.requirements)
    conditions: dict[tuple[str, str], dict[int, Conditions]] = {}
    for episode in record.episodes():
        runs.add(episode)
        if episode.planned:
            of_case = conditions.setdefault((episode.case, episode.component), {})
            of_case.setdefault(episode.spec.run, Conditions.of(episode.spec))
    judged = judged_runs(lines, runs)
    claims = []
    for verdict in record.head.verdicts:
        run, episodes, violations = verdict.run, verdict.episodes, verdict.violations
        if max(run, verdict.planned) >= _MAX_COUNT:
            raise ValueError(f"{run} runs of {verdict.planned} are too many")
        if not violations <= episodes <= run:
            raise ValueError(f"{violations} violations, {episodes} valid and {run} run contradict")
        confidence = verdict.bound.confidence
        if not 0.5 < confidence < 1.0:
            raise ValueError(f"{confidence!r} is no confidence")
        claim = Claim(
            requirement=verdict.requirement,
            case=verdict.case,
            component=verdict.component,
            item=verdict.item,
            check=_check(verdict, lines.requirements.get(verdict.requirement)),
            method=verdict.method,
            confidence=confidence,
            planned=verdict.planned,
            run=run,
            saved=verdict.saved,
            episodes=episodes,
            violations=violations,
            judged={
                int(each.episode.rpartition("#")[2]): each.verdict == "violated"
                if each.valid
                else None
                for each in judged.get(question_key(verdict.item, verdict), ())
            },
            conditions=conditions.get((verdict.case, verdict.component), {}),
        )
        claims.append(claim)
    return claims


def _check(verdict: ItemVerdict, requirement: Requirement | None) -> str:
    """Describe what was judged; for a test on single episodes, its node id."""
    check = verdict.check
    if not check:
        stated = "" if requirement is None else requirement.check
        check = f"{stated} in {verdict.item}".lstrip()
    if verdict.pairs is None:
        return check
    reference, paired = verdict.pairs.reference, verdict.paired
    without = verdict.pairs.without
    second = [f"without {without}"] if without else []
    second += [f"beside {reference}"] if reference else []
    details = [f"pairs {' and '.join(second)}"]
    if paired is not None and paired.measure:
        details.append(f"measure {paired.measure}")
    if paired is not None and paired.change_at_most is not None:
        details.append(f"change_at_most {paired.change_at_most}")
    return ", ".join([check, *details])


_SEQUENTIAL = ("sprt", "e-process")
"""Methods whose number of episodes depends on their outcomes."""
_N_DEPENDED = "n depended on the outcome"


def compare_claims(claims: Sequence[Claim], baseline: Sequence[Claim]) -> list[BaselineComparison]:
    """Compare the claims of two records, and list those of one alone, by case and requirement.

    The results hold together: Holm's correction keeps the probability of any false "worse" in the
    session at the requirements' level, and separately that of any false "better".

    Args:
        claims: Of the new record.
        baseline: Of the earlier record.
    """
    return corrected_comparisons(uncorrected_comparisons(claims, baseline))


def uncorrected_comparisons(
    claims: Sequence[Claim], baseline: Sequence[Claim]
) -> list[BaselineComparison]:
    """Compare as :func:`compare_claims`, each by itself."""
    comparisons = []
    for own, other in _matched_claims(claims, baseline):
        if own is not None and other is not None:
            comparisons.append(_comparison(own, other))
        elif own is not None:
            comparisons.append(
                BaselineComparison(own.requirement, own.case, own.component, None, "new")
            )
        elif other is not None:
            comparisons.append(
                BaselineComparison(other.requirement, other.case, None, other.component, "gone")
            )
    comparisons.sort(key=lambda comparison: (comparison.case, comparison.requirement))
    return comparisons


def corrected_comparisons(comparisons: Sequence[BaselineComparison]) -> list[BaselineComparison]:
    """Correct the results by Holm's method over everything with a p-value."""
    comparisons = list(comparisons)
    family = [i for i, comparison in enumerate(comparisons) if comparison.p_worse is not None]
    worse = holm([comparisons[i].p_worse or 0.0 for i in family])
    better = holm([comparisons[i].p_better or 0.0 for i in family])
    for i, p_worse, p_better in zip(family, worse, better, strict=True):
        corrected = replace(comparisons[i], p_worse_holm=p_worse, p_better_holm=p_better)
        if corrected.uncorrected is not None and corrected.confidence is not None:
            corrected = replace(
                corrected, status=comparison_status(p_better, p_worse, corrected.confidence)
            )
        comparisons[i] = corrected
    return comparisons


def _comparison(own: Claim, other: Claim) -> BaselineComparison:
    comparison = BaselineComparison(
        requirement=own.requirement,
        case=own.case,
        component=own.component,
        baseline_component=other.component,
        status="no comparison",
        confidence=own.confidence,
        violations=own.violations,
        episodes=own.episodes,
        baseline_violations=other.violations,
        baseline_episodes=other.episodes,
    )
    obstacle = _incomparable_question(own, other)
    if obstacle:
        return replace(comparison, reason=obstacle)
    obstacle = _incomparable_outcome(own, other)
    if obstacle:
        # Were it left out, how many tests the correction counts would depend on what they show.
        return replace(comparison, reason=obstacle, p_worse=1.0, p_better=1.0)
    ours, theirs = own.by_seed, other.by_seed
    if ours is not None and theirs is not None and ours.keys() == theirs.keys():
        only_now = sum(bool(ours[seed]) and not theirs[seed] for seed in ours)
        only_baseline = sum(bool(theirs[seed]) and not ours[seed] for seed in ours)
        pairs = compare_pairs(only_now, only_baseline, own.confidence)
        comparison = replace(
            comparison, test="McNemar", only_now=only_now, only_baseline=only_baseline
        )
    else:
        counts = own.violations, own.episodes, other.violations, other.episodes
        pairs = compare_counts(*counts, own.confidence)
        comparison = replace(comparison, test="Fisher")
    return replace(
        comparison,
        status=pairs.status,
        uncorrected=pairs.status,
        p_worse=pairs.p_worse,
        p_better=pairs.p_better,
    )


def _incomparable_question(own: Claim, other: Claim) -> str:
    """Reason why two claims cannot be compared, whatever their outcomes; empty for none."""
    # The check of a test that never ran is not known.
    if own.run and other.run and own.check != other.check:
        return f"the check changed from {other.check!r} to {own.check!r}"
    changed = _changed_conditions(own.conditions, other.conditions)
    if changed:
        more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
        return f"the scenario changed: {', '.join(changed[:3])}{more}"
    sequential = [claim.method for claim in (own, other) if claim.method in _SEQUENTIAL]
    return f"{_N_DEPENDED} ({sequential[0]})" if sequential else ""


def _incomparable_outcome(own: Claim, other: Claim) -> str:
    """Reason why the runs are not enough for a comparison; empty if they are.

    A campaign that may end early and did not is compared. Such campaigns are among those that a
    fixed number of runs would have left with the same counts, so that a false result is no more
    likely than with a fixed number.
    """
    for origin, claim in (("", own), ("of the baseline ", other)):
        if claim.saved:
            return f"{_N_DEPENDED} ({claim.saved} of {claim.planned} runs {origin}saved)"
        if claim.run < claim.planned:
            return f"only {claim.run} of {claim.planned} planned runs {origin}were run"
        if not claim.episodes:
            return f"no valid episodes {origin}".rstrip()
        # An invalid episode counts if it violates and not if it satisfies: the rate would be that
        # of a selection.
        if claim.run - claim.episodes > MAX_INVALID_SHARE * claim.run:
            return f"only {claim.episodes} of {claim.run} runs {origin}are valid"
    return ""


def _matched_claims(
    claims: Sequence[Claim], baseline: Sequence[Claim]
) -> Iterator[tuple[Claim | None, Claim | None]]:
    """Match each claim with at most one counterpart; ``None`` where there is none.

    A requirement may be decided on a case several times: for two components, or by two tests.
    Those that agree in most keys are matched first, and only where there is no second candidate.
    """
    left, right = list(claims), list(baseline)
    for key in _MATCHED_BY:
        for own in list(left):
            own_candidates = [claim for claim in left if key(claim) == key(own)]
            candidates = [claim for claim in right if key(claim) == key(own)]
            if len(own_candidates) == len(candidates) == 1:
                left.remove(own)
                right.remove(candidates[0])
                yield own, candidates[0]
    yield from ((own, None) for own in left)
    yield from ((None, other) for other in right)


_MATCHED_BY: tuple[Callable[[Claim], tuple[str, ...]], ...] = (
    attrgetter("requirement", "case", "component", "item", "check"),
    attrgetter("requirement", "case", "item", "check"),
    attrgetter("requirement", "case", "component", "check"),
    attrgetter("requirement", "case"),
)


_BASELINE_OPTION = "--dura-baseline"


@dataclass(frozen=True)
class Baseline:
    """Earlier record, read and checked.

    Args:
        session: What the record of another session says of it, before anything is compared.
        claims: Its verdicts.
    """

    session: ComparedBaseline
    claims: tuple[Claim, ...]

    @classmethod
    def read(cls, path: str, relative_to: Path) -> Baseline:
        """Read a file, or the record in a directory.

        Raises:
            ConfigurationError: If there is none, or it is damaged, foreign or unfinished.
        """
        file = relative_to / path
        if file.is_dir():
            file /= RECORD_FILE
        record = open_record(file, _BASELINE_OPTION, may_be_link=True)
        head = record.head
        # The files of the component are in the baseline's own record.
        component = head.component_under_test.to_json()
        component.pop("sources", None)
        try:
            claims = tuple(claims_of(record))
        except (ValueError, RecursionError) as error:
            raise ConfigurationError(
                "the baseline is damaged",
                file=str(file),
                key=_BASELINE_OPTION,
                found=f"{type(error).__name__}: {error}",
                expected="a record as pytest-dura wrote it",
                remedy="restore the file, or run the baseline's session again",
            ) from None
        if head.status == "running":
            raise ConfigurationError(
                "the baseline's session was killed, or is still running",
                file=str(file),
                key="status",
                found=head.status,
                expected="complete, or interrupted, of which the finished campaigns are compared",
                remedy="run the baseline's session to its end",
            )
        session = ComparedBaseline(
            path=path,
            sha256=str(file_entry(file)["sha256"]),
            created=head.created,
            status=head.status,
            base_seed=head.base_seed,
            component=component,
        )
        return cls(session, claims)

    def compared(self, record: SessionRecord | None = None) -> ComparedBaseline:
        """Compare a session with it, by :func:`compare_claims`.

        Args:
            record: The new session's record; ``None`` as long as it runs.
        """
        if record is None:
            return self.session
        comparisons = compare_claims(claims_of(record), self.claims)
        tests = sum(comparison.p_worse is not None for comparison in comparisons)
        return replace(self.session, tests=tests, comparisons=tuple(comparisons))


def regression_objections(baseline: ComparedBaseline) -> list[str]:
    """List the reasons to fail a gate that is to fail where a rate got worse.

    Args:
        baseline: Of :meth:`Baseline.compared` of a finished session.
    """
    comparisons = baseline.comparisons
    if all(comparison.test is None for comparison in comparisons):
        return ["the gate fails: nothing in this session can be compared with the baseline"]
    return [
        f"the gate fails: {comparison.requirement} on {comparison.case} is worse"
        " than in the baseline"
        for comparison in comparisons
        if comparison.status == "worse"
    ]
