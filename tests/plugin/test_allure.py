from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest
from allure_commons import model2
from allure_commons.types import AttachmentType, Severity
from corridors import IDLE, requirement, scenario

from pytest_dura.core.codec import encode

RECKLESS = "--dura-generator=corridor:Reckless"
SCENARIOS = ["--dura-scenarios", "--dura-select=corridor/*"]
LOOP = ["Update", "Propose", "Assess", "Decide", "Act", "Log"]
OWN = """
import allure
import pytest

@allure.severity("trivial")
@allure.epic("own")
@pytest.mark.dura(scenario="corridor/tight", runs=2)
@pytest.mark.requirement("OWN-1", text="Stays.", kind="security", source="a [link](x) & <b>")
def test_each(episode):
    '''What the author says.'''
    assert not episode.collided

@pytest.mark.dura(scenario="corridor/tight", runs=2)
@pytest.mark.requirement("OWN-2", text="Moves.", kind="performance")
def test_rate(campaign):
    campaign.require("always (gap >= 0)", at_most=0.9)

def test_plain():
    pass
"""


def loaded(kind, data, **parts):
    """What allure's own class of a result makes of plain data; it refuses unknown keys."""
    return kind(**(data | parts))


def step(data):
    return loaded(
        model2.TestStepResult,
        data,
        steps=[step(one) for one in data.get("steps", ())],
        attachments=[model2.Attachment(**one) for one in data.get("attachments", ())],
        parameters=[model2.Parameter(**one) for one in data.get("parameters", ())],
    )


class Results:
    """The results in a directory by their names, each as allure's own model."""

    def __init__(self, folder):
        self.folder = folder
        self.found = {}
        for file in folder.glob("*-result.json"):
            data = json.loads(file.read_text("utf-8"))
            base = step(
                {key: data.get(key) for key in ("name", "status")}
                | {key: data[key] for key in ("steps", "attachments", "parameters") if key in data}
            )
            result = loaded(
                model2.TestResult,
                data,
                steps=base.steps,
                attachments=base.attachments,
                parameters=base.parameters,
                labels=[model2.Label(**one) for one in data["labels"]],
                links=[model2.Link(**one) for one in data.get("links", ())],
            )
            assert result.fullName not in self.found or "test_each" in result.fullName
            self.found.setdefault(result.fullName, result)

    def labels(self, name):
        found = {}
        for one in self.found[name].labels:
            found.setdefault(one.name, set()).add(one.value)
        return found

    def parameters(self, name):
        return {one.name: one.value for one in self.found[name].parameters}

    def body(self, attachment):
        """The bytes of an attachment that is where it is said to be, under a name of its own."""
        file = self.folder / attachment.source
        assert file.resolve().parent == self.folder.resolve()
        return file.read_bytes()

    def bodies(self, step):
        return {one.name: self.body(one) for one in step.attachments}


@pytest.fixture
def allure(project):
    def run(*arguments):
        result = project.run("--alluredir=allure", *arguments)
        text = result.stdout.str() + result.stderr.str()
        assert "INTERNALERROR" not in text
        assert "Warning" not in text
        return Results(project.path / "allure")

    return run


@pytest.mark.parametrize("mode", ["plain", "n2"])
def test_a_violation_tells_of_itself_in_every_mode(reference, mode):
    assert "INTERNALERROR" not in reference(mode).result.stdout.str()
    found = Results(reference(mode).path / "allure")
    assert len(found.found) == 3
    result = found.found["corridor.tight#GAP-1"]
    assert result.status == "failed"
    assert result.name == "corridor/tight: GAP-1 It touches nothing."
    assert "2 of 2 valid episodes violated it" in result.description
    assert result.description.startswith("**GAP-1** It touches nothing.")
    missed = "gap is 0 where more than 0 is required, first at t = 0.20 s"
    description = result.description.replace("\\", "")
    assert "**violated: safety on corridor/tight (Reckless)**" in description
    assert "\n\nNo role had objected; the run ended " in description
    assert f"\n- GAP-1: 2 of 2 runs violate it: at worst {missed}." in description
    assert "\n- replay: `pytest --dura-replay='corridor/tight#0'`" in result.description
    (worst,) = result.steps
    assert worst.name.startswith("Counterexample corridor/tight#0, seed ")
    assert worst.status == "failed"
    assert "No role had objected; the run ended " in worst.statusDetails["message"]
    assert f" GAP-1: 2 of 2 runs violate it: at worst {missed}." in worst.statusDetails["message"]
    assert [one.name.partition(":")[0] for one in worst.steps] == LOOP
    assert worst.steps[0].name == "Update: t = 0.20 s"
    assert worst.steps[1].name == "Propose: 20.0"
    assert {"gap"} <= {one.name for one in worst.steps[0].parameters}
    assert [(one.name, one.value) for one in worst.steps[5].parameters][-1] == (
        "GAP-1",
        "violated: always (gap > 0)",
    )
    passed = found.found["corridor.free#GO-1"]
    assert passed.status == "passed"
    (sample,) = passed.steps
    assert (sample.name.partition(",")[0], sample.status) == ("Sample corridor/free#0", "passed")


def test_labels_link_and_parameters(allure, project):
    scenario(project, faults=IDLE, fault_injector="corridor:Idle", requirements="[R-1]", runs=1)
    requirement(project, "always (gap >= 0)", source="house rule", kind="recovery")
    pattern = "--allure-link-pattern=requirement:https://example.org/{}.html"
    found = allure("corridor/it", "corridor/tight", "--dura-seed=3", pattern)
    labels = found.labels("corridor.it#R-1")
    assert labels["epic"] == {"dependability"}
    assert labels["feature"] == {"corridor/it"}
    assert labels["story"] == {"ghost-obstacle"}
    assert labels["severity"] == {Severity.CRITICAL}
    assert labels["tag"] == {"recovery"}
    assert labels["requirement"] == {"R-1"}
    assert labels["component"] == {"Careful"}
    assert found.labels("corridor.tight#GAP-1")["severity"] == {Severity.BLOCKER}
    assert found.labels("corridor.tight#GAP-1")["story"] == {"no faults"}
    result = found.found["corridor.it#R-1"]
    assert result.links == [model2.Link("requirement", "https://example.org/R-1.html", "R-1")]
    assert "Source: house rule" in result.description
    told = found.parameters("corridor.tight#GAP-1")
    assert told == {
        "case": "'corridor/tight'",
        "component": "'Careful'",
        "verdict": "'supported'",
        "planned": "2",
        "valid": "2",
        "violations": "0",
        "bound": told["bound"],
        "confidence": "0.95",
        "base seed": "3",
    }
    assert float(told["bound"]) == project.verdict("GAP-1", "corridor/tight").bound.upper
    assert all(one.excluded for one in result.parameters)


def test_attachments_are_what_they_are_said_to_be(reference):
    from mcap.reader import make_reader

    session = reference("plain")
    found = Results(session.path / "allure")
    result = found.found["corridor.tight#GAP-1"]
    verdict = json.loads(found.bodies(result)["verdict GAP-1"])
    told = session.verdict("GAP-1", "corridor/tight")
    assert verdict == {key: encode(getattr(told, key)) for key in verdict}
    assert verdict["counterexamples"][0]["episode"] == "corridor/tight#0"
    (worst,) = result.steps
    types = {one.name: one.type for one in worst.attachments}
    assert types == {
        "plot": AttachmentType.SVG.mime_type,
        "animation": AttachmentType.HTML.mime_type,
        "signals": AttachmentType.CSV.mime_type,
        "trace": "application/octet-stream",
    }
    bodies = found.bodies(worst)
    plot = ET.fromstring(bodies["plot"])
    assert plot.tag == "{http://www.w3.org/2000/svg}svg"
    assert "GAP-1: violated at 0.20 s" in "".join(plot.itertext())
    assert "margin of gap > 0" in "".join(plot.itertext())
    assert b"DuraPlayer.mount(" in bodies["animation"]
    rows = bodies["signals"].decode().splitlines()
    assert rows[0] == "time,breeze,cleared,collided,gap,x"
    assert len(rows) == 1 + 21
    assert bodies["trace"].startswith(b"\x89MCAP0\r\n")
    channels = make_reader(io.BytesIO(bodies["trace"])).get_summary().channels
    assert channels
    assert worst.attachments[3].source.endswith(".mcap")


def test_a_violation_on_pairs_has_its_event_and_picture_and_names_no_module(allure, project):
    project.write(
        "scenarios/requirements_P-1.yaml",
        "requirements:\n  - {id: P-1, text: An attack costs nothing., kind: security, "
        "applies_to: [intersection/ghost-obstacle], paired: {without: faults, "
        "measure: 'pytest_dura.driving.measures:clearance_time', change_at_most: 0.0}}\n",
    )
    found = allure("intersection/ghost-obstacle::P-1", "--dura-runs=1", "--dura-generator=tactical")
    result = found.found["intersection.ghost-obstacle#P-1"]
    assert result.status == "failed"
    card = result.description.replace("\\", "").partition("**violated: security on ")[2]
    assert "the fault ghost-obstacle" in card
    message = result.statusDetails["message"]
    assert re.search(
        r": clearance time grows by \S+ s with the faults where 0 s is allowed", message
    )
    assert "pytest_dura" not in result.description + result.statusDetails["message"]
    (worst,) = result.steps
    assert worst.name.startswith("Counterexample intersection/ghost-obstacle#0, ")
    picture = ET.fromstring(found.bodies(worst)["picture"])
    assert picture.tag == "{http://www.w3.org/2000/svg}svg"
    assert "clearance time grows by" in picture.get("aria-label")


def test_our_functions_are_told_of_and_others_are_left_alone(allure, project):
    project.write("test_it.py", OWN)
    found = allure("test_it.py", RECKLESS)
    result = found.found["test_it#test_each"]
    assert result.status == "failed"
    assert result.description.startswith("What the author says.\n\n**OWN-1** Stays.")
    assert r"a \[link\](x) \& \<b\>" in result.description
    assert "by assertion: the test looked at collided" in result.description
    assert result.name.startswith("test_each[")
    assert result.name.endswith(": OWN-1 Stays.")
    labels = found.labels("test_it#test_each")
    assert (labels["severity"], labels["epic"]) == ({"trivial"}, {"own"})
    assert labels["feature"] == {"corridor/tight"}
    assert found.parameters("test_it#test_each")["episode"].startswith("corridor/tight#")
    (worst,) = result.steps
    assert worst.name.startswith("Counterexample corridor/tight#")
    assert [one.name.partition(":")[0] for one in worst.steps] == LOOP
    (sample,) = found.found["test_it#test_rate"].steps
    assert found.labels("test_it#test_rate")["severity"] == {"normal"}
    assert "plot" in found.bodies(sample)
    plain = found.found["test_it#test_plain"]
    assert (plain.steps, plain.attachments, plain.parameters) == ([], [], [])
    assert "epic" not in found.labels("test_it#test_plain")


def test_a_summary_keeps_the_verdict_alone(allure):
    found = allure("corridor/tight", RECKLESS, "--dura-evidence-level=summary")
    result = found.found["corridor.tight#GAP-1"]
    assert result.steps == []
    assert [one.name for one in result.attachments] == ["verdict GAP-1"]


def test_reports_do_not_change_the_evidence(project, reference):
    def kept(session):
        record = session.evidence()
        names = ("id", "planned", "digest", "trace")
        episodes = [[getattr(one, name) for name in names] for one in record.episodes]
        return episodes, record.verdicts

    project.run(*SCENARIOS, RECKLESS)
    assert kept(reference("plain")) == kept(project)


def test_labels_select_our_items(project):
    result = project.run(*SCENARIOS, "--allure-severities=blocker")
    result.assert_outcomes(passed=2, deselected=1)
    result = project.run(*SCENARIOS, "--allure-features=corridor/tight")
    result.assert_outcomes(passed=1, deselected=2)


def test_a_test_is_the_same_one_whatever_it_finds(allure, project):
    project.write("test_it.py", OWN)
    arguments = ["corridor/tight", "test_it.py::test_rate"]
    before = allure(*arguments).found
    for file in (project.path / "allure").iterdir():
        file.unlink()
    after = allure(*arguments, RECKLESS, "--dura-seed=9").found
    assert {name: one.historyId for name, one in before.items()} == {
        name: one.historyId for name, one in after.items()
    }


def test_what_was_never_run_is_undecided(allure, project):
    project.write(
        "test_it.py",
        "import pytest\n@pytest.fixture\ndef breaks(): raise RuntimeError('no')\n"
        "@pytest.mark.dura(scenario='corridor/tight')\n"
        "@pytest.mark.requirement('OWN-1', text='Never begins.')\n"
        "def test_setup(breaks, campaign): pass\n",
    )
    found = allure("test_it.py")
    result = found.found["test_it#test_setup"]
    assert result.status == "broken"
    assert result.steps == []
    assert found.parameters("test_it#test_setup")["verdict"] == "'undecided'"


def test_an_episode_that_says_nothing_says_why(allure, project):
    scenario(project, "it", monitor="Broken", requirements="[GAP-1]")
    scenario(project, "idle", faults=IDLE, fault_injector="corridor:Idle", requirements="[GAP-1]")
    found = allure("corridor/it", "corridor/idle").found
    (missing,) = found["corridor.it#GAP-1"].steps
    assert missing.name.startswith("Missing corridor/it#0, ")
    assert missing.status == "failed"
    assert "RuntimeError: no opinion" in missing.statusDetails["message"]
    (invalid,) = found["corridor.idle#GAP-1"].steps
    assert invalid.name.startswith("Invalid corridor/idle#0, ")
    assert "never manifested: ghost-obstacle" in invalid.statusDetails["message"]


def test_what_violates_no_requirement_is_no_counterexample(allure, project):
    project.write(
        "scenarios/requirements_P-1.yaml",
        "requirements:\n  - {id: P-1, text: Recovery helps., kind: recovery, "
        "check: always (gap > 0), paired: {without: recovery_planner}}\n",
    )
    scenario(
        project,
        generator="Reckless",
        recovery_planner="Brake",
        world="{wall: 3.0}",
        requirements="[P-1]",
    )
    result = allure("corridor/it").found["corridor.it#P-1"]
    assert result.status == "passed"
    (sample,) = result.steps
    assert (sample.name.partition(",")[0], sample.status) == ("Sample corridor/it#0", "passed")


def test_an_attachment_that_is_too_large_is_left_out_visibly(allure, project):
    project.write(
        "conftest.py",
        # Not by the package's attribute, which may be the module of an earlier test.
        "import importlib\n"
        "importlib.import_module('pytest_dura.plugin.session.allure_results').LARGEST = 5000\n",
    )
    found = allure("corridor/tight", RECKLESS)
    (worst,) = found.found["corridor.tight#GAP-1"].steps
    bodies = found.bodies(worst)
    assert {"plot", "signals", "animation (left out)", "trace (left out)"} == bodies.keys()
    assert b"an attachment has at most 5000" in bodies["trace (left out)"]


NASTY = r"\0\x1b[31m\ud800\u202e<script>alert(1)</script>../../x&\n" + "x" * 10_000


def test_hostile_texts_come_out_harmless(allure, project):
    project.write(
        "nasty.py",
        "from corridor import Corridor, Reckless\n"
        "from pytest_dura import Proposal\n"
        f"NASTY = '{NASTY}'\n"
        "class Nasty(Reckless):\n"
        "    def propose(self, view):\n"
        "        if view.time > 0.25: raise ValueError(NASTY)\n"
        "        return Proposal(20.0, explanation=NASTY.replace('\\ud800', ''))\n",
    )
    project.write(
        "test_it.py",
        "import pytest\nfrom nasty import NASTY\n"
        "@pytest.mark.dura(scenario='corridor/tight', runs=1)\n"
        "@pytest.mark.requirement('javascript:alert(1)//../' + NASTY, text=NASTY)\n"
        "def test_it(episode): assert not episode.collided, NASTY\n",
    )
    found = allure("corridor/tight", "test_it.py", "--dura-generator=nasty:Nasty", "-n", "2")
    result = found.found["test_it#test_it"]
    (link,) = result.links
    assert link.url.startswith("javascript%3Aalert%281%29%2F%2F..%2F")
    # What stands between backticks is shown as it is written.
    prose = re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", result.description, flags=re.DOTALL)
    assert "<script>" not in prose.replace(r"\<script\>", "")
    files = [one.name for one in found.folder.iterdir()]
    assert all(name.count("-") == 5 and "/" not in name for name in files)
    for one in [result, *result.steps, *result.steps[0].steps]:
        texts = [str(parameter.value) for parameter in one.parameters]
        assert max(map(len, [one.name, *texts])) < 1000
        assert all(text.isprintable() for text in texts)
    for name, body in found.bodies(result.steps[0]).items():
        assert len(body) < 200_000
        if name != "trace":
            assert b"<script>alert" not in body


def test_without_alluredir_allure_is_not_imported(project):
    code = (
        "import sys, pytest; pytest.main(['corridor/tight', '-q', '-p', 'no:allure_pytest']);"
        "sys.exit(any(name.split('.')[0] in ('allure', 'allure_commons') for name in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=project.path, check=False)
    assert run.returncode == 0
