"""``python -m pytest_dura merge``: parts of real sessions against the same sessions as a whole."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections import defaultdict
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest
from forging import forgeries
from sealing import seal

from pytest_dura.__main__ import main
from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import (
    Baseline,
    DirectoryLock,
    SessionRecord,
    check_record,
    file_entry,
    files_below,
    manifest_text,
    merge_bundles,
    open_record,
    record_problems,
    record_schema,
    verify_bundle,
    write_bundle,
)
from pytest_dura.evidence import bundle as bundle_directory
from pytest_dura.evidence.files import listed_files
from pytest_dura.evidence.verify import conclude_again

PROJECT = Path(__file__).with_name("project")
TESTS = """
import pytest

@pytest.mark.dura(scenario="corridor/*")
@pytest.mark.requirement("GAP-1")
def test_each_run(episode):
    assert not episode.collided

@pytest.mark.xfail(reason="known: the wall is near")
@pytest.mark.dura(scenario="corridor/tight")
@pytest.mark.requirement("GAP-1")
def test_tight(campaign):
    campaign.require()

@pytest.mark.dura(scenario="corridor/drift*", runs=3)
@pytest.mark.requirement("PAIR-1", text="No worse for the faults.", kind="security")
def test_pairs(campaign):
    campaign.paired(without="faults").require("always (gap > -1)")

def test_by_hand(orchestrator):
    orchestrator.run("corridor/free")
    orchestrator.run("corridor/drift", seed=7)
"""
DRIFT = """
name: corridor/drift
simulator: corridor:Corridor
duration: 1.0
runs: 3
world: {wall: 4.0}
roles: {generator: "corridor:Careful",
        fault_injector: "pytest_dura.faults.injector:CampaignInjector"}
faults: [{type: bias, target: gap, activation: {at: 0.1}, parameters: {offset: 0.1}}]
requirements: [GAP-1]
"""
HAZARDS = """
hazards:
  - {id: H-1, text: It touches the wall., loss: "L-1: the wall", severity: S1}
  - {id: H-2, text: It stands in the way., loss: "L-2: the others' time"}
"""
RUN = """
import json, sys
import pytest
for arguments in json.loads(sys.argv[-1]):
    code = pytest.main(arguments)
    print("EXIT", int(code), file=sys.stderr)
"""
ARGUMENTS = ["-q", "-p", "no:cacheprovider", "-p", "no:unraisableexception", "test_it.py",
             "--dura-scenarios", "--dura-select=corridor/*",
             "--dura-generator=corridor:Reckless"]  # fmt: skip
COUNTS = (1, 2, 3)
SELECTIONS = {
    "runs": "test_each_run or tight", "rest": "not test_each_run", "some": "pairs or free or hand",
}  # fmt: skip
"""Names of sessions and what they select with ``-k``; the first two are the whole together."""


@pytest.fixture(scope="module")
def made(tmp_path_factory, forked_workers):
    """A session with verdicts of each word, faults, pairs and a waiver, whole and in N shards."""
    folder = tmp_path_factory.mktemp("merged")
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    (folder / "test_it.py").write_text(TESTS)
    (folder / "scenarios/corridor/drift.yaml").write_text(DRIFT)
    (folder / "scenarios/hazards.yaml").write_text(HAZARDS)
    requirements = folder / "scenarios/requirements.yaml"
    requirements.write_text(
        requirements.read_text().replace("kind: safety\n", "kind: safety\n    mitigates: [H-1]\n")
    )
    scenario = (folder / "scenarios/corridor/free.yaml").read_text()
    broken = scenario.replace("corridor:Watch", "corridor:Broken")
    (folder / "scenarios/corridor/broken.yaml").write_text(
        broken.replace("corridor/free", "corridor/broken")
    )
    sessions = [[*ARGUMENTS, "--dura-evidence=whole"]]
    sessions += [
        [*ARGUMENTS, f"--dura-shard={index}/{count}", f"--dura-evidence=of-{count}/{index}"]
        for count in COUNTS
        for index in range(1, count + 1)
    ]
    sessions += [
        [*ARGUMENTS, "-k", chosen, f"--dura-evidence={name}"] for name, chosen in SELECTIONS.items()
    ]
    sessions.append([*ARGUMENTS[:6], "-k", "nothing", "--dura-shard=1/1", "--dura-evidence=none"])
    sessions += [
        [
            *ARGUMENTS[:6],
            "-k",
            "nothing",
            f"--dura-shard={index}/2",
            f"--dura-evidence=idle/{index}",
        ]
        for index in (1, 2)
    ]
    # In the middle of the plan, other runs are planned: the second shard of another session.
    sessions.append([*ARGUMENTS, "--dura-runs=1", "--dura-shard=2/2", "--dura-evidence=other"])
    environment = {name: one for name, one in os.environ.items() if name != "PYTEST_ADDOPTS"}
    (folder / "run.py").write_text(RUN)
    found = subprocess.run(
        forked_workers.command("run.py", json.dumps(sessions)), cwd=folder, env=environment,
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    codes = [line for line in found.stderr.splitlines() if line.startswith("EXIT")]
    assert len(codes) == len(sessions), found.stdout[-3000:] + found.stderr[-3000:]
    assert codes[0] == "EXIT 1"
    return folder


def of(made, count):
    return [made / f"of-{count}" / str(index) for index in range(1, count + 1)]


@pytest.fixture
def two(made, tmp_path):
    """Copies of two shards, to be spoilt."""
    return [shutil.copytree(one, tmp_path / f"in-{one.name}") for one in of(made, 2)]


def comparable(folder):
    """All of a record that does not tell who ran it, where, when, and how fast."""
    record = json.loads((folder / "evidence.json").read_text())
    for name in ("created", "finished", "command", "environment", "timings", "shard",
                 "merged_from"):  # fmt: skip
        del record[name]
    del record["resume"]["session"], record["execution"]["chosen"]
    for episode in record["episodes"]:
        del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
    return record


def rewritten(folder, change):
    """The bundle after a change to its record, with everything rendered from it anew."""
    record = json.loads((folder / "evidence.json").read_text())
    change(record)
    if not check_record(record):
        write_bundle(SessionRecord.of(record, folder))
        return
    names = listed_files(folder)  # what is not valid cannot be rendered
    (folder / "evidence.json").write_text(json.dumps(record, indent=1))
    entries = {name: file_entry(folder / name) for name in names}
    (folder / "manifest.json").write_text(manifest_text(entries))


def replace_episode(record, other):
    """Put another episode in the place of that with its id, and of its seed."""
    episodes = [
        one
        for one in record["episodes"]
        if (one["id"], one["seed"]) != (other["id"], other["seed"])
    ]
    record["episodes"] = sorted(
        [*episodes, other],
        key=lambda one: (one["case"], one["component"], one["spec"]["run"], one["seed"]),
    )


def refused(bundles, output, *words):
    with pytest.raises(ConfigurationError) as told:
        merge_bundles(bundles, output)
    for word in words:
        assert word in str(told.value)
    assert not output.exists() or not any(output.iterdir())
    return told.value


@pytest.mark.parametrize("count", COUNTS)
def test_all_shards_come_to_what_the_session_comes_to(made, tmp_path, count):
    output = tmp_path / "out"
    merged = merge_bundles(of(made, count), output)
    assert merged.gate.result == "failed"
    whole = comparable(made / "whole")
    found = comparable(output)
    assert found["gate"] == whole["gate"]
    assert {one["verdict"] for one in found["verdicts"]} == {"supported", "violated", "undecided"}
    assert sum(one["waiver"] is not None for one in found["verdicts"]) == 1
    for key in whole:
        assert found[key] == whole[key], key
    assert verify_bundle(output).problems == []
    record = json.loads((output / "evidence.json").read_text())
    assert record["shard"] is None
    assert [one["index"] for one in record["merged_from"]] == list(range(1, count + 1))
    shards = [json.loads((one / "evidence.json").read_text()) for one in of(made, count)]
    assert record["created"] == min(one["created"] for one in shards)
    assert record["finished"] == max(one["finished"] for one in shards)
    assert [one["command"] for one in record["merged_from"]] == [one["command"] for one in shards]


def test_hazards_of_all_shards_are_those_of_the_whole_and_may_not_differ(made, two, tmp_path):
    merge_bundles(two, tmp_path / "merged")
    assert not (tmp_path / "merged/needs.json").exists()
    assert main(["export", "needs", str(tmp_path / "merged")]) == 0
    record = json.loads((tmp_path / "merged/evidence.json").read_text())
    assert [hazard["id"] for hazard in record["hazards"]] == ["H-1", "H-2"]
    listed = {each["id"]: each.get("mitigates") for each in record["requirements"]}
    assert listed["GAP-1"] == ["H-1"]
    assert listed["GO-1"] == []
    needs = json.loads((tmp_path / "merged/needs.json").read_text())["versions"]["1.0"]["needs"]
    assert needs["HAZARD-H-1"]["status"] == "violated"
    assert needs["HAZARD-H-2"]["status"] == "no requirement"

    def worse(record):
        record["hazards"][0]["severity"] = "S3"

    rewritten(two[1], worse)
    refused(two, tmp_path / "out", "not made alike", "hazards H-1.severity", "S3")


def test_what_two_shards_told_of_an_episode_comes_from_one_of_them(two, tmp_path):
    """A test ran it by itself, on a slower machine: its events differ, and so does its trace."""
    hand, held = sorted(two, key=lambda one: "corridor/free" in str(
        json.loads((one / "evidence.json").read_text())["shard"]["holds"]))  # fmt: skip
    own = {one.id: one for one in open_record(held / "evidence.json").episodes()}["corridor/free#0"]
    slow = {"tick": 1, "time": 0.1, "kind": "timeout", "subject": "x", "detail": "", "data": {}}
    name = own.trace.file
    other = {
        **own.to_json(),
        "events": [slow],
        "trace": own.trace.to_json() | {"kept_for": "sample"},
    }
    (hand / name).write_bytes(b"as slow as that")
    other["trace"] |= file_entry(hand / name)

    def change(record):
        replace_episode(record, other)

    rewritten(hand, change)
    assert own.trace.kept_for == "violation"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            "pytest_dura.evidence.parts.verify_bundle",
            lambda _: type("", (), {"intact": 1}),
        )
        merge_bundles(two, tmp_path / "out")
    found = {one.id: one for one in open_record(tmp_path / "out/evidence.json").episodes()}
    assert found["corridor/free#0"].events == own.events
    assert found["corridor/free#0"].trace == own.trace
    assert verify_bundle(tmp_path / "out").problems == []


def test_the_order_of_the_bundles_does_not_matter(made, tmp_path):
    written = set()
    for number, bundles in enumerate([*permutations(of(made, 3))][::3]):
        merge_bundles(bundles, tmp_path / str(number))
        text = (tmp_path / str(number) / "evidence.json").read_text()
        written.add(text.replace(str(tmp_path / str(number)), "OUT"))
    assert len(written) == 1


def test_great_records_are_merged_a_few_episodes_at_a_time(made, tmp_path, monkeypatch):
    merge_bundles(of(made, 2), tmp_path / "a")
    monkeypatch.setattr(bundle_directory, "STREAMED_BYTES", 0)
    monkeypatch.setattr(bundle_directory, "_read_record", None)  # which reads all of it
    merge_bundles(of(made, 2), tmp_path / "b")
    assert comparable(tmp_path / "a") == comparable(tmp_path / "b")


def test_the_whole_passes_only_if_nothing_in_any_shard_speaks_against_it(made, tmp_path, capsys):
    output = str(tmp_path / "out")
    assert main(["merge", *map(str, of(made, 2)), "--output", output]) == 1
    told = capsys.readouterr().out
    assert "GAP-1 on corridor/free is violated" in told
    assert "gate of the whole: failed" in told


CODES = {
    (0, 0): (0, "passed"),
    (0, 6): (6, "failed"),
    (6, 6): (6, "failed"),
    (6, 7): (1, "failed"),
    (5, 5): (5, "failed"),
    (0, 5): (1, "failed"),
    (5, 7): (7, "failed"),
}


@pytest.mark.parametrize("codes, whole", CODES.items(), ids=str)
def test_the_whole_fails_if_any_shard_did_whatever_its_exit_code(made, tmp_path, codes, whole):
    """Of shards with nothing to run, as if plugins had ended them with these codes."""
    bundles = [shutil.copytree(made / f"idle/{index}", tmp_path / str(index)) for index in (1, 2)]
    for folder, code in zip(bundles, codes, strict=True):
        reasons = [f"pytest ended with exit code {code}"] if code not in (0, 5) else []
        gate = {
            "result": "failed" if code else "passed", "exit_code": code,
            "reasons": ["no test was run"] if code == 5 else reasons,
        }  # fmt: skip

        def end(record, gate=gate):
            record["gate"].update(gate)
            record["totals"]["gate"] = gate["result"]

        rewritten(folder, end)
    merge_bundles(bundles, tmp_path / "out")
    gate = open_record(tmp_path / "out/evidence.json").head.gate
    assert (gate.exit_code, gate.result) == whole
    assert bool(gate.reasons) == (whole[1] == "failed")


def test_what_stood_against_a_shard_stands_against_the_whole(two, tmp_path):
    against = [f"infrastructure: the disk of {folder.name} was full" for folder in two]
    for folder, reason in zip(two, against, strict=True):
        rewritten(folder, lambda record, reason=reason: record["gate"]["reasons"].append(reason))
    assert {*against} <= {*merge_bundles(two, tmp_path / "out").gate.reasons}


MERGED = {
    ("created", "other"), ("finished", "other"), ("merged_from", "fewer"),
    ("merged_from[].index", "other"), ("merged_from[].count", "other"),
    ("merged_from[].plan", "other"), ("merged_from[].created", "other"),
    ("merged_from[].finished", "other"),
}  # fmt: skip
"""What a merged record says of its shards, and of which it says something else besides."""


def test_one_forged_field_of_a_merged_record_is_found(two, tmp_path):
    for index, folder in enumerate(two):
        # Of two shards of one second, neither is the one whose times are those of the whole.
        rewritten(
            folder,
            lambda record, second=index: record.update(
                created=f"2026-01-01T00:00:0{second}+00:00",
                finished=f"2026-01-01T00:01:0{second}+00:00",
            ),
        )
    output = tmp_path / "out"
    merge_bundles(two, output)
    text = (output / "evidence.json").read_text()
    by_field = defaultdict(list)
    for forgery in forgeries(record_schema(), json.loads(text)):
        by_field[forgery.field, forgery.kind].append(forgery)
    for key in sorted(MERGED):
        refuted = []
        for forgery in by_field[key]:
            record = json.loads(text)
            forgery.apply(record)
            forged = None if check_record(record) else SessionRecord.of(record, output)
            refuted.append(forged is None or next(record_problems(forged), None))
        assert any(refuted), key


def test_replay_and_baseline_take_the_merged_bundle(made, tmp_path, pytester, monkeypatch):
    merge_bundles(of(made, 2), tmp_path / "out")
    assert Baseline.read(str(tmp_path / "out"), tmp_path).claims
    monkeypatch.chdir(made)
    result = pytester.runpytest_inprocess(
        f"--rootdir={made}", "-c", str(made / "pytest.ini"), "--dura-replay=corridor/free#1",
        f"--dura-evidence={tmp_path / 'out'}",
    )  # fmt: skip
    assert result.ret == 0
    assert "  the same" in result.outlines


def test_the_whole_is_held_against_a_baseline_and_no_shard(made, tmp_path, capsys):
    bundles, baseline = list(map(str, of(made, 2))), str(made / "whole")
    asked = ["merge", *bundles, "--baseline", baseline]
    assert main([*asked, "--output", str(tmp_path / "out")]) == 1
    record = json.loads((tmp_path / "out/evidence.json").read_text())
    words = {one["status"] for one in record["baseline"]["comparisons"]}
    assert words == {"unchanged", "not comparable"} or "worse" not in words
    assert len(record["baseline"]["comparisons"]) == len(record["verdicts"])
    assert [one["path"] for one in record["inputs"] if one["kind"] == "baseline"] == [baseline]
    assert verify_bundle(tmp_path / "out").problems == []
    assert main([*asked, "--baseline-worse=fail", "--output", str(tmp_path / "fail")]) == 1
    assert "nothing in this session can be compared" not in capsys.readouterr().out
    assert main(["merge", *bundles, "--baseline-worse=fail", "--output", str(tmp_path / "x")]) == 2
    assert "--baseline-worse is about a baseline" in capsys.readouterr().err


def test_a_shard_that_is_missing_is_named(made, tmp_path):
    bundles = of(made, 3)
    del bundles[1]
    refused(bundles, tmp_path / "out", "shard 2 of 3 is missing", "=2/3")


def test_several_missing_shards_are_named(made, tmp_path):
    refused(of(made, 3)[1:2], tmp_path / "out", "shards 1, 3 of 3 are missing")


def test_of_very_many_missing_shards_the_first_are_named(two, tmp_path):
    for one in two:
        rewritten(one, lambda record: put(record, 10**15, "shard", "count"))
    refused(two, tmp_path / "out", "shards 3, 4, 5, 6, 7, 8, 9, 10 and more of 1000000000000000")


def test_a_number_that_is_no_integer_is_refused(two, tmp_path):
    rewritten(two[1], lambda record: put(record, 2.0, "shard", "count"))
    refused(two, tmp_path / "out", "is not intact", "/shard/count: found")


def test_a_shard_that_is_there_twice_counts_once(made, two, tmp_path):
    merge_bundles(of(made, 2), tmp_path / "once")
    merge_bundles([*of(made, 2), two[1]], tmp_path / "twice")
    assert comparable(tmp_path / "twice") == comparable(tmp_path / "once")
    parts = [json.loads((tmp_path / name / "evidence.json").read_text())["merged_from"]
             for name in ("once", "twice")]  # fmt: skip
    assert parts[0] == parts[1]


@pytest.mark.parametrize("name", ["evidence.json", "summary.md", "episodes"])
def test_a_shard_that_was_changed_is_refused(two, tmp_path, name):
    file = two[1] / name
    file = min(file.iterdir()) if file.is_dir() else file
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    refused(two, tmp_path / "out", "is not intact", str(two[1]), "verify")


def test_shards_of_other_plans_are_refused(made, tmp_path):
    first, second = of(made, 2)
    error = refused([first, made / "other"], tmp_path / "out", "part of another session")
    assert (error.key, error.file) == ("shard.plan", str(made / "other/evidence.json"))
    refused([first, of(made, 3)[1]], tmp_path / "out", "shard.count")
    assert second


# -- Parts that overlap ------------------------------------------------------------------------


def merged(bundles, output):
    merge_bundles(bundles, output)
    assert verify_bundle(output).problems == []
    return comparable(output)


@pytest.mark.parametrize(
    "names",
    [["runs", "rest"], ["some", "rest", "runs"], ["whole"], ["whole", "some"],
     ["of-2/2", "whole", "of-2/1"], ["runs", "of-3/1", "rest", "of-3/3", "of-3/2"]],
    ids=" ".join,
)  # fmt: skip
def test_parts_come_to_the_whole_record_for_record_however_they_overlap(made, tmp_path, names):
    found, whole = (
        merged([made / name for name in names], tmp_path / "out"),
        comparable(made / "whole"),
    )
    for key in whole:
        assert found[key] == whole[key], key


def test_a_part_alone_leaves_out_what_it_did_not_run(made, tmp_path):
    found, some = merged([made / "some"], tmp_path / "out"), comparable(made / "some")
    assert found == some
    assert found["selection"]["asked"] < found["selection"]["planned"]
    assert len(found["verdicts"]) < len(comparable(made / "whole")["verdicts"])


def test_a_bundle_merged_with_itself_or_with_its_parts_is_the_bundle(made, tmp_path):
    once, own = tmp_path / "once", tmp_path / "own"
    merge_bundles(of(made, 2), once)
    twice = shutil.copytree(once, tmp_path / "copy")
    merge_bundles([once, twice, made / "of-2/2"], own)
    texts = [(folder / "evidence.json").read_text() for folder in (once, own)]
    assert texts[0].replace(str(once), "OUT") == texts[1].replace(str(own), "OUT")


def test_merging_is_associative_and_commutative(made, tmp_path):
    parts = {name: made / name for name in ("runs", "rest", "some")}
    merge_bundles(parts.values(), tmp_path / "at-once")
    written = {_written(tmp_path / "at-once")}
    for last, bundle in parts.items():  # whichever began between the two others
        pair, output = tmp_path / f"without-{last}", tmp_path / f"{last}-last"
        merge_bundles([parts[name] for name in parts if name != last], pair)
        merge_bundles([bundle, pair] if last == "rest" else [pair, bundle], output)
        written.add(_written(output))
    assert len(written) == 1


def _written(bundle):
    return (bundle / "evidence.json").read_text().replace(str(bundle), "OUT")


def test_merged_bundles_that_share_a_session_are_refused(made, tmp_path):
    merge_bundles([made / "runs", made / "rest"], tmp_path / "1")
    merge_bundles([made / "rest", made / "some"], tmp_path / "2")
    refused([tmp_path / "1", tmp_path / "2"], tmp_path / "out", "share a session", "themselves")


def test_an_episode_that_two_parts_have_with_other_digests_is_refused(made, tmp_path, monkeypatch):
    parts = [shutil.copytree(made / name, tmp_path / name) for name in ("whole", "some")]
    own = {one.id: one for one in open_record(parts[0] / "evidence.json").episodes()}
    digest = own["corridor/free#1"].digest
    other = {**own["corridor/free#1"].to_json(), "digest": "0" * 64, "trace": None}
    rewritten(parts[1], lambda record: replace_episode(record, other))
    # The forged digest is found before; here two machines are to differ.
    monkeypatch.setattr(
        "pytest_dura.evidence.parts.verify_bundle", lambda _: type("", (), {"intact": 1})
    )
    error = refused(parts, tmp_path / "out", "corridor/free#1", "differently in two parts")
    assert all(text in str(error) for text in (digest, "0" * 64))
    for folder in parts:
        assert str(folder / "evidence.json") in str(error)
    assert "--dura-replay" in error.remedy


def cut(folder, target, case, kept, only=None, **changes):
    """A copy of a bundle that has some runs of a case, and concludes from these.

    With ``only``, this item alone asked something of them.
    """
    shutil.copytree(folder, target)
    record = json.loads((target / "evidence.json").read_text())
    record["episodes"] = [
        one for one in record["episodes"]
        if one["case"] != case or not one["planned"] or one["spec"]["run"] in kept
    ]  # fmt: skip
    for judgement in record["judgements"]:
        if judgement["case"] == case and judgement["kind"] != "claim":
            judgement["runs"] = [run for run in judgement["runs"] if run["run"] in kept]
            judgement.update(changes if judgement["kind"] == "campaign" else {})
    record["judgements"] = [
        one for one in record["judgements"]
        if (one["runs"] or one["kind"] != "test")
        and (only is None or one["case"] != case or one["item"] == only or one["kind"] == "claim")
    ]  # fmt: skip
    for plan in record["cases"]:
        if plan["id"] == case and 0 not in kept:
            plan["repeat"] = None
    record["gate"]["reasons"] = []
    concluded = conclude_again(SessionRecord.of(record, target))
    written = write_bundle(conclude_again(concluded))  # its gate follows from its verdicts
    assert verify_bundle(target).problems == []
    return written


def verdict_of(record, item):
    (verdict,) = (one for one in record.head.verdicts if one.item == item)
    return verdict


def test_parts_of_a_campaign_come_to_its_verdict_or_say_what_is_missing(made, tmp_path):
    whole = open_record(made / "whole/evidence.json")
    case, item = "corridor/free", "corridor/free::GO-1"
    runs = sorted({one.spec.run for one in whole.episodes() if one.case == case and one.planned})
    assert len(runs) >= 3
    first, last = tmp_path / "first", tmp_path / "last"
    cut(made / "whole", first, case, runs[:1])
    end = cut(made / "whole", last, case, runs[2:])
    assert "runs 0 to 1 are missing" in verdict_of(end, item).reason
    assert verdict_of(end, item).verdict == "undecided"
    merge_bundles([last, first], tmp_path / "gap")
    gap = open_record(tmp_path / "gap/evidence.json")
    assert "run 1 is missing" in verdict_of(gap, item).reason
    assert not verdict_of(gap, item).too_few
    assert "run 1 is missing" in (tmp_path / "gap/report.html").read_text()
    rest = tmp_path / "rest"
    cut(made / "whole", rest, case, runs[1:])
    merged = tmp_path / "merged"
    merge_bundles([rest, first], merged)
    found, expected = comparable(merged), comparable(made / "whole")
    for key in ("verdicts", "judgements", "episodes", "cases", "totals", "coverage", "overall"):
        assert found[key] == expected[key], key


def test_runs_beyond_the_decision_are_named_and_enter_nothing(made, tmp_path, capsys):
    case, item, both = "corridor/free", "corridor/free::GAP-1", {"until_decided": True}
    runs = range(5)
    ahead = cut(made / "whole", tmp_path / "ahead", case, runs, **both)
    short = cut(made / "whole", tmp_path / "short", case, [0], **both)
    verdict, alone = verdict_of(ahead, item), verdict_of(short, item)
    assert (verdict.verdict, verdict.run) == ("violated", 1)
    assert verdict.beyond_plan
    assert replace(verdict, beyond_plan=()) == alone
    sentence = "beyond the decision after 1 and enter"
    for name in ("summary.md", "report.html"):
        assert sentence in " ".join((tmp_path / "ahead" / name).read_text().split())
        assert sentence not in (tmp_path / "short" / name).read_text()
    alone = {
        name: cut(made / "whole", tmp_path / f"{name}-alone", case, kept, only=item, **both).head
        for name, kept in (("ahead", runs), ("short", [0]))
    }
    assert alone["ahead"].totals.episodes > alone["short"].totals.episodes
    for key in ("cases", "overall", "coverage", "effectiveness", "conclusions"):
        assert getattr(alone["ahead"], key) == getattr(alone["short"], key), key
    merge_bundles([tmp_path / "short", tmp_path / "ahead"], tmp_path / "out")
    merged = open_record(tmp_path / "out/evidence.json")
    assert verdict_of(merged, item) == verdict


def test_an_interrupted_shard_is_refused(two, tmp_path):
    def change(record):
        record["status"] = "interrupted"
        record["gate"] |= {"result": "incomplete", "exit_code": 2, "reasons": ["interrupted"]}
        record["totals"]["gate"] = "incomplete"

    rewritten(two[1], change)
    refused(two, tmp_path / "out", "the session is interrupted", "run the shard again")


def put(record, value, *path):
    for key in path[:-1]:
        record = record[key]
    record[path[-1]] = value


def put_input(record, kind, value):
    next(one for one in record["inputs"] if one["kind"] == kind)["sha256"] = value


CHANGES = {
    "environment.packages.numpy": lambda record: put(
        record, "0.0.1", "environment", "packages", "numpy"
    ),
    "tool.code": lambda record: put(record, "0" * 64, "tool", "code"),
    "environment.python": lambda record: put(record, "3.99.0", "environment", "python"),
    "environment.git.commit": lambda record: put(record, "a" * 40, "environment", "git", "commit"),
    "options.--dura-time-budget": lambda record: put(
        record, '"3"', "options", "--dura-time-budget"
    ),
    "base_seed": lambda record: put(record, 7, "base_seed"),
    "component_under_test Reckless.digest": lambda record: put(
        record, "0" * 64, "component_under_test", "digest"
    ),
    "requirements GAP-1.text": lambda record: put(
        record, "Another text.", "requirements", 0, "text"
    ),
    "inputs scenario scenarios/corridor/broken.yaml": lambda record: put_input(
        record, "scenario", "0" * 64
    ),
    "gate.warn_undecided": lambda record: put(record, True, "gate", "warn_undecided"),
    "evidence_level": lambda record: put(record, "all", "evidence_level"),
}


@pytest.mark.parametrize("key", CHANGES)
def test_shards_that_were_not_made_alike_are_refused(two, tmp_path, key, monkeypatch):
    rewritten(two[1], CHANGES[key])
    # Of some of these verify says itself that they cannot be; here it is to be the merge.
    monkeypatch.setattr(
        "pytest_dura.evidence.parts.verify_bundle", lambda _: type("", (), {"intact": 1})
    )
    error = refused(two, tmp_path / "out", "were not made alike")
    assert (error.key, error.file) == (key, str(two[1] / "evidence.json"))
    assert str(two[0] / "evidence.json") in error.expected
    assert error.remedy


@pytest.mark.parametrize("kind, path", [("conftest", "conftest.py"), ("configuration", "a.ini")])
def test_a_file_that_only_one_shard_saw_is_refused(two, tmp_path, kind, path):
    """A conftest may choose the component under test, in the shard where it is there."""
    one = {"path": path, "kind": kind, "sha256": "0" * 64, "changed": False}

    def change(record):
        record["inputs"].append(one)
        record["inputs"].sort(key=lambda one: str((one["path"], one["kind"], one["sha256"])))

    rewritten(two[1], change)
    error = refused(two, tmp_path / "out", "were not made alike")
    assert (error.key, error.file) == (f"inputs {kind} {path}", str(two[0] / "evidence.json"))
    assert str(two[1] / "evidence.json") in error.expected


def test_a_conftest_of_a_folder_that_a_shard_runs_nothing_of_is_its_own(two, tmp_path):
    one = {"path": "far/conftest.py", "kind": "conftest", "sha256": "0" * 64, "changed": False}
    rewritten(two[1], lambda record: record["inputs"].insert(0, one))
    merge_bundles(two, tmp_path / "out")


def test_another_version_of_the_tool_is_refused(two, tmp_path):
    for one in two:
        rewritten(one, lambda record: put(record, "99.0", "tool", "version"))
    refused(two, tmp_path / "out", "another version", "99.0")


def test_other_code_of_the_same_version_is_refused(two, tmp_path):
    for one in two:
        rewritten(one, lambda record: put(record, "0" * 64, "tool", "code"))
    error = refused(two, tmp_path / "out", "other code of pytest-dura")
    assert (error.key, error.found) == ("tool.code", "0" * 64)


def test_machines_may_differ_and_are_told(two, tmp_path):
    def change(record):
        record["environment"] |= {"platform": "Elsewhere", "cpu_features": ["NEON"]}

    rewritten(two[1], change)
    merge_bundles(two, tmp_path / "out")
    record = json.loads((tmp_path / "out/evidence.json").read_text())
    assert [one["environment"]["platform"] == "Elsewhere" for one in record["merged_from"]] == [
        False, True,
    ]  # fmt: skip
    assert "2 shards, in environments that differ" in (tmp_path / "out/summary.md").read_text()
    assert "Elsewhere" in (tmp_path / "out/report.html").read_text()


def test_units_that_two_shards_hold_instead_of_others_are_missed(two, tmp_path):
    first = json.loads((two[0] / "evidence.json").read_text())["shard"]["holds"]

    def change(record):
        held = [*record["shard"]["holds"][1:], first[0]]
        record["shard"]["holds"] = sorted(held, key=lambda one: (one["kind"], one["name"]))

    rewritten(two[1], change)
    refused(two, tmp_path / "out", "do not hold what the whole session was to run")


def test_units_that_no_shard_holds_are_missed(two, tmp_path):
    rewritten(two[1], lambda record: record["shard"]["holds"].pop())
    refused(two, tmp_path / "out", "do not hold what the whole session was to run")


# -- What is hostile, and where it goes -------------------------------------------------------


def test_a_trace_that_leads_out_of_the_bundle_is_not_followed(two, tmp_path):
    (tmp_path / "evil.mcap").write_bytes(b"evil")
    record = json.loads((two[0] / "evidence.json").read_text())
    traced = next(one for one in record["episodes"] if one["trace"])
    traced["trace"]["file"] = "episodes/../../evil.mcap"
    (two[0] / "evidence.json").write_text(json.dumps(record, indent=1) + "\n")
    seal(two[0])
    refused(two, tmp_path / "out", "is not intact")


@pytest.mark.parametrize("name", ["evidence.json", "episodes"])
def test_links_are_not_followed(two, tmp_path, name):
    file = two[0] / name
    file = min(file.iterdir()) if file.is_dir() else file
    file.rename(tmp_path / "elsewhere")
    file.symlink_to(tmp_path / "elsewhere")
    refused(two, tmp_path / "out", "is not intact")


@pytest.mark.parametrize(
    "text",
    ["", "[" * 100_000, '{"schema_version": "3", "episodes": 3}', '{"a": 1, "a": 2}', "\udcff"],
    ids=range(5),
)
def test_a_record_that_is_none_is_refused(two, tmp_path, text):
    (two[0] / "evidence.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    seal(two[0])
    refused(two, tmp_path / "out", "is not intact")


def test_a_trace_that_changes_while_it_is_copied_is_refused(two, tmp_path, monkeypatch):
    def verified(folder):
        found = verify_bundle(folder)
        trace = min((folder / "episodes").iterdir())
        trace.write_bytes(trace.read_bytes() + b"!")
        return found

    monkeypatch.setattr("pytest_dura.evidence.parts.verify_bundle", verified)
    with pytest.raises(ConfigurationError, match="a trace changed while it was copied"):
        merge_bundles(two, tmp_path / "out")
    # What is there says that it was not finished.
    left = json.loads((tmp_path / "out/evidence.json").read_text())
    assert (left["status"], left["gate"]["result"]) == ("running", "incomplete")


def test_nothing_is_written_over(two, tmp_path, capsys):
    held = tmp_path / "held"
    held.mkdir()
    (held / "mine.txt").write_text("mine")
    before = {name: file_entry(two[0] / name) for name in files_below(two[0])}
    for output in (held, two[0], two[0] / "inside", tmp_path, held / "mine.txt"):
        assert main(["merge", *map(str, two), "--output", str(output)]) == 2
        assert "--output" in capsys.readouterr().err
    assert (held / "mine.txt").read_text() == "mine"
    assert {name: file_entry(two[0] / name) for name in files_below(two[0])} == before


def test_two_merges_at_once_do_not_write_one_directory(two, tmp_path):
    lock = DirectoryLock(tmp_path / "out")
    try:
        with pytest.raises(ConfigurationError, match="another session"):
            merge_bundles(two, tmp_path / "out")
    finally:
        lock.release()
    merge_bundles(two, tmp_path / "out")


def test_a_wrong_call_is_told(tmp_path, capsys):
    assert main(["merge", str(tmp_path / "nowhere"), "--output", str(tmp_path / "out")]) == 2
    assert "there is no such directory" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["merge", "a"])
    assert ended.value.code == 2


def test_a_session_that_selects_nothing_passes_in_no_way(made, tmp_path):
    merged = merge_bundles([made / "none"], tmp_path / "out")
    assert merged.gate.reasons == ("no test was run",)
    assert merged.gate.result == "failed"
