"""The one way to draw: what is written is well-formed, whatever the texts are."""

from __future__ import annotations

import pytest

from pytest_dura.reports.svg import Scale, document, path_of, tag


def test_numbers_have_one_decimal_and_nothing_is_left_out_but_none():
    assert tag("rect", x=1 / 3, y=2, rx=0, width=None) == '<rect x="0.3" y="2" rx="0"/>'
    assert 'viewBox="0 0 3 4" width="3"' in document(3, 4)
    assert " width" not in document(3, 4, width=None)


def test_a_path_breaks_where_there_is_no_place():
    points = [(0.0, 1.0), (1.0, float("nan")), (2.0, 3.0), (3.0, 4.0), (float("inf"), 5.0)]
    assert path_of(points) == "M0.0 1.0M2.0 3.0L3.0 4.0"


@pytest.mark.parametrize(
    "low, high",
    [(0.0, 0.3), (0.0, 1.0), (-1.0, 0.0), (-26.0, 10.0), (7.2, 7.3), (5.0, 5.0), (0.0, 0.0),
     (-3.0, -3.0), (-1e100, 1e100), (0.0, 3600.0)],
)  # fmt: skip
def test_a_scale_between_numbers_has_few_ticks_around_them(low, high):
    scale = Scale.between(low, high, 5.0, 105.0)
    assert scale.ticks[0] <= low + 1e-9 * abs(low)
    assert scale.ticks[-1] >= high - 1e-9 * abs(high)
    assert 2 <= len(scale.ticks) <= 13
    assert (scale(scale.low), scale(scale.high)) == (5.0, pytest.approx(105.0))
