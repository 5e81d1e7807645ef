"""Hostile texts in files, markers and components: a session ends properly, and says so harmlessly.

What cannot be used is refused before anything runs.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET

import pytest
from corridors import scenario

from pytest_dura.__main__ import main
from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import verify_bundle
from pytest_dura.library import load_library
from pytest_dura.plugin.messages import error_text

# What a terminal acts on, or hides; ends of lines and tabs are pytest's own business.
CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)
TEXT = (
    "</script><script>window.pwned=1</script>'\"><svg onload=alert(1)>]]>&lt;"
    "\x1b[31m\x9b2J\x07\x00\x7f\u202e\u2028\ufeff\ud800\r\n\n# Gate passed\ngate: passed\n"
    "| a |`@me #1 [x](javascript:alert(1))../../etc/passwd$(id)%s{0}"
    "\n::error::pwned\n \t::set-env name=x::y\r::stop-commands::z\x85::add-mask::a\n##[error]pwned "
    "##vso[task.setvariable variable=x]y ##[set-env name=x]y"
)
COMMAND = re.compile(r"^\s*::|##\w*\[", re.MULTILINE)
"""What a CI takes for a command in its log: GitHub, Azure, TeamCity."""
MEGABYTE = 2**20 // len(TEXT) + 1
COMPONENT = f"""
from corridor import Brake, Corridor, Reckless, Watch
from pytest_dura import Assessed, Assessment, Proposal, Recovery
TEXT = {TEXT!a}

class Hostile(Reckless):
    def propose(self, view):
        if view.time > 0.25:
            raise ValueError(TEXT)
        return Proposal(20.0, explanation=TEXT)

class Endless(Reckless):
    def propose(self, view):
        raise ValueError(TEXT * {MEGABYTE})

class Worries(Watch):
    def run(self, view):
        return Assessment(Assessed.UNSAFE, score=-1.0, reasons=(TEXT, TEXT))

class Dies(Watch):
    def run(self, view):
        raise RuntimeError(TEXT)

class Brakes(Brake):
    def run(self, view):
        return Recovery(20.0, TEXT, TEXT)
"""
TESTS = f"""
import pytest
from hostile import TEXT

@pytest.fixture(scope="session")
def dura_metrics():
    return {{TEXT.replace(chr(0xd800), ""): lambda episode: 1.0}}

@pytest.fixture
def broken():
    raise RuntimeError(TEXT)

@pytest.fixture
def skipped():
    pytest.skip(TEXT)

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("javascript:alert(1)//" + TEXT, text=TEXT * {MEGABYTE}, source=TEXT)
def test_each(episode):
    try:
        raise LookupError(TEXT)
    except LookupError:
        assert not episode.collided, TEXT

@pytest.mark.xfail(reason=TEXT)
@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("X" + TEXT, text=TEXT)
def test_excused(episode):
    raise KeyError(TEXT)

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("S" + TEXT, text="x")
def test_never_begins(broken, episode):
    pass

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("T" + TEXT, text="x")
def test_left_out(skipped, episode):
    pass

@pytest.mark.dura(scenario="corridor/it", faults=[
    {{"type": "bias", "id": "<script>'\\"`../..|$(id)", "target": "gap",
      "activation": {{"at": 0.1}}, "parameters": {{"offset": 1.0}}}}])
@pytest.mark.requirement("F" + TEXT, text="x", kind="security")
def test_faults(campaign):
    campaign.require("always (gap > 5)")
"""
YAML = json.dumps(TEXT.replace("\ud800", ""))
REQUIREMENTS = f"""
requirements:
  - {{id: H-1, text: {YAML}, kind: safety, source: {YAML}, reason: {YAML},
     check: always (gap > 5)}}
  - {{id: H-2, text: {YAML}, kind: safety, check: always (gap > -1)}}
"""


def write_all(project):
    """A project in which every text that the loaders accept is hostile."""
    project.write("hostile.py", COMPONENT)
    project.write("test_it.py", TESTS)
    project.write("scenarios/requirements_hostile.yaml", REQUIREMENTS)
    for name, generator, monitor, requirement in (
        ("it", "Hostile", "Worries", "H-1"), ("dies", "Hostile", "Dies", "H-2"),
        ("endless", "Endless", "Watch", "H-1"),
    ):  # fmt: skip
        scenario(
            project, name, generator=f"hostile:{generator}", monitor=f"hostile:{monitor}", runs=1,
            recovery_planner="hostile:Brakes", requirements=f"[{requirement}]",
            world=f"{{wall: 1.0, {json.dumps('k' + TEXT[:40])}: {YAML}}}",
        )  # fmt: skip
        file = project.path / f"scenarios/corridor/{name}.yaml"
        file.write_text(f"{file.read_text()}description: {YAML}\n")


def test_a_session_of_hostile_texts_ends_properly_and_harmlessly(project, capsys):
    write_all(project)
    result = project.run(
        "corridor/it", "corridor/dies", "corridor/endless", "test_it.py", "-ra", "-n", "2",
        "--junit-xml=junit.xml", "--alluredir=allure",
    )  # fmt: skip
    shown = result.stdout.str() + result.stderr.str()
    assert "INTERNALERROR" not in shown
    assert result.ret == 1
    result.assert_outcomes(failed=5, errors=1, xfailed=1, skipped=1)
    assert CONTROL.findall(shown) == []
    assert COMMAND.findall(shown) == []
    assert len(shown) < 400_000
    ours = shown.partition("= dura =")[2].partition("= short test summary")[0].splitlines()
    assert [line[:12] for line in ours if line.startswith("gate")] == ["gate: failed"]
    told = re.split("\n[_=]{4}", shown.partition(" corridor/it::H-1 _")[2])[0]
    assert "rerun:    pytest " in told
    assert "\ngate: passed" not in told
    check_evidence(project, capsys)
    check_junit(project.path / "junit.xml")
    check_allure(project.path / "allure")


def check_evidence(project, capsys):
    directory = project.path / "dura-evidence"
    found = verify_bundle(directory, project.path / "junit.xml")
    assert found.problems == []
    assert found.totals.violated == 4
    assert found.totals.missing == 1
    assert {one.text for one in project.evidence().requirements} >= {TEXT}
    assert main(["verify", str(directory)]) == 0
    printed = capsys.readouterr().out
    assert printed.endswith("\nintact\n")
    assert COMMAND.findall(printed) == []
    for file in directory.iterdir():
        if file.is_file():
            assert CONTROL.findall(file.read_text()) == []


def check_junit(file):
    """Our properties are harmless; other texts are pytest's, which escapes them for XML."""
    properties = [one.attrib for one in ET.parse(file).iter("property")]
    assert len(properties) > 60
    for one in properties:
        assert CONTROL.findall(one["value"]) == []
        assert len(one["value"]) <= (2000 if one["name"] == "card_traceback" else 500)


def check_allure(folder):
    files = [*folder.iterdir()]
    assert all(re.fullmatch(r"[0-9a-f-]{36}-\w+(\.\w+)?", one.name) for one in files)
    for file in files:
        assert file.stat().st_size < 2_000_000
        if file.suffix != ".mcap":
            assert CONTROL.findall(file.read_text("utf-8")) == []


REFUSED = json.dumps("</script>\x1b[31m\u202e\n../x")
SCENARIO = {"name": "corridor/it", "simulator": "driving", "duration": "0.5"}


@pytest.mark.parametrize(
    "text, key",
    [
        (f"requirements: [{{id: {REFUSED}, text: t, kind: safety}}]", "requirements.0.id"),
        (f"requirements: [{{id: R, text: t, kind: {REFUSED}}}]", "requirements.0.kind"),
        (f"requirements: [{{id: R, text: t, kind: safety, check: {REFUSED}}}]",
         "requirements.0.check"),
        (f"name: {REFUSED}", "name"),
        (f"{REFUSED}: 1", "unknown key"),
        (f"requirements: [{REFUSED}]", "requirements.0"),
        (f"roles: {{{REFUSED}: x}}", "roles."),
        (f"roles: {{generator: {REFUSED}}}", "roles.generator"),
        (f"simulator: {REFUSED}", "simulator"),
        (f"policy: {REFUSED}", "policy"),
        (f"variation: {{{REFUSED}: {{min: 0, max: 1}}}}", "variation."),
        (f"faults: [{{type: {REFUSED}}}]", "faults.0"),
        (f"faults: [{{type: bias, id: {REFUSED}}}]", "faults.0.id"),
        (f"faults: [{{type: bias, target: {REFUSED}}}]", "faults.0"),
        (f"campaigns: [{REFUSED}]", "campaigns.0"),
    ],
)  # fmt: skip
def test_what_a_file_may_not_hold_is_one_harmless_error(tmp_path, text, key):
    if "text: t" not in text:
        name = text.partition(":")[0]
        given = (f"{one}: {value}" for one, value in SCENARIO.items() if one != name)
        text = "\n".join([*given, text])
    (tmp_path / "file.yaml").write_text(text + "\n")
    with pytest.raises(ConfigurationError) as caught:
        load_library([tmp_path])
    told = error_text(caught.value)
    assert key in told
    assert caught.value.line
    assert CONTROL.findall(told) == []
    assert COMMAND.findall(told) == []


MARKERS = (
    "dura(scenario=TEXT)",
    "dura(scenario='corridor/free', faults=[TEXT])",
    "dura(scenario='corridor/free', faults=[{'type': TEXT}])",
    "dura(scenario='corridor/free', faults=[{'type': 'bias', 'id': TEXT}])",
    "dura(scenario='corridor/free', runs=TEXT)",
    "dura(**{'scenario': 'corridor/free', TEXT: 1})",
    "requirement(TEXT)",
    "requirement(TEXT, text='x', kind=TEXT)",
    "requirement('GAP-1', text=TEXT)",
    "requirement('OTHER', text='another one')",
)


def test_what_a_marker_or_a_file_may_not_hold_ends_a_session_harmlessly(project):
    project.write(
        "test_said_before.py",
        f"import pytest\nTEXT = {TEXT!a}\n"
        "@pytest.mark.dura(scenario='corridor/free')\n"
        "@pytest.mark.requirement('OTHER', text=TEXT)\ndef test_it(episode): pass\n",
    )
    files = [f"test_{number}.py" for number in range(len(MARKERS))]
    for file, marker in zip(files, MARKERS, strict=True):
        known = "" if marker.startswith("dura") else "@pytest.mark.dura(scenario='corridor/free')\n"
        project.write(
            file,
            f"import pytest\nTEXT = {TEXT!a}\n"
            f"@pytest.mark.{marker}\n{known}def test_it(episode): pass\n",
        )
    result = project.run("test_said_before.py", *files, "--junit-xml=junit.xml")
    told = result.stdout.str() + result.stderr.str()
    # The test before them runs, and decides nothing.
    result.assert_outcomes(errors=len(MARKERS), failed=3)
    assert "\ngate: passed" not in told
    assert "INTERNALERROR" not in told
    assert CONTROL.findall(told) == []
    assert COMMAND.findall(told) == []
    ET.parse(project.path / "junit.xml")
    project.write("scenarios/x\x1b[31m\u202e.yaml", f"name: {YAML}\n")
    result = project.scenarios()
    assert result.ret == 4
    assert CONTROL.findall(result.stderr.str()) == []
    assert COMMAND.findall(result.stderr.str()) == []


def test_errors_of_other_peoples_fixtures_stay_as_they_are(pytester, fast_sessions):
    pytester.makeconftest(
        "import pathlib\n"
        "def pytest_runtest_makereport(item, call):\n"
        "    if call.excinfo is not None:\n"
        "        pathlib.Path('told').write_text(ascii(call.excinfo.value.args))\n"
    )
    pytester.makepyfile(
        "import pytest\n"
        "@pytest.fixture\n"
        "def broken():\n"
        "    raise ValueError('\\x1b[31mred')\n"
        "def test_it(broken):\n"
        "    pass\n"
    )
    pytester.runpytest_inprocess("-n", "1").assert_outcomes(errors=1)
    assert (pytester.path / "told").read_text() == ascii(("\x1b[31mred",))
