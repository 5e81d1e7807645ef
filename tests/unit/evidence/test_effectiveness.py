"""What the runs show of recovery and monitors by themselves, and where they cannot show it."""

from __future__ import annotations

from typing import Any

import pytest
from conclusions import concluded
from entries import make

from pytest_dura.evidence import Effectiveness
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.requirements.monitoring.quality import MonitorQuality

OWN, TWIN = "a/b", "a/b~recovery_planner"


def verdict(
    case: str = OWN, component: str = "C", without: str = "recovery_planner", **counts: Any
) -> ItemVerdict:
    names = ("only_with", "only_without", "both", "neither")
    table = {name: 0 for word in names for name in (word, f"acted_{word}")} | counts
    pairs = {"case": f"{case}~recovery_planner", "without": without, **table}
    return make(ItemVerdict, requirement="R", case=case, component=component, pairs=pairs)


def episode(case: str, run: int, *, acted: bool = False, jerk: float = 1.0) -> EpisodeEntry:
    return make(
        EpisodeEntry, case=case, component="C", spec={"run": run}, planned=True, validity="valid",
        outcome={"switching": {"takeovers": int(acted)}},
        metrics={"performance": {"jerk": {"last": 0.0, "min": -jerk, "max": jerk}}},
        timings={"simulated_seconds": 9.0},
    )  # fmt: skip


def monitor(
    target: str, *, tp: int = 0, fn: int = 0, fp: int = 0, tn: int = 0, name: str = "watch"
) -> MonitorQuality:
    return make(
        MonitorQuality, case=TWIN, component="C", monitor=name, target=target,
        true_positives=tp, false_negatives=fn, false_positives=fp, true_negatives=tn,
    )  # fmt: skip


def effectiveness(
    verdicts: Any = (), monitors: Any = (), episodes: Any = ()
) -> list[dict[str, Any]]:
    head = {"verdicts": verdicts, "monitors": monitors}
    return concluded(Effectiveness, episodes, **head)["effectiveness"]


def of_recovery(*verdicts: ItemVerdict, episodes: Any = ()) -> dict[str, Any]:
    (found,) = effectiveness(verdicts, episodes=episodes)
    assert (found["role"], found["requirement"], found["component"]) == (
        "recovery_planner", "R", "C",
    )  # fmt: skip
    return found


@pytest.mark.parametrize(
    "counts, finding, detail",
    [
        (
            {"neither": 90, "acted_neither": 2},
            "cannot be told",
            (
                "nothing to prevent: 0 violations of R without it, so prevented 0, futile 0, "
                "unavoidable 0; of 90 pairs, introduced 0 (0 to 4 %)"
            ),
        ),
        (
            {"only_with": 2, "neither": 3},
            "introduced",
            (
                "nothing to prevent: 0 violations of R without it, so prevented 0, futile 0, "
                "unavoidable 0; of 5 pairs, introduced 2 (5 to 85 %)"
            ),
        ),
        (
            {"both": 2, "acted_both": 2, "neither": 1},
            "prevented none",
            (
                "of 2 violations of R without it, prevented 0 (0 to 84 %), futile 2 (16 to 100 %); "
                "of the pairs without one (1), introduced 0 (0 to 98 %)"
            ),
        ),
        (
            {"both": 2, "neither": 1},
            "never acted",
            "acted in none of 2 violations of R without it in 3 pairs",
        ),
        (
            {"only_without": 3, "both": 1},
            "prevented",
            "of 4 violations of R without it, prevented 3 (19 to 99 %), futile 0 (0 to 60 %)",
        ),
        (
            {"only_without": 1, "only_with": 2},
            "prevented",
            (
                "of 1 violation of R without it, prevented 1 (2 to 100 %), futile 0 (0 to 98 %); "
                "of the pairs without one (2), introduced 2 (16 to 100 %)"
            ),
        ),
        (
            {"both": 1, "acted_both": 1, "only_with": 1},
            "introduced",
            (
                "of 1 violation of R without it, prevented 0 (0 to 98 %), futile 1 (2 to 100 %); "
                "of the pairs without one (1), introduced 1 (2 to 100 %)"
            ),
        ),
        ({}, "cannot be told", "no pair with and without it is complete for R"),
    ],
)
def test_what_pairs_show_of_recovery(counts: Any, finding: str, detail: str) -> None:
    found = of_recovery(verdict(**counts))
    assert (found["finding"], found["detail"]) == (finding, detail)


def test_what_a_reference_has_as_well_is_unavoidable_and_of_the_others_a_share_is_prevented() -> (
    None
):
    counts = {"only_without": 32, "both": 14, "acted_both": 14, "only_with": 1, "neither": 13}
    found = of_recovery(
        verdict(**counts, reference="Careful", reference_without=26, reference_both=14)
    )
    assert found["detail"] == (
        "of 46 violations of R without it, prevented 32 (54 to 82 %), futile 14 (18 to 46 %), "
        "unavoidable for Careful 26 (41 to 71 %); of the 20 avoidable, prevented 20 (83 to 100 %); "
        "of the pairs without one (14), introduced 1 (0 to 34 %)"
    )
    vain = of_recovery(verdict(both=2, acted_both=2, reference="Careful", reference_without=2))
    assert vain["detail"].endswith("unavoidable for Careful 2 (16 to 100 %)")


def test_the_pairs_of_all_cases_count_together_and_each_once() -> None:
    found = of_recovery(
        verdict("a/b", neither=4), verdict("c/d", only_without=1), verdict("c/d", only_without=1)
    )
    assert found["finding"] == "prevented"
    assert "of 1 violation of R without it, prevented 1" in found["detail"]
    assert "of the pairs without one (4)" in found["detail"]


def test_commands_that_changed_nothing_are_seen_in_the_runs_in_which_it_acted() -> None:
    runs = [episode(OWN, 0, acted=True), episode(TWIN, 0), episode(OWN, 1), episode(TWIN, 1)]
    found = of_recovery(verdict(both=1, acted_both=1, neither=1), episodes=runs)
    assert found["finding"] == "changed nothing"
    assert "the runs in which it acted (1) went as" in found["detail"]


def test_one_run_that_went_otherwise_is_enough() -> None:
    runs = [
        *(episode(OWN, run, acted=True, jerk=1.0 + run) for run in range(2)),
        *(episode(TWIN, run) for run in range(2)),
    ]
    found = of_recovery(verdict(both=2, acted_both=2), episodes=runs)
    assert found["finding"] == "prevented none"


def test_pairs_without_something_else_say_nothing_of_recovery() -> None:
    other = verdict(only_without=1, without="faults")
    assert effectiveness([other]) == []


@pytest.mark.parametrize(
    "told, finding, detail",
    [
        ([monitor("R", tn=3, fp=1)], "cannot be told", "(R)"),
        ([monitor("R", fn=2, tn=1)], "silent", "R 0 of 2"),
        ([monitor("R", fn=2, fp=1)], "warned of none", "R 0 of 2"),
        ([monitor("R", fn=1), monitor("R", tp=2)], "warned", "R 2 of 3"),
        ([monitor("S", tn=3), monitor("R", tp=2)], "warned", "warned in time of R 2 of 2"),
    ],
)
def test_what_runs_without_recovery_show_of_a_monitor(told: Any, finding: str, detail: str) -> None:
    (found,) = effectiveness([], told)
    assert (found["role"], found["requirement"]) == ("watch", None)
    assert found["finding"] == finding
    assert detail in found["detail"]


def test_an_assessor_that_speaks_by_alerts_alone_is_no_silent_monitor() -> None:
    told = [monitor("R", fn=2, name="security_assessor")]
    assert effectiveness([], told) == []
    told = [monitor("R", tp=2, name="security_assessor")]
    assert effectiveness([], told)[0]["finding"] == "warned"
