"""Where an episode leaves its fault-free twin, and which fault answers for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from handmade import handmade

from pytest_dura import Episode
from pytest_dura.core import Divergence, FaultRecord
from pytest_dura.core.episode import Propagation


def episode(proposals: str, failure: str | None = None) -> Episode:
    """One letter per proposal, at 0.0 s, 0.1 s, ..."""
    decisions = {"proposed": np.array(list(proposals), dtype=np.str_)}
    return handmade(len(proposals) + 1, decisions=decisions, failure=failure)


def again(one: Episode) -> Callable[[], Episode]:
    return lambda: one


def fault(manifested_at: float | None) -> FaultRecord:
    return FaultRecord("f", "lidar", manifested_at=manifested_at)


@pytest.mark.parametrize(
    "faulty, twin, at",
    [
        ("gggg", "gggg", None),
        ("ggsg", "gggg", 0.2),
        ("sggg", "gggg", 0.0),
        ("ggs", "gggg", 0.2),
        ("g gg", "gggg", 0.1),  # no proposal at all is another proposal
    ],
)
def test_the_first_proposal_that_differs(faulty: str, twin: str, at: float | None) -> None:
    found = Divergence.of(episode(faulty), episode(twin), again(episode(twin)))
    assert found == Divergence(at)


@pytest.mark.parametrize(
    "faulty, twin, until",
    [("gg", "gggg", 0.1), ("gggg", "ggg", 0.2), ("ggggs", "gggg", 0.3), ("", "g", -np.inf)],
)
def test_what_one_of_them_no_longer_proposes_is_no_other_proposal(
    faulty: str, twin: str, until: float
) -> None:
    found = Divergence.of(episode(faulty), episode(twin), again(episode(twin)))
    assert found == Divergence(until=pytest.approx(until))


def test_a_fault_that_manifested_where_there_is_nothing_to_compare_is_not_contained() -> None:
    found = Divergence.of(episode("gggg"), episode("gg"), again(episode("gg")))
    assert found.of_fault(fault(0.1)) == Propagation("contained")
    late = found.of_fault(fault(0.2))
    assert late is not None
    assert (late.status, late.reason) == (
        "unknown",
        "one of the runs has no proposal after 0.10 s to compare",
    )


def test_the_second_twin_is_run_only_where_the_first_one_differs() -> None:
    def never() -> Episode:
        raise AssertionError("asked for")

    assert Divergence.of(episode("gg"), episode("gg"), never) == Divergence()


@pytest.mark.parametrize(
    "second, at, doubt",
    [
        ("gggg", 0.2, ""),
        ("gggs", 0.2, ""),  # they part later
        ("ggag", None, "two runs without faults differ from 0.20 s on"),
        ("aggg", None, "two runs without faults differ from 0.00 s on"),
    ],
)
def test_twins_that_differ_by_then_say_nothing(second: str, at: float | None, doubt: str) -> None:
    found = Divergence.of(episode("ggss"), episode("gggg"), again(episode(second)))
    assert found == Divergence(at, doubt)


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_missing_run_says_nothing(missing: int) -> None:
    runs = [episode("gs"), episode("gg"), episode("gg")]
    runs[missing] = replace(runs[missing], failure="infrastructure: x")
    found = Divergence.of(runs[0], runs[1], again(runs[2]))
    assert found == Divergence(doubt="case#0 is missing")


def test_what_had_manifested_by_then_answers_for_it() -> None:
    found = Divergence(0.5)
    assert found.of_fault(fault(None)) is None
    assert found.of_fault(fault(0.3)) == Propagation("propagated", 0.5)
    assert found.of_fault(fault(0.5)) == Propagation("propagated", 0.5)
    later = found.of_fault(fault(0.6))
    assert later is not None
    assert (later.status, later.at) == ("unknown", None)
    assert "from 0.50 s on, through another fault" in later.reason


def test_no_difference_contains_a_fault_and_a_doubt_hides_it() -> None:
    assert Divergence().of_fault(fault(0.3)) == Propagation("contained")
    assert Divergence(doubt="d").of_fault(fault(0.3)) == Propagation("unknown", None, "d")
