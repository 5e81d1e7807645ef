from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from pytest_dura.reports import Panel, signal_plot
from pytest_dura.reports.episode_view import POINTS

SVG = "{http://www.w3.org/2000/svg}"


def parsed(svg):
    return ET.fromstring(svg)


def points(path):
    return [tuple(map(float, one)) for one in re.findall(r"[ML](\S+?) ([-\d.]+)", path.get("d"))]


def plot(*columns, mark=None, bound=None, title="t"):
    time = np.arange(len(columns[0])) * 0.1
    curves = {f"c{index}": np.asarray(one, float) for index, one in enumerate(columns)}
    panels = [Panel("gap", curves, bound)] if columns else []
    return parsed(signal_plot(title, "what is seen", time, panels, mark))


def test_it_is_readable_without_seeing_it():
    root = plot([1.0, 2.0], title="corridor#0")
    assert root.get("role") == "img"
    names = {one.get("id"): one.text for one in root if one.get("id")}
    assert [names[one] for one in root.get("aria-labelledby").split()] == [
        "corridor#0",
        "what is seen",
    ]


def test_greater_values_are_higher_and_later_ones_further_right():
    (path,) = plot([0.0, 4.0, 2.0]).iter(f"{SVG}path")
    (x0, y0), (x1, y1), (x2, y2) = points(path)
    assert x0 < x1 < x2
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.1)
    assert y1 < y2 < y0
    assert y0 - y2 == pytest.approx(y2 - y1, abs=0.1)


def test_the_mark_stands_where_it_happened():
    root = plot([0.0, 4.0, 2.0], mark=(0.1, "SAF-1 violated"))
    (path,) = root.iter(f"{SVG}path")
    (line,) = [one for one in root.iter(f"{SVG}line") if one.get("class") == "mark"]
    assert float(line.get("x1")) == points(path)[1][0]
    assert "SAF-1 violated" in [one.text for one in root.iter(f"{SVG}text")]


def test_a_line_breaks_where_there_is_no_value():
    (path,) = plot([0.0, 1.0, np.nan, 1.0, np.inf, 3.0]).iter(f"{SVG}path")
    assert re.findall("[ML]", path.get("d")) == ["M", "L", "M", "M"]


def test_a_long_curve_is_thinned_and_keeps_its_extremes():
    column = np.zeros(100_000)
    column[54_321] = -7.0
    (path,) = plot(column).iter(f"{SVG}path")
    found = points(path)
    assert len(found) <= POINTS
    lowest = max(found, key=lambda point: point[1])
    assert lowest[0] == pytest.approx(64 + 640 * 0.54321, abs=1.5)


@pytest.mark.parametrize(
    "column",
    [[], [3.0], [np.nan] * 3, [1e308, -1e308], [5.0, 5.0]],
    ids=["empty", "one", "nothing", "huge", "constant"],
)
def test_odd_columns_give_a_plot(column):
    root = plot(column, bound=0.0, mark=(0.0, "here"))
    assert "nan" not in ET.tostring(root, "unicode")
    assert "inf" not in ET.tostring(root, "unicode")
