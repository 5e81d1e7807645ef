"""Records that were changed in one place, and what only recomputing them finds.

The formats, which would give each change away, are left out of account: a forger renders them anew.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest
from forged_fields import PAGE, free_names, rows_of, table_rows
from forging import forgeries

from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import (
    SessionRecord,
    check_record,
    conclude,
    open_record,
    record_problems,
    record_schema,
    verify_bundle,
)
from pytest_dura.evidence.conclusions.totals import Totals
from pytest_dura.evidence.verify import conclude_again, conclusion_problems, trace_problems
from pytest_dura.requirements import upper_bound

PROJECT = Path(__file__).with_name("project")
NUDGED = """
name: corridor/nudged
simulator: corridor:Corridor
duration: 2.0
runs: 6
world: {wall: 10.0}
variation: {world.wall: {min: 3.0, max: 11.0}}
roles:
  generator: corridor:Reckless
  safety_monitor: oddities:Early
  fault_injector: %s
faults: [{type: noise, id: g, target: gap, activation: {at: 0.1}, duration: once}]
requirements: [GAP-1, RATE-1, SEQ-1]
"""
SEARCHED = """
name: hall/searched
simulator: corridor:Corridor
duration: 1.0
world: {wall: 10.0}
variation: {world.wall: {min: 0.5, max: 11.0}}
roles: {generator: "corridor:Reckless"}
"""
UNHURT = """
name: hall/unhurt
simulator: corridor:Corridor
duration: 1.0
runs: 4
world: {wall: 10.0}
roles: {generator: "corridor:Careful", fault_injector: "corridor:Idle"}
faults: [{type: noise, id: g, target: gap, activation: {at: 0.1}, duration: once}]
requirements: [GAP-1]
"""
RATES = """
requirements:
  - {id: RATE-1, text: t, kind: safety, check: always (gap > 0.01), at_most: 0.97, confidence: 0.6}
  - {id: SEQ-1, text: t, kind: safety, check: always (gap > 0), at_most: 0.6, method: e-process}
"""
TESTS = """
import pytest
from pytest_dura import derive_seed

def test_by_hand_what_is_planned_later(orchestrator):
    orchestrator.run("corridor/paired", seed=derive_seed(0, "corridor/paired", 0))

@pytest.mark.dura(scenario="corridor/paired", runs=3)
def test_pairs(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > 0)")

def test_by_hand(orchestrator):
    orchestrator.run("corridor/free", seed=7)

@pytest.mark.dura(scenario="hall/unhurt")
@pytest.mark.requirement("GAP-1")
def test_all_runs(campaign):
    campaign.require()

@pytest.mark.dura(scenario="hall/unhurt", runs=2)
@pytest.mark.requirement("GAP-1")
def test_each_run(episode):
    assert not episode.collided

@pytest.mark.dura(scenario="hall/searched")
@pytest.mark.requirement("GAP-1")
def test_search(campaign):
    campaign.falsify(budget=12, shrink=10)

@pytest.mark.dura(scenario="hall/searched")
def test_search_in_vain(campaign):
    campaign.falsify("always (gap > -1)", budget=12)

class TestInstance:
    @pytest.fixture(scope="session")
    def generator(self):
        import corridor
        return corridor.Careful()

    def test_it(self, orchestrator):
        orchestrator.run("corridor/tight", seed=8)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory, forked_workers):
    """A session with campaigns of different lengths on one case, pairs, and a bare instance."""
    folder = tmp_path_factory.mktemp("forged")
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    scenarios = folder / "scenarios"
    injector = "pytest_dura.faults.injector:CampaignInjector"
    (scenarios / "corridor/nudged.yaml").write_text(NUDGED % injector)
    idle = (NUDGED % "corridor:Idle").replace("corridor/nudged", "corridor/idle")
    (scenarios / "corridor/idle.yaml").write_text(idle)
    paired = NUDGED.replace("corridor/nudged", "corridor/paired").replace("11.0}}", "4.0}}")
    paired = paired.replace("fault_injector: %s", "recovery_planner: corridor:Brake")
    paired = paired.replace("faults: [{", "description: '").replace("once}]", "once'")
    (scenarios / "corridor/paired.yaml").write_text(paired)
    (scenarios / "rates.yaml").write_text(RATES)
    (scenarios / "searched.yaml").write_text(SEARCHED)
    (scenarios / "unhurt.yaml").write_text(UNHURT)
    (folder / "test_it.py").write_text(TESTS)
    environment = {name: one for name, one in os.environ.items() if name != "PYTEST_ADDOPTS"}
    subprocess.run(
        [*forked_workers.command("-m", "pytest"), "-q", "-p", "no:cacheprovider", "test_it.py",
         "--dura-scenarios", "--dura-select=corridor/*", "--junit-xml=junit.xml"],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return folder / "dura-evidence"


def problems_of(made, record):
    """What a record and the traces say against it."""
    if invalid := check_record(record):
        return list(map(str, invalid))
    found, rejudged = SessionRecord.of(record, made), {}
    told = list(record_problems(found))
    told += trace_problems(found, rejudged)
    return told + list(conclusion_problems(found))


def verdict(record, **wanted):
    (found, *_) = [
        one for one in record["verdicts"] if all(one[key] == wanted[key] for key in wanted)
    ]
    return found


def episode(record, which):
    return next(one for one in record["episodes"] if which(one))


def test_the_session_is_intact_though_its_campaigns_are_of_different_lengths(made):
    assert verify_bundle(made).problems == []
    verdicts = open_record(made / "evidence.json").head.verdicts
    runs = {one.run for one in verdicts if one.case == "corridor/idle"}
    assert len(runs) > 1
    assert [one.run for one in verdicts if one.pairs and one.item.startswith("test_it")] == [3]


def plan_searched(record):
    """A run that a search chose, by hand in the record, counted among those of a plan."""
    chosen = json.loads(json.dumps(episode(record, lambda run: run["case"] == "corridor/free")))
    case = json.loads(json.dumps(record["cases"][0]))
    name = "corridor/free@0123456789"
    chosen |= {"id": f"{name}#0", "case": name}
    chosen["spec"]["case"] = case["id"] = name
    record["episodes"].append(chosen)
    record["cases"].append(case)


CHANGES = {
    "invalid episodes count as valid": lambda r: verdict(
        r, requirement="GAP-1", case="corridor/idle"
    ).update(reason="all is well"),
    "a sequential bound": lambda r: verdict(r, requirement="SEQ-1")["bound"].update(upper=0.01),
    "the bound on pairs": lambda r: verdict(r, paired=paired(r))["bound"].update(upper=0.01),
    "the p-value of pairs": lambda r: verdict(r, paired=paired(r))["pairs"].update(p_value=0.5),
    "fewer runs than there were": lambda r: verdict(r, case="corridor/free").update(
        run=2, planned=2, episodes=2
    ),
    "counterexamples in another order": lambda r: max(
        r["verdicts"], key=lambda one: len(one["counterexamples"])
    )["counterexamples"].reverse(),
    "a verdict twice": lambda r: r["verdicts"].append(r["verdicts"][-1]),
    "untested cells are left out": lambda r: r["coverage"].update(
        cells=[one for one in r["coverage"]["cells"] if one["verdict"]]
    ),
    "a fault that was not violated through": lambda r: episode(r, lambda one: one["faults"])[
        "faults"
    ][0].update(outcome="violated also without it"),
    "violations also without the faults": lambda r: verdict(
        r, requirement="GAP-1", case="corridor/nudged"
    ).update(also_without=0),
    "a fault that manifested": lambda r: episode(r, lambda one: one["case"] == "corridor/idle")[
        "faults"
    ][0].update(manifested_at=0.1),
    "other faults in the spec": lambda r: episode(r, lambda one: one["faults"])["spec"].update(
        faults=[]
    ),
    "another scenario": lambda r: r["episodes"][0]["spec"]["scenario"].update(name="corridor"),
    "times of a monitor": lambda r: r["monitors"][0].update(lead_times=[], lead_time=None),
    "another base seed": lambda r: r.update(base_seed=77),
    "an episode by hand as planned": lambda r: episode(r, lambda one: not one["planned"]).update(
        planned=True
    ),
    "an episode by hand twice": lambda r: r["episodes"].append(
        episode(r, lambda one: not one["planned"])
    ),
    "a violation without its trace": lambda r: episode(
        r, lambda one: one["trace"] and one["trace"]["kept_for"] == "violation"
    ).update(trace=None),
    "every trace is missing": lambda r: r.update(evidence_level="all"),
    "traces where there are none": lambda r: r.update(evidence_level="summary"),
    "the outcome of a traced episode": lambda r: episode(r, lambda one: one["trace"])["outcome"][
        "measures"
    ].update(clearance_time=0.01),
    "no inputs": lambda r: r.update(inputs=[]),
    "a reason of the gate is left out": lambda r: r["gate"].update(reasons=["something"]),
    "a number that is not finite": lambda r: r["timings"].update(simulated_seconds=float("inf")),
    "a larger plan, as if more runs had been saved": lambda r: verdict(
        r, requirement="SEQ-1", case="corridor/paired"
    ).update(planned=12, saved=7),
    "invalid runs of a test as valid ones": lambda r: valid_after_all(
        verdict(r, item="test_it.py::test_each_run")
    ),
    "a first violation after the end of the search": lambda r: first_of_search(r).update(
        {"GAP-1": 10**6}
    ),
    "an episode that a search chose as planned": plan_searched,
}


def valid_after_all(judged):
    assert (judged["run"], judged["invalid"], judged["episodes"]) == (2, 2, 0)
    judged |= {"episodes": 2, "invalid": 0}
    judged["bound"]["upper"] = upper_bound(0, 2, judged["bound"]["confidence"])


def first_of_search(record):
    """By the requirement, at which of its simulations a baseline violated it first."""
    search = next(each for each in record["searches"] if "test_search[" in each["item"])
    return search["baselines"][0]["first"]


def paired(record):
    return next(one["paired"] for one in record["verdicts"] if one["paired"])


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_what_follows_from_the_rest_is_computed_again(made, change):
    record = json.loads((made / "evidence.json").read_text())
    before = json.dumps(record)
    change(record)
    assert json.dumps(record) != before
    if not check_record(record):  # else there is nothing to count
        counted = conclude(SessionRecord.of(record, made), [Totals])
        record["totals"] = counted.head.totals.to_json()
    problems = problems_of(made, record)
    assert problems
    cut_short = (",", " the", " say", " valid", " planned")
    assert not [problem for problem in problems if problem.endswith(cut_short)]


def said_of(record, validity, **changes):
    """Change what a requirement of its case says of an episode of this validity."""
    found = episode(record, lambda one: one["validity"] == validity and one["verdicts"])
    next(iter(found["verdicts"].values())).update(changes)


def ask_more(record):
    asked = next(one for one in record["judgements"] if one["kind"] == "campaign")
    case = next(one for one in record["cases"] if one["id"] == asked["case"])
    asked["planned"] = case["planned"] + 1


def pass_what_its_check_violates(record):
    """A test that passed on an episode that violates the requirement's own check."""
    for judgement in record["judgements"]:
        if judgement["kind"] == "test":
            (run,) = judgement["runs"]
            found = episode(record, lambda one, run=run: one["digest"] == run["digest"])
            found["verdicts"][judgement["requirement"]] = {
                "status": "violated", "margin": -1.0, "time": 0.0, "detail": "", "vacuous": False,
            }  # fmt: skip
            run["verdict"] |= {"status": "satisfied", "margin": None, "time": None}
            return


INPUTS = {
    "more runs than its case has": ask_more,
    "an invalid run satisfies": lambda r: said_of(
        r, "invalid", status="satisfied", margin=1.0, time=None
    ),
    "a run that came to its end is open": lambda r: said_of(r, "valid", status="open"),
    "a whole run is missing": lambda r: said_of(r, "valid", status="missing", detail=""),
    "a violation after the end": lambda r: said_of(r, "valid", status="violated", time=1e6),
    "satisfied by less than nothing": lambda r: said_of(
        r, "valid", status="satisfied", margin=-1.0
    ),
    "violated, and vacuous": lambda r: said_of(r, "valid", status="violated", vacuous=True),
    "a requirement that its case does not declare": lambda r: episode(
        r, lambda one: one["verdicts"]
    )["verdicts"].update(NEW=next(iter(r["episodes"][0]["verdicts"].values()))),
    "a run that is not recorded": lambda r: next(one for one in r["judgements"] if one["runs"])[
        "runs"
    ][0].update(digest="0" * 64),
    "a test that passes what its check violates": pass_what_its_check_violates,
}


@pytest.mark.parametrize("change", INPUTS.values(), ids=list(INPUTS))
def test_inputs_may_not_contradict_each_other_though_all_else_follows_from_them(made, change):
    record = json.loads((made / "evidence.json").read_text())
    change(record)
    again = conclude_again(SessionRecord.of(record, made))
    # Reasons of the gate other than verdicts are kept, so that they stay there twice.
    assert [each for each in conclusion_problems(again) if "json: /gate/" not in each] == []
    assert list(record_problems(again)) != []


def run_of_another_case(record):
    """A campaign rests on a run of another case, which nothing violates."""
    asked = next(
        each for each in record["judgements"]
        if each["kind"] == "campaign" and each["runs"] and not each["twins"]
    )  # fmt: skip
    run = asked["runs"][0]
    other = episode(
        record,
        lambda one: (
            (one["spec"]["run"], one["validity"], one["planned"]) == (run["run"], "valid", True)
            and one["case"] != asked["case"]
        ),
    )
    run.update(digest=other["digest"], verdict=None)
    return f"{other['id']} is of the case {other['case']}, and not of {asked['case']}"


def rate_of_searched_runs(record):
    asked = next(each for each in record["judgements"] if each["kind"] == "campaign")
    asked["case"] += "@0123456789"
    return "a search chose the case, and no rate can be made of it"


def failed_twice(record):
    record["failed_items"] = [*record["failed_items"], record["failed_items"][0]]
    return "failed_items: not each of them once, in order"


@pytest.mark.parametrize("change", [run_of_another_case, rate_of_searched_runs, failed_twice])
def test_what_nothing_is_concluded_from_is_named(made, change):
    record = json.loads((made / "evidence.json").read_text())
    expected = change(record)
    told = list(record_problems(SessionRecord.of(record, made)))
    assert [problem for problem in told if problem.endswith(expected)], told


def names_it(name, field, kind):
    """Whether the name of a field, or of a kind of other value of it, is about this one."""
    return re.match(re.escape(name) + r"(?![\w*])", f"{field} ({kind})") is not None


def found_by(made, record):
    """What verify finds against a record first, formats aside; ``None`` for nothing.

    What is slow comes last: reading the traces.
    """
    if check_record(record):
        return "form"
    read = SessionRecord.of(record, made)
    read = read.changed(totals=conclude(read, [Totals]).head.totals)
    checks = {
        "contradiction": lambda: record_problems(read),
        "conclusion": lambda: conclusion_problems(read),
        "trace": lambda: trace_problems(read, {}),
    }
    try:
        return next(name for name, check in checks.items() if any(True for _ in check()))
    except StopIteration:
        return None
    except Exception:  # as verify reports it
        return "conclusion"


def found_in_totals(made, record):
    """What verify finds against totals that were not counted anew."""
    if check_record(record):
        return "form"
    return "conclusion" if [*conclusion_problems(SessionRecord.of(record, made))] else "nothing"


def test_one_forged_field_is_found_whatever_field_it_is(made):
    """Each field of the schema that this session fills, with each kind of other value.

    Where a field stands several times, it is enough that one of its places is found: not all
    verdicts rest on traces. What finds them is printed, and is the table of ``docs/trust.md``.
    """
    text = (made / "evidence.json").read_text()
    by_field = defaultdict(list)
    for forgery in forgeries(record_schema(), json.loads(text)):
        by_field[forgery.field, forgery.kind].append(forgery)
    free = {key: {name for name in free_names() if names_it(name, *key)} for key in by_field}
    claims = [
        key
        for key, names in free.items()
        if not names and key[0].partition(".")[0] != "totals"  # a forger counts anew
    ]
    assert [*trace_problems(SessionRecord.of(json.loads(text), made), {})] == []
    assert {name for names in free.values() for name in names} == {*free_names()}
    assert len(claims) > 350
    missed, table = [], defaultdict(Counter)
    for field, _ in by_field:
        table[field.partition(".")[0].partition("[")[0]]["values"] += 1
    for key in claims:
        places = by_field[key]
        for number in dict.fromkeys((0, len(places) - 1, len(places) // 2)):
            record = json.loads(text)
            places[number].apply(record)
            finder = found_by(made, record)
            if finder is not None:
                table[key[0].partition(".")[0].partition("[")[0]][finder] += 1
                break
        else:
            missed.append(key)
    for field, kind in by_field:
        if field.partition(".")[0] == "totals":
            record = json.loads(text)
            by_field[field, kind][0].apply(record)
            table["totals"][found_in_totals(made, record)] += 1
    rows = [*table_rows(table)]
    sys.stdout.write("".join(f"{row}\n" for row in rows))
    assert not missed, "\n".join(f"{field} ({kind})" for field, kind in missed)
    assert rows_of(PAGE.read_text("utf-8")) == rows, "`python tests/support/forged_fields.py`"


@pytest.mark.parametrize(
    "before, after",
    [
        ('"status": "complete"', '"status": "running", "status": "complete"'),
        ('"wall_seconds": ', '"wall_seconds": NaN, "wall_seconds_": '),
        ('"inputs": [', '"inputs": [' + "[" * 3000),
    ],
    ids=["a key twice", "NaN", "nested"],
)
def test_what_is_no_record_is_refused(made, tmp_path, before, after):
    text = (made / "evidence.json").read_text()
    assert before in text
    (tmp_path / "evidence.json").write_text(text.replace(before, after, 1))
    with pytest.raises(ConfigurationError, match="no evidence record"):
        open_record(tmp_path / "evidence.json")


TESTCASE = re.compile(r"<testcase .*?</testcase>", re.DOTALL)


@pytest.mark.parametrize("status", ["supported", "violated", "undecided"])
def test_a_junit_file_with_a_verdict_that_the_record_lacks_is_found(made, tmp_path, status):
    text = (made.parent / "junit.xml").read_text()
    assert verify_bundle(made, made.parent / "junit.xml").problems == []
    case = next(
        case for case in TESTCASE.findall(text) if f'name="verdict" value="{status}"' in case
    )
    invented = case.replace('name="requirement" value="', 'name="requirement" value="NEW-')
    (tmp_path / "junit.xml").write_text(text.replace(case, case + invented, 1))
    problems = verify_bundle(made, tmp_path / "junit.xml").problems
    assert problems
    assert any("and not in the record" in problem for problem in problems)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("name", ["evidence.json", "summary.md", "manifest.json", "trace"])
def test_a_pipe_in_place_of_a_file_blocks_nobody(made, tmp_path, name):
    bundle = shutil.copytree(made, tmp_path / "bundle")
    file = bundle / name if name != "trace" else next(bundle.glob("episodes/*"))
    file.unlink()
    os.mkfifo(file)
    assert not verify_bundle(bundle).intact
