"""The paper's figures as the benchmark quotes them, and the picture that it draws."""

from __future__ import annotations

import importlib
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def paper_table(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield importlib.import_module("paper_table")
    for name in ("paper_table", "machine"):
        sys.modules.pop(name, None)


def outcomes(module: Any, clearance: float | None, number: int = 2) -> list[Any]:
    return [
        module.Outcome(
            flagged=bool(i), collided=False, struck=False, rescued=False, uncomfortable=bool(i),
            clearance=None if clearance is None else clearance + i, alerts=0, valid=True,
            reactions={"frozen": 1},
        )
        for i in range(number)
    ]  # fmt: skip


def arms(module: Any, times: dict[str, float | None]) -> Any:
    runs = {
        (scenario, attacked, policy, number): one
        for scenario, clearance in times.items()
        for attacked in (True, False)
        for policy in module.POLICIES
        for number, one in enumerate(outcomes(module, clearance))
    }
    return module.Arms(runs, 2)


def test_the_paper_s_rates_come_out_of_its_counts(paper_table: Any) -> None:
    rates = {
        name.rpartition("/")[2]: tuple(
            f"{100 * count / one.runs:.1f}" for count in (one.flagged, one.collided)
        )
        for name, one in paper_table.PAPER.items()
    }
    assert rates == {
        "nominal": ("6.7", "0.0"),
        "congested": ("20.0", "6.7"),
        "conflicting-traffic": ("33.3", "13.3"),
        "ghost-obstacle": ("86.7", "6.7"),
        "trajectory-spoofing": ("60.0", "20.0"),
        "pedestrian-crossing": ("26.7", "6.7"),
    }
    overall = paper_table.PAPER_OVERALL
    assert f"{100 * overall.flagged / overall.runs:.1f}" == "38.9"
    assert f"{100 * overall.collided / overall.runs:.1f}" == "8.9"


def test_every_scenario_of_the_paper_is_here_and_in_its_order(paper_table: Any) -> None:
    scenarios = paper_table.load_library([]).scenarios
    by_default = [one for one in scenarios.values() if not one.on_request]
    placed = sorted(by_default, key=lambda one: one.order)
    assert [one.name for one in placed] == list(paper_table.PAPER)


def test_the_paper_stands_beside_the_rows_that_have_an_equal(paper_table: Any) -> None:
    both = ["intersection/nominal", "intersection/ghost-obstacle"]
    made = arms(paper_table, dict.fromkeys(both, 10.0))
    printed = paper_table.paper_table(made, both, both[1:]).splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in printed]
    assert [(row[0].rpartition("/")[2], row[1], row[2], row[4]) for row in rows] == [
        ("nominal", "no", "yes", "6.7"),
        ("nominal", "no", "no", ""),
        ("ghost-obstacle", "yes", "yes", "86.7"),
        ("ghost-obstacle", "yes", "no", ""),
        ("ghost-obstacle", "no", "yes", ""),
        ("ghost-obstacle", "no", "no", ""),
        ("overall", "as listed", "yes", "38.9"),
        ("overall", "as listed", "no", ""),
    ]
    assert rows[0][3] == "50.0"
    assert rows[0][14] == "0/0/2/0"


def test_the_distance_from_the_paper_is_that_of_rates_and_means(paper_table: Any) -> None:
    made = arms(paper_table, {"intersection/nominal": 10.0})
    row = paper_table.against_paper(made, ["intersection/nominal"]).splitlines()[2]
    assert "| +43.3 |" in row
    assert row.endswith("| +5.1 |")


def test_the_figure_is_svg_and_names_who_never_cleared(paper_table: Any) -> None:
    scenarios = ["intersection/nominal", "intersection/congested"]
    made = arms(paper_table, {scenarios[0]: 10.0, scenarios[1]: None})
    drawn = paper_table.clearance_figure({"a<b": made}, scenarios, 2)
    texts = [one.text for one in ET.fromstring(drawn).iter() if one.tag.endswith("text")]
    assert {"nominal", "congested", "paper (n = 15)", "a<b (n = 2)", "5.4", "10.5"} <= set(texts)
    assert texts.count("nobody cleared") == 1
