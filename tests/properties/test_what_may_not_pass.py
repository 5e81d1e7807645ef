"""What may not pass: the judge of campaigns and the gate, held against their rules in a table."""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
from entries import make
from scipy.stats import binom

from pytest_dura import CampaignVerdict, EpisodeVerdict, Requirement
from pytest_dura.evidence import Gate
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.requirements import CampaignJudge, judge_campaign, lower_bound, upper_bound

RUNS = 40
LIMIT = 0.3
METHODS = (None, "fixed", "e-process", "sprt")


def episode(run: int, verdict: Any = "satisfied", **keys: Any) -> EpisodeVerdict:
    """The verdict on one episode, in which the component was asked 10 times and always answered."""
    margin = -1.0 if verdict == "violated" else 1.0
    keys = {"proposals": 10, "valid_proposals": 10} | keys
    return EpisodeVerdict("R", f"case#{run}", "planner", verdict, margin, None, "", **keys)


def requirement(method: Any) -> Requirement:
    """With no rate, or with a rate that is decided by this method."""
    if method is None:
        return Requirement("R")
    return Requirement("R", at_most=LIMIT, method=method, p0=0.01 if method == "sprt" else None)


def judged(method: Any, verdicts: Sequence[EpisodeVerdict], **keys: Any) -> CampaignVerdict:
    return judge_campaign(requirement(method), "case", verdicts, **{"planned": RUNS} | keys)


Verdicts = list[EpisodeVerdict]


def with_last(number: int, verdict: str, **keys: Any) -> Callable[[Verdicts], Verdicts]:
    """The last ones are of another kind."""
    return lambda all_: [
        *all_[: len(all_) - number],
        *(episode(RUNS - number + i, verdict, **keys) for i in range(number)),
    ]


def each(**keys: Any) -> Callable[[Verdicts], Verdicts]:
    """All have something in common."""
    return lambda all_: [replace(verdict, **keys) for verdict in all_]


NOT_SUPPORTED: dict[str, tuple[Callable[[Verdicts], Verdicts], str]] = {
    "nothing was run": (lambda _: [], "none of the episodes was valid"),
    "fewer were run than planned": (lambda all_: all_[:3], f"only 3 of {RUNS} planned"),
    "the session was interrupted after one": (lambda all_: all_[:1], "only 1 of"),
    "one is missing": (with_last(1, "missing"), "missing (infrastructure)"),
    "more than a fifth is invalid": (with_last(9, "invalid"), "invalid, more than 20%"),
    "all are invalid": (with_last(RUNS, "invalid"), "none of the episodes was valid"),
    "a fault came too late for an end": (
        with_last(1, "invalid", ended="critical"),
        "ended before a fault had an effect (1 critical)",
    ),
    "a crash that no requirement sees": (
        with_last(1, "satisfied", ended="critical", unseen_crash="case#39"),
        "a crash that no requirement sees",
    ),
    "its condition never held": (each(vacuous=True), "its condition held in none"),
    "a planned fault never manifested": (
        each(not_manifested=("ghost",)),
        "ghost manifested in none",
    ),
    "one of two planned faults never manifested": (
        lambda all_: [
            replace(verdict, not_manifested=("ghost", "fog") if run % 2 else ("fog",))
            for run, verdict in enumerate(all_)
        ],
        "fog manifested in none",
    ),
    "the component never answers": (each(valid_proposals=0), "at only 0 of 400 ticks"),
    "the component rarely answers": (each(valid_proposals=4), "at only 160 of 400 ticks"),
}
TOO_FEW = {"fewer were run than planned", "the session was interrupted after one"}
"""Obstacles of which an option excuses a verdict: its runs are valid, and merely too few."""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("obstacle", NOT_SUPPORTED)
def test_one_obstacle_leaves_a_campaign_undecided_that_would_be_supported(
    method: str | None, obstacle: str
) -> None:
    plain = [episode(run) for run in range(RUNS)]
    assert judged(method, plain).verdict == "supported"
    change, reason = NOT_SUPPORTED[obstacle]
    result = judged(method, change(plain))
    assert result.verdict == "undecided"
    assert reason in result.reason
    assert result.saved == 0
    assert result.too_few == (obstacle in TOO_FEW)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "borne",
    [
        with_last(8, "invalid"),  # a fifth
        lambda all_: [*each(vacuous=True)(all_[:-1]), all_[-1]],
        lambda all_: [*each(not_manifested=("ghost",))(all_[:-1]), all_[-1]],
        each(valid_proposals=5),
    ],
    ids=["a fifth is invalid", "held once", "manifested once", "answers half of the time"],
)
def test_what_is_just_no_obstacle_is_borne(
    method: str | None, borne: Callable[[Verdicts], Verdicts]
) -> None:
    verdicts = borne([episode(run) for run in range(RUNS)])
    assert judged(method, verdicts).verdict == "supported"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "statuses", [("violated", "satisfied"), ("satisfied", "violated"), ("violated", "invalid")]
)
def test_no_further_attempt_hides_a_violation(
    method: str | None, statuses: tuple[str, str]
) -> None:
    attempts = [episode(run, status) for run in range(RUNS) for status in statuses]
    result = judged(method, attempts)
    assert (result.verdict, result.run) == ("violated", RUNS)
    assert result.violations == result.episodes > 0


def test_of_attempts_without_a_violation_the_last_one_counts() -> None:
    for statuses, expected in (
        (("invalid", "satisfied"), "supported"),
        (("satisfied", "missing"), "undecided"),
    ):
        attempts = [episode(run, status) for run in range(RUNS) for status in statuses]
        assert judged(None, attempts).verdict == expected


@pytest.mark.parametrize("episodes", [1, 7, 40])
def test_a_bound_that_equals_the_limit_keeps_it(episodes: int) -> None:
    for violations in range(episodes):
        statuses = ["violated"] * violations + ["satisfied"] * (episodes - violations)
        verdicts = [episode(run, status) for run, status in enumerate(statuses)]

        def verdict(at_most: float, all_: Verdicts = verdicts) -> str:
            rule = Requirement("R", at_most=at_most)
            return judge_campaign(rule, "case", all_, planned=len(all_)).verdict

        upper, lower = (bound(violations, episodes, 0.95) for bound in (upper_bound, lower_bound))
        assert verdict(upper) == "supported"
        assert verdict(math.nextafter(upper, 0)) == "undecided"
        if lower > 0:
            assert verdict(lower) == "undecided"
            assert verdict(math.nextafter(lower, 0)) == "violated"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("situation", ["repeated", "without effect"])
def test_equal_runs_are_one_observation_which_bounds_no_rate(
    method: str | None, situation: Any
) -> None:
    for violations in (0, 1, RUNS):
        verdicts = [
            episode(run, "violated" if run < violations else "satisfied") for run in range(RUNS)
        ]
        result = judged(method, verdicts, situation=situation)
        if violations and (method is None or violations == RUNS):
            expected = "violated"
        else:
            rate_or_variation = method is not None or situation == "without effect"
            expected = "undecided" if rate_or_variation else "supported"
        assert result.verdict == expected, (violations, result)
        assert not result.too_few
        assert result.bound.upper is None


def test_a_repeated_situation_ends_a_campaign_and_saves_the_rest() -> None:
    first_two = [episode(0), episode(1)]
    result = judged(None, first_two, situation="repeated")
    assert (result.verdict, result.saved) == ("supported", RUNS - 2)
    for spoilt in ("invalid", "missing"):
        result = judged(None, [episode(0), episode(1, spoilt)], situation="repeated")
        assert result.verdict == "undecided"


@pytest.mark.parametrize("method", ["e-process", "sprt"])
def test_a_violation_after_a_sequential_acceptance_is_no_pass(method: str) -> None:
    accepted = [episode(run) for run in range(RUNS - 1)]
    assert judged(method, accepted).verdict == "supported"
    for later in ("violated", "open"):
        result = judged(method, [*accepted, episode(RUNS, later)])
        assert (result.verdict, result.too_few) == ("undecided", False)
        assert "and 1 after these violated it or ended before it was decided" in result.reason


def drawn(source: random.Random) -> Verdicts:
    """Up to sixty episodes, of which any share violates the requirement."""
    share = source.choice([0, 0.02, 0.1, 0.4, 1])
    idle = source.choice([0.0, 0.0, 0.9, 1.0])
    vacuous = source.choice([0.0, 0.0, 0.9, 1.0])
    answered = source.choice([1, 5, 10, 10, 10])
    kinds = source.choice([["violated"], ["violated", "open", "invalid"], ["violated", "missing"]])
    result = []
    for run in range(source.randrange(60)):
        verdict = "satisfied"
        if source.random() < share:
            verdict = source.choice(kinds)
        ended = source.choice(["", "halt"]) if verdict == "invalid" else ""
        result.append(
            episode(
                run,
                verdict,
                vacuous=verdict == "satisfied" and source.random() < vacuous,
                not_manifested=("ghost",) if source.random() < idle else (),
                without_effect=verdict == "violated" and source.random() < 0.2,
                ended="critical" if verdict == "open" else ended,
                unseen_crash=f"case#{run}" if source.random() < 0.001 else "",
                valid_proposals=answered,
            )
        )
    return result


def obstacles(all_: Verdicts, planned: int, *, rate: bool) -> list[str]:
    """The rules by which a campaign of a fixed number of runs supports nothing."""
    statuses = Counter("invalid" if verdict.without_effect else verdict.verdict for verdict in all_)
    valid = [verdict for verdict in all_ if verdict.valid]
    broken = {
        "fewer": len(all_) < planned,
        "missing": statuses["missing"] > 0,
        "invalid share": 5 * statuses["invalid"] > len(all_),
        "none valid": not valid,
        "open": statuses["open"] > 0 and not rate,
        "ended invalid": any(verdict.verdict == "invalid" and verdict.ended for verdict in all_),
        "unseen crash": any(verdict.unseen_crash for verdict in all_),
        "without effect": any(verdict.without_effect for verdict in all_) and rate,
        "vacuous": statuses["satisfied"] > 0
        and not statuses["violated"]
        and all(verdict.vacuous for verdict in all_ if verdict.verdict == "satisfied"),
        "idle": bool(valid) and all(verdict.not_manifested for verdict in valid),
        "silent": sum(verdict.valid_proposals for verdict in all_) < 5 * len(all_),
    }
    return [name for name, is_broken in broken.items() if is_broken]


def expected(all_: Verdicts, planned: int, at_most: float | None) -> tuple[str, list[str]]:
    """The status on a campaign of a fixed number of runs, and the obstacles that it met."""
    against = obstacles(all_, planned, rate=at_most is not None)
    violations = sum(verdict.verdict == "violated" and verdict.valid for verdict in all_)
    if at_most is None:
        if any(verdict.verdict == "violated" for verdict in all_):
            return "violated", []
        return ("undecided" if against else "supported"), against
    valid = sum(verdict.valid for verdict in all_)
    # What is not known may all be satisfied.
    unknown = sum(verdict.verdict == "missing" for verdict in all_) + max(0, planned - len(all_))
    if violations and binom.sf(violations - 1, valid + unknown, at_most) < 0.05 - 1e-12:
        return "violated", []
    if against:
        return "undecided", against
    worst = violations + sum(verdict.verdict == "open" for verdict in all_)
    return ("supported" if binom.cdf(worst, valid, at_most) <= 0.05 else "undecided"), []


def test_a_campaign_of_a_fixed_number_of_runs_is_judged_as_the_rules_say() -> None:
    alone: Counter[str] = Counter()
    statuses: Counter[str] = Counter()
    excused: Counter[bool] = Counter()
    for seed in range(2500):
        source = random.Random(seed)
        all_ = drawn(source)
        planned = max(1, len(all_) + source.choice([-3, 0, 0, 0, 0, 2, 30]))
        at_most = source.choice([None, 0.05, 0.1, 0.3])
        status, against = expected(all_, planned, at_most)
        rule = Requirement("R", at_most=at_most)
        result = judge_campaign(rule, "case", all_, planned=planned)
        assert result.verdict == status, (seed, result)
        too_few = status == "undecided" and {"fewer"}.issuperset(against)
        assert result.too_few == too_few, (seed, result)
        excused[too_few] += status == "undecided"
        statuses[f"{status} {at_most is not None}"] += 1
        if len(against) == 1:
            alone[against[0]] += 1
    # Each rule has decided alone, and each status was given with a rate and without.
    assert set(alone) >= {
        "fewer", "missing", "invalid share", "open", "ended invalid", "unseen crash",
        "without effect", "vacuous", "idle", "silent",
    }  # fmt: skip
    assert min(statuses.values()) > 50
    assert len(statuses) == 6
    assert min(excused[True], excused[False]) > 50


@pytest.mark.parametrize("method", METHODS)
def test_runs_that_end_by_decision_end_in_one_unless_one_is_missing(method: str | None) -> None:
    ends: Counter[str] = Counter()
    for seed in range(300):
        source = random.Random(seed)
        all_ = drawn(source)
        judge = CampaignJudge(requirement(method), "case", planned=60, until_decided=True)
        for verdict in all_:
            judge.add(verdict)
            if judge.decided:
                break
        result = judge.verdict()
        missing = any(verdict.verdict == "missing" for verdict in judge.verdicts)
        if judge.decided and not missing:
            assert result.verdict != "undecided", (seed, result)
        assert result.saved == (
            60 - result.run if judge.decided and result.verdict != "undecided" else 0
        )
        ends[result.verdict] += judge.decided
    # Without a rate nothing but a violation decides, and what is missing.
    reached = (
        ("violated", "undecided") if method is None else ("supported", "violated", "undecided")
    )
    assert min(ends[status] for status in reached) > 5, ends


VERDICT_SETS: list[list[tuple[str, bool]]] = [
    [],
    *([pair] for pair in itertools.product(("supported", "undecided", "violated"), (False, True))),
    [("too few", False)],
    [("too few", True), ("undecided", False)],
    [("supported", False), ("undecided", False)],
    [("undecided", True), ("violated", False)],
]


@pytest.mark.parametrize("warn_undecided", [False, True])
@pytest.mark.parametrize("verdicts", VERDICT_SETS, ids=str)
def test_the_gate_passes_only_what_nothing_stands_against(
    verdicts: list[tuple[str, bool]], warn_undecided: bool
) -> None:
    plain = [
        make(
            ItemVerdict,
            requirement=f"R{number}",
            case="case",
            verdict="undecided" if status == "too few" else status,
            too_few=status == "too few",
            waiver={"kind": "xfail", "reason": "ticket 7"} if waived else None,
        )
        for number, (status, waived) in enumerate(verdicts)
    ]
    against = [
        f"R{number} on case is {'undecided' if status == 'too few' else status}"
        for number, (status, waived) in enumerate(verdicts)
        if not waived
        and (status in ("violated", "undecided") or (status == "too few" and not warn_undecided))
    ]
    for code, failed, objections, interrupted in itertools.product(
        (0, 1, 2, 3, 4, 5), (0, 2), ([], ["a trace is gone"]), (False, True)
    ):
        gate = Gate.of(
            plain,
            objections,
            searches=[],
            interrupted=interrupted,
            exit_code=code,
            failed=failed,
            warn_undecided=warn_undecided,
        )
        reasons = [*against, *objections]
        reasons += ["2 test items failed"] if failed else []
        reasons += ["no test was run"] if code == 5 else []
        if interrupted:
            assert gate.result == "incomplete"
            reasons.append(f"the session was interrupted (exit code {code or 2})")
        elif code or reasons:
            assert gate.result == "failed"
            reasons = reasons or [f"pytest ended with exit code {code}"]
        else:
            assert gate.result == "passed"
        assert sorted(gate.reasons) == sorted(reasons)
        assert (gate.exit_code == 0) == (gate.result == "passed")
        assert code in (0, gate.exit_code)


@pytest.mark.parametrize("waived", [False, True])
@pytest.mark.parametrize("warn_undecided", [False, True])
@pytest.mark.parametrize("baseline_violates", [False, True])
@pytest.mark.parametrize("outcome", ["falsified", "not repeatable", "undecided", "nothing found"])
def test_the_gate_passes_a_search_only_if_nothing_was_violated_and_enough_was_decided(
    outcome: str, baseline_violates: bool, warn_undecided: bool, waived: bool
) -> None:
    search = make(
        RecordedSearch,
        case="case",
        waiver={"kind": "xfail", "reason": "ticket 7"} if waived else None,
        outcomes=[{"requirement": "R", "status": outcome}],
        baselines=[{"first": {"R": 3 if baseline_violates else None}}],
    )
    gate = Gate.of(
        [],
        [],
        searches=[search],
        interrupted=False,
        exit_code=0,
        failed=0,
        warn_undecided=warn_undecided,
    )
    against = outcome != "nothing found" or baseline_violates
    assert gate.result == ("failed" if against and not waived else "passed")
