"""What is compared with a baseline, by which test, and what is not compared at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from baseline_records import record, spec, verdict

from pytest_dura import Fault
from pytest_dura.core.codec import encode
from pytest_dura.evidence import SessionRecord, claims_of, compare_claims


def compared(new, old):
    return compare_claims(*(claims_of(SessionRecord.of(one, Path())) for one in (new, old)))


def one_compared(new, old):
    (found,) = compared(new, old)
    return found


def test_equal_seeds_are_pairs():
    found = one_compared(record(verdict(10, {0, 1, 2, 3, 4, 9})), record(verdict(10, {9})))
    assert (found.status, found.test, found.only_now, found.only_baseline) == (
        "worse", "McNemar", 5, 0,
    )  # fmt: skip
    assert (found.p_worse, found.p_better) == (1 / 32, 1.0)
    assert (found.violations, found.episodes) == (6, 10)
    assert (found.baseline_violations, found.baseline_episodes) == (1, 10)


def test_the_other_way_round_is_better():
    found = one_compared(record(verdict(10)), record(verdict(10, range(5))))
    assert (found.status, found.p_better, found.only_baseline) == ("better", 1 / 32, 5)


def test_other_seeds_are_independent_campaigns():
    found = one_compared(record(verdict(3, range(3)), seed=1), record(verdict(3)))
    assert (found.status, found.test, found.p_worse) == ("worse", "Fisher", 0.05)
    assert found.only_now is None


def test_other_numbers_of_runs_are_compared_by_their_counts():
    found = one_compared(record(verdict(3, range(3))), record(verdict(40)))
    assert (found.status, found.test) == ("worse", "Fisher")


def test_an_invalid_run_leaves_no_pairs_since_its_number_is_unknown():
    spoilt = verdict(10, {0}, episodes=9, invalid=1)
    assert one_compared(record(spoilt), record(verdict(10))).test == "Fisher"


def test_runs_that_are_not_all_there_leave_no_pairs():
    cut = record(verdict(10, {0, 1}))
    assert one_compared(cut, record(verdict(10))).test == "McNemar"
    cut["judgements"][0]["runs"].pop()
    assert one_compared(cut, record(verdict(10))).test == "Fisher"


def test_pairs_are_told_by_the_lines_and_not_by_what_the_verdict_lists():
    listed = record(verdict(10, {0, 1}))
    listed["verdicts"][0]["counterexamples"] = []
    found = one_compared(listed, record(verdict(10, {0})))
    assert (found.test, found.only_now, found.only_baseline) == ("McNemar", 1, 0)


def test_episodes_by_hand_are_not_among_the_runs():
    new, old = record(verdict(3, {0})), record(verdict(3))
    by_hand = {**new["episodes"][0], "planned": False, "spec": spec(0, 99, wall=1.0)}
    new["episodes"].insert(0, by_hand)
    assert one_compared(new, old).test == "McNemar"


@pytest.mark.parametrize("seed", [0, 1], ids=["equal seeds", "other seeds"])
def test_the_words_have_the_requirements_own_confidence(seed):
    strict = verdict(10, range(5))
    strict["bound"] = {**strict["bound"], "confidence": 0.99}
    found = one_compared(record(strict, seed=seed), record(verdict(10)))
    assert (found.status, found.confidence) == ("no evidence of a change", 0.99)
    assert found.uncorrected == "no evidence of a change"
    assert found.p_worse <= 0.05


def test_the_component_may_differ():
    found = one_compared(record(verdict(10, range(5))), record(verdict(10, component="Old")))
    assert (found.component, found.baseline_component, found.status) == ("C", "Old", "worse")


def test_new_and_gone():
    new = record(verdict(3), verdict(3, requirement="N"))
    old = record(verdict(3), verdict(3, case="a/c"))
    words = {(one.requirement, one.case): one for one in compared(new, old)}
    assert words["N", "a/b"].status == "new"
    assert words["N", "a/b"].baseline_component is None
    assert words["R", "a/c"].status == "gone"
    assert words["R", "a/c"].component is None
    assert words["R", "a/b"].status == "no evidence of a change"
    assert [one.p_worse_holm for one in words.values()].count(None) == 2


def pairs_without(role):
    return {"without": role, "case": "a/b"}


@pytest.mark.parametrize("changes, reason", [
    ({"check": "gap > 1"}, "the check changed from 'gap > 0' to 'gap > 1'"),
    ({"pairs": pairs_without("faults")}, "the check changed from 'gap > 0' to 'gap > 0, pairs wi"),
    ({"check": "", "item": "t.py::f"}, "the check changed from 'gap > 0' to 'gap > 0 in t.py::f'"),
    ({"method": "e-process"}, "n depended on the outcome (e-process)"),
    ({"method": "sprt"}, "n depended on the outcome (sprt)"),
])  # fmt: skip
def test_another_question_is_no_comparison_and_no_test(changes, reason):
    found = one_compared(record(verdict(10, range(5), **changes)), record(verdict(10)))
    assert (found.status, found.test, found.p_worse) == ("no comparison", None, None)
    assert found.reason.startswith(reason)


def test_pairs_without_the_same_are_compared():
    new, old = (verdict(10, some, pairs=pairs_without("faults")) for some in (range(5), ()))
    assert one_compared(record(new), record(old)).status == "worse"
    other = verdict(10, pairs=pairs_without("recovery_planner"))
    assert one_compared(record(new), record(other)).status == "no comparison"


def test_another_bound_on_the_change_of_a_measure_is_another_question():
    def with_bound(value):
        paired = {"without": "faults", "measure": "m:f", "change_at_most": value}
        return record(verdict(10, check="", paired=paired, pairs=pairs_without("faults")))

    assert one_compared(with_bound(0.0), with_bound(0.0)).status == "no evidence of a change"
    assert "change_at_most 0.5" in one_compared(with_bound(0.0), with_bound(0.5)).reason
    assert "change_at_most 0.0" in one_compared(with_bound(0.0), with_bound(None)).reason


@pytest.mark.parametrize("changes, reason", [
    ({"saved": 5, "planned": 15}, "n depended on the outcome (5 of 15 runs {}saved)"),
    ({"planned": 12}, "only 10 of 12 planned runs {}were run"),
    ({"episodes": 0, "violations": 0, "counterexamples": []}, "no valid episodes {}"),
    ({"episodes": 7}, "only 7 of 10 runs {}are valid"),
])  # fmt: skip
def test_what_the_outcome_keeps_from_being_compared_counts_as_a_test(changes, reason):
    spoilt, fine = verdict(10, **changes), verdict(10, range(5))
    now = one_compared(record(spoilt), record(fine))
    assert (now.status, now.test, now.p_worse) == ("no comparison", None, 1.0)
    assert now.reason == reason.format("").strip()
    before = one_compared(record(fine), record(spoilt))
    assert before.reason == reason.format("of the baseline ").strip()
    beside = compared(
        record(fine, verdict(10, case="a/c", **changes)),
        record(verdict(10), verdict(10, case="a/c")),
    )
    assert [one.status for one in beside] == ["no evidence of a change", "no comparison"]
    assert (beside[0].uncorrected, beside[0].p_worse_holm) == ("worse", 2 / 32)


def test_a_test_that_never_ran_has_not_changed_its_check():
    never = verdict(0, planned=3, check="", item="a/b::R")
    assert one_compared(record(never), record(verdict(3))).reason == (
        "only 0 of 3 planned runs were run"
    )


def test_the_words_rest_on_holms_correction():
    cases = ["a/1", "a/2", "a/3"]
    violating = [range(7), range(5), ()]  # p = 1/128, 1/32, 1
    new = record(*(verdict(10, some, case) for some, case in zip(violating, cases, strict=True)))
    old = record(*(verdict(10, case=case) for case in cases))
    found = compared(new, old)
    assert [one.status for one in found] == [
        "worse", "no evidence of a change", "no evidence of a change",
    ]  # fmt: skip
    assert [one.uncorrected for one in found] == ["worse", "worse", "no evidence of a change"]
    assert [one.p_worse_holm for one in found] == [3 / 128, 2 / 32, 1.0]
    assert [one.p_better_holm for one in compared(old, new)] == [3 / 128, 2 / 32, 1.0]


@pytest.mark.parametrize("seed", [0, 1], ids=["equal seeds", "other seeds"])
def test_another_scenario_under_the_same_name_is_no_comparison(seed):
    new = record(verdict(10, range(5)), seed=seed, walls=[5.0])
    found = one_compared(new, record(verdict(10), walls=[4.0]))
    assert found.reason == "the scenario changed: scenario.world.wall"
    assert found.p_worse is None


def test_another_range_shows_where_seeds_are_equal():
    found = one_compared(record(verdict(10), walls=[4.0, 5.0]), record(verdict(10), walls=[4.0]))
    assert found.reason == "the scenario changed: scenario.world.wall"


def test_what_varies_between_the_runs_may_differ_between_campaigns_of_other_seeds():
    new = record(verdict(10), walls=[4.1, 5.2, 4.7], seed=1)
    for walls in ([4.3, 4.4], [4.3]):
        old = record(verdict(10), walls=walls)
        assert one_compared(new, old).test == one_compared(old, new).test == "Fisher"


@pytest.mark.parametrize("path, value, told", [
    (("faults",), [encode(Fault("ghost-obstacle", "ghost", "lidar", {"at": 0.5}))],
     "faults, faults.0.activation.at, faults.0.by_chance and 4 more"),
    (("simulator", "path"), "m:Other", "simulator.path"),
    (("termination", "violation"), True, "termination.violation"),
    (("roles", "fault_injector"), {"path": "m:I", "params": {}},
     "fault_injector, fault_injector.params, fault_injector.path"),
])  # fmt: skip
def test_other_conditions_are_named(path, value, told):
    new = record(verdict(3))
    for episode in new["episodes"]:
        inner = episode["spec"]
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
    found = one_compared(new, record(verdict(3)))
    assert found.reason == f"the scenario changed: {told}"


def test_other_roles_and_policies_are_what_is_compared():
    new = record(verdict(3))
    for episode in new["episodes"]:
        episode["spec"]["roles"]["safety_monitor"] = {"path": "m:M", "params": {}}
        episode["spec"]["policy"] = "halt"
    assert one_compared(new, record(verdict(3))).status == "no evidence of a change"


def made(*told):
    """One verdict for each ``(component, item)``, all with the same check."""
    return record(*(verdict(3, component=component, item=item) for component, item in told))


@pytest.mark.parametrize("new, old", [
    ("Ai Aj Bi Bj", "Bj Bi Aj Ai"),  # by component and item
    ("Ai Aj", "Bj Bi"),  # by item
    ("Ai Bi", "Bj Aj"),  # by component
    ("Ai", "Bj"),  # the only ones
])  # fmt: skip
def test_of_several_verdicts_on_a_case_those_that_agree_most_are_compared(new, old):
    found = compared(made(*new.split()), made(*old.split()))
    assert {one.status for one in found} == {"no evidence of a change"}
    assert len(found) == len(new.split())
    names = {component for component, _ in new.split()} & {
        component for component, _ in old.split()
    }
    assert all(one.component == one.baseline_component for one in found if one.component in names)


def test_what_could_be_compared_with_several_is_compared_with_none():
    found = compared(made("Ai"), made("Bj", "Dj"))
    assert sorted(one.status for one in found) == ["gone", "gone", "new"]


def test_tests_with_other_checks_are_not_mixed_up():
    new = record(
        verdict(10, range(5), item="t.py::one", check="x > 0"),
        verdict(10, item="t.py::two", check="x > 1"),
    )
    old = record(
        verdict(10, range(5), item="t.py::moved", check="x > 1"),
        verdict(10, item="t.py::one", check="x > 0"),
    )
    counts = sorted((one.violations, one.baseline_violations) for one in compared(new, old))
    assert counts == [(0, 5), (5, 0)]


def test_several_components_are_matched_by_name_and_never_twice():
    new = record(verdict(3, component="A"), verdict(3, component="B"))
    old = record(verdict(3, component="B"), verdict(3, component="D"))
    found = {(one.component, one.baseline_component): one.status for one in compared(new, old)}
    assert found == {
        ("B", "B"): "no evidence of a change", ("A", "D"): "no evidence of a change",
    }  # fmt: skip
