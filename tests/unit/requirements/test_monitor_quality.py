"""Monitor quality: what the monitors said, and how that compares with what happened."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from loops import Says, doing, run_loop
from thermostat import Bias, Controller, HeatMonitor, JumpWatch, Overheater, SwitchOff

from pytest_dura import (
    Alert,
    Assessed,
    Assessment,
    ConfigurationError,
    Episode,
    Fault,
    Proposal,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.core.codec import decode, encode
from pytest_dura.requirements import (
    EpisodeVerdict,
    MonitorQuality,
    MonitorTimeline,
    Requirement,
    judge_alerts,
    judge_episode,
    judge_monitor,
    monitor_timeline,
)
from pytest_dura.requirements.monitoring.quality import Spread

BIAS = Fault("bias", "bias", "thermometer", {"at": 0.5}, 0.3)


def monitor_at(*ticks: int, asked: Any = None, again: Any = None) -> Any:
    """Unsafe at these ticks; asked at some only; what it says when a proposal was refined."""
    calls: list[int] = []

    def output(view: Any) -> Assessment:
        calls.append(view.index)
        ticks_now = ticks if again is None or calls.count(view.index) == 1 else again
        return Assessment(Assessed.UNSAFE if view.index in ticks_now else Assessed.SAFE, 0.0)

    declared = {"trigger": lambda _, view: view.index in asked} if asked is not None else {}
    return doing(SafetyMonitor, output, **declared)


def alerts_at(*ticks: int) -> Any:
    def output(view: Any) -> SecurityAssessment:
        alert = Alert("pattern", "subject", str(view.index))
        return SecurityAssessment(alerts=(alert,) if view.index in ticks else ())

    return doing(SecurityAssessor, output)


def heating(**loop: Any) -> Episode:
    return run_loop(Says(lambda view: Proposal(1.0)), **{"policy": "log_only", **loop})


def seconds(*stretches: tuple[int, int]) -> tuple[Any, ...]:
    return tuple(pytest.approx((first / 10, last / 10)) for first, last in stretches)


def test_each_monitor_has_its_own_alarms() -> None:
    found = monitor_timeline(
        heating(
            safety_monitor=monitor_at(2, 3, 4, 7),
            second=monitor_at(0, 9),
            third=monitor_at(),
            security_assessor=alerts_at(1, 2, 5),
        )
    )
    assert found.alarms["safety_monitor"] == seconds((2, 4), (7, 7))
    assert found.alarms["second"] == seconds((0, 0), (9, 10))  # nobody is asked at the last tick
    assert found.alarms["third"] == ()
    assert found.alarms["security_assessor"] == ()
    assert found.alerts == seconds((1, 2), (5, 5))
    assert found.intervention is None
    assert (found.duration, found.validity) == (1.0, "valid")


def test_an_alarm_stands_until_the_monitor_is_asked_again_and_takes_it_back() -> None:
    episode = heating(safety_monitor=monitor_at(2, 4, 5, 8, asked=(0, 2, 4, 6, 8)))
    assert monitor_timeline(episode).alarms["safety_monitor"] == seconds((2, 5), (8, 10))
    assert episode.metrics.flags == {"safety_monitor": [2, 4, 8]}


def test_an_alarm_that_nobody_asked_about_again_was_in_time() -> None:
    episode = heating(seconds=8.0, safety_monitor=monitor_at(2, asked=range(3)))
    too_hot = Requirement("R", check="always (temperature <= 30)")
    verdict = replace(judge_episode(too_hot, episode), verdict="violated", time=7.0)
    found = judge_monitor("safety_monitor", [(verdict, monitor_timeline(episode))])
    assert (found.true_positives, found.early, found.lead_times) == (1, 0, (5.0,))


def test_a_monitor_that_was_never_asked_has_no_entry_and_no_assessor_no_alerts() -> None:
    found = monitor_timeline(heating(safety_monitor=monitor_at(1, asked=()), second=monitor_at()))
    assert found.alarms == {"second": ()}
    assert found.alerts is None


def test_a_tick_counts_once_even_if_only_the_first_proposal_was_unsafe() -> None:
    episode = heating(
        policy="refine(2)", safety_monitor=monitor_at(3, 6, again=(6,)), second=monitor_at()
    )
    assert episode.metrics.flags == {"safety_monitor": [3, 6]}
    assert monitor_timeline(episode).intervention == "a proposal was refined"


def test_two_assessors_are_watched_together() -> None:
    episode = heating(security_assessor=alerts_at(1, 6), other_assessor=alerts_at(1, 2, 3))
    assert episode.metrics.alert_ticks == {"security_assessor": [1, 6], "other_assessor": [1, 2, 3]}
    assert monitor_timeline(episode).alerts == seconds((1, 3), (6, 6))


def test_flags_and_alerts_enter_the_digest() -> None:
    episode = heating(safety_monitor=monitor_at(2), security_assessor=alerts_at(3))
    measured = episode.metrics.deterministic()
    assert measured["flags"] == {"safety_monitor": [2]}
    assert measured["alert_ticks"] == {"security_assessor": [3]}


def test_a_watch_is_plain_data_that_reads_back_equal() -> None:
    for assessor in ({}, {"security_assessor": alerts_at(1)}):
        found = monitor_timeline(heating(safety_monitor=monitor_at(2, 3), **assessor))
        assert decode(MonitorTimeline, json.loads(json.dumps(encode(found)))) == found


def verdict(word: Any, run: int, time: float | None = None, **fields: Any) -> EpisodeVerdict:
    plain = {
        "requirement": "R", "episode": f"case#{run}", "component": "Planner", "verdict": word,
        "margin": None, "time": time, "detail": "", "proposals": 10, "valid_proposals": 10,
    }  # fmt: skip
    return EpisodeVerdict(**{**plain, **fields})


def seen(run: int, *alarms: tuple[float, float], **fields: Any) -> MonitorTimeline:
    plain = {
        "episode": f"case#{run}", "component": "Planner", "validity": "valid", "duration": 36.0,
        "alarms": {"monitor": alarms}, "alerts": (),
    }  # fmt: skip
    return MonitorTimeline(**{**plain, **fields})


def judge(*rows: Any, horizon: float = 5.0) -> MonitorQuality:
    """Rows of (word, time, alarms)."""
    judged = [
        (verdict(word, run, time), seen(run, *alarms))
        for run, (word, time, *alarms) in enumerate(rows)
    ]
    return judge_monitor("monitor", judged, horizon)


def counts(found: MonitorQuality) -> tuple[int, int, int, int]:
    return (
        found.true_positives, found.false_negatives, found.false_positives, found.true_negatives
    )  # fmt: skip


def test_each_episode_is_one_count() -> None:
    found = judge(
        ("violated", 10.0, (8.0, 8.5)),
        ("violated", 10.0, (6.0, 11.0)),
        ("violated", 10.0),
        ("satisfied", None, (1.0, 2.0), (4.0, 4.0)),
        ("satisfied", None),
        ("satisfied", None),
    )
    assert counts(found) == (2, 1, 1, 2)
    assert found.episodes == 6
    assert (found.precision, found.recall) == (2 / 3, 2 / 3)
    assert found.false_positive_rate == 1 / 3
    assert found.lead_times == (2.0, 4.0)
    assert found.horizon == 5.0


def test_false_alarms_are_counted_each_over_the_hours_without_a_violation() -> None:
    found = judge(
        ("satisfied", None, (1.0, 2.0), (4.0, 4.0)),
        ("satisfied", None),
        ("violated", 10.0, (1.0, 2.0), (9.0, 9.0)),
    )
    assert (found.false_alarms, found.hours) == (2, pytest.approx(72 / 3600))
    assert found.false_alarms_per_hour == pytest.approx(100.0)


@pytest.mark.parametrize("alarm, late", [((10.0, 12.0), 1), ((11.0, 11.0), 1), ((1.0, 4.9), 0)])
def test_an_alarm_outside_the_window_is_no_warning(alarm: Any, late: int) -> None:
    found = judge(("violated", 10.0, alarm))
    assert counts(found) == (0, 1, 0, 0)
    assert (found.late, found.early) == (late, 1 - late)
    assert found.recall == 0.0


@pytest.mark.parametrize(
    "alarms, lead",
    [
        ([(9.9, 9.9)], 0.1),
        ([(5.0, 5.0)], 5.0),
        ([(1.0, 5.0)], 5.0),  # stands at the window's beginning
        ([(1.0, 30.0)], 5.0),
        ([(1.0, 2.0), (7.0, 7.5), (9.0, 9.0)], 3.0),
        ([(9.0, 9.5), (10.0, 12.0)], 1.0),
    ],
)
def test_the_lead_time_is_to_the_first_alarm_in_the_window(alarms: Any, lead: float) -> None:
    found = judge(("violated", 10.0, *alarms))
    assert counts(found) == (1, 0, 0, 0)
    assert found.lead_times == pytest.approx((lead,))
    assert (found.late, found.early) == (0, 0)


def test_float_times_do_not_move_an_alarm_over_the_edge() -> None:
    violated_at = 7.3 + 1e-9
    assert counts(judge(("violated", violated_at, (7.3, 7.3)))) == (0, 1, 0, 0)
    assert counts(judge(("violated", violated_at, (2.3, 2.3)))) == (1, 0, 0, 0)


def test_the_horizon_decides_what_is_a_warning() -> None:
    row = ("violated", 10.0, (4.0, 6.0))
    assert judge(row, horizon=3.0).early == 1
    assert judge(row, horizon=4.5).lead_times == (4.5,)
    assert judge(row, horizon=9.0).lead_times == (6.0,)


def test_what_cannot_be_judged_is_counted_apart() -> None:
    found = judge(
        ("invalid", None, (1.0, 1.0)), ("missing", None), ("missing", None), ("violated", None)
    )
    assert (found.invalid, found.missing, found.untimed, found.episodes) == (1, 2, 1, 0)
    assert (found.precision, found.recall, found.false_alarms_per_hour) == (None, None, None)
    assert found.lead_time is None


def test_rates_and_times_follow_from_the_counts() -> None:
    rows = [("violated", 10.0, (10.0 - lead, 10.0)) for lead in (1.0, 4.0, 3.0)]
    found = judge(*rows, ("satisfied", None))
    assert found.lead_time == Spread(1.0, 3.0, 4.0)
    assert (found.case, found.episodes, found.horizon) == ("case", 4, 5.0)
    assert (found.precision, found.recall) == (1.0, 1.0)
    assert found.with_rates() == found


@pytest.mark.parametrize("horizon", [0.0, -1.0, float("inf"), float("nan")])
def test_a_horizon_is_a_positive_number(horizon: float) -> None:
    with pytest.raises(ConfigurationError, match="horizon"):
        judge(("satisfied", None), horizon=horizon)


@pytest.mark.parametrize(
    "loop, told",
    [
        ({"policy": "recover", "recovery_planner": SwitchOff()}, "recovery acted in room/test#0"),
        ({"policy": "halt"}, "halted"),
        ({"policy": "refine(1)"}, "refined"),
    ],
)
def test_a_monitor_on_whose_word_somebody_acted_is_not_judged(loop: Any, told: str) -> None:
    episode = heating(safety_monitor=monitor_at(4), security_assessor=alerts_at(), **loop)
    found = judge_episode(Requirement("R", check="always (temperature < 90)"), episode)
    with pytest.raises(ConfigurationError, match=told):
        judge_monitor("safety_monitor", [(found, monitor_timeline(episode))])
    with pytest.raises(ConfigurationError, match=told):
        judge_alerts([monitor_timeline(episode)])


def test_an_unknown_monitor_is_told_with_the_known_ones() -> None:
    with pytest.raises(ConfigurationError, match="one of monitor"):
        judge_monitor("monitr", [(verdict("satisfied", 0), seen(0))])


def test_a_monitor_may_be_silent_for_want_of_being_asked_in_some_episodes() -> None:
    judged = [
        (verdict("violated", 0, 5.0), seen(0, alarms={})),
        (verdict("satisfied", 1), seen(1)),
    ]
    assert counts(judge_monitor("monitor", judged)) == (0, 1, 0, 1)


def test_verdicts_belong_to_their_episodes_and_to_one_claim() -> None:
    with pytest.raises(ConfigurationError, match="about one episode"):
        judge_monitor("monitor", [(verdict("satisfied", 0), seen(1))])
    other = (verdict("satisfied", 1, requirement="Q"), seen(1))
    with pytest.raises(ConfigurationError, match="Q of Planner and R of Planner"):
        judge_monitor("monitor", [(verdict("satisfied", 0), seen(0)), other])
    with pytest.raises(ConfigurationError, match="no episodes"):
        judge_monitor("monitor", [])


def test_real_monitors_are_told_apart_by_their_quality() -> None:
    check = Requirement("R", check="always (temperature < 17.5)")
    judged = []
    for run, target in enumerate((90.0, 16.0, 90.0)):
        episode = run_loop(
            Controller(target),
            policy="log_only",
            seconds=2.0 if run < 2 else 0.2,
            safety_monitor=HeatMonitor(limit=16.5),
            late_monitor=HeatMonitor(limit=18.0),
            nervous_monitor=HeatMonitor(limit=10.0),
            spec={"seed": run},
        )
        judged.append((judge_episode(check, episode), monitor_timeline(episode)))
    assert [one.verdict for one, _ in judged] == ["violated", "satisfied", "satisfied"]
    good, late, nervous = (
        judge_monitor(name, judged)
        for name in ("safety_monitor", "late_monitor", "nervous_monitor")
    )
    assert counts(good) == (1, 0, 0, 2)
    assert 0.0 < good.lead_times[0] < judged[0][0].time
    assert (counts(late), late.late) == ((0, 1, 0, 2), 1)
    assert (counts(nervous), nervous.precision) == ((1, 0, 2, 0), 1 / 3)
    assert nervous.lead_times == (pytest.approx(judged[0][0].time),)
    assert nervous.false_alarms >= 2


def test_alerts_are_judged_by_whether_a_fault_manifested() -> None:
    def attacked(
        run: int, *alerts: tuple[float, float], detected_at: float | None = None
    ) -> MonitorTimeline:
        return seen(run, alerts=alerts, manifested_at=3.0, detected_at=detected_at)

    found = judge_alerts(
        [
            attacked(0, (3.5, 3.5), detected_at=3.5),
            attacked(1, (1.0, 1.0)),
            attacked(2, (9.0, 9.0)),
            attacked(3),
            seen(4, alerts=((1.0, 1.0), (5.0, 6.0))),
            seen(5),
            seen(6, validity="invalid"),
            seen(7, validity="missing", alerts=None),
            attacked(8, (2.0, 2.9)),
        ]
    )
    assert counts(found) == (1, 4, 1, 1)
    assert (found.early, found.late) == (2, 1)
    assert (found.invalid, found.missing) == (1, 1)
    assert (found.delays, found.lead_times, found.horizon) == ((0.5,), (), None)
    assert (found.monitor, found.target, found.false_alarms) == ("alerts", "faults", 2)
    assert found.delay == Spread(0.5, 0.5, 0.5)


def test_alerts_of_a_real_loop_with_and_without_a_fault() -> None:
    watches = [
        monitor_timeline(
            run_loop(
                Overheater(),
                policy="log_only",
                security_assessor=JumpWatch(),
                fault_injector=Bias(bias),
                spec={"faults": faults},
            )
        )
        for bias, faults in ((-10.0, (BIAS,)), (-1.0, (BIAS,)), (-10.0, ()))
    ]
    assert [one.manifested_at for one in watches] == [0.5, 0.5, None]
    found = judge_alerts(watches)
    assert counts(found) == (1, 1, 0, 1)
    assert found.delays == (0.0,)


def test_alerts_count_from_the_activation_on_where_the_component_reads_seldom() -> None:
    def reading_each_second(view: Any) -> Proposal:
        if view.index % 10 == 0:
            view.percept["thermometer"]
        return Proposal(0.0)

    watches = [
        monitor_timeline(
            run_loop(
                Says(reading_each_second),
                policy="log_only",
                seconds=2.0,
                security_assessor=JumpWatch(),
                fault_injector=Bias(),
                spec={"faults": (replace(BIAS, activation={"at": at}, duration=0.8),)},
            )
        )
        for at in (0.3, 0.6, 1.0)
    ]
    assert [one.manifested_at for one in watches] == pytest.approx([0.3, 0.6, 1.0])
    found = judge_alerts(watches)
    assert (found.recall, found.early) == (1.0, 0)
    assert found.delays == pytest.approx((0.0, 0.0, 0.0))


def test_silence_is_no_miss_where_nobody_could_speak() -> None:
    with pytest.raises(ConfigurationError, match=r"no assessor was asked in case#0"):
        judge_alerts([seen(0, alerts=None)])
