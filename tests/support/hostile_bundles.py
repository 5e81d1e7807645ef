"""Whole sessions in whose record and traces every text is hostile, yet all else is as it should be.

They begin as a real session. Which of its strings are texts is read from the record's schema, so
that a new key is hostile, too; the same text becomes the same hostile one everywhere, and what
follows from the rest is computed again. So a verifier has nothing to say against them.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import sys
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from hostile_records import HOSTILE
from hypothesis import strategies as st
from traces import simple_trace

from pytest_dura.core import Line, Scene, Tracks, derive_seed
from pytest_dura.core.codec import decode, encode
from pytest_dura.core.state import Event
from pytest_dura.evidence import (
    Baseline,
    Cases,
    Coverage,
    Effectiveness,
    Gate,
    SessionRecord,
    complete,
    conclude,
    open_record,
    plain_data,
    read_trace,
    record_schema,
    trace_path,
    write_trace,
)
from pytest_dura.evidence.conclusions.judgements import Judgements
from pytest_dura.evidence.conclusions.totals import Totals
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.provenance import digest_of

PROJECT = Path(__file__).parents[1] / "plugin" / "project"
MEGABYTE = 2**20
SORTS = (
    ("</script><script>window.pwned=1</script>", "<img src=x onerror=window.pwned=1>", "</title>",
     "'\"><svg onload=window.pwned=1>", "' onmouseover='pwned=1' x='", "</style><b>", "<!-- -->",
     "</text></g></svg><a>", "]]><![CDATA[<i>", "<?xml?><!DOCTYPE x>", "&lt;&#0;&amp;<"),
    ("\x1b[31m", "\x9b31m", "\x1b]8;;http://evil.example\x07", "\b\x7f", "\x00", "\ud800", "\udfff",
     "\u202e", "\u2066\ufeff", "\u2028", "\x85", "\ufffe\uffff", "\U000e0041", "\u200b", "\r"),
    ("\n\n# Gate passed\n", "\n| a |\n", "|", "\\|", "`", "``", "![x](http://evil.example/x.png)",
     "[x](javascript:alert(1))", "\n[x]: http://evil.example\n", "<http://evil.example>", "@me",
     "www.evil.example", "GH-1 #1", "$x$", "~~x~~"),
    ("../../etc/passwd", "/", "\\..\\", "C:\\con", "%2e%2e%2f", "..", "$(id)", "`id`", "; rm -rf /",
     "-rf", "!!python/object/apply:os.system [id]", "&a *a", "? x\n: y", "# ", "{{x}}{%", "%s{0}"),
    ("\n::error::x", "\r\n \t::set-env name=x::y", "##[error]x", "##vso[task.complete]x",
     "##teamcity[x]"),
)  # fmt: skip
"""What markup, a terminal, Markdown and GitHub, file systems, shells and YAML, and the log of a CI
may act on."""
ALONE = (
    "__proto__", "constructor", "javascript:window.pwned=1", "COM1", ".", "..", "~", "-", "NaN",
    "null", "=1+1", "1e3", "- ", "1. ", "---", "...", "é😀", "\u3164", "::", "urn:cdx:x", "\t",
    "\r\n",
)  # fmt: skip
FULL = st.tuples(*map(st.sampled_from, SORTS)).flatmap(st.permutations).map("".join)
"""Something of each sort, so that whatever is not escaped shows in any place."""
ODD = st.sampled_from((*ALONE, *HOSTILE)) | st.text(st.characters(codec=None), min_size=1)


FREE = """
name: corridor/free
simulator: corridor:Corridor
duration: 0.5
runs: 2
world: {wall: 10.0, kind: a}
variation:
  world.wall: {min: 0.5, max: 1.5}
  world.kind: {choice: [a, b]}
roles: {generator: "own:Looks", safety_monitor: "corridor:Watch",
        recovery_planner: "corridor:Brake"}
faults:
  - {type: bias, id: bias, target: gap, activation: {at: 0.0}, parameters: {offset: 1.0}}
campaigns: [none, bias]
requirements: [GAP-1, PAIR-1]
"""
BROKEN = """
name: corridor/broken
simulator: corridor:Corridor
duration: 0.5
roles: {generator: "own:Looks", safety_monitor: "corridor:Broken"}
requirements: [GAP-1]
"""
OWN = """
from corridor import Reckless
class Looks(Reckless):
    def propose(self, view):
        assert view.percept["gap"] > -9
        return super().propose(view)
"""
REQUIREMENTS = """
requirements:
  - {id: GAP-1, text: It touches nothing., kind: safety, check: always (gap > 0),
     source: house rule, reason: walls are hard, applies_to: ["corridor/b*"], mitigates: [H-1]}
  - {id: PAIR-1, text: Recovery helps., kind: recovery, check: always (gap > 0),
     paired: {without: recovery_planner}}
"""
HAZARDS = """
hazards:
  - {id: H-1, text: It is too near to the wall., loss: the wall itself, severity: S2,
     operating_condition: at speed, triggering_condition: dim light, source: brooding}
  - {id: H-2, text: It never arrives., loss: precious time}
"""
TESTS = """
import pytest
@pytest.mark.xfail(reason="known since long")
@pytest.mark.dura(scenario="corridor/free", faults=["none"], runs=1)
@pytest.mark.requirement("OWN-1", text="Its own words.")
def test_each(episode):
    assert episode.collided is None
"""


def real_session(folder):
    """A session with every kind of verdict and episode, run in this process; its bundle."""
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    (folder / "scenarios/corridor/tight.yaml").unlink()
    for file, text in {
        "scenarios/corridor/free.yaml": FREE, "scenarios/corridor/broken.yaml": BROKEN,
        "scenarios/requirements.yaml": REQUIREMENTS, "scenarios/hazards.yaml": HAZARDS,
        "test_it.py": TESTS, "own.py": OWN,
    }.items():  # fmt: skip
        (folder / file).write_text(text)
    arguments = [
        "-p", "no:cacheprovider", "--assert=plain", "--dura-scenarios", "--dura-select=corridor/*",
        "test_it.py",
    ]  # fmt: skip
    before, modules, path = Path.cwd(), set(sys.modules), list(sys.path)
    os.chdir(folder)
    try:
        with redirect_stdout(io.StringIO()) as told:
            code = pytest.main(arguments)
    finally:
        os.chdir(before)
        sys.path[:] = path
        for module in {"corridor", "own", "test_it"} - modules:
            sys.modules.pop(module, None)
    assert code == pytest.ExitCode.TESTS_FAILED, told.getvalue()
    return folder / "dura-evidence"


OURS = {
    "created", "finished", "termination", "method", "policy", "check", "correction", "sha256",
    "digest", "file", "without", "roles", "propagation", "schema_version", "timings", "world",
}  # fmt: skip
"""Keys whose values are no user's, or are read back: formulas, paths of traces, names of roles."""
ROLES = {"generator", "recovery_planner", "none"}
_CASE = re.compile(r"corridor/\w+([+~][\w-]+)*(#\d+)?(::[\w-]+)?")


@dataclass
class Spoiler:
    """Puts a hostile text in place of each harmless one, always the same; they all differ.

    Args:
        pool: Hostile texts that all differ; empty to leave everything as it is.
        long: Of the harmless texts, those for which it is a megabyte.
    """

    pool: list[str]
    long: frozenset[str] = frozenset()
    given: dict[str, str] = field(default_factory=dict)

    def __call__(self, text: str) -> str:
        """The text that stands for this one. Of ids of cases and episodes the parts do."""
        if not self.pool or not text or text in ROLES:
            return text
        if _CASE.fullmatch(text) and re.search("[+~#]|::", text):
            parts = re.split("([+~#]|::)", text)
            return "".join(one if number % 2 or one.isdigit() else self(one)
                           for number, one in enumerate(parts))  # fmt: skip
        if text not in self.given:
            lap, index = divmod(len(self.given), len(self.pool))
            hostile = self.pool[index]
            if text in self.long:
                hostile *= MEGABYTE // len(hostile) + 1
            if _CASE.fullmatch(text):  # seeds follow from it, and only a search gives it an @
                hostile = hostile.encode(errors="replace").decode().replace("@", "(at)")
            self.given[text] = hostile + str(lap or "")
        return self.given[text]

    def record(self, value, part):
        """Data of this part of the schema, with what the schema leaves free replaced."""
        part = _resolved(part, value)
        if isinstance(value, str):
            return value if {"enum", "const", "pattern"} & part.keys() else self(value)
        if isinstance(value, list):
            return [self.record(one, part.get("items", {})) for one in value]
        if isinstance(value, dict):
            return dict(self._entry(name, one, part) for name, one in value.items())
        return value

    def _entry(self, name, value, part):
        known = part.get("properties", {})
        if name == "roles":
            return name, {role: self._role(one) for role, one in value.items()}
        if name == "sources" and not value.keys() <= {"digest", "files", "versions"}:
            return name, {
                digest: {self(file): sha256 for file, sha256 in named.items()}
                for digest, named in value.items()
            }
        if name in OURS or (name == "kind" and value.startswith("fault_")):
            return name, value
        if name == "scenario" and isinstance(value, dict) and "seed" not in value:  # of a spec
            known = {key: {} for key in ("name", "duration", "iterations", "world")}
            return name, self.record(value, {"properties": known})
        if name == "component" and isinstance(value, dict):
            known = {name: {"$ref": "#/$defs/component_under_test"}}
        if name in known:
            return name, self.record(value, known[name])
        others = part.get("additionalProperties", {})
        return self(name), self.record(value, others if isinstance(others, dict) else {})

    def _role(self, told):
        return {**told, "path": told["path"], "params": self.record({"a parameter": "x"}, {})}


def _resolved(part, value):
    """What a schema says of this very value."""
    if "$ref" in part:
        return _resolved(record_schema()["$defs"][part["$ref"].rpartition("/")[2]], value)
    if "anyOf" in part and value is not None:
        return _resolved(next(one for one in part["anyOf"] if _fits(one, value)), value)
    return part


def _fits(part, value):
    """Whether this alternative is meant; the schema has none that differ in their values alone."""
    if "$ref" in part:
        part = record_schema()["$defs"][part["$ref"].rpartition("/")[2]]
    kind = {dict: "object", list: "array", str: "string"}.get(type(value), "number")
    if kind != part.get("type", kind):
        return False
    return kind != "object" or value.keys() <= part.get("properties", value).keys()


LONG = (
    "OWN-1", "Its own words.", "house rule", "walls are hard", "known since long", "an objection",
    "corridor/broken", "another component", "numpy", "prompt", "well",
    "test_it.py", "own measure", "a value", "detail", "inner key", "inner value",
    "explanations 1", "reasons 0", "recoveries 2", "action 1", "thing 2", "signal", "a monitor",
    "rule",
)  # fmt: skip
"""Texts of each sort, that a record has few times: it would be as many megabytes large."""


@st.composite
def spoilers(draw):
    """What makes a harmless session hostile; one text or another is a megabyte."""
    pool = draw(st.lists(FULL, min_size=12, max_size=12, unique=True))
    pool += draw(st.lists(ODD.filter(lambda one: one not in pool), max_size=4, unique=True))
    return Spoiler(pool, frozenset([draw(st.sampled_from(LONG))]))


def _keep_details(plain, told):
    """Put back what formulas and functions say of runs, which traces show again."""
    for before, after in zip(plain["episodes"], told["episodes"], strict=True):
        pairs = zip(before["verdicts"].values(), after["verdicts"].values(), strict=True)
        for verdict, spoilt in pairs:
            if verdict["detail"] not in (before["failure"], before["invalid_reason"]):
                spoilt["detail"] = verdict["detail"]
    for before, after in zip(plain["judgements"], told["judgements"], strict=True):
        for run, spoilt in zip(before["runs"], after["runs"], strict=True):
            for key in ("verdict", "twin_verdict") if before["check"] else ():
                if run[key] is not None:
                    spoilt[key]["detail"] = run[key]["detail"]
    for before, after in zip(plain["verdicts"], told["verdicts"], strict=True):
        kept = [(before, after), *zip(before["attempts"], after["attempts"], strict=True)]
        for verdict, spoilt in kept:
            first = verdict["first_uncounted"]
            if verdict["check"] and first and "infra" not in str(first):
                spoilt["first_uncounted"]["detail"] = first["detail"]


def session(real, directory, spoil):
    """The real session with hostile texts: its record, and its traces in another directory."""
    before = open_record(real / "evidence.json")
    told = before.to_json()
    traces = [one["trace"] and read_trace(real / one["trace"]["file"]) for one in told["episodes"]]
    _name_everything(told)
    told["baseline"] = encode(Baseline.read(".", real).compared(SessionRecord.of(told, real)))
    reasons = [one["reason"] for one in told["verdicts"]]
    plain = json.loads(json.dumps(told))
    told = spoil.record(plain, record_schema())
    _keep_details(plain, told)
    for one in told["episodes"]:
        for event in one["events"]:
            if "traceback" in event:  # the page folds what has several lines
                event["traceback"] = f"Traceback\n{event['traceback']}"
        one["events"] = [encode(decode(Event, event)) for event in one["events"]]  # as long as kept
    _digest_sources(told["component_under_test"])
    for one, reason in zip(told["verdicts"], reasons, strict=True):
        one["reason"] = re.sub(r"\bbias\b", lambda _: spoil("bias"), reason)
        for attempt in one["attempts"]:  # of the same runs
            attempt["reason"] = one["reason"]
    for one, trace in zip(told["episodes"], traces, strict=True):
        name, run = one["spec"]["scenario"]["name"], one["spec"]["run"]
        one["seed"] = one["spec"]["seed"] = derive_seed(told["base_seed"], name, run)
        if trace is not None:
            one["trace"] |= _trace(directory, one, trace, spoil)
    verdicts = [decode(ItemVerdict, one) for one in told["verdicts"]]
    told["requirements"].sort(key=lambda one: one["id"])
    told["failed_items"] = sorted(told.get("failed_items") or ())
    told["cases"].sort(key=lambda one: (one["id"], one["component"]))
    told["episodes"].sort(key=lambda one: (one["case"], one["component"], one["spec"]["run"]))
    told["verdicts"].sort(key=lambda one: (one["case"], one["requirement"], one["item"]))
    gate = Gate.of(
        sorted(verdicts, key=lambda one: (one.case, one.requirement, one.item)),
        [spoil("an objection"), spoil("another one")],
        searches=[decode(RecordedSearch, one) for one in told["searches"]],
        interrupted=False, exit_code=1,
        failed=3, warn_undecided=False,
    )  # fmt: skip
    record = SessionRecord.of(plain_data(told), directory)
    tables = [Judgements, Cases, Effectiveness, Coverage, Totals]
    return complete(
        conclude(record, tables), finished=told["finished"],
        gate=gate,
        inputs=told["inputs"], wall_seconds=2.0, evidence_seconds=1.0, redact=lambda same: same,
    )  # fmt: skip


def _digest_sources(under_test):
    """Let the digests of components be those of files with these names."""
    made = {before: digest_of(named) for before, named in under_test["sources"].items()}
    under_test["sources"] = {made[one]: named for one, named in under_test["sources"].items()}
    for one in (under_test, *under_test.get("others", ())):
        one["digest"] = made.get(one["digest"])


def _trace(directory, one, trace, spoil):
    """The trace of an episode, of which it says the same as the record, and all else hostile."""
    keys = ("id", "case", "component", "seed", "digest", "validity", "termination", "failure")
    ticks = len(trace.time)
    many = max(ticks - 1, 0)
    scene = simple_trace(ticks).recording.scene
    ids = tuple(spoil(f"thing {number}") for number in range(3))
    texts = np.array([spoil(f"action {tick % 3}") for tick in range(many)], np.str_)
    said = {
        name: tuple(spoil(f"{name} {tick % 3}") for tick in range(many))
        for name in ("explanations", "reasons", "recoveries")
    }
    trace = replace(
        trace,
        about={key: one[key] for key in keys},
        events=one["events"],
        signals={**trace.signals, spoil("signal"): trace.time, f"percept.{spoil('x')}": trace.time},
        decisions={**trace.decisions, "proposed": texts, spoil("column"): texts},
        recording=replace(
            trace.recording, **said, problem=spoil("no scene"),
            flags={spoil("a monitor"): np.zeros(many, np.int8)},
            scene=Scene(
                (Line(spoil("line"), scene.lines[0].points),),
                Tracks(ids[:2], scene.truth.poses), Tracks(ids, scene.percept.poses), ids[0],
            ),
        ),
    )  # fmt: skip
    file = trace_path(one)
    verdicts = [{"requirement": spoil("GAP-1"), "verdict": spoil("word"), "check": spoil("rule")}]
    return {"file": file, **write_trace(directory / file, trace, verdicts)}


def _name_everything(told):
    """Put a text also where a real session of this kind has none."""
    under_test = told["component_under_test"]
    under_test |= {
        "params": {"planner": {"model": "large", "prompt": ["drive", "well"]}},
        "others": [
            {**{k: v for k, v in under_test.items() if k != "sources"}, "name": "another component"}
        ],
    }
    told["environment"]["packages"]["a package"] = "a version"
    for one in told["episodes"]:
        one["metrics"]["user"] = {"own measure": 1.0}
        one["metrics"]["violations"]["a role"] = 1
        one["metrics"]["performance"]["a value"] = {"last": 1.0, "min": None, "max": 2.0}
        one["events"].append(
            {"tick": 0, "time": 0.0, "kind": "kind", "subject": "subject", "detail": "detail",
             "data": {"key": ["value", {"inner key": "inner value"}]}}
        )  # fmt: skip
    (waived,) = (one for one in told["verdicts"] if one["waiver"])
    left = ("item", "waiver", "attempts", "assertion", "also_without")
    waived["attempts"] = [{key: one for key, one in waived.items() if key not in left}]
    told["judgements"] += [
        {**judgement, "attempt": judgement["attempt"] + 1}
        for judgement in told["judgements"]
        if judgement["kind"] != "claim" and judgement["decides"] == waived["item"]
    ]
