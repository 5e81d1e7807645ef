"""Sessions that seed defects into what a suite rests on: what catches them, and what fails."""

import json
import re

import pytest
import yaml
from corridors import requirement, scenario
from gsn_rules import rule_problems

from pytest_dura.qualification import MUTANTS

FEW = "inverted or frozen or flipped or coin or always_safe or stale or looser"


@pytest.fixture(autouse=True)
def _own_mutants_alone():
    """Sessions in this process share the registry; what one registers, no later one has."""
    before = dict(MUTANTS._registered)
    yield
    MUTANTS._registered.clear()
    MUTANTS._registered.update(before)


@pytest.fixture
def qualified(project):
    """Runs the corridor's scenarios, and the gate on some of its mutants."""

    def run(*arguments, chosen=FEW):
        keep = f"corridor or {chosen}" if chosen else ""
        chosen_arguments = ["-k", keep] if keep else []
        return project.scenarios("--dura-qualify", "--dura-runs=2", *chosen_arguments, *arguments)

    return run


@pytest.fixture
def few(project, qualified, made_once):
    """What a session printed that seeded a few defects, which the gate passes."""
    return made_once(project, "few", lambda: qualified("--junitxml=junit.xml"))


@pytest.fixture
def each(project, qualified, made_once):
    """What a session printed that seeded each defect, with a share demanded that is not there."""
    share = "--dura-qualify-at-least=0.9"
    return made_once(project, "each", lambda: qualified(share, chosen=""))


def results(project):
    facts = project.evidence().facts
    return {fact.about: fact.data for fact in facts}


def catchers(result):
    return {(kill["requirement"], kill["case"]) for kill in result["kills"]}


def test_says_which_requirement_catches_which_defect(project, few):
    assert few.ret == 0
    known = results(project)
    assert known["generator.inverted"]["status"] == "caught"
    assert ("GO-1", "corridor/free") in catchers(known["generator.inverted"])
    flipped = known["simulator.sign_flipped[signal=gap]"]
    assert ("GAP-1", "corridor/free") in catchers(flipped)
    assert ("GO-1", "corridor/free") not in catchers(flipped)
    assert flipped["runs"] == 2  # one of each case: what is caught is run no further


def test_tells_a_defect_that_changes_no_run_from_one_that_survives(project, few):
    known = results(project)
    assert known["generator.frozen[since=6]"]["status"] == "no difference"
    assert known["safety_monitor.always_safe"]["status"] == "no difference"
    stale = known["generator.stale[ticks=15]"]
    assert (stale["status"], stale["kills"]) == ("survived", [])
    near = stale["nearest"]
    assert near["requirement"] == "GAP-1"
    assert 0 < near["left"] < near["before"]
    assert (near["runs"], near["nearer"]) == (2, 2)


def test_says_what_would_catch_a_survivor_and_that_it_would(project, qualified, few):
    """The corridor's wall is where it is: with the margin asked for, the gate catches it."""
    table = project.evidence().conclusions["qualification_survivors"]
    place = [column.name for column in table.columns].index("would catch it")
    (row,) = [row for row in table.rows if row[0] == "generator.stale[ticks=15]"]
    above, to = map(float, re.fullmatch(r"a margin above (\S+), up to (\S+)", row[place]).groups())
    assert row[place + 1] == 1
    asked = (above + to) / 2
    file = project.path / "scenarios" / "requirements.yaml"
    file.write_text(file.read_text().replace("always (gap > 0)", f"always (gap > {asked:g})"))
    qualified(chosen="stale")
    known = results(project)["generator.stale[ticks=15]"]
    assert ("GAP-1", row[2].partition(" on ")[2]) in catchers(known)


def test_requirements_are_seeded_with_defects_too(project, qualified):
    """GAP-1 asks for a gap above 0, at the wall: a planner that drives into it is let pass where
    the bound lies behind the wall, and one that is sound fails by the opposite."""
    qualified(chosen="requirement")
    known = results(project)
    negated = known["requirement.negated[id=GAP-1]"]
    assert (negated["status"], negated["about"]) == (
        "caught", "asks for the opposite: not (always (gap > 0))",
    )  # fmt: skip
    looser = known["requirement.looser[id=GO-1]"]
    assert (looser["status"], looser["kills"]) == ("survived", [])
    assert known["requirement.looser[id=GAP-1]"]["about"].endswith("always (gap > -0.5)")
    assert "requirement.shorter[id=GAP-1]" not in known


def test_what_does_not_repeat_is_caught_by_the_repetition(project, few):
    (kill, *_) = results(project)["generator.coin_flips"]["kills"]
    assert kill["requirement"] == "repeatability"


def test_shows_it_in_the_terminal_the_summary_and_the_page(project, each):
    each.stdout.fnmatch_lines([
        "Seeded defects", "*generator.inverted*caught*GO-1*corridor/free*",
        "The suite catches * of * seeded defects (95 % interval * to * %)*",
        "Defects that nothing catches",
    ])  # fmt: skip
    table = project.evidence().conclusions["qualification"]
    assert len(table.rows) == len(results(project))
    for name in ("summary.md", "report.html"):
        assert "Seeded defects" in (project.path / "dura-evidence" / name).read_text("utf-8")


def test_a_survivor_has_a_card_that_is_no_cause_of_a_failed_gate(project, few):
    """With the margin that it leaves, and what would catch it; beside the matrix alone."""
    assert few.ret == 0
    near = results(project)["generator.stale[ticks=15]"]["nearest"]
    bundle = project.path / "dura-evidence"
    page = re.sub(r"<[^>]+>", " ", (bundle / "report.html").read_text("utf-8"))
    _, _, cards = " ".join(page.split()).partition("How near each survivor came to being caught")
    about, _, card = cards.partition("generator.stale[ticks=15] :")
    named = "requirement.looser[id=GAP-1], requirement.looser[id=GO-1]"
    assert f"No margin says how near {named} came." in about
    assert f"Nearest is GAP-1 on {near['case']}, of whose margin of {near['before']:.3g}" in card
    assert f"Asked for a margin above {near['left']:.3g}" in card
    assert "in 1 run with a probability of 95 %" in card
    shown = f"{100 * (1 - near['left'] / near['before']):.0f} % used up"
    assert shown in card
    others = few.stdout.str() + (bundle / "summary.md").read_text("utf-8")
    others += (project.path / "junit.xml").read_text("utf-8")
    assert "How near each survivor" not in others
    assert "Cause 1" not in others


def test_the_record_has_no_episode_and_no_verdict_of_a_mutant(project, few):
    record = project.evidence()
    assert {episode.component for episode in record.episodes} == {"Careful"}
    assert {verdict.verdict for verdict in record.verdicts} == {"supported"}
    assert {case.id for case in record.cases} == {"corridor/free", "corridor/tight"}


def test_verify_concludes_the_tables_again_and_finds_a_forged_count(project, few):
    command = ("-m", "pytest_dura", "verify", "dura-evidence")
    assert project.pytester.run(*project.workers.command(*command)).ret == 0
    file = project.path / "dura-evidence" / "evidence.json"
    record = json.loads(file.read_text("utf-8"))
    (row,) = [
        row for row in record["conclusions"]["qualification"]["rows"]
        if row[0] == "generator.inverted"
    ]  # fmt: skip
    row[1] = "survived"
    file.write_text(json.dumps(record), encoding="utf-8")
    forged = project.pytester.run(*project.workers.command(*command))
    assert forged.ret != 0
    forged.stdout.fnmatch_lines(["*conclusions/qualification*"])


def test_the_argument_claims_what_is_caught_and_leaves_the_rest_undeveloped(project, qualified):
    qualified(chosen="generator")
    text = (project.path / "dura-evidence" / "assurance-case.gsn.yaml").read_text("utf-8")
    found = {id_: node for id_, node in yaml.safe_load(text).items() if id_ != "module"}
    assert rule_problems(found) == []
    known = results(project)
    total, caught = len(known), sum(each["status"] == "caught" for each in known.values())
    top = found["G-table:qualification"]
    assert f"the suite catches {caught} of {total} seeded defects (95 % interval" in top["text"]
    assert "G-table:qualification" in found["GTop"]["supportedBy"]
    of_component = [data for name, data in known.items() if name.startswith("generator.")]
    own = sum(each["status"] == "caught" for each in of_component)
    shown = found["G-table:qualification@generator"]
    assert shown["text"] == (
        f"Of {len(of_component)} seeded defects of the generator, the suite catches {own}."
    )
    assert [found[name]["url"] for name in shown["supportedBy"]] == [
        "evidence.json#/conclusions/qualification"
    ]
    left = found["G-table:qualification@generator-left"]
    assert left["undeveloped"]
    assert "Not shown: generator." in left["text"]
    # What was not run at all is left open as a whole.
    assert "G-table:qualification@simulator" not in found
    assert found["G-table:qualification@simulator-left"]["undeveloped"]


def test_the_page_has_a_matrix_of_what_catches_what(project, few):
    page = (project.path / "dura-evidence" / "report.html").read_text("utf-8")
    assert "Which requirement catches which seeded defect" in page
    (described,) = re.findall(r"generator\.inverted: ([^.<]*)\.", page)
    assert set(described.split(", ")) == {
        kill["requirement"] for kill in results(project)["generator.inverted"]["kills"]
    }
    assert "generator.frozen[since=6]: no difference." in page


def test_without_a_qualification_the_argument_claims_nothing_of_it(project):
    assert project.scenarios().ret == 0
    text = (project.path / "dura-evidence" / "assurance-case.gsn.yaml").read_text("utf-8")
    assert "seeded" not in text


def test_the_gate_demands_a_share(project, each):
    assert each.ret == 1
    reasons = " ".join(project.evidence().gate.reasons)
    assert "the suite catches" in reasons
    assert "at least 90 % are demanded" in reasons


def test_a_share_counts_what_the_session_left_out_as_not_caught(project, qualified):
    result = qualified("--dura-qualify-at-least=0.01", chosen="inverted")
    assert result.ret == 1
    assert "not run" in " ".join(project.evidence().gate.reasons)
    left_out = results(project)["generator.stale[ticks=5]"]
    assert (left_out["status"], left_out["problem"]) == ("not run", "the session left it out")


@pytest.mark.parametrize("share", ["0", "1.5", "many"])
def test_refuses_what_is_no_share(project, share):
    result = project.scenarios(f"--dura-qualify-at-least={share}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--dura-qualify-at-least*", "*a number above 0*"])


def test_refuses_to_qualify_nothing(project):
    project.write("test_nothing.py", "def test_nothing():\n    pass\n")
    result = project.run("--dura-qualify", "test_nothing.py")
    assert result.ret != 0
    text = "\n".join([*result.outlines, *result.errlines])
    assert "--dura-qualify qualifies scenario cases" in text


def test_a_defect_whose_runs_break_down_is_not_caught_and_fails(project, qualified):
    project.write("breaking.py", BREAKS)
    project.write("conftest.py", "import breaking\n")
    result = qualified("-p", "no:xdist", chosen="breaks")
    assert result.ret == 1
    known = results(project)["safety_monitor.breaks"]
    assert (known["status"], known["kills"]) == ("not run", [])
    assert "out of order" in known["problem"]


BREAKS = """
from pytest_dura import SafetyMonitor
from pytest_dura.qualification import MUTANTS, Mutation


@MUTANTS.register("safety_monitor.breaks")
class Breaks(Mutation, SafetyMonitor):
    about = "breaks down"

    def run(self, view):
        raise RuntimeError("out of order")
"""


def test_monitors_are_provoked(project, qualified):
    """The component stops by itself, so that its gate needs no monitor. One that drives on is
    refused by the monitor and stopped by the recovery: on its runs both are judged."""
    scenario(
        project, "watched", recovery_planner="Brake", duration=5.0, monitor="Watch",
        world="{wall: 4.0}", requirements="[GAP-1]",
    )  # fmt: skip
    project.write("provoking.py", DRIVES_ON)
    project.write("conftest.py", "import provoking\n")
    qualified("--dura-select=corridor/watched", chosen="always_safe or nothing or drives_on")
    known = results(project)
    for name in ("safety_monitor.always_safe", "recovery_planner.nothing"):
        (kill,) = known[name]["kills"]
        assert (kill["requirement"], kill["provoker"]) == ("GAP-1", "generator.drives_on")
    # With its own monitor and recovery the gate passes it.
    assert known["generator.drives_on"]["status"] == "survived"


DRIVES_ON = """
from pytest_dura import Proposal
from pytest_dura.qualification import MUTANTS
from pytest_dura.qualification.mutants.component import ComponentMutation


@MUTANTS.register("generator.drives_on")
class DrivesOn(ComponentMutation):
    about = "drives on at the wall"
    provokes = True

    def propose(self, view):
        return Proposal(1.0)
"""


def test_what_the_part_as_it_is_violates_catches_nothing(project, qualified):
    requirement(project, "always (x < -100)", name="NEVER-1", applies_to='["corridor/*"]')
    qualified(chosen="inverted")
    known = results(project)["generator.inverted"]
    assert known["status"] == "caught"
    assert "NEVER-1" not in {kill["requirement"] for kill in known["kills"]}


def test_a_marker_asks_for_it(project):
    project.write("test_marked.py", MARKED)
    result = project.run("test_marked.py", "-k", "marked or inverted")
    assert result.ret == 0
    known = results(project)["generator.inverted"]
    assert catchers(known) == {("GO-1", "corridor/free")}


MARKED = """
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=2, qualify=True)
@pytest.mark.requirement("GO-1")
def test_marked(campaign):
    campaign.require()
"""


def test_workers_run_it_as_well(project, qualified):
    result = qualified("-n", "2", chosen="inverted or flipped")
    assert result.ret == 0
    assert results(project)["generator.inverted"]["status"] == "caught"


def test_a_requirement_that_catches_nothing_is_named(project, qualified):
    requirement(project, "always (x > -100)", name="LAX-1", applies_to='["corridor/*"]')
    qualified(chosen="inverted")
    rows = {row[0]: row[1:3] for row in
            project.evidence().conclusions["qualification_requirements"].rows}  # fmt: skip
    assert rows["LAX-1"] == (0, 0)
    assert rows["GO-1"][0] >= 1


def test_a_repetition_that_breaks_down_catches_nothing(project, qualified):
    project.write("breaking.py", BREAKS_LATER)
    project.write("conftest.py", "import breaking\n")
    qualified("--dura-executor=in-process", chosen="tires")
    result = results(project)["simulator.tires"]
    assert (result["status"], result["kills"]) == ("no difference", [])
    assert "out of order" in result["problem"]


BREAKS_LATER = """
from pytest_dura.qualification import MUTANTS
from pytest_dura.qualification.mutants.plant import SimulatorMutation


@MUTANTS.register("simulator.tires")
class Tires(SimulatorMutation):
    about = "breaks down from the fifth episode of its process on"
    episodes = 0

    def reset(self, scenario, seed):
        type(self).episodes += 1
        if self.episodes > 4:
            raise RuntimeError("out of order")
        return self.part.reset(scenario, seed)
"""
