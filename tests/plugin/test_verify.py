"""`python -m pytest_dura verify` on a real bundle, and on what has been done to copies of it.

Each copy gets a fresh manifest, so that its hashes are true: what finds the difference is that the
bundle contradicts itself.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from sealing import alter, seal

from pytest_dura.__main__ import main
from pytest_dura.evidence import (
    MANIFEST_FILE,
    SessionRecord,
    file_entry,
    manifest_text,
    verify_bundle,
    write_bundle,
)
from pytest_dura.evidence.verify import conclude_again

PROJECT = Path(__file__).with_name("project")
WAIVED = """
import pytest
@pytest.mark.xfail(reason="known: the wall is near")
@pytest.mark.dura(scenario="corridor/tight")
@pytest.mark.requirement("GAP-1")
def test_tight(campaign):
    campaign.require()
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory, forked_workers):
    """A session with supported, violated and undecided verdicts, and traces of its violations."""
    folder = tmp_path_factory.mktemp("verified")
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    (folder / "test_tight.py").write_text(WAIVED)
    scenario = (folder / "scenarios/corridor/free.yaml").read_text()
    broken = scenario.replace("corridor:Watch", "corridor:Broken")
    broken = broken.replace("corridor/free", "corridor/broken")
    (folder / "scenarios/corridor/broken.yaml").write_text(broken)
    environment = {name: one for name, one in os.environ.items() if name != "PYTEST_ADDOPTS"}
    found = subprocess.run(
        [*forked_workers.command("-m", "pytest"), "-q", "-p", "no:cacheprovider", "test_tight.py",
         "--dura-scenarios", "--dura-select=corridor/*", "--dura-generator=corridor:Reckless",
         "--junit-xml=junit.xml", "--dura-export=cyclonedx", "--dura-export=in-toto"],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert found.returncode == 1, found.stdout + found.stderr
    return folder / "dura-evidence"


@pytest.fixture
def bundle(made, tmp_path):
    return shutil.copytree(made, tmp_path / "bundle")


def sealed(bundle):
    """A manifest that agrees with whatever lies there now."""
    seal(bundle)
    return verify_bundle(bundle)


def changed(bundle, change):
    """The bundle after a change to its record."""
    alter(bundle, change)
    return verify_bundle(bundle)


def test_the_bundle_of_a_session_is_intact(made):
    found = verify_bundle(made)
    assert found.problems == []
    counts = found.totals
    assert (counts.gate, counts.waived) == ("failed", 1)
    assert all(
        getattr(counts, key) > 0 for key in ("supported", "violated", "undecided", "missing")
    )
    assert found.rejudged


def test_the_command_says_so(made, capsys):
    assert main(["verify", str(made)]) == 0
    told = capsys.readouterr().out
    assert told.endswith("gate failed\nintact\n")


def test_the_command_lists_differences(bundle, capsys):
    (bundle / "summary.md").write_text("all is well\n")
    assert main(["verify", str(bundle)]) == 1
    told = capsys.readouterr().out
    assert "summary.md: changed since it was written" in told
    assert told.endswith("\nNOT INTACT: 2 differences\n")


def test_the_command_counts_a_single_difference(bundle, capsys):
    (bundle / "evidence.schema.json").write_text("{}\n")  # not a file of a bundle
    assert main(["verify", str(bundle)]) == 1
    assert capsys.readouterr().out.endswith("\nNOT INTACT: 1 difference\n")


def test_a_directory_that_is_not_there_is_a_wrong_call(tmp_path, capsys):
    assert main(["verify", str(tmp_path / "nowhere")]) == 2
    assert "there is no such directory" in capsys.readouterr().err


def test_a_directory_without_evidence_is_not_intact(tmp_path, capsys):
    assert main(["verify", str(tmp_path)]) == 1
    assert "there is no evidence here" in capsys.readouterr().out


def verdict(record, word):
    return next(one for one in record["verdicts"] if one["verdict"] == word)


def drop_episode(record):
    del record["episodes"][0]


def drop_verdict(record):
    record["verdicts"].remove(verdict(record, "violated"))


def turn_violation(record):
    """What a forger would do: the word, its counts and the gate, all of them consistent."""
    one = verdict(record, "violated")
    one |= {"verdict": "supported", "violations": 0, "counterexamples": []}


def pass_gate(record):
    record["gate"] |= {"result": "passed", "exit_code": 0, "reasons": []}
    record["totals"]["gate"] = "passed"


def forget_the_failure(record):
    one = next(one for one in record["episodes"] if one["validity"] == "missing")
    one |= {"validity": "valid", "failure": None, "termination": "time"}


def milder_violation(record):
    traced = {one["id"] for one in record["episodes"] if one["trace"]}
    for one in record["verdicts"]:
        for counterexample in one["counterexamples"]:
            if counterexample["episode"] in traced and one["check"]:
                counterexample["margin"] = -1e-9
                return
    raise AssertionError("no counterexample with a trace")


def other_trace(record):
    traced = [one for one in record["episodes"] if one["trace"]]
    traced[0]["trace"], traced[1]["trace"] = traced[1]["trace"], traced[0]["trace"]


def trace_elsewhere(record):
    next(one for one in record["episodes"] if one["trace"])["trace"]["file"] = "../outside.mcap"


def untested_after_all(record):
    cell = next(one for one in record["coverage"]["cells"] if one["verdict"])
    cell["case"] = "corridor/elsewhere"


def waive(record):
    verdict(record, "undecided")["waiver"] = {"kind": "xfail", "reason": "known"}


CHANGES = {
    "an episode is left out": drop_episode,
    "a violated verdict is left out": drop_verdict,
    "a violated verdict is turned": turn_violation,
    "the gate is said to have passed": pass_gate,
    "a failure is forgotten": forget_the_failure,
    "a milder violation": milder_violation,
    "traces are exchanged": other_trace,
    "a trace outside the bundle": trace_elsewhere,
    "a cell without a verdict counts as tested": untested_after_all,
    "a waiver that nobody gave": waive,
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_a_record_that_contradicts_itself_is_found_though_its_hashes_are_true(bundle, change):
    """By the record and its traces alone: the formats, which say what it said before, aside."""
    found = changed(bundle, change).problems
    assert any(one.startswith(("evidence.json: ", "episodes/")) for one in found), found


def cut(pattern):
    def change(text):
        shorter = re.sub(pattern, "", text, count=1, flags=re.DOTALL)
        assert shorter != text
        return shorter

    return change


def without_claim(text):
    document = json.loads(text)
    del document["declarations"]["claims"][0]
    return json.dumps(document)


def dangling(text):
    document = json.loads(text)
    document["declarations"]["claims"][0]["target"] = "nobody"
    return json.dumps(document)


def passed(text):
    statement = json.loads(text)
    statement["predicate"]["result"] = "PASSED"
    return json.dumps(statement)


def other_digest(text):
    statement = json.loads(text)
    statement["subject"][-1]["digest"]["sha256"] = "0" * 64
    return json.dumps(statement)


FORMATS = {
    "summary.md, a row less": ("summary.md", cut(r"\n\|[^\n]*corridor/tight[^\n]*")),
    "cyclonedx.json, a claim less": ("cyclonedx.json", without_claim),
    "cyclonedx.json, a target that is not there": ("cyclonedx.json", dangling),
    "test-result.intoto.json, passed": ("test-result.intoto.json", passed),
    "test-result.intoto.json, other evidence": ("test-result.intoto.json", other_digest),
    "assurance-case.gsn.yaml, no support": (
        "assurance-case.gsn.yaml",
        cut(r"\n\"?Sn[^\n]*:\n(  [^\n]*\n)+"),
    ),
    "report.html, no verdicts": ("report.html", cut(r"<tr[^>]*id=\"verdict.*?</tr>")),
    "report.html, empty": ("report.html", lambda _: ""),
    "assurance-case.svg, empty": ("assurance-case.svg", lambda _: ""),
}


@pytest.mark.parametrize("name, change", FORMATS.values(), ids=list(FORMATS))
def test_a_format_that_says_something_else_is_found_though_its_hash_is_true(bundle, name, change):
    file = bundle / name
    file.write_text(change(file.read_text()))
    found = sealed(bundle)
    assert any(one.startswith(name) for one in found.problems), found.problems


def test_a_signal_of_a_trace_that_was_changed_is_found_by_judging_it_again(bundle):
    from pytest_dura.evidence import read_trace, write_trace

    def change(record):
        violating = {one["episode"] for v in record["verdicts"] for one in v["counterexamples"]}
        one = next(one for one in record["episodes"] if one["trace"] and one["id"] in violating)
        file = bundle / one["trace"]["file"]
        trace = read_trace(file)
        trace.signals["gap"][:] = 5.0
        one["trace"] |= write_trace(file, trace)

    found = changed(bundle, change)
    assert any("the record says violated at" in one for one in found.problems), found.problems


def test_a_whole_bundle_that_was_forged_is_found_as_far_as_it_has_traces(bundle):
    """Word, counts, totals, gate and every format agree: only the traces say otherwise."""
    record, forged = json.loads((bundle / "evidence.json").read_text()), 0
    runs = [run for judgement in record["judgements"] for run in judgement["runs"]]
    said = [run["verdict"] for run in runs if run["verdict"] is not None]
    said += [verdict for episode in record["episodes"] for verdict in episode["verdicts"].values()]
    for verdict in said:
        if verdict["status"] == "violated":
            verdict |= {"status": "satisfied", "margin": 1.0, "time": None}
            forged += 1
    again = conclude_again(SessionRecord.of(record, bundle))
    assert not any(verdict.verdict == "violated" for verdict in again.head.verdicts)
    write_bundle(again)
    problems = verify_bundle(bundle).problems
    traced = [problem for problem in problems if "on it is violated at" in problem]
    assert 0 < len(traced) <= forged, problems


def test_the_junit_file_of_the_session_says_the_same(made, capsys):
    assert main(["verify", str(made), f"--junit-xml={made.parent / 'junit.xml'}"]) == 0
    assert capsys.readouterr().out.endswith("intact\n")


@pytest.mark.parametrize(
    "before, after",
    [
        ('name="verdict" value="violated"', 'name="verdict" value="supported"'),
        ('name="verdict" value="supported"', 'name="verdict" value="violated"'),
        ('name="verdict" value="undecided"', 'name="verdict" value="violated"'),
        ('name="requirement" value="GAP-1"', 'name="requirement" value="GAP-2"'),
        ("<testcase", "<testcase_"),
        ("<testsuites", "<!DOCTYPE x><testsuites"),
    ],
)
def test_a_junit_file_that_says_something_else_is_found(made, tmp_path, before, after):
    text = (made.parent / "junit.xml").read_text()
    assert before in text
    (tmp_path / "junit.xml").write_text(text.replace(before, after, 1))
    found = verify_bundle(made, tmp_path / "junit.xml")
    assert all(one.startswith("junit.xml: ") for one in found.problems)
    assert found.problems


def of_another_version(bundle):
    """As its writer would have sealed it."""
    before = file_entry(bundle / "evidence.json")["sha256"]
    alter(bundle, lambda record: record["tool"].update(version="0.0.9"))
    statement = bundle / "test-result.intoto.json"
    after = file_entry(bundle / "evidence.json")["sha256"]
    statement.write_text(statement.read_text().replace(before, after))
    seal(bundle)


def test_formats_of_another_version_are_not_rendered_again_and_it_says_so(bundle, capsys):
    report = bundle / "report.html"
    report.write_text(report.read_text().replace("violated", "supported", 1))
    seal(bundle)
    assert main(["verify", str(bundle)]) == 1
    of_another_version(bundle)
    assert main(["verify", str(bundle)]) == 3
    told = capsys.readouterr().out
    assert "\nnot re-rendered: pytest-dura 0.0.9 wrote this bundle, and this is " in told
    assert not told.endswith("\nintact\n")
    (bundle / "summary.md").write_text("all is well\n")
    assert main(["verify", str(bundle)]) == 1


def test_a_bundle_of_another_version_is_concluded_all_the_same(bundle, capsys):
    of_another_version(bundle)
    statement = (bundle / "test-result.intoto.json").read_text()
    alter(bundle, lambda record: record["cases"][0]["metrics"].update(alerts=99))
    assert main(["verify", str(bundle)]) == 1
    told = capsys.readouterr().out
    assert "evidence.json: /cases/0/metrics/alerts: found 99, expected " in told
    assert (bundle / "test-result.intoto.json").read_text() == statement
    assert "test-result.intoto.json: a statement on another evidence.json" in told


def test_a_record_of_another_form_is_refused_with_its_version(bundle, capsys):
    alter(bundle, lambda record: record.update(schema_version="1"))
    assert main(["verify", str(bundle)]) == 1
    told = capsys.readouterr().out
    assert "this evidence was written by another version of pytest-dura" in told
    assert "found: '1'" in " ".join(told.split())


@pytest.mark.parametrize(
    "broken, told",
    [
        ("pytest_dura.evidence.verify.conclude", "evidence.json: damaged (ZeroDivisionError"),
        ("pytest_dura.evidence.verify.record_problems", "evidence.json: damaged (ZeroDivision"),
        ("pytest_dura.reports.summary.render", "summary.md: cannot be rendered again (ZeroDiv"),
        ("pytest_dura.evidence.verify.read_trace", "cannot be read as the trace of corridor/"),
    ],
)
def test_whatever_fails_while_a_bundle_is_verified_is_a_problem(made, monkeypatch, broken, told):
    monkeypatch.setattr(broken, lambda *_, **__: 1 / 0)
    found = verify_bundle(made)
    assert any(told in problem for problem in found.problems), found.problems
    assert not found.intact


def test_the_digest_of_a_component_is_that_of_its_files(bundle):
    under_test = json.loads((bundle / "evidence.json").read_text())["component_under_test"]
    assert under_test["sources"][under_test["digest"]].keys() == {"corridor.py"}

    def other_file(record):
        (named,) = record["component_under_test"]["sources"].values()
        named["corridor.py"] = "0" * 64

    found = changed(bundle, other_file)
    assert "evidence.json: component Reckless: its digest is not that of its files" in (
        found.problems
    )


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda told: told.update(digest="0" * 64), "no files are listed of which its digest"),
        (lambda told: told.pop("sources"), "no files are listed of which its digest"),
        (lambda told: told.update(file_count=2), "/file_count: found 2, expected 1"),
        (lambda told: told["files"][0].update(sha256="0" * 64), "corridor.py is none of the files"),
        (
            lambda told: told["sources"].update({"0" * 64: {}}),
            f"/sources/{'0' * 64}: found a value, expected nothing",
        ),
    ],
)
def test_what_a_component_is_made_of_agrees(bundle, change, problem):
    found = changed(bundle, lambda record: change(record["component_under_test"]))
    assert any(problem in one for one in found.problems)


def test_a_manifest_that_lists_an_episode_kept_to_resume_is_a_difference(bundle):
    kept = min(file for file in (bundle / ".episodes").rglob("*.episode"))
    name = kept.relative_to(bundle).as_posix()
    files = json.loads((bundle / MANIFEST_FILE).read_bytes())["files"]
    (bundle / MANIFEST_FILE).write_text(manifest_text(files | {name: file_entry(kept)}))
    assert verify_bundle(bundle).problems == [
        f"{name}: in the manifest, and no file of this bundle"
    ]


def test_a_file_that_no_bundle_has_is_a_difference(bundle):
    (bundle / "episodes/notes.txt").write_text("mine\n")
    (bundle / "readme.html").write_text("<p>all is well</p>\n")
    assert sealed(bundle).problems == [
        "episodes/notes.txt: in the manifest, and no file of this bundle",
        "readme.html: in the manifest, and no file of this bundle",
    ]
