"""A formula that no signal can make false is refused, and a refused one holds on every trace."""

from __future__ import annotations

from collections import Counter
from typing import get_args

import pytest
from formulas import formulas, traces
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import ConfigurationError
from pytest_dura.requirements import Ending, Formula, Temporal, evaluate, node_text, read_formula

REFUSAL = "holds whatever the signals are"
HOLDS = [
    "always (gap >= gap)",
    "always (gap * 0 >= 0)",
    "always (0 * gap <= 0.5)",
    "always (gap - gap == 0)",
    "always (2 * x - x - x <= 0)",
    "always (x + 1 > x)",
    "always (abs(x) >= 0)",
    "always (exp(x) >= -1)",
    "always (x * x >= 0)",
    "always (pow(x - y, 2) >= 2 * x * y - x * x - y * y or abs(y) >= 0)",
    "always ((gap > 0) or (gap <= 0))",
    "always ((gap > -1) or (gap < 1))",
    "always ((x > 1) implies (x > 0))",
    "always ((x > y) iff (y < x))",
    "eventually (gap == gap)",
    "not eventually (x < x)",
    "(x < 1) until (y >= y)",
    "(always (x > 0)) or not (always (x > 0))",
    "always (once (x >= x))",
]
FAILS = [
    "always (gap > 0)",
    "always (gap >= 0)",
    "always (x >= y)",
    "always ((gap > 0) or (gap < 0))",
    "always ((x > 0) implies (x > 1))",
    "always (abs(x) > 0)",
    "always (x * y >= 0)",
    "always (x * x + y >= 0)",
    "always (x / x >= 1)",
    "always (pow(x, 3) >= 0)",
    "always ((x > 0) implies eventually[0:2] (x <= 0))",
    "always (rise(x > 0) implies (y > 0))",
    "eventually[5:10] (x >= x)",  # the episode may end before the window
    "always (x >= x) and always (y > 0)",
]


@pytest.mark.parametrize("text", HOLDS)
def test_a_formula_that_no_signal_can_make_false_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=REFUSAL) as refused:
        read_formula(text)
    assert refused.value.expected == "a formula that an episode can violate"


@pytest.mark.parametrize("text", FAILS)
def test_a_formula_that_can_be_false_is_not_refused(text: str) -> None:
    assert read_formula(text)


def refused_as_certain(text: str) -> bool:
    try:
        read_formula(text)
    except ConfigurationError as error:
        return REFUSAL in error.problem
    return False


def test_no_trace_violates_a_refused_formula() -> None:
    """Few small whole numbers make comparisons that hold always, and samples that lie on bounds."""
    drawn: Counter[bool] = Counter()
    ranging = formulas(("a", "b"), max_leaves=3, numbers=st.integers(-1, 1).map(float))

    @settings(max_examples=600, derandomize=True, deadline=None)
    @given(ranging, st.lists(traces(("a", "b"), min_size=2), min_size=3, max_size=3))
    def check(formula: Formula, several: list[dict[str, list[float]]]) -> None:
        root = Temporal("always", formula.root)
        certain = refused_as_certain(node_text(root))
        drawn[certain] += 1
        for trace in several if certain else ():
            time = [float(tick) for tick in range(len(trace["a"]))]
            for ending in get_args(Ending):
                found = evaluate(Formula(root, node_text(root)), time, trace, ending=ending)
                assert found.status != "violated"

    check()
    assert min(drawn[True], drawn[False]) > 20
