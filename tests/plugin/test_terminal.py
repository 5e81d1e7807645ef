from __future__ import annotations

import re
from importlib.metadata import version

import pytest
from entries import make
from pens import table_lines

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.reports.session_tables import case_table


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
    labels = [line[2:12].strip() for line in card if re.match(r"  [\w-]+: ", line)]
    assert labels == ["GAP-1:", "episode:", "replay:", "next:"]
    text = " ".join(" ".join(card).split())
    assert (
        "GAP-1: 3 of 3 runs violate it: at worst gap is 0 where more than 0 is required, " in text
    )
    assert "[always (gap > 0)]" in text
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
    for once in ("reliance", "fault", "attack"):
        assert starts.count(once) == 1
    columns = next(line for line in brief if line.startswith("case "))
    legend = " ".join(" ".join(brief).split())
    for column, meaning in (
        ("recov", "stretches in which recovery acted, in valid runs"),
        ("alerts", "in valid runs"),
        ("inv", "invalid runs, and missing ones behind a plus"),
    ):
        assert column in columns
        assert legend.count(f"{column}: {meaning}") == 1
    # What the runs cannot show is no news.
    assert not any("cannot be told" in line for line in brief)
    (attack,) = (line for line in brief if line.startswith("attack:"))
    assert re.search(r"; ghost-obstacle (costs|saves) [\d.]+ s of clearance", attack)
    (fault,) = (line for line in brief if line.startswith("fault:"))
    assert "1 fault in 2 runs: 2 activated, 2 manifested" in fault
    assert "verdicts are supported. The weakest bound among them" in " ".join(brief)

    whole = section(project.scenarios("--dura-runs=2", "-v", select=chosen))
    for title in ("reliance", "fault", "attack", "recovery", "monitor"):
        assert any(line.startswith(f"{title} ") for line in whole), title
    legends = " ".join(whole)
    for legend in ("act: it began", "prev: violated only without recovery", "TP: true positives"):
        assert legend in legends
    assert any(line.startswith("verdict ") for line in whole)
    assert any("cannot be told" in line for line in whole)
    assert (
        len([line for line in whole if "pairs: runs of equal seeds, with the faults" in line]) == 1
    )


def test_all_verdicts_and_failures_are_shown_with_v(project):
    lines = section(project.scenarios("--dura-generator=corridor:Reckless", "-v"))
    (header,) = (line for line in lines if line.startswith("verdict "))
    assert header.split() == [
        "verdict", "n", "viol", "open", "inv", "miss", "vac", "rate", "<=", "margin",
    ]  # fmt: skip
    rows = [line.split() for line in lines if re.match(r"(GAP|GO)-1 on ", line)]
    assert [row[:5] + row[-1:] for row in rows] == [
        ["GAP-1", "on", "corridor/free", "violated", "3", "0"],
        ["GAP-1", "on", "corridor/tight", "violated", "2", "0"],
        ["GO-1", "on", "corridor/free", "supported", "3", "0"],
    ]
    # A failure is told once: its card has what its item's failure says, and how to run it again.
    assert sum("violated: " in line for line in lines) == 2
    rerun = "  rerun:    pytest corridor/tight::GAP-1 --dura-generator=corridor:Reckless"
    assert rerun in lines


def test_a_failure_section_has_three_lines_and_the_card_the_rest(project):
    text = project.scenarios("--dura-generator=corridor:Reckless").stdout.str()
    failure = text.partition("___ corridor/tight::GAP-1 ___")[2].partition("\n")[2]
    lines = re.split(r"\n[_=]{5,} ", failure)[0].split("\n")
    assert [line.partition(":")[0] for line in lines] == ["violated", "worst", "rerun"]
    assert lines[1].split(": ", 2)[1].strip() == "corridor/tight#0"
    assert lines[1].endswith(
        "gap is 0 where more than 0 is required, first at t = 0.20 s (why: see its card)"
    )


def test_what_would_decide_a_rate_stands_in_the_card_alone(project):
    requirements = project.path / "scenarios/requirements.yaml"
    text = requirements.read_text()
    requirements.write_text(
        re.sub(r"(?m)^( +)(check: .*gap.*)$", r"\1\2\n\1at_most: 0.05", text, count=1)
    )
    result = project.scenarios().stdout.str()
    assert result.count("a new plan on a fresh seed") == 1
    failure = result.partition("::GAP-1 ___")[2].partition("=== dura ===")[0]
    assert "which does not support 0.05\n" in failure


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
    assert "undecided: safety on corridor/broken (Careful) (1 of 1 cause)" in lines
    (line,) = (line for line in lines if line.startswith("  GAP-1:"))
    assert "undecided, 0 of 0 runs violate it, 3 missing." in line
    assert "  and:      GO-1: undecided for the same reason" in lines
    reruns = [line for line in lines if line.startswith("  rerun:")]
    assert reruns == ["  rerun:    pytest corridor/broken"]


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
    case = make(CaseEntry, id="room", component="Heater", metrics=nothing)
    _, row, *_ = table_lines(case_table([case]))
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
