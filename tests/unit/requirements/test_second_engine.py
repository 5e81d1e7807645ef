"""rtamt beside our own evaluation: what is compared, what is not, and that differences show."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from episodes import episode
from formulas import formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import ConfigurationError, Episode
from pytest_dura.requirements import (
    Ending,
    EnginesDisagreeError,
    Evaluation,
    Formula,
    JudgedEpisode,
    Requirement,
    SecondEngine,
    evaluate,
    judge_episode,
    parse,
)
from pytest_dura.requirements.second_engine import COMPARED
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.program import plan_of

pytest.importorskip("rtamt", reason="rtamt's ANTLR 4.7 cannot be imported from Python 3.13 on")

ENDINGS: tuple[Ending, ...] = ("time", "goal", "stopped", "open")
STEP = 0.1


@pytest.fixture(autouse=True)
def no_plan_of_another_test() -> Iterator[None]:
    """Plans hold the functions of their operators."""
    plan_of.cache_clear()
    yield
    plan_of.cache_clear()


def compare(engine: SecondEngine, formula: Formula, found: Evaluation, columns: Any) -> None:
    engine.compare(formula, found, columns, time_step=STEP, episode="case#0", spec="0")


def judged_by_both(one: Episode, engine: SecondEngine) -> JudgedEpisode:
    judged = JudgedEpisode.of(one)
    judged.evaluate_also_by(engine)
    return judged


@settings(derandomize=True, deadline=None, max_examples=150)
@given(formulas(("a", "b"), time_step=STEP), traces(("a", "b")), st.sampled_from(ENDINGS))
def test_the_engines_agree_on_any_formula(
    formula: Formula, trace: dict[str, list[float]], ending: Ending
) -> None:
    engine = SecondEngine()
    time = np.arange(len(trace["a"])) * STEP
    found = evaluate(formula, time, trace, ending=ending, time_step=STEP)
    compare(engine, formula, found, trace)
    assert list(engine.results.values()) == [COMPARED]


def early(function: Callable[..., Any], at: int) -> Callable[..., Any]:
    """The same operator, whose window ends a sample too early."""

    def wrong(*given: Any) -> Any:
        arguments = list(given)
        if arguments[at] is not None:
            arguments[at] = max(arguments[at] - 1, arguments[at - 1])
        return function(*arguments)

    return wrong


WRONG = {
    "until": ("always ((a > -9) until[0:2] (b > 0))", lambda: early(windows.until, 3)),
    "since": ("always ((a > -9) since[0:1] (b > -2))", lambda: early(windows.since, 3)),
    "sliding": ("always[0:0] (eventually[0:2] (b > 0))", lambda: early(windows.sliding, 3)),
    "sliding_past": ("always (once[0:1] (a > 0))", lambda: early(windows.sliding_past, 3)),
    "running_past": ("always (once (a > 0))", lambda: lambda values, join: values),
    "running": ("always (a > 0 implies always (b > 0))", lambda: lambda values, join: values),
    "following": ("always[0:0] (next (a > 0))", lambda: lambda values, end: values),
    "preceding": ("always (prev (a > 0))", lambda: lambda values, start: values),
}


@pytest.mark.parametrize("operator", WRONG)
def test_a_wrong_operator_of_ours_is_reported(
    operator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, defect = WRONG[operator]
    formula = parse(text)
    trace = {"a": [1.0, -2.0, 3.0, -1.0, 2.0, -3.0], "b": [-2.0, -1.0, 1.0, -3.0, -1.0, 2.0]}
    time = np.arange(6.0)
    compared = SecondEngine()
    about: dict[str, Any] = {"time_step": 1.0, "episode": "case#0", "spec": "0"}
    compared.compare(formula, evaluate(formula, time, trace, ending="goal"), trace, **about)
    monkeypatch.setattr(windows, operator, defect())
    plan_of.cache_clear()
    found = evaluate(formula, time, trace, ending="goal")
    with pytest.raises(EnginesDisagreeError) as raised:
        compared.compare(formula, found, trace, **about)
    text = str(raised.value)
    assert text.startswith(f"infrastructure: the STL engines disagree on `{formula}`, episode case")
    assert f"ours is {found.status} by {found.margin!r}" in text
    assert compared.differences == [text]
    with pytest.raises(EnginesDisagreeError):
        compared.compare(formula, found, trace, **about)
    assert (len(compared.differences), compared.counts()["compared"]) == (1, 2)


@pytest.mark.parametrize(
    "check, status",
    [
        ("always (gap >= 0)", "satisfied"),
        ("always (gap == 0)", "satisfied"),
        ("always (gap > 0)", "violated"),
        ("always ((gap > 0) or (gap <= 0))", "satisfied"),
        ("not (eventually (gap <= 0))", "violated"),
    ],
)
def test_on_the_bound_the_truth_is_compared_and_not_the_sign(check: str, status: str) -> None:
    formula, columns = parse(check), {"gap": [0.0, 0.0, 0.0]}
    found = evaluate(formula, [0.0, 0.1, 0.2], columns)
    assert (found.margin, found.status) == (0.0, status)
    engine = SecondEngine()
    compare(engine, formula, found, columns)
    other: Any = "satisfied" if status == "violated" else "violated"
    with pytest.raises(EnginesDisagreeError):
        compare(engine, formula, replace(found, status=other), columns)


def test_margins_must_be_equal_to_the_bit_but_for_exp_and_pow() -> None:
    columns = {"x": [0.3, 0.7, 1.9]}
    for text, tolerated in (("always (x / 3 > 0)", False), ("always (exp(x) > 0)", True)):
        formula, engine = parse(text), SecondEngine()
        found = evaluate(formula, [0.0, 0.1, 0.2], columns)
        compare(engine, formula, found, columns)
        near = replace(found, margin=float(np.nextafter(found.margin, 9.0)))
        if tolerated:
            compare(engine, formula, near, columns)
            near = replace(found, margin=found.margin + 1e-6)
        with pytest.raises(EnginesDisagreeError):
            compare(engine, formula, near, columns)


def test_a_difference_leaves_the_episode_missing_and_names_the_requirement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    requirement = Requirement("SAF-1", check="always (eventually[0:1] (gap > 2))")
    one = episode(gap=[1, 3, 1, 3, 1, 3])
    assert judge_episode(requirement, one).verdict == "satisfied"
    both = judged_by_both(one, SecondEngine())
    assert judge_episode(requirement, both).verdict == "satisfied"
    monkeypatch.setattr(windows, "sliding", early(windows.sliding, 3))
    plan_of.cache_clear()
    one = episode(gap=[1, 3, 1, 3, 1, 3])
    both = judged_by_both(one, SecondEngine())
    assert judge_episode(requirement, one).verdict == "violated"
    found = judge_episode(requirement, both)
    assert (found.verdict, found.margin) == ("missing", None)
    assert found.detail.startswith(
        "infrastructure: the STL engines disagree on SAF-1, episode case#0: "
    )
    assert "violated by -1.0" in found.detail
    assert "satisfied by 1.0" in found.detail
    for ask in (both.satisfies, both.robustness):
        with pytest.raises(EnginesDisagreeError):
            ask(requirement.check)


def always_true(_: Episode) -> bool:
    return True


def test_what_is_not_compared_is_counted_with_its_reason() -> None:
    engine = SecondEngine()
    formula = "always (gap > 0)"
    for check, one in (
        (always_true, episode()),
        (formula, episode(gap=[])),
        (formula, episode(gap=[1.0])),
        (formula, episode(gap=[np.nan, 1.0])),
        ("always (proposal.hallucinated < 1)", episode()),
        (formula, episode()),
        (formula, episode()),  # the same once more
    ):
        judge_episode(Requirement("R"), judged_by_both(one, engine), check)
    counts = engine.counts()
    assert counts.pop("version")
    assert counts == {
        "engine": "rtamt",
        "compared": 1,
        "not_compared": {
            "a signal is not finite at the first sample": 1,
            "the check is a function": 1,
            "the component gives no account of its proposals": 1,
            "the episode has no samples": 1,
            "the trace has a single sample": 1,
        },
    }


def test_what_rtamt_fails_on_is_counted_too(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = SecondEngine()

    def fails(*_: object) -> list[float]:
        raise RecursionError

    monkeypatch.setattr(engine, "robustness", fails)
    judge_episode(Requirement("R", check="always (gap > 0)"), judged_by_both(episode(), engine))
    assert list(engine.results.values()) == ["rtamt cannot evaluate it (RecursionError)"]


def test_without_rtamt_both_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtamt", None)
    with pytest.raises(ConfigurationError, match="dura_stl_engine") as raised:
        SecondEngine()
    assert "below 3.13" in str(raised.value)
