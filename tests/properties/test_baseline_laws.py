"""Laws of the comparison with a baseline: what is compared, and how surely anything changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from baseline_records import record, verdict
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.evidence import SessionRecord, claims_of, compare_claims
from pytest_dura.evidence.baseline import BaselineComparison

lawful = settings(derandomize=True, deadline=None, max_examples=8)
RUNS = 12
LEVEL = 0.05


def compared(new: dict[str, Any], old: dict[str, Any]) -> list[BaselineComparison]:
    return compare_claims(*(claims_of(SessionRecord.of(data, Path())) for data in (new, old)))


def sessions(violations: list[int]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A session that violates so many runs, case by case, and a baseline that violates none."""
    names = [f"a/case{number:02d}" for number in range(len(violations))]
    new = [
        verdict(RUNS, range(many), case=name) for name, many in zip(names, violations, strict=True)
    ]
    return record(*new), record(*(verdict(RUNS, case=name) for name in names))


def holm(p_values: list[float]) -> list[float]:
    """Holm's adjusted p-values, from their definition."""
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    steps = [min(1.0, (len(p_values) - k) * p_values[i]) for k, i in enumerate(order)]
    return [max(steps[: order.index(i) + 1]) for i in range(len(p_values))]


@lawful
@given(st.lists(st.integers(0, RUNS), min_size=1, max_size=12))
def test_every_word_holds_for_all_comparisons_of_the_session_together(
    violations: list[int],
) -> None:
    adjusted = holm([0.5**many for many in violations])
    for turned in (False, True):
        new, old = sessions(violations)
        comparisons = compared(*((old, new) if turned else (new, old)))
        expected = ["worse" if p <= LEVEL else "no evidence of a change" for p in adjusted]
        if turned:
            expected = ["better" if status == "worse" else status for status in expected]
        assert [comparison.status for comparison in comparisons] == expected
        p_values = [
            comparison.p_better_holm if turned else comparison.p_worse_holm
            for comparison in comparisons
        ]
        assert p_values == pytest.approx(adjusted)


@lawful
@given(st.integers(5, RUNS), st.integers(0, 9))
def test_more_comparisons_never_make_a_word_surer(violations: int, others: int) -> None:
    few, many = (compared(*sessions([violations, *[0] * more])) for more in (others, others + 1))
    assert few[0].uncorrected == many[0].uncorrected == "worse"
    assert few[0].p_worse_holm <= many[0].p_worse_holm
    assert (few[0].status == "worse") == (0.5**violations * (others + 1) <= LEVEL)


INCOMPLETE: dict[str, dict[str, Any]] = {
    "fewer runs than planned": {"planned": RUNS + 1},
    "ended early": {"planned": RUNS + 3, "saved": 3},
    "no valid episode": {"episodes": 0, "violations": 0, "counterexamples": []},
    "too many invalid": {"episodes": RUNS - 3, "invalid": 3},
    "a sequential test": {"method": "e-process"},
    "another check": {"check": "gap > 1"},
}


@pytest.mark.parametrize("keys", INCOMPLETE.values(), ids=list(INCOMPLETE))
def test_what_did_not_run_as_planned_is_never_called_better_or_worse(keys: dict[str, Any]) -> None:
    for violating, other in ((range(9), range(0)), (range(0), range(RUNS))):
        spoilt, whole = verdict(RUNS, violating, **keys), verdict(RUNS, other)
        for new, old in ((spoilt, whole), (whole, spoilt)):
            (comparison,) = compared(record(new), record(old))
            assert (comparison.status, comparison.test) == ("no comparison", None)
            assert comparison.reason


def test_what_the_outcome_kept_from_a_comparison_still_counts_as_one() -> None:
    five = verdict(RUNS, range(5))
    for count in range(3):
        names = [f"a/spoilt{number}" for number in range(count)]
        spoilt = [verdict(RUNS, case=name, planned=RUNS + 1) for name in names]
        whole = [verdict(RUNS, case=name) for name in names]
        comparisons = compared(record(five, *spoilt), record(verdict(RUNS), *whole))
        assert comparisons[0].p_worse_holm == pytest.approx((count + 1) * 0.5**5)
        assert (comparisons[0].status == "worse") == (count == 0)
