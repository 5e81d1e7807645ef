"""Requirements that a language model drafts: what is refused and why, and what is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from drafting_model import HEADWAY, draft, drafting

from pytest_dura.__main__ import main
from pytest_dura.campaign.runner import Runner
from pytest_dura.domains import DOMAINS
from pytest_dura.evidence.mcap import trace_bytes
from pytest_dura.evidence.traces import Trace
from pytest_dura.library import load_library
from pytest_dura.llm.drafts.asking import Draft, signal_lines
from pytest_dura.llm.drafts.checks import RecordedRun, refusal_of_text, shown_on
from pytest_dura.requirements.drafts import (
    draft_digest,
    drafted_by,
    signed_source,
    unsigned_reason,
)
from pytest_dura.requirements.model import Requirement

SENTENCE = "The ego keeps 2 s to the leader on dry roads"
SCENARIO = """
name: road/leader
simulator: driving
duration: 6.0
runs: 2
policy: recover
world:
  ego: {distance: 90.0, speed: 9.0, turn: straight}
  vehicles:
    - {id: LEADER, arm: south, turn: straight, distance: 50.0, speed: 9.0}
requirements: [SAF-1]
"""
LEADER_GAP = draft(
    "always (leader_gap < 50 implies leader_gap >= 2)",
    ("leader_gap", 50.0, "m"),
    ("leader_gap", 2, "m"),
    name="LEAD-1",
)
BOUNDS = (("time_headway", 2.0, "s"), ("time_headway", 10, "s"), ("speed", 5, "m/s"))


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """`run(*rounds, arguments)` lets a scripted model draft; the code, what was printed, it."""
    monkeypatch.chdir(tmp_path)
    for name in ("DURA_LLM_API_KEY", "DURA_LLM_HEADERS", "DURA_LLM_EXTRA_BODY", "DURA_LLM_ABOUT"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "leader.yaml").write_text(SCENARIO)

    def drafted(*rounds, arguments=("--mutants=none",)):
        with drafting(*rounds) as server:
            server_given = [f"--llm={server.base_url}/{server.model}"]
            code = main([
                "draft", "--domain=driving", SENTENCE, "--suite=suite", "--scenario=road/*",
                *server_given, *arguments,
            ])  # fmt: skip
        return code, capsys.readouterr(), server.requests

    return drafted


def asked(requests):
    """The conversations of the drafting, without what probed the server."""
    bodies = [each.json for each in requests if each.body]
    return [each["messages"] for each in bodies if "requirements for tests" in str(each)]


def refusal(given, taken=()):
    return refusal_of_text(Draft.of(given), DOMAINS["driving"], dict.fromkeys(taken, "a file"))


@pytest.mark.parametrize(
    "given, reason",
    [
        (draft("always (headway >= 2)", ("headway", 2, "s")), "unknown signal 'headway'"),
        (draft("always (speed >= )"), "formula"),
        (draft("always (speed >= speed)"), "holds whatever the signals are"),
        (draft("os.path:exists"), "is the path of a function"),
        (
            draft("always (speed < 9)", ("speed", 9, "km/h")),
            "stated in 'km/h', and its unit is m/s",
        ),
        (draft("always (speed < 9)"), "compares speed with 9, and no bound states its unit"),
        (draft("always (speed < 9)", ("speed", 32.4, "m/s")), "and the check has none"),
        (draft("always (speed < 9)", ("gap", 9, "m")), "which the check does not read"),
        (draft("always (gap > ttc)"), "gap in m is compared with ttc in s"),
        (draft("always (gap > 0)", name="SAF 1"), "is not made of letters"),
        (draft("always (gap > 0)", name="SAF-1"), "SAF-1 is in use"),
        (draft("always (gap > 0)", reason=" "), "the reason is empty"),
    ],
)
def test_a_draft_that_cannot_be_a_requirement_is_refused_with_its_reason(given, reason):
    assert reason in refusal(given, taken=["SAF-1"])


def test_signals_units_and_numbers_that_fit_are_taken():
    assert refusal(draft(HEADWAY, *BOUNDS)) == ""
    assert refusal(draft("always (gap > 0 and not collided == 1)")) == ""


def test_the_prompt_names_each_signal_with_its_unit_and_meaning():
    lines = signal_lines(DOMAINS["driving"]).splitlines()
    assert len(lines) == len(DOMAINS["driving"].units)
    assert "- speed [m/s] of the ego along its heading" in lines


def recorded(name, **signals):
    columns = {key: np.asarray(column, dtype=float) for key, column in signals.items()}
    length = len(next(iter(columns.values())))
    return RecordedRun(name, np.arange(length) * 0.1, columns, {})


def shown(check, *runs):
    return shown_on(Draft.of(draft(check)), runs)


def test_what_never_applies_never_changes_or_never_holds_is_refused():
    rising = recorded("rising", gap=[1, 2, 3], speed=[4, 4, 4])
    falling = recorded("falling", gap=[3, 2, 1.5], speed=[4, 4, 4])
    assert "vacuous" in shown("always (gap > 9 implies speed < 1)", rising, falling).refusal
    assert (
        "robustness is 3 throughout 1 recorded runs" in shown("always (speed > 1)", rising).refusal
    )
    assert (
        "all 2 runs that decide it violate it" in shown("always (gap > 2)", rising, falling).refusal
    )
    assert "none of 1 recorded runs decides" in shown("always[0, 9] (gap > 0)", rising).refusal
    found = shown("always (gap > 1.2)", rising, falling)
    assert (found.refusal, found.satisfied, found.violated) == ("", 1, 1)


def test_what_is_refused_goes_back_to_the_model_with_its_reason(run):
    wrong = draft("always (time_headway >= 2)", ("time_headway", 2, "m"))
    code, printed, requests = run([wrong], [LEADER_GAP])
    assert code == 0, printed
    assert "HEADWAY-1 refused: the bound of time_headway is stated in 'm'" in printed.out
    assert "LEAD-1 kept: " in printed.out
    first, second = asked(requests)
    assert [each["role"] for each in second] == ["system", "user", "assistant", "user"]
    assert second[:2] == first
    assert first[1]["content"] == SENTENCE
    assert "HEADWAY-1: the bound of time_headway is stated in 'm'" in second[3]["content"]


def test_the_model_is_asked_at_most_so_many_times(run):
    code, printed, requests = run("I would rather not.", arguments=["--rounds=2"])
    assert code == 1
    assert printed.out.count("malformed") == 2
    assert printed.out.splitlines()[-1] == "no draft passed"
    assert len(asked(requests)) == 2


def test_what_passes_is_written_with_its_provenance(run, tmp_path):
    code, printed, _ = run([LEADER_GAP], arguments=["--mutants=none", "-o", "drafts.yaml"])
    assert code == 0, printed
    text = (tmp_path / "drafts.yaml").read_text()
    assert SENTENCE in text
    (entry,) = yaml.safe_load(text)["requirements"]
    assert entry["source"].startswith("drafted, not reviewed: scripted, server ")
    assert "prompt sha256:" in entry["source"]
    assert entry["applies_to"] == ["road/leader"]
    library = load_library([tmp_path / "suite", tmp_path / "drafts.yaml"])
    assert library.scenarios["road/leader"].requirements == ("SAF-1", "LEAD-1")
    assert "no person has signed" in unsigned_reason(library.requirements["LEAD-1"])
    assert main(["draft", "--domain=driving", SENTENCE, "-o", "drafts.yaml"]) == 2


def test_a_draft_is_kept_for_a_defect_that_the_suite_does_not_catch(run):
    """The suite asks for no contact alone, and one planner brakes hard without a reason."""
    smooth = draft("always (acceleration >= -4)", ("acceleration", -4, "m/s2"), name="SMOOTH-1")
    idle = draft("always (gap > -5)", ("gap", -5, "m"), name="IDLE-1")
    code, printed, requests = run([smooth, idle], [LEADER_GAP], arguments=["--rounds=2"])
    lines = [line.strip() for line in printed.out.splitlines() if line.startswith("  ")]
    assert code == 0
    (kept,) = [line for line in lines if line.startswith("SMOOTH-1 kept: ")]
    assert "driving.generator.brakes_for_nothing" in kept
    assert [line for line in lines if line.startswith("IDLE-1 refused: it catches 0 of 25")]
    _, second = asked(requests)
    assert "IDLE-1: it catches 0 of 25 seeded defects" in second[3]["content"]
    assert "SMOOTH-1" not in second[3]["content"]


def test_the_same_drafts_come_from_a_cassette_without_a_server(run, monkeypatch, capsys):
    tape = ["--dura-cassette=tape.sqlite", "--mutants=none"]
    code, first, _ = run([LEADER_GAP], arguments=["--dura-llm=record", *tape])
    assert code == 0
    given = ["draft", "--domain=driving", SENTENCE, "--suite=suite", "--scenario=road/*", *tape]
    assert main([*given, "--dura-llm=replay"]) == 0
    again = capsys.readouterr().out
    assert again.splitlines()[1:] == first.out.splitlines()[1:]
    given[2] = "The ego stops at once"
    assert main([*given, "--dura-llm=replay"]) == 2
    assert "the model gives no draft" in capsys.readouterr().err


def test_traces_of_a_bundle_take_the_place_of_runs(run, tmp_path):
    trace = Trace.of(Runner.of(tmp_path / "suite").run("road/leader"))
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "one.mcap").write_bytes(trace_bytes(trace))
    never = draft("always (speed > 60 implies gap > 1)", ("speed", 60, "m/s"), ("gap", 1, "m"))
    given = ["--mutants=none", "--rounds=1", "--traces=kept"]
    code, printed, _ = run([LEADER_GAP, never], arguments=given)
    assert "judged on 1 recorded run\n" in printed.out
    assert (
        "HEADWAY-1 refused: vacuous: its condition holds in none of 1 recorded runs" in printed.out
    )
    assert "LEAD-1 kept" in printed.out
    assert code == 0
    code, printed, _ = run([LEADER_GAP], arguments=["--traces=elsewhere"])
    assert code == 2
    assert "elsewhere" in printed.err


SIGNED = Requirement("R-1", "As it should be.", check="always (gap > 1)", reason="So.")


def test_a_signature_is_one_on_what_is_required():
    made = replace(SIGNED, source="drafted, not reviewed: a model, server 1; catches 2 of 3")
    source = signed_source(made, "A. Person", "2026-01-02", "the bound", accepted=True)
    signed = replace(made, source=source)
    assert unsigned_reason(SIGNED) == ""
    assert "no person has signed" in unsigned_reason(made)
    assert unsigned_reason(signed) == ""
    assert unsigned_reason(replace(signed, applies_to=("a/*",))) == ""
    for changed in (
        {"check": "always (gap > 0)"},
        {"text": "Else."},
        {"at_most": 0.1},
        {"id": "R"},
    ):
        assert "changed after a person signed" in unsigned_reason(replace(signed, **changed))
    rejected = signed_source(signed, "B. Other", "2026-01-03", "the bound", accepted=False)
    assert "a person rejected" in unsigned_reason(replace(made, source=rejected))
    assert {drafted_by(each) for each in (made.source, source, rejected)} == {
        "a model, server 1; catches 2 of 3"
    }
    for forged in ("Drafted, by me", "drafted, signed by me", "drafted, signed sha256:00 by me"):
        assert unsigned_reason(replace(made, source=forged))
    assert draft_digest(made) == draft_digest(signed)


def test_a_campaign_of_a_script_leaves_an_unsigned_draft_undecided_too(run, tmp_path):
    campaign = Runner.of(tmp_path / "suite").campaign("road/leader", 1)
    plain = Requirement("R-1", "As it should be.", check="always (gap > 0)", reason="So.")
    made = replace(plain, source="drafted, not reviewed: a model")
    assert campaign.judge(plain).verdict == "supported"
    found = campaign.judge(made)
    assert (found.verdict, found.too_few) == ("undecided", False)
    assert "no person has signed" in found.reason
    source = signed_source(made, "A. Person", "2026-01-02", "the bound", accepted=True)
    assert campaign.judge(replace(made, source=source)).verdict == "supported"
