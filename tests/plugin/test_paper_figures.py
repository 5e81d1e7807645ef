"""The paper's figures beside those of a session that runs its scenarios."""

from __future__ import annotations

import pytest

from pytest_dura.driving.paper import PAPER
from pytest_dura.evidence import verify_bundle
from pytest_dura.library.loading import builtin_paths

(BUILTIN,) = builtin_paths()


@pytest.fixture(scope="module")
def built_in():
    assert BUILTIN.is_dir()
    return {f"intersection/{file.stem}" for file in (BUILTIN / "intersection").glob("*.yaml")}


def test_the_paper_is_that_of_the_six_scenarios_and_counts_its_own_percentages(built_in):
    assert set(PAPER) == built_in
    flagged, collided = (
        [round(100 * getattr(each, name) / each.runs, 1) for each in PAPER.values()]
        for name in ("flagged", "collided")
    )
    assert flagged == [6.7, 20.0, 33.3, 86.7, 60.0, 26.7]
    assert collided == [0.0, 6.7, 13.3, 6.7, 20.0, 6.7]


def test_page_and_summary_show_them_as_context_and_the_terminal_on_request(project):
    selected = ("--dura-scenarios=builtin", "--dura-select=intersection/[np]*", "--dura-runs=2")
    result = project.run(*selected)
    record = project.evidence()
    table = record.conclusions["paper"]
    assert [row[0] for row in table.rows] == ["nominal", "pedestrian-crossing"]
    names = [column.name for column in table.columns]
    for row in table.rows:
        cells = dict(zip(names, row, strict=True))
        case = f"intersection/{cells['scenario']}"
        runs = [each for each in record.episodes if each.case == case]
        flagged = sum(each.outcome.flagged for each in runs)
        assert cells["here: flag"].startswith(f"{100 * flagged / 2:.1f} (")
        assert cells["paper: flag"] == f"{100 * PAPER[case].flagged / 15:.1f}"
        stuck = sum(each.outcome.measures["gridlock"] for each in runs)
        assert cells["here: grid"] == f"{stuck} of 2"
    heading = "The paper's figures beside these"
    folder = project.path / "dura-evidence"
    assert heading in (folder / "summary.md").read_text()
    assert "another simulator, another model" in (folder / "report.html").read_text()
    assert heading not in result.stdout.str()
    assert verify_bundle(folder).problems == []
    assert heading in project.run(*selected, "-v").stdout.str()
