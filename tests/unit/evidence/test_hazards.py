"""What a record says of its hazards, in every format that is rendered from it."""

import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from gsn_rules import rule_problems
from session_records import REQUIREMENTS, hazard, session_record, verdict
from stated_counts import dead_references, elements_of, stated_counts

from pytest_dura.core.codec import encode
from pytest_dura.evidence import record_problems
from pytest_dura.library import parse_yaml
from pytest_dura.library.hazards import read_hazards
from pytest_dura.reports import cyclonedx, generated_argument, needs, summary
from pytest_dura.reports.gsn import svg_file, yaml_file
from pytest_dura.reports.hazards import hazard_line
from pytest_dura.reports.html import page
from pytest_dura.reports.wording import limitation_sentences

HAZARDS = [
    hazard("H-1", "S3"), hazard("H-2", "S2"), hazard("H-3"), hazard("H-4", "S3"), hazard("H-5")
]  # fmt: skip
MITIGATES = {"SAF-1": ["H-1"], "SEC-1": ["H-1", "H-2"], "PERF-1": ["H-5"]}


def record(hazards=HAZARDS, mitigates=MITIGATES, **changes):
    """SAF-1 is supported and violated, SEC-1 undecided, PERF-1 violated and waived."""
    requirements = [
        encode(REQUIREMENTS[name]) | ({"mitigates": mitigates[name]} if name in mitigates else {})
        for name in sorted(REQUIREMENTS)
    ]
    return session_record(**{"hazards": hazards, "requirements": requirements, **changes})


def goals(found, record_):
    """Elements of an argument by their aliases, which keeps the rules and leads nowhere dead."""
    assert rule_problems(found) == []
    text = yaml_file.render(record_)
    assert list(dead_references(text, record_)) == []
    return {node["alias"]: (id_, node) for id_, node in found.items() if "alias" in node}


@pytest.mark.parametrize(
    "hazards, mitigates, problem",
    [
        (HAZARDS, {"SAF-1": ["H-9"]}, "requirement SAF-1: it mitigates H-9, which is not listed"),
        (None, {"SAF-1": ["H-1"]}, "requirement SAF-1: it mitigates H-1, which is not listed"),
        (HAZARDS, {"SAF-1": ["H-1", "H-1"]}, "requirement SAF-1: it mitigates H-1 twice"),
        ([HAZARDS[0], HAZARDS[0]], {}, "hazards: one of them is listed twice"),
    ],
)
def test_hazards_that_contradict_the_requirements_are_problems_of_the_record(
    hazards, mitigates, problem
):
    changes = {} if hazards is None else {"hazards": hazards}
    requirements = record(HAZARDS, mitigates).head.requirements
    found = session_record(requirements=list(requirements), **changes)
    assert f"evidence.json: {problem}" in list(record_problems(found))
    assert not any("mitigates" in told or "hazard" in told for told in record_problems(record()))


def test_hazards_without_evidence_stand_at_the_top_of_what_is_not_shown():
    first, second, third, *_ = limitation_sentences(record())
    assert first == (
        "2 of 5 hazards without evidence, since no requirement of the session names them: "
        "H-4 (S3), H-3."
    )
    assert second == (
        "2 of 5 hazards without evidence, since no verdict supports the mitigation of them: "
        "H-2 (S2), H-5."
    )
    assert "hazard" not in third
    unjudged, *_ = limitation_sentences(record(HAZARDS[:1], {"SAF-1": ["H-1"]}, verdicts=[]))
    assert unjudged == (
        "1 of 1 hazard without evidence, since nothing was judged that is to mitigate it: H-1 (S3)."
    )
    assert hazard_line(record()) == "hazards without evidence: 4 of 5: H-4 (S3), H-3, H-2 (S2), H-5"
    assert hazard_line(record(HAZARDS[:1], {"SAF-1": ["H-1"]})) == ""
    assert not any("hazard" in told for told in limitation_sentences(session_record()))


def test_the_argument_goes_over_hazards_and_requirements_without_one_have_their_own_goal():
    mitigates = {"SAF-1": ["H-1"], "SEC-1": ["H-1", "H-2"]}
    made = record(HAZARDS[:3], mitigates)
    found = elements_of(yaml_file.render(made))
    by_alias = goals(found, made)
    strategy, node = by_alias["strategy:hazards"]
    assert found["GTop"]["supportedBy"][0] == strategy
    assert "strategy:kinds" not in by_alias
    first, second = (by_alias[f"hazard:H-{number}"][0] for number in (1, 2))
    others, below = by_alias["without-hazard"]
    assert node["supportedBy"] == [first, second, others]
    what = "safety, security and performance requirements"
    assert found["GTop"]["text"].endswith(f"meets its {what}.")
    assert node["text"] == (
        f"Argument over the {what}, by the 2 hazards that they mitigate, and over those that "
        "mitigate none."
    )
    assert (first, second) == ("G-hazard:H-1", "G-hazard:H-2")
    assert found[first]["supportedBy"] == ["G-SAF-1", "G-SEC-1"]
    assert found[second]["supportedBy"] == ["G-SEC-1"]
    assert below["supportedBy"] == ["G-PERF-1"]
    assert "1 supported, 1 violated, 1 undecided." in found[first]["text"]
    context = found[found[first]["inContextOf"][0]]["text"]
    assert context == (
        "Loss: L-1: health. Severity, as declared: S3; no ASIL follows without classes of exposure "
        "and controllability. Operating condition: In rain. Source: STPA."
    )


def test_only_hazards_that_a_requirement_of_the_session_names_are_argued_over():
    made = record(HAZARDS[:3], {"SAF-1": ["H-1"]})
    found = elements_of(yaml_file.render(made))
    assert [id_ for id_ in found if id_.startswith("G-hazard:")] == ["G-hazard:H-1"]
    assert "by the 1 hazard that they mitigate" in found["SHazards"]["text"]
    # That they were all is not shown, and what was left out stands there by name.
    assert found["GHazards"]["undeveloped"]
    assert "no requirement of the session names H-2, H-3." in found["GHazards"]["text"]
    unnamed = elements_of(yaml_file.render(record(HAZARDS[:3], {})))
    assert "SKinds" in unnamed["GTop"]["supportedBy"]
    assert "names H-1, H-2, H-3." in unnamed["GHazards"]["text"]


def bounded(**changes):
    """A hazard whose only requirement is supported in 20 of 20 runs."""
    verdicts = [verdict("SAF-1", "a/clear", ["satisfied"] * 20)]
    return record(
        [hazard("H-1", "S3", **changes)], {"SAF-1": ["H-1"]}, verdicts=verdicts, monitors=[]
    )


def test_the_extent_to_which_a_hazard_was_tested_is_its_weakest_bound():
    made = bounded()
    goal = elements_of(yaml_file.render(made))["G-hazard:H-1"]
    assert goal["text"] == (
        "H-1 is mitigated to the extent tested: State H-1. The weakest bound of its supported "
        "verdicts: at most 13.91 % of such runs violate SAF-1 in a/clear, n = 20, 95 % confidence. "
        "Verdicts on its 1 requirement: 1 supported."
    )
    assert "| ≤ 13.91 % (95 % conf.) | none declared |" in summary.render(made)
    assert "at most 13.91 % of such runs violate SAF-1" in page.render(made)
    wider = [*made.head.verdicts, verdict("SAF-1", "a/clear+ghost", ["satisfied"] * 5)]
    weaker = record([hazard("H-1")], {"SAF-1": ["H-1"]}, verdicts=wider)
    assert "at most 45.07 %" in elements_of(yaml_file.render(weaker))["G-hazard:H-1"]["text"]
    violated = elements_of(yaml_file.render(record()))["G-hazard:H-5"]["text"]
    assert "No verdict supports it, so that there is no bound." in violated


@pytest.mark.parametrize(
    "declared, met, why",
    [
        ({"at_most": 0.2}, True, ""),
        ({"at_most": 0.1}, False, "Not shown: The weakest bound"),
        ({"acceptance_criterion": "Rarer than with a driver"}, False, "it has no rate"),
    ],
)
def test_bounds_are_held_against_the_acceptance_criterion_of_a_hazard(declared, met, why):
    made = bounded(**declared)
    found = elements_of(yaml_file.render(made))
    goals(found, made)
    criterion = found["G-accepted:H-1"]
    assert "G-accepted:H-1" in found["G-hazard:H-1"]["supportedBy"]
    assert criterion.get("undeveloped", False) != met
    assert criterion["text"].startswith("The acceptance criterion of H-1 is met: ")
    assert why in criterion["text"]
    assert f"({'shown' if met else 'not shown'}) |" in summary.render(made)
    assert "G-accepted:H-1" not in elements_of(yaml_file.render(bounded()))


def test_a_violation_defeats_the_hazards_goal_and_a_waived_one_challenges_it():
    found = elements_of(yaml_file.render(record()))
    by_alias = goals(found, record())
    first, last = by_alias["hazard:H-1"][1], by_alias["hazard:H-5"][1]
    against = by_alias["challenge:hazard:H-1"][1]
    assert first["defeated"]
    assert against["supportedBy"] == ["CG-SAF-1"]
    assert "SAF-1 is violated" in against["text"]
    assert "defeated" not in last
    assert "Waivers accept all" in by_alias["challenge:hazard:H-5"][1]["text"]
    assert "defeated" not in by_alias["hazard:H-2"][1]


def test_without_hazards_the_argument_goes_over_kinds():
    found = elements_of(yaml_file.render(session_record()))
    assert found["GTop"]["supportedBy"][0] == "SKinds"
    assert "hazard" not in json.dumps(found)


def test_ids_that_others_may_refer_to_are_the_same_with_hazards():
    public = {"GTop", "GMonitors", *(f"G-{requirement}" for requirement in MITIGATES)}
    for made in (record(), session_record()):
        assert public <= elements_of(yaml_file.render(made)).keys()


def test_the_picture_has_every_hazard_and_each_requirement_once():
    text = svg_file.render(record())
    assert stated_counts(svg_file, text) == record().head.totals.to_json()
    for alias in ("H-1", "H-2", "H-5"):
        assert f"{alias} is mitigated" in text.replace("\n", " ")
    drawn = [each for each in ET.fromstring(text).iter() if each.get("data-id") == "G-SEC-1"]
    assert sorted(each.get("data-kind") for each in drawn) == ["Goal", "Reference"]


def test_the_page_leads_from_hazards_to_the_verdicts_on_their_requirements():
    text = page.render(record())
    view = re.search('<section id="hazards".*?</section>', text, re.DOTALL)[0]
    order = re.findall(r'<th scope="row">(H-\d)</th>', view)
    assert order == ["H-4", "H-2", "H-3", "H-5", "H-1"]
    assert view.count("without evidence: ") == 4
    assert view.count("No requirement of the session names it.") == 2
    last = view[view.rindex("<tr>") :]
    assert ">SAF-1: 1 violated, 1 supported</a>" in last
    ids = set(re.findall(r'id="([^"]*)"', text))
    links = re.findall(r'href="#([^"]*)"', view)
    assert links
    assert set(links) <= ids
    assert '<section id="hazards"' not in page.render(session_record())


def test_the_summary_has_a_short_table_of_hazards():
    text = summary.render(record())
    table = text.partition("\n## Hazards\n")[2].partition("\n## ")[0]
    rows = [line for line in table.split("\n") if line.startswith("| `")]
    assert rows[0] == "| `H-4` | S3 | State H-4. | none | no requirement | none | none declared |"
    assert rows[-1] == (
        "| `H-1` | S3 | State H-1. | SAF-1, SEC-1 | violated | ≤ 77.64 % (95 % conf.) "
        "| none declared |"
    )
    assert "## Hazards" not in summary.render(session_record())


def test_cyclonedx_names_the_hazards_of_a_requirement():
    document = json.loads(cyclonedx.render(record()))
    listed = {
        each["identifier"]: [p["value"] for p in each["properties"] if "mitigates" in p["name"]]
        for each in document["definitions"]["standards"][0]["requirements"]
    }
    assert listed == MITIGATES


def needs_of(record_):
    (version,) = json.loads(needs.render(record_))["versions"].values()
    return version["needs"]


def test_needs_link_verdicts_over_requirements_to_hazards():
    found = needs_of(record())
    assert stated_counts(needs, needs.render(record())) == record().head.totals.to_json()
    assert found["HAZARD-H-1"]["title"] == "H-1: State H-1."
    assert found["HAZARD-H-1"]["severity"] == "S3"
    assert found["HAZARD-H-3"]["status"] == "no requirement"
    assert found["REQUIREMENT-SEC-1"]["links"] == ["HAZARD-H-1", "HAZARD-H-2"]
    (violated,) = [
        need for need in found.values() if need["title"] == "SAF-1 on a/clear+ghost: violated"
    ]
    requirement, case = violated["links"]
    assert requirement == "REQUIREMENT-SAF-1"
    assert (found[case]["type"], found[case]["title"]) == ("testcase", "a/clear+ghost")
    assert violated["counterexamples"] == "a/clear+ghost#1"
    # As sphinx-needs asks for by default, and without the dots that mean a part of a need.
    assert all(re.match("^[A-Z0-9_]{5,}", id_) and "." not in id_ for id_ in found)


def test_texts_in_needs_are_neither_functions_nor_variants_of_sphinx_needs():
    text = "[[copy('id', 'SESSION')]] <<x>> [[[y]]]\n\n.. raw:: html"
    found = needs_of(record([hazard("H-1", text=text, loss=text)], {}))["HAZARD-H-1"]
    for key in ("title", "loss"):
        assert "[[" not in found[key]
        assert "<<" not in found[key]
        assert "\n" not in found[key]
        assert "copy('id', 'SESSION')" in found[key]
    assert found["content"] == ""


def test_ids_of_needs_stay_apart():
    ids = ["a.b", "a-b", "a b", "a/b"]
    found = needs_of(record([hazard(id_) for id_ in ids], {}))
    hazards = [need for need in found.values() if need["type"] == "hazard"]
    assert sorted(need["title"].partition(":")[0] for need in hazards) == sorted(ids)


def test_an_incomplete_session_does_not_read_as_one_that_passed():
    made = record(status="interrupted", gate={
        "result": "incomplete", "exit_code": 2, "warn_undecided": False, "failed": 0, "reasons": []
    })  # fmt: skip
    assert needs_of(made)["SESSION"]["title"] == "Session incomplete (interrupted): this is no pass"
    assert generated_argument(made)["GTop"].undeveloped


DOCS = Path(__file__).parents[3] / "docs"
PAGES = [(DOCS / name).read_text("utf-8") for name in ("standards.md", "evidence/exports.md")]
BLOCKS = dict(re.findall(r"```(yaml|python)\n(.*?)```", "\n".join(PAGES), re.DOTALL))


def test_the_hazards_of_the_documentation_can_be_read():
    (located,) = read_hazards(parse_yaml(BLOCKS["yaml"], "hazards.yaml"))
    assert located.hazard.severity == "S3"


def test_the_documentation_declares_every_type_and_field_of_needs():
    configuration = {}
    exec(BLOCKS["python"], configuration)
    assert tuple(each["directive"] for each in configuration["needs_types"]) == needs.TYPES
    assert tuple(configuration["needs_fields"]) == needs.FIELDS
    known = {"id", "type", "title", "status", "content", "tags", "links", *needs.FIELDS}
    assert all(set(need) <= known for need in needs_of(record()).values())


def test_sphinx_needs_imports_the_file_as_the_documentation_says(tmp_path):
    pytest.importorskip("sphinx_needs")
    text = "[[copy('id', 'SESSION')]] <<x>> <b>bold</b> `c` :ndf:`echo('x')`"
    hazards = [*HAZARDS, hazard("H 6", text=text, loss=text)]
    (tmp_path / "needs.json").write_text(needs.render(record(hazards)))
    (tmp_path / "conf.py").write_text(BLOCKS["python"] + "needs_build_json = True\n")
    (tmp_path / "index.rst").write_text("Evidence\n========\n\n.. needimport:: needs.json\n")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", ".", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    built = json.loads((tmp_path / "out/needs.json").read_text())
    imported = built["versions"][built["current_version"]]["needs"]
    assert imported.keys() == needs_of(record(hazards)).keys()
    assert imported["HAZARD-H-1"]["links_back"] == ["REQUIREMENT-SAF-1", "REQUIREMENT-SEC-1"]
    (odd,) = [need for need in imported.values() if need["title"].startswith("H 6")]
    assert "copy('id', 'SESSION')" in odd["loss"]
    assert "<b>" not in (tmp_path / "out/index.html").read_text()
