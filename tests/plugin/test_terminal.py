from __future__ import annotations

import re
from importlib.metadata import version

import pytest
from entries import make

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.plugin.terminal_tables import case_table


def section(result):
    """What the plugin prints below its heading, up to pytest's own short summary."""
    lines = result.outlines
    start = next(i for i, line in enumerate(lines) if re.fullmatch(r"=+ dura =+", line))
    rest = lines[start + 1 :]
    end = next(i for i, line in enumerate(rest) if re.match(r"=+ .* =+$", line))
    return rest[:end]


def test_the_header_says_what_is_tested(project):
    result = project.scenarios("--dura-seed=5")
    assert "dura: component under test Careful, base seed 5, 2 cases, 5 episodes" in result.outlines


@pytest.mark.parametrize("mode", ["plain", "n2"])
def test_the_summary_of_a_campaign(reference, mode):
    lines = section(reference(mode).result)
    assert "component under test: Reckless, base seed 0" in lines
    table = [re.split(r"\s{2,}", line) for line in lines if line.startswith(("case ", "corridor/"))]
    assert table[0] == [
        "case", "n", "flag %", "coll %", "clearance s", "grid", "recov", "alerts", "inv",
    ]  # fmt: skip
    assert table[1] == ["corridor/free", "3", "100", "100", "0.1 +- 0.0 (3)", "0", "0", "0", "0"]
    assert table[2] == ["corridor/tight", "2", "0", "100", "0.1 +- 0.0 (2)", "0", "0", "0", "0"]
    assert lines[-2:] == [
        "gate: failed, 1 supported, 2 violated",
        "evidence: dura-evidence/report.html",
    ]


def test_a_red_session_begins_with_a_card_for_each_cause(reference):
    lines = section(reference("plain").result)
    heading = "violated: safety on corridor/free (Reckless) (1 of 2 causes)"
    end = lines.index("component under test: Reckless, base seed 0")
    assert lines[0] == heading
    card = lines[1 : lines.index("")]
    assert card[0].startswith("  At t = 0.50 s safety_monitor found the proposal unsafe: too near")
    labels = [line[2:12].strip() for line in card if re.match("  [a-z]+: ", line)]
    assert labels == ["required:", "check:", "episode:", "replay:", "next:"]
    (replay,) = (line for line in card if line.startswith("  replay:"))
    assert replay.split(":", 1)[1].strip() == "pytest --dura-replay='corridor/free#0'"
    assert "violated: safety on corridor/tight (Reckless) (2 of 2 causes)" in lines[:end]
    assert not any(line.startswith(("  rerun:", "supported", "violated   ")) for line in lines)


def test_of_many_causes_the_worst_have_cards_and_the_others_are_counted(project):
    text = (project.path / "scenarios/corridor/free.yaml").read_text()
    for number in range(6):
        (project.path / f"scenarios/corridor/free{number}.yaml").write_text(
            text.replace("corridor/free", f"corridor/free{number}")
        )
    brief = section(project.scenarios("--dura-generator=corridor:Reckless"))
    headings = [line for line in brief if line.startswith("violated: ")]
    assert len(headings) == 5
    assert headings[0].endswith("(1 of 8 causes)")
    assert "and 3 more causes: 3 violated; -v shows them, as does the report" in brief
    whole = section(project.scenarios("--dura-generator=corridor:Reckless", "-v"))
    assert sum("causes)" in line for line in whole) == 8


def test_a_green_session_ends_in_40_lines_and_shows_all_with_v(project):
    chosen = "intersection/ghost-obstacle"
    result = project.scenarios("--dura-runs=2", select=chosen)
    brief = section(result)
    assert result.ret == 0
    assert len(brief) <= 30  # all six scenarios have ten lines more
    assert brief[0].startswith("component under test:")
    starts = [line.partition(":")[0] for line in brief]
    for once in ("reliance", "fault", "attack", "recovery_planner", "safety_monitor"):
        assert starts.count(once) == 1
    (fault,) = (line for line in brief if line.startswith("fault:"))
    assert "1 fault in 2 runs: 2 activated, 2 manifested" in fault
    assert "verdicts are supported. The weakest bound among them" in " ".join(brief)

    whole = section(project.scenarios("--dura-runs=2", "-v", select=chosen))
    for title in ("reliance", "fault", "attack", "recovery", "monitor"):
        assert any(line.startswith(f"{title} ") for line in whole), title
    legends = " ".join(whole)
    for legend in ("act: it began", "prev: violated only without recovery", "TP: true positives"):
        assert legend in legends
    assert any(line.startswith("supported ") for line in whole)


def test_all_verdicts_and_failures_are_shown_with_v(project):
    lines = section(project.scenarios("--dura-generator=corridor:Reckless", "-v"))
    start = lines.index("violated   corridor/free (Reckless)")
    assert [line.strip() for line in lines[start + 1 : start + 3]] == [
        "n = 3, 3 violations, rate <= 1 at 0.95, every episode",
        "GAP-1 (0)",
    ]
    start = lines.index("violated: GAP-1 on corridor/tight (Reckless)")
    assert lines[start + 1 : start + 7] == [
        "  2 of 2 valid episodes violated it",
        "  check:  always (gap > 0)",
        "  worst:  corridor/tight#0 at t = 0.20 s, margin 0",
        "  also in: #1",
        "  replay: pytest --dura-replay='corridor/tight#0'",
        "  rerun:  pytest corridor/tight::GAP-1 --dura-generator=corridor:Reckless",
    ]


def test_without_a_report_the_last_lines_name_the_record_and_go_on(project, monkeypatch):
    def broken(record):
        raise ValueError("no page today")

    monkeypatch.setattr("pytest_dura.reports.html.page.render", broken)
    lines = [line for line in section(project.scenarios()) if line]
    assert lines[-3:] == [
        "gate: failed, 3 supported",
        "evidence: dura-evidence/evidence.json",
        "to go on: pytest --dura-scenarios '--dura-select=corridor/*' --dura-resume",
    ]
    assert any("report.html could not be made" in line for line in lines)


def test_the_printed_commands_work(project):
    result = project.scenarios("--dura-generator=corridor:Reckless", "--dura-evidence=out", "-v")
    lines = [line.split() for line in result.outlines if line.startswith(("  replay:", "  rerun:"))]
    assert {"replay:", "rerun:"} == {label for label, *_ in lines}
    for _, _, *arguments in [line for line in lines if "corridor/free" in " ".join(line)]:
        again = project.run(*[argument.replace("'", "") for argument in arguments])
        assert again.ret in (0, 1)
        assert "corridor/free" in again.stdout.str()


def test_requirements_undecided_for_one_reason_are_told_once(project):
    text = (project.path / "scenarios/corridor/free.yaml").read_text()
    (project.path / "scenarios/corridor/broken.yaml").write_text(
        text.replace("corridor/free", "corridor/broken").replace(":Watch", ":Broken")
    )
    lines = section(project.run("corridor/broken", "-v"))
    assert "undecided: GAP-1, GO-1 on corridor/broken (Careful)" in lines
    start = lines.index("undecided  corridor/broken (Careful)")
    assert lines[start + 1] == " " * 11 + "n = 0, 0 violations, 3 missing, every episode"
    assert lines[start + 2].startswith(" " * 11 + "GAP-1")
    reruns = [line for line in lines if line.startswith("  rerun:")]
    assert reruns == ["  rerun:  pytest corridor/broken"]


def test_every_line_fits_into_100_columns(project):
    result = project.scenarios("--dura-runs=1", select="intersection/[cp]*")
    wide = [line for line in section(result) if len(line) > 100]
    assert wide == []


def test_a_domain_without_measures_has_no_columns_of_them():
    nothing = {
        "planned": 3, "run": 3, "valid": 2, "invalid": 0, "missing": 1, "flagged": None,
        "measures": {}, "recoveries": 0, "alerts": 4,
        "user": {"warmth": {"mean": 21.5, "runs": 2}},
    }  # fmt: skip
    _, row, *_ = case_table([make(CaseEntry, id="room", component="Heater", metrics=nothing)])
    assert row.split() == [
        "room",
        "2",
        "(3)",
        "-",
        "0",
        "4",
        "0+1",
        "missing",
        "21.5",
    ]


def test_nothing_of_ours_without_anything_of_ours(project):
    project.write("test_plain.py", "def test_one(): pass\n")
    assert "dura" not in project.run().stdout.str().replace(f"dura-{version('pytest-dura')}", "")
