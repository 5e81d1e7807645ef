"""The figures that the design notes and the README rest on come out of the benchmark."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pytest_dura.requirements import FixedN


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    import sequential_cost

    yield sequential_cost
    for name in ("sequential_cost", "machine"):
        sys.modules.pop(name, None)


def test_the_fixed_design_of_both_levels(script) -> None:
    assert script.fixed_design() == (181, 4)


def test_the_clean_runs_of_each_method(script) -> None:
    rows = script.clean_table(FixedN(0.05, 0.95, 181)).splitlines()[2:]
    assert [row.split("|")[2].strip() for row in rows] == ["59", "177", "72", "74"]


def test_a_hopeless_component_is_rejected_soon(script) -> None:
    rows = script.hopeless_table(FixedN(0.05, 0.95, 181), 4, budget=400).splitlines()[2:]
    always = {row.split("|")[1].strip(): row.split("|")[4].strip() for row in rows}
    assert always == {
        "fixed 181, stopped when hopeless": "5.0 (5)",
        "fixed 181, until violated": "15.0 (15)",
        "SPRT against 0.01": "2.0 (2)",
        "e-process": "2.0 (2)",
    }
