"""The one way to draw: what is written is well-formed, whatever the texts are."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
from jinja2 import Environment

from pytest_dura.reports.svg import NAMESPACE, Scale, document, joined, path_of, tag

HOSTILE = """</text><script>alert("1")</script> & ' " --> ]]>"""


def test_texts_and_attributes_are_escaped_and_elements_are_not():
    group = tag("g", tag("title", HOSTILE), HOSTILE, class_=HOSTILE, data_id=HOSTILE)
    root = ET.fromstring(document(10, 20, group))
    (read,) = root
    assert (read.get("class"), read.get("data-id")) == (HOSTILE, HOSTILE)
    assert read[0].text == read[0].tail == HOSTILE
    assert [one.tag for one in root.iter()] == [
        f"{{{NAMESPACE}}}{n}" for n in ("svg", "g", "title")
    ]


def test_joining_keeps_the_difference_between_texts_and_elements():
    assert joined(["a<b", tag("br")], "\n") == "a&lt;b\n<br/>"
    plain = tag("br") + tag("br")
    assert type(plain) is str  # sums of elements are texts again, and are escaped
    assert tag("g", plain) == "<g>&lt;br/&gt;&lt;br/&gt;</g>"


def test_a_template_escapes_texts_and_leaves_elements():
    template = Environment(autoescape=True).from_string("{{ element }}{{ text }}")
    assert template.render(element=tag("b", "<"), text="<i>") == "<b>&lt;</b>&lt;i&gt;"


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
