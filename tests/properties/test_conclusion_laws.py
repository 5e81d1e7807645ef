"""Laws of conclusions: verdicts are a function of the set of lines, and of the plan's own rule."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.evidence.conclusions.verdicts import Runs, VerdictLines, conclude_verdicts
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.requirements import Paired, Requirement
from pytest_dura.requirements.campaign_verdicts import number_ranges
from pytest_dura.requirements.episode_verdicts import CheckVerdict
from pytest_dura.requirements.judgements import (
    CampaignCourse,
    Judgement,
    RunJudgement,
    conclude_campaign,
)
from pytest_dura.requirements.runs import Run

lawful = settings(derandomize=True, deadline=None, max_examples=150)

QUESTIONS = st.sampled_from(
    [
        (Requirement("R", check="c"), False),
        (Requirement("R", check="c"), True),
        (Requirement("R", check="c", at_most=0.3), False),
        (Requirement("R", check="c", at_most=0.3), True),
        (Requirement("R", check="c", at_most=0.4, method="sprt", p0=0.05), True),
        (Requirement("R", check="c", paired=Paired("recovery_planner")), False),
    ]
)
STATUSES = st.sampled_from(["satisfied", "satisfied", "violated", "open", "invalid", "missing"])
TERMINATIONS = {"open": "critical", "missing": "infrastructure"}


def run_of(case: str, number: int, status: Any, *, declared: bool, crashed: bool) -> Run:
    verdict = CheckVerdict(status, None, None, f"{status} {number}", vacuous=False)
    termination = TERMINATIONS.get(status, "critical" if crashed else "goal")
    return Run(
        episode=f"{case}#{number}", case=case, number=number, component="C",
        digest=f"{case}{number}", validity=status if status in ("invalid", "missing") else "valid",
        termination=termination, failure="infrastructure: x" if status == "missing" else None,
        invalid_reason="never manifested: f" if status == "invalid" else None, proposals=10,
        valid_proposals=10, not_manifested=(), recovered=False, trajectory=f"{number % 3}",
        drawn=False, verdicts={"R": verdict} if declared else {}, violates=status == "violated",
    )  # fmt: skip


@st.composite
def campaigns(draw: st.DrawFn) -> tuple[Judgement, dict[str, Run]]:
    """A question, with runs that no rule has cut short."""
    requirement, until_decided = draw(QUESTIONS)
    declared, count = draw(st.booleans()), draw(st.integers(0, 14))
    cases = ["own", "twin"] if requirement.paired else ["own"]
    runs, judged = {}, []
    for number in range(count):
        sides = [
            run_of(case, number, draw(STATUSES), declared=declared, crashed=draw(st.booleans()))
            for case in cases
        ]
        said = [None if declared else CheckVerdict(word_of(side), None, None, "", vacuous=False)
                for side in sides]  # fmt: skip
        twin = sides[1].digest if len(sides) > 1 else ""
        judged.append(RunJudgement(sides[0].digest, number, twin, *said))
        runs.update({side.digest: side for side in sides})
    planned = draw(st.integers(1, 12))
    question = Judgement(
        "campaign", "R", "own", "C", planned, requirement.check, requirement.paired,
        requirement.at_most, requirement.confidence, requirement.method, requirement.p0,
        until_decided, "twin" if requirement.paired else "",
    )  # fmt: skip
    return replace(question, runs=tuple(judged)), runs


def word_of(run: Run) -> Any:
    if run.validity != "valid":
        return run.validity
    return "violated" if run.violates else "satisfied"


@lawful
@given(campaigns(), st.randoms(use_true_random=False))
def test_the_order_of_lines_does_not_matter(
    campaign: tuple[Judgement, dict[str, Run]], random: Any
) -> None:
    judgement, runs = campaign
    shuffled = list(judgement.runs)
    random.shuffle(shuffled)
    again = replace(judgement, runs=tuple(shuffled))
    assert conclude_campaign(again, runs, varies=True) == conclude_campaign(
        judgement, runs, varies=True
    )


@lawful
@given(campaigns())
def test_what_is_concluded_is_what_the_campaign_came_to_while_it_ran(
    campaign: tuple[Judgement, dict[str, Run]],
) -> None:
    judgement, runs = campaign
    course = CampaignCourse(judgement, varies=True)
    for judged in judgement.runs:
        if not course.goes_on:
            break
        course.add(judged, runs[judged.digest], runs.get(judged.twin))
    concluded = conclude_campaign(course.judgement, runs, varies=True)
    assert concluded.verdict == course.verdict()
    assert concluded.beyond_plan == []
    # Runs that were made ahead, or by another part of the session, enter nothing.
    whole = conclude_campaign(judgement, runs, varies=True)
    assert whole.verdict == course.verdict()
    assert whole.beyond_plan == [each.run for each in judgement.runs[len(course.runs) :]]


@lawful
@given(campaigns(), st.data())
def test_a_run_that_is_gone_is_missing_of_the_plan(
    campaign: tuple[Judgement, dict[str, Run]], data: Any
) -> None:
    """It never turns a verdict that was not supported into a supported one."""
    judgement, runs = campaign
    whole = conclude_campaign(judgement, runs, varies=True).verdict
    if whole.run == 0:
        return
    gone = data.draw(st.integers(0, whole.run - 1))
    del runs[judgement.runs[gone].digest]
    left = conclude_campaign(judgement, runs, varies=True).verdict
    assert left.run == gone
    assert (
        left.verdict == "undecided"
        or left.verdict == whole.verdict == "violated"
        or (left.counterexamples == () and left.saved)
    )
    if left.run + left.saved < left.planned:
        assert left.verdict != "supported"


def concluded(judgements: list[Judgement], runs: dict[str, Run]) -> ItemVerdict:
    """The one verdict that the lines of some parts come to."""
    known = Runs({}, {})
    for run in runs.values():
        known.take(run)
    (verdict,) = conclude_verdicts(VerdictLines(judgements, {}, {}), known)
    return verdict


@lawful
@given(campaigns(), st.data())
def test_parts_that_stopped_on_their_own_come_to_what_the_whole_comes_to(
    campaign: tuple[Judgement, dict[str, Run]], data: Any
) -> None:
    """Parts may overlap, and are joined in any order, also some of them before the others."""
    judgement, runs = campaign
    whole = concluded([judgement], runs)
    owners = [data.draw(st.sets(st.integers(0, 2), min_size=1)) for _ in judgement.runs]
    parts = [
        replace(judgement, runs=tuple(
            run for run, owned in zip(judgement.runs, owners, strict=True) if part in owned
        ))
        for part in range(3)
    ]  # fmt: skip
    for order in data.draw(st.permutations(parts)), [*parts, *parts], [judgement, parts[1]]:
        assert concluded(list(order), runs) == whole


@lawful
@given(campaigns(), st.data())
def test_runs_beyond_the_decision_enter_nothing_whether_they_are_there_or_not(
    campaign: tuple[Judgement, dict[str, Run]], data: Any
) -> None:
    judgement, runs = campaign
    whole = concluded([judgement], runs)
    kept = [each for each in judgement.runs if each.run < whole.run or data.draw(st.booleans())]
    left = concluded([replace(judgement, runs=tuple(kept))], runs)
    assert left == replace(whole, beyond_plan=left.beyond_plan)
    decided = len(judgement.runs) > whole.run
    assert whole.beyond_plan == tuple(range(whole.run, len(judgement.runs)))
    if decided:
        assert left.beyond_plan == tuple(each.run for each in kept[whole.run :])


@lawful
@given(campaigns(), st.data())
def test_runs_that_no_part_has_are_named_and_never_excused(
    campaign: tuple[Judgement, dict[str, Run]], data: Any
) -> None:
    judgement, runs = campaign
    whole = concluded([judgement], runs)
    if whole.run < 2:
        return
    first = data.draw(st.integers(0, whole.run - 2))
    last = data.draw(st.integers(first, whole.run - 2))
    kept = [each for each in judgement.runs if not first <= each.run <= last]
    left = concluded([replace(judgement, runs=tuple(kept))], runs)
    assert left.run == first
    assert left.beyond_plan == ()
    assert left.verdict in ("undecided", "violated")
    if left.verdict == "undecided":
        verb = "runs {} are missing" if last > first else "run {} is missing"
        assert verb.format(number_ranges(range(first, last + 1))) in left.reason
        assert not left.too_few


def test_ranges_of_runs_are_short() -> None:
    assert number_ranges([]) == ""
    assert number_ranges([3, 4, 5, 7, 9, 10]) == "3 to 5, 7, 9 to 10"
