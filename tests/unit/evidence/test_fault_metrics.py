"""How far the faults of a case got: counts, rates' denominators and latencies."""

from __future__ import annotations

from typing import Any

from entries import make
from pens import table_lines

from pytest_dura.core import FaultRecord
from pytest_dura.core.codec import encode
from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.conclusions.faults import TRACED, FaultMetrics, with_chains
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.reports.cards import chain_line
from pytest_dura.reports.session_tables import fault_table


def fault_metrics(episodes):
    metrics = FaultMetrics()
    for one in episodes:
        metrics.add(make(EpisodeEntry, **one))
    return [encode(entry) for entry in metrics.entries()]


def road_free(faults):
    return make(CaseEntry, id="road/free", component="C", metrics={"faults": faults})


def told(**fields: Any) -> dict[str, Any]:
    chain = {key: fields.pop(key) for key in list(fields) if key in TRACED}
    return encode(FaultRecord("f", "lidar", **fields).traced(**chain))


def metrics(*faults: dict[str, Any]) -> dict[str, Any]:
    (found,) = fault_metrics([{"faults": [one]} for one in faults])
    return found


IDLE = told()
MASKED = told(activated_at=1.0, outcome="masked")
CONTAINED = told(
    activated_at=1.0, manifested_at=1.5, propagation="contained", outcome="contained",
    detected_at=2.5,
)  # fmt: skip
SPREAD = told(
    activated_at=1.0, manifested_at=1.0, propagation="propagated", propagated_at=1.2,
    detected_at=1.5, recovery_at=2.0, recovered_at=2.3, outcome="violated",
)  # fmt: skip
UNKNOWN = told(activated_at=1.0, manifested_at=1.0, propagation="unknown", outcome="tolerated")


def test_each_step_is_counted_over_those_that_could_take_it() -> None:
    found = metrics(IDLE, MASKED, CONTAINED, SPREAD, UNKNOWN)
    keys = (
        "run", "activated", "manifested", "followed", "propagated", "detected", "recovery",
        "recovered", "violated",
    )  # fmt: skip
    assert [found[key] for key in keys] == [5, 4, 3, 2, 1, 2, 1, 1, 1]
    assert found["rates"] == {
        "activation": 4 / 5,
        "manifestation": 3 / 5,
        "propagation": 1 / 2,
        "detection": 2 / 3,
        "recovery": 1.0,
    }
    assert metrics(IDLE)["rates"]["propagation"] is None


def test_latencies_run_from_activation_to_alert_and_from_manifestation_to_recovery() -> None:
    found = metrics(CONTAINED, SPREAD)
    assert found["detection_latency"] == {"median": 1.0, "max": 1.5}
    assert found["recovery_latency"] == {"median": 1.0, "max": 1.0}
    assert abs(found["time_to_recover"]["median"] - 0.3) < 1e-9
    assert metrics(IDLE)["detection_latency"] is None


def test_an_alert_without_a_manifestation_is_none_of_the_fault() -> None:
    assert metrics({**MASKED, "detected_at": 1.0})["detected"] == 0


def test_faults_of_a_case_are_told_apart_in_declared_order() -> None:
    other = {**IDLE, "id": "g"}
    found = fault_metrics([{"faults": [SPREAD, other]}, {"faults": [SPREAD, other]}])
    assert [(one["id"], one["run"]) for one in found] == [("f", 2), ("g", 2)]
    assert fault_metrics([{"faults": []}]) == []


def test_what_no_verdict_followed_is_unknown() -> None:
    bare = encode(FaultRecord("f", "lidar").traced())
    plain = {"id": "road/free#0", "faults": [bare]}
    assert with_chains(plain, {}) == plain
    (fault,) = with_chains(plain, {"f": SPREAD})["faults"]
    assert fault["manifested_at"] is None, "the loop's own record stays"
    assert fault["propagated_at"] == 1.2


def test_the_table_shows_a_dash_for_what_is_not_known() -> None:
    case = road_free([metrics(UNKNOWN)])
    row = table_lines(fault_table([case]))[1].removeprefix("f on road/free").split()
    assert row == ["1", "1", "1", "-", "0", "-", "0", "-", "0"]
    part = road_free([metrics(UNKNOWN, SPREAD)])
    assert table_lines(fault_table([part]))[1].removeprefix("f on road/free").split()[3] == "1/1"
    assert table_lines(fault_table([road_free([])])) == []


def test_a_violation_that_nobody_asked_for_is_no_zero() -> None:
    unasked = told(activated_at=1.0, manifested_at=1.0)
    missing = told(activated_at=1.0, outcome="missing")
    assert metrics(unasked)["judged"] == metrics(missing)["judged"] == 0
    assert metrics(unasked, SPREAD, CONTAINED)["judged"] == 2

    def last(*faults: dict[str, Any]) -> str:
        case = road_free([metrics(*faults)])
        return table_lines(fault_table([case]))[1].split()[-1]

    assert [last(unasked), last(missing), last(CONTAINED)] == ["-", "-", "0"]
    assert [last(unasked, SPREAD, CONTAINED), last(SPREAD, CONTAINED)] == ["1/2", "1"]


def test_what_is_violated_without_the_fault_as_well_is_not_its_doing() -> None:
    shared = {**SPREAD, "outcome": "violated also without it"}
    found = metrics(shared, SPREAD, CONTAINED)
    assert (found["judged"], found["violated"], found["violated_without"]) == (3, 1, 1)
    case = road_free([found])
    assert table_lines(fault_table([case]))[1].split()[-1] == "1+1"
    case = road_free([metrics(shared)])
    assert table_lines(fault_table([case]))[1].split()[-1] == "0+1"
    assert chain_line(make(TracedFault, **shared)).endswith(
        "recovered 2.30 s, violated also without it"
    )


def test_the_chain_in_words() -> None:
    fault = {**SPREAD, "detected_by": "security_assessor", "pattern": "p", "recovery": "brake"}
    assert chain_line(make(TracedFault, **fault)) == (
        "f: activated 1.00 s, manifested 1.00 s, propagated 1.20 s, detected 1.50 s "
        "(security_assessor: p), recovery 2.00 s (brake), recovered 2.30 s, violated"
    )
    assert chain_line(make(TracedFault, **IDLE)) == "f: never active"
