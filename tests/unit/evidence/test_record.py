from __future__ import annotations

import copy

from conclusions import concluded
from entries import make
from item_lines import expected, report
from session_records import HEADER

from pytest_dura.core.codec import decode, encode
from pytest_dura.evidence import UNKNOWN_COMPONENT, CaseMetrics, Cases, RecordBuilder
from pytest_dura.evidence.case_model import CaseEntry, CasePlan
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gather import claim
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.lines import KeptTrace, SignalUnit
from pytest_dura.evidence.model import Fact
from pytest_dura.evidence.session_model import ComponentEntry
from pytest_dura.requirements.judgements import Judgement
from pytest_dura.requirements.model import Requirement

REQUIREMENT = encode(Requirement("R", "t"))


def case(component="C", planned=2):
    return make(
        CasePlan, id="a/b", scenario="a/b", component=component, requirements=["R"], planned=planned
    ).to_json()


def episode(run=0, digest=None, validity="valid", termination="goal", word="satisfied", **outcome):
    names = ("collided", "clearance_time", "gridlock")
    outcome["measures"] = {key: outcome.pop(key) for key in names if key in outcome}
    return make(
        EpisodeEntry, id=f"a/b#{run}", case="a/b", component="C", seed=run, planned=True,
        validity=validity, digest=(digest or DIGITS[run]) * 64, outcome=outcome,
        trajectory=f"{run:064d}", termination=termination, spec={"run": run},
        verdicts={"R": said(word)},
    ).to_json()  # fmt: skip


DIGITS = "0123456789"


def said(word):
    return {"status": word, "margin": None, "time": None, "detail": "", "vacuous": False}


def ran(*words):
    """The episodes of runs that the requirement finds to be as these words say."""
    return [episode(run, word=word) for run, word in enumerate(words)]


def judgement(kind, runs, **changes):
    asked = {
        "requirement": "R", "case": "a/b", "component": "C", "planned": len(runs), "check": "x",
        "confidence": 0.95, **changes,
    }  # fmt: skip
    return encode(decode(Judgement, {**NOTHING_ASKED, "kind": kind, "runs": runs, **asked}))


NOTHING_ASKED = encode(Judgement("claim", "", "", "", 0))


def looked_up(run, word=None, digest=None):
    """A run of a judgement, with the verdict of a check of the item's own if it has one."""
    verdict = None if word is None else said(word)
    return {"digest": (digest or DIGITS[run]) * 64, "run": run, "twin": "", "verdict": verdict,
            "twin_verdict": None, "values": None, "reference": "",
            "reference_verdict": None}  # fmt: skip


def campaign(count=1, **changes):
    """The question whether so many runs satisfy the requirement of the case."""
    return judgement("campaign", [looked_up(run) for run in range(count)], **changes)


def own_check(*words, **changes):
    """A question with a check of the item's own, of which each run comes to one of these words."""
    return judgement("campaign", [looked_up(*told) for told in enumerate(words)], **changes)


def looked_at(word, run=0, planned=2):
    """What a test asserts of one episode."""
    own = {"alone": True, "by_check": False, "observed": [], "false": [], "failed": ""}
    return judgement("test", [looked_up(run, word)], planned=planned, check="", assertion=own)


def record():
    return RecordBuilder(HEADER)


def evidence(made, status="complete"):
    found = made.record(status)
    return found.to_json()


def case_metrics(episodes, planned):
    metrics = CaseMetrics()
    for one in episodes:
        metrics.add(make(EpisodeEntry, **one))
    return encode(metrics.entry(planned))


def test_the_same_report_may_come_twice():
    made = record()
    told = report(cases=[case()], episodes=[episode(0), episode(1)], judgements=[campaign(2)])
    made.add(copy.deepcopy(told))
    once = copy.deepcopy(evidence(made))
    made.add(copy.deepcopy(told))
    assert evidence(made) == once
    assert len(once["episodes"]) == 2
    assert once["verdicts"][0]["attempts"] == []


def test_the_order_of_reports_does_not_matter():
    first = report("x", cases=[case()], episodes=[episode(1)])
    second = report("y", cases=[case()], episodes=ran("violated"), judgements=[campaign()])
    forth, back = record(), record()
    for told in (first, second):
        forth.add(copy.deepcopy(told))
    for told in (second, first):
        back.add(copy.deepcopy(told))
    assert evidence(forth) == evidence(back)


def test_two_digests_of_one_episode_leave_the_claim_undecided():
    made = record()
    made.add(report(cases=[case()], episodes=[episode(0)], judgements=[campaign()]))
    made.add(report("other", episodes=[episode(0, digest="e")]))
    (found,) = evidence(made)["verdicts"]
    assert found["verdict"] == "undecided"
    assert found["reason"].startswith("infrastructure: nondeterministic: the episode a/b#0")
    assert made.problems == [found["reason"]]


def test_two_digests_do_not_excuse_a_violation():
    made = record()
    made.add(report(cases=[case()], episodes=ran("violated"), judgements=[campaign()]))
    made.add(report("other", episodes=[episode(0, digest="e")]))
    assert evidence(made)["verdicts"][0]["verdict"] == "violated"


def test_other_inputs_are_another_episode():
    made = record()
    other = episode(0, digest="e")
    other["spec"]["seed"] = 7
    made.add(report(cases=[case()], episodes=[episode(0), other]))
    assert made.problems == []
    assert len(evidence(made)["episodes"]) == 2


def test_of_several_attempts_a_violation_counts_and_all_are_kept():
    for order in (("violated", "satisfied"), ("satisfied", "violated")):
        made = record()
        for attempt, word in enumerate(order, 1):
            asked = [own_check(word)]
            parts = {"cases": [case()], "episodes": ran("satisfied"), "judgements": asked}
            made.add(report(attempt=attempt, **parts))
        (found,) = evidence(made)["verdicts"]
        assert found["verdict"] == "violated"
        assert len(found["attempts"]) == 1


def test_an_expected_item_that_never_reports_is_undecided():
    made = record()
    made.add(expected("a/b::R", REQUIREMENT, case(planned=3)))
    told = evidence(made)
    (found,) = told["verdicts"]
    assert (found["verdict"], found["planned"], found["run"]) == ("undecided", 3, 0)
    assert [one["id"] for one in told["cases"]] == ["a/b"]
    assert told["requirements"] == [REQUIREMENT]


def test_an_expected_item_takes_the_components_name_when_it_is_known():
    made = record()
    made.add(expected("a/b::R", REQUIREMENT, case(component=UNKNOWN_COMPONENT)))
    assert evidence(made, "running")["verdicts"][0]["component"] == UNKNOWN_COMPONENT
    made = record()
    made.add(expected("a/b::R", REQUIREMENT, case(component=UNKNOWN_COMPONENT)))
    made.add(report("other", components=[make(ComponentEntry, name="C").to_json()]))
    assert evidence(made)["verdicts"][0]["component"] == "C"


def test_tests_on_single_episodes_make_one_verdict():
    made = record()
    for run, word in enumerate(["satisfied", "violated"]):
        told = looked_at(word, run, planned=3)
        parts = {"cases": [case(planned=3)], "episodes": [episode(run)], "judgements": [told]}
        made.add(report(f"t.py::f[a/b#{run}]", **parts))
    (found,) = evidence(made)["verdicts"]
    assert (found["verdict"], found["planned"], found["run"]) == ("violated", 3, 2)
    assert found["item"] == "t.py::f"
    assert [one["episode"] for one in found["counterexamples"]] == ["a/b#1"]


def told_by(made, item, word, run=0):
    told = {"cases": [case()], "episodes": [episode(run)], "judgements": [looked_at(word, run)]}
    made.add(report(f"{item}[a/b#{run}]", **told))


def test_what_two_tests_make_of_an_episode_is_told_apart():
    """One that was skipped is no earlier attempt of the one that passed."""
    made = record()
    for run in range(2):
        told_by(made, "t.py::skips", "invalid", run)
        told_by(made, "t.py::passes", "satisfied", run)
    words = {one["item"]: one["verdict"] for one in evidence(made)["verdicts"]}
    assert words == {"t.py::skips": "undecided", "t.py::passes": "supported"}


def test_of_several_looks_at_an_episode_the_worst_counts_and_of_attempts_the_last():
    for words in (("invalid", "satisfied"), ("satisfied", "invalid")):
        looks, attempts = record(), record()
        for number, word in enumerate(words, 1):
            asked = [looked_at(word, planned=1)]
            told = {"cases": [case()], "episodes": [episode(0)], "judgements": asked}
            looks.add(report(f"t.py::f[a/b#0-{number}]", **told))
            attempts.add(report("t.py::f[a/b#0]", attempt=number, **told))
        assert evidence(looks)["verdicts"][0]["verdict"] == "undecided"
        last = "supported" if words[-1] == "satisfied" else "undecided"
        assert evidence(attempts)["verdicts"][0]["verdict"] == last


def test_a_waiver_of_one_run_does_not_excuse_another():
    for second, excused in (("satisfied", True), ("invalid", False), (None, False)):
        made = record()
        told_by(made, "t.py::f", "violated", 0)
        if second is not None:
            told_by(made, "t.py::f", second, 1)
        made.waive("t.py::f[a/b#0]", "xfail", "ticket 7")
        (found,) = evidence(made)["verdicts"]
        assert found["verdict"] == "violated"
        assert (found["waiver"] is not None) is excused


def test_several_questions_of_an_item_are_no_attempts_at_one():
    made = record()
    others = [{"check": "y"}, {"at_most": 0.5}, {"at_most": 0.5, "method": "e-process"}]
    for changes in ({}, *others):
        told = own_check("satisfied", **changes)
        made.add(report(cases=[case()], episodes=[episode(0)], judgements=[told]))
    found = evidence(made)["verdicts"]
    assert [verdict["attempts"] for verdict in found] == [[], [], [], []]


def test_what_a_test_was_to_decide_and_did_not_is_undecided():
    made = record()
    plan = make(CasePlan, **case())
    claims = [encode(claim("t.py::f[a/b]", name, plan)) for name in "RS"]
    asked = {"judgements": claims, "claimed": [case()]}
    made.add(report("t.py::f[a/b]", requirements=[REQUIREMENT], **asked))
    told = {"cases": [case()], "episodes": [episode(0)], "judgements": [campaign()]}
    made.add(report("t.py::f[a/b]", **told))
    single = encode(claim("t.py::g", "R", plan))
    made.add(report("t.py::g[a/b#0]", judgements=[single], claimed=[case()]))
    made.waive("t.py::g[a/b#0]", "skip", "too cold")
    found = evidence(made)["verdicts"]
    assert [(one["item"], one["requirement"], one["verdict"]) for one in found] == [
        ("t.py::f[a/b]", "R", "supported"),
        ("t.py::g", "R", "undecided"),
        ("t.py::f[a/b]", "S", "undecided"),
    ]
    assert found[1]["waiver"] == {"kind": "skip", "reason": "too cold"}
    assert found[2]["reason"] == "the test ended without a verdict on it"


def test_an_item_that_never_ran_does_not_deny_that_episodes_of_its_case_did():
    made = record()
    made.add(expected("a/b::R", REQUIREMENT, case()))
    (before,) = evidence(made)["verdicts"]
    assert "only 0 of" in before["reason"]
    made.add(report(cases=[case()], episodes=[episode(0)]))
    (found,) = evidence(made)["verdicts"]
    assert found["verdict"] == "undecided"
    assert found["reason"] == "episodes of the case ran, and no verdict was made on them"


def test_waivers_are_recorded_beside_the_verdict():
    made = record()
    made.add(report(cases=[case()], episodes=ran("violated"), judgements=[campaign()]))
    made.waive("a/b::R", "xfail", "ticket 7")
    (found,) = evidence(made)["verdicts"]
    assert found["verdict"] == "violated"
    assert found["waiver"] == {"kind": "xfail", "reason": "ticket 7"}


def test_case_metrics_over_valid_and_over_planned_runs():
    runs = [
        episode(0, collided=True, flagged=True, gridlock=False),
        episode(1, collided=False, gridlock=False, clearance_time=8.0, recoveries=2, alerts=1),
        episode(2, collided=False, gridlock=True, clearance_time=None, termination="decided"),
        episode(3, collided=True, gridlock=False, validity="invalid", termination="decided"),
        episode(4, collided=False, gridlock=False, clearance_time=12.0),
        episode(5, validity="missing"),
    ]
    found = case_metrics(runs, 8)
    assert [found[key] for key in ("planned", "run", "valid", "invalid", "missing")] == [
        8, 6, 4, 1, 1,
    ]  # fmt: skip
    assert found["measures"]["collided"] == {
        "valid": 1, "run": 2, "share_of_valid": 0.25, "share_of_planned": 0.25,
    }  # fmt: skip
    assert found["flagged"]["share_of_valid"] == 0.25
    assert found["measures"]["gridlock"]["valid"] == 1
    assert found["measures"]["clearance_time"] == {"runs": 2, "mean": 10.0, "sd": 8.0**0.5}
    assert (found["recoveries"], found["alerts"]) == (2, 1)
    assert found["ended_early"] == 2


def test_case_metrics_without_any_measures():
    found = case_metrics([episode(0), episode(1)], 2)
    assert found["measures"] == {}
    assert found["flagged"]["valid"] == 0
    assert case_metrics([], 3)["valid"] == 0


def driven(run, takeovers=0, reactions=(), **own):
    """An episode with decisions."""
    switching = {
        "decisions": 10, "recovered": takeovers, "takeovers": takeovers, "switches": takeovers,
        "censored": 0, "time_to_safe": [],
    }  # fmt: skip
    made = episode(run, switching=switching, **own)
    made["metrics"]["reactions"] = dict(reactions)
    return made


def test_reliance_and_reactions_are_counted_over_valid_runs():
    runs = [
        driven(0, 0, {"frozen": 1}),
        driven(1, 2, {"frozen": 1, "erratic": 2}),
        driven(2, 1, {"frozen": 4}, validity="invalid"),
    ]
    found = case_metrics(runs, 4)
    assert found["rescued"] == {
        "valid": 1, "run": 2, "share_of_valid": 0.5, "share_of_planned": 0.5,
    }  # fmt: skip
    assert found["switching"]["share"] == 0.1
    assert found["reactions"] == {"erratic": 2, "frozen": 2}


def test_where_nothing_is_decided_nothing_is_rescued():
    assert case_metrics([driven(0)], 1)["rescued"]["valid"] == 0
    assert case_metrics([episode(0)], 1)["rescued"] is None


def test_all_cases_of_a_component_are_pooled_without_their_twins():
    twin = {**case(), "id": "a/b~recovery_planner", "without": ["recovery_planner"]}
    free = {**case(), "id": "c/d+none"}
    cases = [
        make(CaseEntry, **one)
        for one in (case(planned=3), {**case(), "id": "c/d"}, twin, free, case("D"))
    ]
    verdicts = [
        make(ItemVerdict, case="a/b", pairs={"case": twin["id"], "without": "faults"}),
        make(ItemVerdict, case="c/d", pairs={"case": free["id"], "without": "faults"}),
    ]
    runs = [
        episode(0, clearance_time=8.0, gridlock=False),
        {**episode(0, clearance_time=12.0, gridlock=False), "case": "c/d"},
        {**episode(0, clearance_time=99.0, gridlock=False), "case": twin["id"]},
        {**episode(0, clearance_time=99.0, gridlock=False), "case": free["id"]},
        {**episode(0, clearance_time=5.0, gridlock=False), "component": "D"},
    ]
    episodes = [make(EpisodeEntry, **{**one, "planned": True}) for one in runs]
    own, other = encode(concluded(Cases, episodes, cases=cases, verdicts=verdicts)["overall"])
    assert (own["component"], own["cases"], own["metrics"]["planned"]) == ("C", 2, 5)
    assert own["metrics"]["measures"]["clearance_time"] == {"runs": 2, "mean": 10.0, "sd": 8.0**0.5}
    assert (other["component"], other["metrics"]["valid"]) == ("D", 1)
    judged = [*verdicts, make(ItemVerdict, case=free["id"])]
    overall = encode(concluded(Cases, cases=cases, verdicts=judged)["overall"])
    assert overall[0]["cases"] == 3, "who is judged for its own sake is no mere twin"


def test_cases_come_in_the_order_of_their_scenarios_then_by_name():
    made = record()
    places = {"z/first": 1, "b/second": 2, "a/none": None, "c/second": 2}
    cases = [{**case(), "id": name, "order": place} for name, place in places.items()]
    made.add(report(cases=cases))
    found = [one["id"] for one in evidence(made)["cases"]]
    assert found == ["z/first", "b/second", "c/second", "a/none"]


def missing(made):
    (found,) = evidence(made)["cases"]
    return found["missing_runs"], found["missing_runs_total"]


def test_planned_runs_that_never_reported_are_listed():
    made = record()
    made.add(expected("a/b::R", REQUIREMENT, case(planned=150)))
    assert missing(made) == (list(range(100)), 150)
    by_hand = episode(2) | {"planned": False}
    made.add(report("t.py::f", cases=[case()], episodes=[episode(1), by_hand]))
    assert missing(made) == ([0, *range(2, 101)], 149)


def test_a_run_that_reported_is_not_missing_whatever_it_came_to():
    made = record()
    made.add(report(cases=[case()], episodes=[episode(0), episode(1, validity="missing")]))
    assert missing(made) == ([], 0)


def test_runs_that_a_campaign_was_decided_without_are_not_missing():
    made = record()
    decided = campaign(1, planned=9, until_decided=True)
    made.add(report(cases=[case(planned=9)], episodes=ran("violated"), judgements=[decided]))
    assert missing(made) == ([], 0)
    more = case(planned=10)
    made.add(report("t.py::f", cases=[more]))
    assert missing(made) == (list(range(1, 10)), 9), "another test planned ten of them"


def test_twins_are_missing_as_their_pairs_are():
    made = record()
    paired = {"without": "faults", "measure": "", "change_at_most": None, "reference": ""}
    pairs = campaign(2, case="a/b+f", twins="a/b", paired=paired)
    made.add(report(cases=[case()], episodes=[episode(0)], judgements=[pairs]))
    assert missing(made) == ([1], 1)


def test_traces_are_attached_to_their_episodes():
    made = record()
    made.add(report(cases=[case()], episodes=[episode(0), episode(1, digest="e")]))
    trace = {"file": "episodes/x.mcap", "sha256": "0" * 64, "bytes": 1, "kept_for": "all"}
    made.add([KeptTrace("a/b#1", "C", "e" * 64, trace)])
    assert [one.get("trace") for one in evidence(made)["episodes"]] == [None, trace]


def test_what_processes_count_for_a_table_is_told_once_by_each():
    made = record()
    for process, count in (("main", 3), ("main", 5), ("gw1", 2), ("main", 5)):
        made.add([Fact("rides", "up", 0, {"count": count}, process)])
    found = [(fact["process"], fact["data"]["count"]) for fact in evidence(made)["facts"]]
    assert found == [("gw1", 2), ("main", 5)]


def test_units_are_those_of_signals_that_checks_name_and_none_that_is_declared_twice():
    builder = RecordBuilder(HEADER)
    for check in ("always (gap > 0)", "always (speed < 3 implies percept.gap > limit)"):
        builder.add([Requirement(check[-3:], "t", check=check)])
    declared = {"gap": "m", "speed": "m/s", "percept.gap": "m", "jerk": "m/s3"}
    builder.add(SignalUnit(*each) for each in (*declared.items(), ("speed", "km/h"), ("gap", "m")))
    assert builder.head("complete").units == {"gap": "m", "percept.gap": "m"}
    assert RecordBuilder(HEADER).head("complete").units is None
