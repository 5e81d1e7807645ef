"""The reference page of the catalogue."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pytest_dura.domains import DOMAINS
from pytest_dura.driving import FAULT_TARGETS
from pytest_dura.faults import Activation
from pytest_dura.library.fault_reference import PAGE, reference_page, write_page

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def page() -> str:
    return reference_page(FAULT_TARGETS)


def test_the_committed_page_is_up_to_date(page: str) -> None:
    committed = (DOCS / PAGE).read_text("utf-8")
    assert committed == page, "run `python -m pytest_dura.library.fault_reference`"


def test_every_description_says_something_and_ranges_and_defaults_stand_there(page: str) -> None:
    assert (
        "| `noise` | `sigma` | number ≥ 0 | 0.5 | 0 to 5, neutral 0 | Standard deviation of each"
        " distribution, in the field's unit. |" in page
    )
    assert (
        "| `noise` | `distribution` | `gaussian`, `uniform`, `laplace` | “gaussian” | each |"
        in page
    )
    assert "| `out-of-range` | `low` | number | required | as it is |" in page
    assert (
        "| `patch` | `colour` | 3 of whole number ≥ 0, ≤ 255 | `[255, 0, 255]` | as it is |" in page
    )
    assert "|  |" not in page, "no cell is empty"


def test_every_row_has_as_many_cells_as_its_table_s_head(page: str) -> None:
    tables = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    assert len(tables) > 10
    for table in tables:
        rows = table.splitlines()
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
        assert len(rows) > 2


def test_activation_duration_targets_and_conditions_are_described(page: str) -> None:
    for title in ("Targets", "Activation", "Duration", "Conditions"):
        assert f"\n## {title}\n" in page
    for key, field in Activation.model_fields.items():
        assert f"| `{key}` |" in page
        assert field.description is not None
        assert field.description in page
    for key in ("`{min, max}`", "`{until, at_most}`", "`{on, off, lasting}`", "abs(channel.field)"):
        assert key in page


def test_without_a_domain_there_are_the_types_own_defaults_alone() -> None:
    page = reference_page()
    assert "odometry" not in re.sub(r"## Targets.*", "", page, flags=re.DOTALL)
    assert "| `object-miss` | a list of objects | `lidar` |" in page


def test_writing_is_reproducible(tmp_path: Path) -> None:
    write_page(tmp_path / "docs" / "a", DOMAINS["driving"].fault_targets)
    write_page(tmp_path / "docs" / "b", DOMAINS["driving"].fault_targets)
    assert (tmp_path / "docs" / "a").read_bytes() == (tmp_path / "docs" / "b").read_bytes()
