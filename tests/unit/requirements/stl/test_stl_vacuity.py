"""Formulas that are satisfied because the conditions of their implications never held."""

from __future__ import annotations

import pytest
from stl_judging import judge


@pytest.mark.parametrize(
    "text, x, y, vacuous",
    [
        ("always ((x > 5) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("always ((x > 2) implies (y > 0))", [1, 2, 3], [1, 1, 1], False),
        ("always ((x >= 3) implies (y > 0))", [1, 2, 3], [1, 1, 1], False),
        ("always ((x > 3) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("(x > 1) implies (y > 0)", [1, 2, 3], [1, 1, 1], True),
        ("always[0:1] ((x > 2) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("always[1:2] ((x < 2) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("always[0:1] (always[0:1] ((x > 2) implies (y > 0)))", [1, 2, 3], [1, 1, 1], False),
        ("always[0:1] (historically[1:1] ((x > 1) implies (y > 0)))", [3, 2, 3], [1, 1, 1], False),
        ("eventually[2:2] (once[1:1] ((x > 2) implies (y > 0)))", [3, 2, 3], [1, 1, 1], True),
        ("eventually[2:2] (historically ((x > 2) implies (y > 0)))", [3, 2, 1], [1, 1, 1], False),
        ("always[2:2] (historically[1:2] ((x > 2) implies (y > 0)))", [3, 2, 1], [1, 1, 1], False),
        ("always ((x > 5) implies (y > 0)) and always (y > 0)", [1, 2, 3], [1, 1, 1], False),
        (
            "always ((x > 5) implies (y > 0)) and always ((y < 0) implies (x > 0))",
            [1, 2, 3],
            [1, 1, 1],
            True,
        ),
        ("((x > 5) implies (y > 0)) or (y < 0)", [1, 2, 3], [1, 1, 1], True),
        ("((x > 5) implies (y > 0)) or (y > 0)", [1, 2, 3], [1, 1, 1], False),
        ("(y < 0) or ((x > 5) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("always ((x > 0) implies ((x > 5) implies (y > 0)))", [1, 2, 3], [1, 1, 1], True),
        ("always ((x > 0) implies ((x > 2) implies (y > 0)))", [1, 2, 3], [1, 1, 1], False),
        # The same with one condition and with two, of which each holds, but not together.
        ("always (((x > 2) and (y < 0)) implies (x < 0))", [1, 2, 3], [-1, 1, 1], True),
        ("always ((x > 2) implies ((y < 0) implies (x < 0)))", [1, 2, 3], [-1, 1, 1], True),
        ("always ((x > 2) implies ((y < 0) implies (x > 0)))", [1, 2, 3], [1, 1, -1], False),
        (
            "always ((x > 2) implies (eventually[0:1] ((y < 0) implies (x < 0))))",
            [3, 2, 1, 0],
            [1, 1, -1, 1],
            True,
        ),
        (
            "always ((x > 2) implies (always[0:1] ((y < 0) implies (x > 0))))",
            [3, 2, 1, 0],
            [1, -1, 1, 1],
            False,
        ),
        (
            "always ((x > 2) implies (once ((y < 0) implies (x > 0))))",
            [1, 2, 3, 1],
            [1, 1, 1, -1],
            True,
        ),
        (
            "always ((x > 2) implies (historically ((y < 0) implies (x > 0))))",
            [1, 2, 3, 1],
            [1, -1, 1, 1],
            False,
        ),
        (
            "always ((x > 2) implies (always ((y < 0) implies (x > 0))))",
            [1, 2, 3, 1],
            [1, -1, 1, 1],
            True,
        ),
        ("not ((y < 0) implies (y < 0)) or (x > 0)", [1, 2, 3], [1, 1, 1], False),
        ("(x > 0) until ((x > 5) implies (y > 0))", [1, 2, 3], [1, 1, 1], False),
        # Whether x stays above 2 is not known at the last sample: it did not hold there.
        ("always ((always[0:1] (x > 2)) implies (y > 0))", [1, 2, 3], [1, 1, 1], True),
        ("always ((always[0:1] (x > 2)) implies (y > 0))", [1, 3, 3], [1, 1, 1], False),
        ("always (x > 0)", [1, 2, 3], [1, 1, 1], False),
    ],
)
def test_a_verdict_that_rests_on_conditions_that_never_held(
    text: str, x: list[float], y: list[float], vacuous: bool
) -> None:
    found = judge(text, x=x, y=y)
    assert (found.status, found.vacuous) == ("satisfied", vacuous)


def test_only_a_satisfied_formula_is_vacuous() -> None:
    assert not judge("always[0:9] ((x > 5) implies (x < 0))", x=[1, 2]).vacuous
    assert not judge("always ((x > 5) implies (x < 0)) and always (x < 0)", x=[1, 2]).vacuous


def test_a_condition_that_a_prefix_leaves_open_has_not_held() -> None:
    text = "(always (x > 0)) implies (y > 0)"
    assert not judge(text, x=[1, 2], y=[1, 1]).vacuous
    assert judge(text, x=[1, 2], y=[1, 1], ending="open").vacuous
