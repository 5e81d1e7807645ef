"""Tests of the causes with which every report begins."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from session_records import CASES, REQUIREMENTS, episode, session_data, session_record, verdict

from pytest_dura.evidence import SessionRecord
from pytest_dura.reports import causes_of
from pytest_dura.reports.cards import cause_card

CLEAR, GHOST, UNAIDED = CASES


def event(kind, time, subject="monitor", detail=""):
    return {
        "tick": round(10 * time), "time": time, "kind": kind, "subject": subject,
        "detail": detail, "data": {},
    }  # fmt: skip


def counterexample(run, time, margin=-1.0, case=CLEAR, *, valid=True):
    return {"episode": f"{case}#{run}", "time": time, "margin": margin, "valid": valid}


def violated(requirement, *counterexamples, case=CLEAR, **changes):
    judged = verdict(requirement, case, ("violated",) * len(counterexamples))
    return judged | {"verdict": "violated", "counterexamples": list(counterexamples)} | changes


def record_of(verdicts, episodes, **changes):
    return session_record(
        verdicts=verdicts,
        episodes=episodes,
        cases=changes.pop("cases", session_data()["cases"]),
        gate={"result": "failed", "exit_code": 1, "warn_undecided": False, "failed": 1,
              "reasons": changes.pop("reasons", [])},
        **changes,
    )  # fmt: skip


def crash(time, detail="the ego ran into WALL"):
    return [event("collision", time, "WALL", detail), event("critical", time, "simulator", detail)]


def test_all_that_an_episode_violates_is_one_cause_with_its_gravest_requirement_first():
    record = record_of(
        [
            violated("PERF-1", counterexample(0, 2.0)),
            violated("SAF-1", counterexample(0, 1.5, -0.2)),
        ],
        [episode(CLEAR, 0, events=crash(1.5), termination="critical")],
    )

    (cause,) = causes_of(record)

    assert [each.id for each in cause.requirements] == ["SAF-1", "PERF-1"]
    assert cause.requirements[0].text == REQUIREMENTS["SAF-1"].text
    assert (cause.status, cause.kind, cause.case) == ("violated", "safety", CLEAR)
    assert (cause.episode, cause.time) == (f"{CLEAR}#0", 1.5)
    assert cause.happened == "At t = 1.50 s the ego ran into WALL."
    assert cause.findings[0].check == REQUIREMENTS["SAF-1"].check
    assert "-0.2" in cause.findings[0].amount


def test_runs_with_the_same_event_share_a_cause_and_those_with_another_have_their_own():
    times = (1.5, 1.2, 1.1)
    record = record_of(
        [violated("SAF-1", *(counterexample(run, time) for run, time in enumerate(times)))],
        [
            episode(CLEAR, 0, events=crash(1.5)),
            episode(CLEAR, 1, events=crash(1.2)),
            episode(CLEAR, 2, events=[event("recovery", 1.0, "brake", "monitor: too near")]),
        ],
    )

    causes = causes_of(record)

    members = {frozenset((cause.episode, *cause.more)) for cause in causes}
    assert members == {frozenset({f"{CLEAR}#0", f"{CLEAR}#1"}), frozenset({f"{CLEAR}#2"})}


def test_what_the_end_of_a_violating_run_leaves_undecided_has_the_same_cause():
    record = record_of(
        [
            violated("SAF-1", counterexample(0, 1.5)),
            verdict("PERF-1", CLEAR, ("open", "satisfied")),
        ],
        [episode(CLEAR, 0, events=crash(1.5), termination="critical"), episode(CLEAR, 1)],
    )

    (cause,) = causes_of(record)

    assert [each.verdict.verdict for each in cause.findings] == ["violated", "undecided"]
    assert [each.requirement.id for each in cause.findings] == ["SAF-1", "PERF-1"]
    assert len(cause.verdicts) == 2


def test_a_component_that_raises_in_each_run_is_the_cause_and_not_that_all_are_equal():
    raised = event(
        "component_failure", 0.0, "C", "raised ValueError: no (planner.py:12 in propose)"
    )
    record = record_of(
        [
            verdict("SAF-1", CLEAR, ("satisfied",) * 3)
            | {"verdict": "undecided", "situation": "repeated"},
            violated("PERF-1", counterexample(0, 2.0)),
        ],
        [episode(CLEAR, run, events=[raised]) for run in range(3)],
    )

    (cause,) = causes_of(record)

    assert cause.happened.startswith(
        "At t = 0.00 s C raised ValueError: no (planner.py:12 in propose)"
    )
    assert cause.happened.endswith(", in 3 of 3 runs.")
    assert cause.next_step.startswith("Repair C first, at planner.py:12 in propose")
    assert {each.requirement for each in cause.verdicts} == {"SAF-1", "PERF-1"}


def test_a_seed_that_violates_in_two_cases_with_the_same_event_is_one_cause():
    record = record_of(
        [
            violated("SAF-1", counterexample(0, 1.5)),
            violated("SAF-1", counterexample(0, 1.5, case=GHOST), case=GHOST),
        ],
        [episode(CLEAR, 0, events=crash(1.5)), episode(GHOST, 0, events=crash(1.5))],
    )

    (cause,) = causes_of(record)

    assert {cause.episode, *cause.more} == {f"{CLEAR}#0", f"{GHOST}#0"}
    assert set(cause.cases) == {CLEAR, GHOST}
    (episode_entry,) = (each for each in cause_card(cause).entries if each.label == "episode")
    assert episode_entry.text == f"{cause.episode}; also {cause.more[0]}"


def test_an_event_after_the_violation_is_not_its_cause():
    record = record_of(
        [violated("PERF-1", counterexample(0, 1.0))],
        [episode(CLEAR, 0, events=[event("unsafe", 0.5, "monitor", "too near"), *crash(1.9)])],
    )

    (cause,) = causes_of(record)

    assert cause.happened.startswith("At t = 0.50 s monitor found the proposal unsafe: too near")
    # No unit is declared.
    missed = "gap is -1 where more than 0 is required, first at t = 1.00 s"
    assert cause.findings[0].amount == missed
    assert "WALL" not in cause.happened


def test_safety_comes_before_performance_violated_before_undecided_and_waived_last():
    waiver = {"kind": "xfail", "reason": "known"}
    record = record_of(
        [
            verdict("SEC-1", CLEAR, ("satisfied",) * 2, planned=4),
            violated("SAF-1", counterexample(0, 1.0), waiver=waiver),
            violated("PERF-1", counterexample(0, 1.0, case=GHOST), case=GHOST),
            violated("SAF-1", counterexample(1, 1.0, case=GHOST), case=GHOST),
        ],
        [episode(CLEAR, 0), episode(GHOST, 0, seed=7), episode(GHOST, 1)],
    )

    causes = causes_of(record)

    assert [(each.status, each.kind, each.waived) for each in causes] == [
        ("violated", "safety", False), ("violated", "performance", False),
        ("undecided", "security", False), ("violated", "safety", True),
    ]  # fmt: skip


def test_the_fault_is_cleared_where_the_same_seed_violates_without_it():
    of_ghost = episode(GHOST, 0, events=crash(1.5))
    fault = of_ghost["faults"][0] | {"violated": ["SAF-1"], "violated_without": ["SAF-1"]}
    record = record_of(
        [violated("SAF-1", counterexample(0, 1.5, case=GHOST), case=GHOST)],
        [
            of_ghost | {"faults": [fault]},
            episode(CLEAR, 0, events=crash(1.7), termination="critical"),
        ],
    )

    (cause,) = causes_of(record)

    (twin,) = cause.twins
    assert (twin.without, twin.episode, twin.violates) == ("faults", f"{CLEAR}#0", True)
    assert "violates it as well" in twin.sentence
    assert "at t = 1.70 s the ego ran into WALL" in twin.sentence
    assert "without the fault as well: look at C, not at the fault" in cause.next_step


def test_the_fault_stays_under_suspicion_where_its_twin_is_clean():
    of_ghost = episode(GHOST, 0, events=crash(1.5))
    fault = of_ghost["faults"][0] | {"violated": ["SAF-1"], "violated_without": []}
    record = record_of(
        [violated("SAF-1", counterexample(0, 1.5, case=GHOST), case=GHOST)],
        [of_ghost | {"faults": [fault]}, episode(CLEAR, 0)],
    )

    (cause,) = causes_of(record)

    (twin,) = cause.twins
    assert twin.violates is False
    assert "does not violate it (SAF-1)" in twin.sentence
    assert "reached its goal at t = 2.00 s" in twin.sentence
    assert "the fault ghost changed what generator read from t = 0.60 s on" in cause.happened
    assert "security_assessor detected ghost at t = 0.70 s" in cause.next_step


def test_the_run_without_recovery_says_what_recovery_was_worth():
    unaided = next(case for case in session_data()["cases"] if case["id"] == CLEAR) | {
        "id": UNAIDED, "without": ["recovery_planner"],
    }  # fmt: skip
    record = record_of(
        [violated("SAF-1", counterexample(0, 1.5))],
        [
            episode(CLEAR, 0, events=[event("recovery", 1.0, "brake", "monitor: too near")]),
            episode(UNAIDED, 0),
        ],
        cases=[*session_data()["cases"], unaided],
    )

    (cause,) = causes_of(record)

    assert [(twin.without, twin.episode) for twin in cause.twins] == [
        ("recovery_planner", f"{UNAIDED}#0")
    ]
    assert "run without it came to nothing grave" in cause.next_step


def test_verdicts_that_more_runs_would_decide_are_one_cause_with_the_number_of_runs():
    record = record_of(
        [
            verdict("SEC-1", CLEAR, ("satisfied", "satisfied", "satisfied")),
            verdict("SEC-1", GHOST, ("satisfied", "satisfied", "violated")),
        ],
        [episode(GHOST, 2)],
    )

    (cause,) = causes_of(record)

    assert cause.status == "undecided"
    assert len(cause.verdicts) == 2
    assert cause.case == GHOST  # the worse of the two
    assert "1 of 3 violates SEC-1" in cause.happened
    plan = re.search(r"seed of (\d+) runs, which may hold (\d+) violations", cause.next_step)
    runs, allowed = map(int, plan.groups())
    assert runs > 3
    again = verdict("SEC-1", GHOST, ("violated",) * allowed + ("satisfied",) * (runs - allowed))
    assert again["verdict"] == "supported"


def test_more_violations_than_are_allowed_are_said_before_any_plan():
    record = record_of(
        [verdict("SEC-1", GHOST, ("satisfied", "violated", "violated"))],
        [episode(GHOST, 1), episode(GHOST, 2)],
    )
    (cause,) = causes_of(record)
    assert cause.happened.startswith("More runs violate it than are allowed, too few to be sure: 2")
    assert cause.next_step.startswith("Mend what violates it: at the observed rate of 66.7 %")
    assert "succeeds with probability" in cause.next_step


def test_a_missing_run_names_role_and_message():
    record = record_of(
        [verdict("SAF-1", CLEAR, ("satisfied", "missing"))],
        [episode(CLEAR, 0), episode(CLEAR, 1, validity="missing")],
    )

    (cause,) = causes_of(record)

    detail = record.head.verdicts[0].first_uncounted.detail.removeprefix("infrastructure: ")
    assert detail
    assert detail in cause.happened
    assert cause.episode == f"{CLEAR}#1"


def test_a_killed_session_is_a_cause_by_itself():
    (cause,) = causes_of(record_of([], [], status="running"))

    assert cause.status == "incomplete"
    assert "was killed after" in cause.happened
    assert "--dura-resume" in cause.next_step


def test_an_objection_beside_the_verdicts_is_a_cause():
    reason = "not repeatable: a/clear#0 (C): run again in this session it came out differently"
    (cause,) = causes_of(record_of([], [], reasons=[reason]))

    assert cause.status == "incomplete"
    assert "came out differently" in cause.happened


def test_a_session_without_failures_reads_no_episode():
    def refuse():
        raise AssertionError("the episodes were read")

    passed = session_record(
        verdicts=[verdict("SAF-1", CLEAR, ("satisfied", "satisfied"))],
        gate={"result": "passed", "exit_code": 0, "warn_undecided": False, "failed": 0,
              "reasons": []},
    )  # fmt: skip
    assert causes_of(SessionRecord(passed.head, passed.directory, refuse)) == []


@pytest.mark.parametrize("runs", [5000])
def test_thousands_of_violating_runs_are_one_cause_read_in_one_pass(runs):
    whole = record_of(
        [violated("SAF-1", *(counterexample(run, 1.5) for run in range(3)))],
        [episode(CLEAR, run, events=crash(1.5)) for run in range(3)],
    )
    (known,) = whole.head.verdicts
    (first, *_) = known.counterexamples
    many = replace(
        known,
        counterexamples=tuple(replace(first, episode=f"{CLEAR}#{run}") for run in range(runs)),
    )
    entry = next(whole.episodes())
    passes = []

    def read():
        passes.append(None)
        for run in range(runs):
            yield entry.replace(id=f"{CLEAR}#{run}", seed=run)

    record = SessionRecord(whole.head.replace(verdicts=[many]), whole.directory, read)
    (cause,) = causes_of(record)

    assert len(cause.more) == runs - 1
    assert len(passes) == 1
