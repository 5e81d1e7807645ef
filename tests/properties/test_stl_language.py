"""Laws of the full language: writing and reading, and margins that agree with verdicts."""

from __future__ import annotations

import math

from formulas import FINITE, formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st
from stl_oracle import robustness, satisfaction

from pytest_dura import ConfigurationError
from pytest_dura.requirements import Formula, Signal, check_time_step, parse
from pytest_dura.requirements.stl.formula import walk

STEP = 0.1
NAMES = ("gap", "percept.gap", "F", "s", "prev", "true")
PIECES = [
    *("always", "eventually[0:2]", "until", "since[1:2]", "G", "F", "U", "S", "X", "not", "and"),
    *("or", "implies", "iff", "a", "b", "s", "percept.gap", "1", "2.5", "-3", "500ms", "(", "("),
    *(")", ")", "[", "]", ":", ",", ">", "<=", "==", "-", "+", "*", "/", "pow(", "abs("),
]


@settings(derandomize=True, deadline=None, max_examples=250)
@given(formulas(NAMES, time_step=STEP, max_leaves=8, numbers=FINITE))
def test_what_is_written_reads_back_as_the_same_formula(formula: Formula) -> None:
    again = parse(str(formula), NAMES)
    assert again == formula
    assert str(again) == str(formula)
    assert again.horizon == formula.horizon
    for node in walk(again.root):
        if isinstance(node, Signal):
            assert again.text.startswith(node.name, node.position)
    for name, position in again.future_operators:
        assert again.text.startswith(name.replace("strong_", "s_"), position)
    check_time_step(again, STEP)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(formulas(NAMES, time_step=STEP, max_leaves=8), traces(NAMES))
def test_the_sign_of_the_robustness_is_the_verdict(
    formula: Formula, trace: dict[str, list[float]]
) -> None:
    margins = robustness(formula.root, trace, STEP)
    for margin, holds in zip(margins, satisfaction(formula.root, trace, STEP), strict=True):
        assert not math.isnan(margin)
        assert margin >= 0 if holds else margin <= 0


@settings(derandomize=True, deadline=None, max_examples=400)
@given(st.text(max_size=40) | st.lists(st.sampled_from(PIECES), max_size=14).map(" ".join))
def test_any_text_is_a_formula_or_one_clear_error(text: str) -> None:
    try:
        formula = parse(text)
    except ConfigurationError as error:
        line, caret = error.problem.splitlines()[1:]
        assert caret.strip() == "^"
        assert len(caret) <= len(text) + 5
        assert len(line) == len(text) + 4
    else:
        assert parse(str(formula)) == formula
