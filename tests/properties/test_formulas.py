"""Laws of formulas: reading and writing, a brute-force evaluator, and rtamt as a reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import ConfigurationError
from pytest_dura.requirements.bounds import evaluate, parse
from pytest_dura.requirements.formula import Formula, Term

STEP = 0.1
NAMES = ("gap", "speed", "percept.gap")
relaxed = settings(deadline=None)
finite = st.floats(allow_nan=False, allow_infinity=False)
# Few distinct values, so that samples often lie on the bound.
values = st.integers(-3, 3).map(float) | st.floats(-100, 100)


@st.composite
def terms(draw: st.DrawFn, bounds: Any = values, last: int = 30, step: float = STEP) -> Term:
    operator = draw(st.sampled_from(["always", "eventually"]))
    signal, comparison = draw(st.sampled_from(NAMES)), draw(st.sampled_from([">", ">=", "<", "<="]))
    if draw(st.booleans()):
        return Term(operator, signal, comparison, draw(bounds))
    first, second = sorted((draw(st.integers(0, last)), draw(st.integers(0, last))))
    return Term(operator, signal, comparison, draw(bounds), first * step, second * step)


def formulas(**options: Any) -> st.SearchStrategy[Formula]:
    return st.lists(terms(**options), min_size=1, max_size=3).map(tuple).map(Formula)


@st.composite
def traces(draw: st.DrawFn, min_size: int = 1) -> tuple[list[float], dict[str, list[float]]]:
    size = draw(st.integers(min_size, 40))
    column = st.lists(values, min_size=size, max_size=size)
    return [i * STEP for i in range(size)], {name: draw(column) for name in NAMES}


def brute(term: Term, trace: dict[str, list[float]], ticks: int) -> tuple[str, float, float]:
    """Status and robustness interval, sample by sample, on whole numbers of steps."""
    first, last = 0, ticks - 1
    if term.end is not None:
        first, last = round(term.start / STEP), round(term.end / STEP)
    upward = term.comparison in (">", ">=")
    verdicts, margins = [], []
    for i in range(first, min(last, ticks - 1) + 1):
        x = trace[term.signal][i]
        margins.append(x - term.bound if upward else term.bound - x)
        verdicts.append(
            {
                ">": x > term.bound,
                ">=": x >= term.bound,
                "<": x < term.bound,
                "<=": x <= term.bound,
            }[term.comparison]
        )
    open_end = last > ticks - 1
    if term.operator == "always":
        low, high = min(margins, default=math.inf), min(margins, default=math.inf)
        low = -math.inf if open_end else low
        status = "undecided" if open_end else "satisfied"
        return ("violated" if False in verdicts else status), low, high
    low, high = max(margins, default=-math.inf), max(margins, default=-math.inf)
    high = math.inf if open_end else high
    status = "undecided" if open_end else "violated"
    return ("satisfied" if True in verdicts else status), low, high


def worst(statuses: Sequence[str]) -> str:
    return next(word for word in ("violated", "undecided", "satisfied") if word in statuses)


@relaxed
@given(formulas(bounds=finite))
def test_what_is_written_reads_back_as_the_same_formula(formula: Formula) -> None:
    assert parse(str(formula), NAMES) == formula


@relaxed
@given(formulas(), traces())
def test_the_evaluator_equals_brute_force(formula: Formula, trace: Any) -> None:
    time, signals = trace
    found = evaluate(formula, time, signals)
    parts = [brute(term, signals, len(time)) for term in formula.terms]
    assert found.status == worst([status for status, _, _ in parts])
    assert found.lower == min(low for _, low, _ in parts)
    assert found.upper == min(high for _, _, high in parts)
    if found.status == "satisfied":
        assert found.margin >= 0
    if found.status == "violated":
        assert found.margin <= 0
        assert found.time in time


@relaxed
@given(formulas(), traces(min_size=2), st.data())
def test_what_a_prefix_decides_the_whole_trace_confirms(
    formula: Formula, trace: Any, data: st.DataObject
) -> None:
    time, signals = trace
    size = data.draw(st.integers(1, len(time)))
    prefix = {name: column[:size] for name, column in signals.items()}
    early = evaluate(formula, time[:size], prefix, complete=False)
    late = evaluate(formula, time, signals)
    if early.status != "undecided":
        assert late.status == early.status
    assert early.lower <= late.lower
    assert late.upper <= early.upper


@relaxed
@given(terms(), traces())
def test_the_negation_has_the_negated_robustness(term: Term, trace: Any) -> None:
    time, signals = trace
    other = {"always": "eventually", "eventually": "always"}
    flipped = {">": "<=", ">=": "<", "<": ">=", "<=": ">"}
    negated = Term(
        other[term.operator],  # type: ignore[arg-type]
        term.signal, flipped[term.comparison], term.bound, term.start, term.end,
    )  # fmt: skip
    one = evaluate(Formula((term,)), time, signals)
    two = evaluate(Formula((negated,)), time, signals)
    assert (one.lower, one.upper) == (-two.upper, -two.lower)
    opposite = {"satisfied": "violated", "violated": "satisfied", "undecided": "undecided"}
    assert two.status == opposite[one.status]


@settings(max_examples=30, deadline=None)
@given(formulas(last=9, step=1.0), traces(min_size=10))
@pytest.mark.filterwarnings("ignore:typing.io is deprecated:DeprecationWarning")
def test_rtamt_reads_the_same_formula_and_gives_the_same_robustness(
    formula: Formula, trace: Any
) -> None:
    import rtamt

    seconds = range(len(trace[0]))
    signals = trace[1]
    names = {name: name.replace(".", "_") for name in NAMES}
    text = str(formula)
    for name, plain in names.items():
        text = text.replace(f"({name} ", f"({plain} ")
    specification = rtamt.StlDiscreteTimeSpecification()
    for plain in ("out", *names.values()):
        specification.declare_var(plain, "float")
    specification.spec = f"out = {text}"
    specification.parse()
    columns = {plain: signals[name] for name, plain in names.items()}
    reference = specification.evaluate({"time": list(seconds), **columns})
    assert evaluate(formula, seconds, signals).margin == reference[0][1]


@relaxed
@given(st.text(max_size=60) | st.text("always()[]:><=and gp.019-+ \n", max_size=60))
def test_any_text_is_a_formula_or_one_clear_error(text: str) -> None:
    try:
        formula = parse(text)
    except ConfigurationError as error:
        caret = error.problem.splitlines()[-1]
        assert caret.strip() == "^"
        assert len(caret) <= len(text) + 5
    else:
        assert parse(str(formula)) == formula
