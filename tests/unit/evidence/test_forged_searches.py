"""Records whose searches were changed in one place, and what verify says against them."""

from __future__ import annotations

import copy

import pytest
from searches import entry
from session_records import CASES, session_record

from pytest_dura.core.codec import encode
from pytest_dura.evidence import record_problems
from pytest_dura.evidence.conclude import conclude
from pytest_dura.evidence.conclusions.searches import Searches
from pytest_dura.evidence.objections import judge_again
from pytest_dura.evidence.verify import differences

PASSED = {"result": "passed", "exit_code": 0, "warn_undecided": False, "failed": 0, "reasons": []}
WAIVER = {"kind": "xfail", "reason": "known"}


def contradictions(record):
    """What the searches of a record cannot say, alone and beside its head and its episodes."""
    table = Searches(record.head)
    return [
        *(problem for episode in record.episodes() for problem in table.check(episode)),
        *table.check_head(),
    ]


def problems(*searches, **changes):
    """What verify finds in these searches: what contradicts itself, and what is concluded else."""
    record = session_record(searches=list(searches), **changes)
    again = conclude(record, [Searches])
    pair = [encode(each.head.searches) for each in (record, again)]
    return [*contradictions(record), *differences("/searches", *pair)]


@pytest.mark.parametrize(
    "words",
    [
        ("falsified",), ("not repeatable",), ("undecided",), ("nothing found",),
        ("falsified", "nothing found"), ("falsified", "not repeatable"), ("falsified", "undecided"),
    ],
)  # fmt: skip
def test_a_search_as_it_is_told_contradicts_nothing(words):
    assert problems(entry(*words)) == []


def outcome(one):
    return one["outcomes"][0]


def found(one):
    return outcome(one)["counterexample"]


def spoil(path, value):
    """A change of the entry at keys and indices."""

    def change(one):
        *rest, last = path
        for key in rest:
            one = one[key]
        one[last] = value

    return change


def found_nothing(one):
    outcome(one).update(status="nothing found", counterexample=None, searcher=None, simulations=37)
    for searcher in one["searchers"]:
        searcher["first"]["SAF-1"] = None


FORGED = {
    "more simulations than its budget": (
        spoil(["budget"], 36), "37 simulations, and its budget is 36"),
    "no simulation": (spoil(["simulations"], 0), "0 simulations, and its budget is 100"),
    "a simulation that no searcher did": (
        spoil(["simulations"], 38), "/searches/0/simulations: found 38, expected 37"),
    "more silence than simulations": (
        spoil(["unknown"], 38), "38 of 37 simulations decided nothing"),
    "more idle faults than simulations": (
        spoil(["not_manifested"], 38),
        "an added fault never came to act in 38 of 37 simulations",
    ),
    "a violation after the end of its searcher": (
        spoil(["searchers", 1, "first", "SAF-1"], 26),
        "cma-es: violated SAF-1 at 26 of its 25 simulations"),
    "a violation after the end of a baseline": (
        spoil(["baselines", 1, "first", "SAF-1"], 38),
        "bang-bang: violated SAF-1 at 38 of its 37 simulations"),
    "figures of another requirement": (
        spoil(["baselines", 0, "best"], {"SAF-2": 0.5}),
        "random seeds: its figures are of other requirements"),
    "a baseline that learns": (
        spoil(["baselines", 1, "trivial"], False), "bang-bang learns, and is no baseline"),
    "a baseline that had more": (
        spoil(["baselines", 1, "simulations"], 100),
        "bang-bang: a baseline of 100 simulations"),
    "a baseline twice": (
        spoil(["baselines", 1, "name"], "random seeds"), "one of its baselines is listed twice"),
    "a claim without a baseline": (
        spoil(["baselines"], []), "SAF-1: falsified, and no baseline stands beside it"),
    "a claim without a counterexample": (
        spoil(["outcomes", 0, "counterexample"], None),
        '/searches/0/outcomes/0/status: found "falsified", expected "nothing found"'),
    "nothing found, beside a counterexample": (
        spoil(["outcomes", 0, "status"], "nothing found"),
        '/searches/0/outcomes/0/status: found "nothing found", expected "falsified"'),
    "a replay that differed": (
        spoil(["outcomes", 0, "counterexample", "repeats"],
              {"runs": 10, "violated": 10, "equal": 9}),
        '/searches/0/outcomes/0/status: found "falsified", expected "not repeatable"'),
    "a replay that did not violate": (
        spoil(["outcomes", 0, "counterexample", "repeats"],
              {"runs": 10, "violated": 9, "equal": 10}),
        '/searches/0/outcomes/0/status: found "falsified", expected "not repeatable"'),
    "no replay": (
        spoil(["outcomes", 0, "counterexample", "repeats"], {"runs": 0, "violated": 0, "equal": 0}),
        '/searches/0/outcomes/0/status: found "falsified", expected "not repeatable"'),
    "more equal replays than replays": (
        spoil(["outcomes", 0, "counterexample", "repeats", "equal"], 2),
        "SAF-1: more repeats than 1"),
    "a confirmed one that is called unrepeatable": (
        spoil(["outcomes", 0, "status"], "not repeatable"),
        '/searches/0/outcomes/0/status: found "not repeatable", expected "falsified"'),
    "a violation that is not told": (
        lambda one: (outcome(one).update(status="nothing found", counterexample=None,
                                         searcher=None, simulations=37)),
        "SAF-1: cma-es violated it at its simulation 9, and there is no counterexample"),
    "nothing found, before the end": (
        lambda one: (found_nothing(one), outcome(one).update(simulations=36)),
        "/searches/0/outcomes/0/simulations: found 36, expected 37"),
    "nothing found, where little was said": (
        lambda one: (found_nothing(one), one.update(unknown=8)),
        '/searches/0/outcomes/0/status: found "nothing found", expected "undecided"'),
    "undecided, where enough was said": (
        lambda one: (found_nothing(one), outcome(one).update(status="undecided")),
        '/searches/0/outcomes/0/status: found "undecided", expected "nothing found"'),
    "a finder that found nothing": (
        spoil(["outcomes", 0, "searcher"], "corners"),
        "SAF-1: corners found it, and violated nothing"),
    "found earlier than its finder did": (
        spoil(["outcomes", 0, "simulations"], 8), "SAF-1: violated at simulation 8 of 37"),
    "a better robustness": (
        spoil(["outcomes", 0, "best"], 0.5),
        "/searches/0/outcomes/0/best: found 0.5, expected -0.25"),
    "another check": (
        spoil(["outcomes", 0, "check"], "gap > -9"),
        "SAF-1: searched 'gap > -9', which is not its check"),
    "a requirement twice": (
        lambda one: one["outcomes"].append(outcome(one)),
        "it is for the requirements SAF-1, SAF-1"),
    "a counterexample of another scenario": (
        spoil(["outcomes", 0, "counterexample", "case"], "a/other@0123456789"),
        "SAF-1: its counterexample a/other@0123456789 is of another scenario than a/clear"),
    "a counterexample of another seed": (
        spoil(["outcomes", 0, "counterexample", "seed"], 8),
        "SAF-1: its counterexample is a/clear with seed 8, and says ('a/clear', 7)"),
    "a parameter that changed twice": (
        lambda one: found(one)["changes"][0].update(path="world.wall"),
        "SAF-1: a parameter of its counterexample changed twice"),
    "shrinking without bounds": (
        spoil(["outcomes", 0, "counterexample", "shrinking", "budget"], 40),
        "SAF-1: 41 simulations to make it simpler, and 40 were allowed"),
    "shrinking that made it larger": (
        spoil(["outcomes", 0, "counterexample", "shrinking", "before"], 3),
        "SAF-1: made simpler from 3 to 4 parameters"),
    "a file of one machine": (
        spoil(["outcomes", 0, "counterexample", "file"], "C:\\found.yaml"),
        "SAF-1: it is kept in C:\\found.yaml, which is a path of one machine"),
    "a file without a name": (
        spoil(["outcomes", 0, "counterexample", "name"], None),
        "SAF-1: its counterexample is kept in scenarios/found/a-clear-saf-1.yaml as None"),
    "a component that nobody describes": (spoil(["component"], "D"), "D is not described"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED)
def test_what_was_changed_is_found(name):
    change, expected = FORGED[name]
    one = copy.deepcopy(entry("falsified"))
    one["searchers"], one["baselines"] = list(one["searchers"]), list(one["baselines"])
    one["outcomes"] = list(one["outcomes"])
    change(one)
    place = "" if expected[0] == "/" else f"search by {one['item']} on a/clear: "
    assert place + expected in problems(one)


def test_an_unconfirmed_counterexample_is_kept_in_no_file():
    (told,) = problems(entry("not repeatable", kept=True))
    assert told.endswith("kept in scenarios/found/a-clear-saf-1.yaml, and was never confirmed")


def test_a_requirement_that_is_not_listed():
    one = entry("nothing found")
    record = session_record(searches=[one], requirements=[])
    assert any(told.endswith("SAF-1: the requirement is not listed")
               for told in contradictions(record))  # fmt: skip


def test_a_search_that_is_listed_twice():
    one = entry("nothing found")
    assert problems(one, {**one, "waiver": WAIVER}) == ["searches: one of them is listed twice"]


CHOSEN = "a/clear@0123456789"


def test_a_searched_episode_that_counts_as_planned():
    record = session_record()
    episodes = [episode.to_json() for episode in record.episodes()]
    episodes[0] |= {"case": CHOSEN, "id": f"{CHOSEN}#0"}
    episodes[0]["spec"]["case"] = CHOSEN
    case = next(case for case in record.head.cases if case.id == CASES[0])
    metrics = case.metrics.replace(run=1, valid=1)
    chosen = case.replace(id=CHOSEN, planned=0, metrics=metrics)
    forged = session_record(episodes=episodes, cases=[*record.head.cases, chosen])
    expected = f"case {CHOSEN}: a search chose it, and there are metrics of it"
    assert f"evidence.json: {expected}" in list(record_problems(forged))
    unlisted = session_record(episodes=episodes)
    assert list(record_problems(unlisted))


def test_a_searched_case_with_metrics():
    case = next(one for one in session_record().head.cases if one.id == CASES[0])
    told = problems(cases=[case.replace(id=CHOSEN)])
    assert told == [f"case {CHOSEN}: a search chose it, and there are metrics of it"]
    idle = case.replace(id=CHOSEN, planned=0, metrics=case.metrics.replace(run=0))
    assert problems(cases=[idle]) == []


def test_a_planned_episode_that_a_search_chose():
    record = session_record()
    episodes = [episode.to_json() for episode in record.episodes()]
    episodes[0] |= {"case": CHOSEN, "id": f"{CHOSEN}#0"}
    expected = f"episode {CHOSEN}#0: a search chose it, and it is planned"
    assert contradictions(session_record(episodes=episodes)) == [expected]


def gate_problems(*searches, **gate):
    verdicts = [one for one in session_record().head.verdicts if one.verdict == "supported"]
    record = session_record(searches=list(searches), verdicts=verdicts, gate={**PASSED, **gate})
    again = encode(judge_again(record.head))
    return list(differences("/gate", encode(record.head.gate), again))


AGAINST = "SAF-1 on a/clear is falsified by a search"


def test_a_gate_that_passed_over_a_counterexample():
    assert gate_problems(entry("nothing found")) == []
    assert gate_problems(entry("falsified"))[0] == '/gate/result: found "passed", expected "failed"'
    assert gate_problems(entry("falsified", waiver=WAIVER)) == []
    assert gate_problems(entry("falsified"), warn_undecided=True) != []
    assert gate_problems(entry("not repeatable")) != []


def test_a_gate_that_failed_for_something_else():
    failed = {"result": "failed", "exit_code": 1}
    assert gate_problems(entry("falsified"), **failed, reasons=["it rained"]) == [
        "/gate/reasons: found 1 entries, expected 2",
        f'/gate/reasons/0: found "it rained", expected "{AGAINST}"',
    ]
    assert gate_problems(entry("falsified"), **failed, reasons=[AGAINST]) == []


@pytest.mark.parametrize("warn_undecided", [False, True])
def test_a_passed_gate_on_an_undecided_search_or_a_violated_baseline_is_a_forgery(warn_undecided):
    search = copy.deepcopy(entry("nothing found"))
    assert gate_problems(search, warn_undecided=warn_undecided) == []
    search["baselines"][1]["first"]["SAF-1"] = 3
    assert gate_problems(search, warn_undecided=warn_undecided) != []
    assert gate_problems(entry("undecided"), warn_undecided=warn_undecided) != []
