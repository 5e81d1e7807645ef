from __future__ import annotations

import numpy as np
import pytest

from pytest_dura.core import Recording
from pytest_dura.evidence import Trace
from pytest_dura.reports import decision_at, loop_steps, signals_csv


def event(tick, kind, subject, detail=""):
    return {"tick": tick, "time": tick / 10, "kind": kind, "subject": subject, "detail": detail}


def trace(ticks=4, **changes):
    told = {
        "about": {"termination": "violation", "failure": None},
        "time": np.arange(ticks) / 10,
        "signals": {"gap": np.array([4.0, 3.0, 1.0, 0.0])[:ticks],
                    "percept.gap": np.array([4.0, 9.0, 9.0, 9.0])[:ticks],
                    "=speed": np.zeros(ticks)},
        "decisions": {
            "verdict": np.array([0, 1, 2])[: ticks - 1],
            "source": np.array(["proposal", "proposal", "recovery"])[: ticks - 1],
            "proposed": np.array(["FASTER"] * 3)[: ticks - 1],
            "executed": np.array(["FASTER", "FASTER", "BRAKE"])[: ticks - 1],
            "attempts": np.array([0, 0, 2])[: ticks - 1],
        },
        "events": [
            event(1, "fault_manifested", "ghost"), event(2, "unsafe", "safety_monitor", "near"),
            event(2, "alert", "V1", "from nowhere"), event(2, "goal_missed", "ego"),
        ],
        "recording": Recording(
            explanations=("", "clear road", "<b>" + "x" * 9999),
            reasons=("", "", "too near"),
            recoveries=("", "", "brake: hard"),
            flags={"safety_monitor": np.array([0, 1, 2]), "oracle": np.array([-1, -1, -1])},
        ),
    }  # fmt: skip
    return Trace(**(told | changes))


def test_the_six_steps_of_a_tick():
    steps = loop_steps(trace(), 2, ["gap", "unheard_of"])
    assert [one.name for one in steps] == [
        "Update: t = 0.20 s",
        "Propose: FASTER",
        "Assess: unsafe",
        "Decide: brake: hard",
        "Act: BRAKE",
        "Log: t = 0.30 s",
    ]
    update, propose, assess, decide, act, log = [dict(one.details) for one in steps]
    assert update == {"gap": "1", "percept.gap": "9"}
    assert propose.keys() == {"explanation"}
    assert propose["explanation"].startswith("<b>xxx")
    assert propose["explanation"].endswith("(10002 characters)")
    assert assess == {
        "safety_monitor": "unsafe",
        "oracle": "not asked",
        "reasons": "too near",
        "unsafe": "safety_monitor: near",
        "alert": "V1: from nowhere",
    }
    assert decide == {"source": "recovery", "recovery": "brake: hard", "attempts": "2"}
    assert act == {"gap then": "0"}
    assert log == {"goal_missed": "ego", "termination": "violation"}


def test_a_tick_in_the_middle_of_an_episode():
    steps = loop_steps(trace(), 1, ["gap"])
    assert steps[0].details == {"gap": "3", "percept.gap": "9", "fault_manifested": "ghost"}
    assert steps[3].name == "Decide: proposal"
    assert steps[5].details == {}


def test_an_episode_that_was_not_recorded_tells_its_decisions():
    steps = loop_steps(trace(recording=Recording()), 2, [])
    assert steps[1].details == {}
    assert steps[3].name == "Decide: recovery"


@pytest.mark.parametrize("time, tick", [(0.1, 1), (0.3, 2), (9.0, 2), (None, 2), (np.nan, 2)])
def test_the_decision_that_a_time_belongs_to(time, tick):
    assert decision_at(trace(), time) == tick


def test_an_episode_without_a_decision_has_no_steps():
    assert decision_at(trace(1), 0.0) is None


def test_the_table_has_a_row_for_each_tick():
    assert signals_csv(trace()).splitlines() == [
        "time,'=speed,gap,percept.gap",
        "0.0,0.0,4.0,4.0",
        "0.1,0.0,3.0,9.0",
        "0.2,0.0,1.0,9.0",
        "0.3,0.0,0.0,9.0",
    ]


def test_the_table_of_a_long_episode_is_bounded():
    rows = signals_csv(trace(), cells=8).splitlines()
    assert [row.partition(",")[0] for row in rows] == ["time", "0.0", "0.2"]
