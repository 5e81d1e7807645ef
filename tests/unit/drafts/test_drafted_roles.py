"""Python roles that a language model drafts: what is refused, and the file of what passes."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from drafting_model import TIME_GAP, drafting, role

from pytest_dura import RoleSpec, Runner, check_role
from pytest_dura.__main__ import main
from pytest_dura.core.percepts import Percept
from pytest_dura.drafts.earning import Suite, domain_named
from pytest_dura.drafts.role_checks import read_role
from pytest_dura.drafts.roles import ROLES, asked_for, basis_of, described, written

SENTENCE = "Nothing ahead may be nearer than two seconds"
SCENARIO = """
name: road/leader
simulator: driving
duration: 3.0
runs: 1
policy: recover
world:
  ego: {distance: 90.0, speed: 9.0, turn: straight}
  vehicles:
    - {id: LEADER, arm: south, turn: straight, distance: 66.0, speed: 9.0}
requirements: [SAF-1]
"""


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """What a draft of each role rests on, and what a model is asked for."""
    path = tmp_path_factory.mktemp("suite")
    (path / "leader.yaml").write_text(SCENARIO)
    suite = Suite(Runner.of(path), domain_named("driving"), ["road/*"])
    return {role: asked_for(role, suite) for role in ROLES}


def monitor(line="", *, top="", base="SafetyMonitor", method="run(self, view)", inside=""):
    """A monitor with something in one place."""
    return f"""\
from pytest_dura import Assessed, Assessment, SafetyMonitor
{top}
class Odd({base}):
    {inside or '"Odd."'}
    def {method}:
        {line or "pass"}
        return Assessment(Assessed.SAFE, 1.0)
"""


HOSTILE = [
    ("open('ran', 'w')", {}, "the name open is not for a draft"),
    ("__import__('os').mkdir('ran')", {}, "the name __import__ is not for a draft"),
    ("exec('import os; os.mkdir(\"ran\")')", {}, "the name exec is not for a draft"),
    ("eval('1')", {}, "the name eval is not for a draft"),
    ("getattr(view, '_truth')", {}, "the name getattr is not for a draft"),
    ("import os", {}, "a draft has no Import"),
    ("().__class__.__base__.__subclasses__()", {}, "has an attribute __subclasses__"),
    ("(x for x in ()).gi_frame.f_builtins['open']('ran')", {}, "has an attribute gi_frame"),
    ("self.__class__.run = 1", {}, "self.__class__.run is not the draft's own to set"),
    ("self.__class__", {}, "self has no __class__"),
    ("view.percept['radar'].tofile('ran')", {}, "ndarray has no tofile"),
    ("view.percept['radar'].T.dump('ran')", {}, "has an attribute dump"),
    ("'{0.__class__}'.format(view)", {}, "has an attribute format"),
    ("f'{view.__class__}'", {}, "RoleView has no __class__"),
    ("self.run = 1", {}, "self.run is not the draft's own to set"),
    ("Assessed.SAFE = 2", {}, "Assessed.SAFE is not the draft's own to set"),
    ("view.outputs['x'] = 2", {}, "is not the draft's own to set"),
    ("SafetyMonitor.cache[0] = 2", {}, "is not the draft's own to set"),
    ("self = view", {}, "self means something else"),
    ("while True: pass", {}, "a draft has no While"),
    ("global x", {}, "a draft has no Global"),
    ("yield 1", {}, "a draft has no Yield"),
    ("def other(): pass", {}, "a function stands in another one"),
    ("b'x'", {}, "bytes is no value of a draft"),
    ("super().run(view)", {}, "super().run is not for a draft"),
    ("", {"top": "open('ran', 'w')"}, "`open('ran', 'w')` in the module: it holds numbers"),
    ("", {"top": "SEEN = []"}, "`SEEN = []` in the module: it holds numbers and texts"),
    ("", {"top": "X = (1, open('ran', 'w'))"}, "in the module: it holds numbers and texts"),
    ("", {"top": "X: open('ran', 'w') = 1"}, "the annotation `open('ran', 'w')` names no type"),
    ("", {"top": "X: 'a' if open('ran', 'w') else 'b'"}, "names no type"),
    ("", {"inside": "X: [open('ran', 'w')] = 1"}, "names no type"),
    ("", {"method": "run(self, view: max(range(10 ** 12)))"}, "names no type"),
    ("x: open = 1", {}, "the name open is not for a draft"),
    ("", {"method": "run(self, view) -> (lambda: 1)()"}, "names no type"),
    ("", {"top": "print = 1"}, "print means something else in the module"),
    ("", {"top": "def aside(): pass"}, "in the module: it holds numbers and texts"),
    ("", {"top": "if open('ran', 'w'): pass"}, "in the module: it holds numbers and texts"),
    ("", {"top": "@open('ran', 'w')"}, "a draft has no decorators"),
    ("", {"top": "import os"}, "`import os` is none of the imports"),
    ("", {"top": "import math as SafetyMonitor"}, "is none of the imports"),
    ("", {"top": "from os import *"}, "`from os import *` is none of the imports"),
    ("", {"top": "from . import conftest"}, "is none of the imports"),
    ("", {"top": "from pytest_dura import Runner"}, "is none of the imports"),
    ("", {"top": "from pytest_dura.core.files import SafetyMonitor"}, "is none of the imports"),
    ("", {"top": "class Two: pass"}, "it has 2 classes"),
    ("", {"base": "object"}, "has to be a subclass of SafetyMonitor alone"),
    ("", {"base": "SafetyMonitor, metaclass=open('ran', 'w')"}, "subclass of SafetyMonitor alone"),
    ("", {"base": "open('ran', 'w')"}, "has to be a subclass of SafetyMonitor alone"),
    ("", {"inside": "repeatable = False"}, "repeatable means something else in the class"),
    ("", {"inside": "seen = {}"}, "`seen = {}` in the class: it holds numbers and texts"),
    ("", {"inside": "open('ran', 'w')"}, "`open('ran', 'w')` in the class"),
    ("", {"inside": "def check_params(self, p): pass"}, "check_params is none that a draft"),
    ("", {"inside": "def __del__(self): pass"}, "__del__ is none that a draft changes"),
    ("", {"inside": "@open('ran', 'w')\n    def x(self): pass"}, "a draft has no decorators"),
    ("", {"inside": "def x(self, y=open('ran', 'w')): pass"}, "a default of x is no number"),
    ("", {"inside": "def __init__(self, y): pass"}, "parameters that each have a default"),
    ("", {"inside": "def x(self, y: open('ran', 'w')): pass"}, "names no type"),
    ("", {"method": "run(self, view, more)"}, "the parameters of run have to be: self, view"),
    ("", {"method": "run(self, *view)"}, "the parameters of run have to be: self, view"),
    ("", {"method": "assess(self, view)"}, "the class has no method run(self, view)"),
]


def problems(code, basis):
    return read_role(code.split("\n"), basis)[2]


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("line, given, reason", HOSTILE)
def test_what_a_role_has_no_use_for_is_refused_and_not_run(asked, line, given, reason, in_folder):
    found = problems(monitor(line, **given), asked["safety_monitor"][0])
    assert any(reason in each for each in found), found
    assert not (in_folder / "ran").exists()


WRONG = [
    ("view.percept['lasar']", "the percept has no channel 'lasar'; it has camera_front"),
    ("view.percept.get('speed')", "the percept has no channel 'speed'"),
    ("view.percept.speed", "Percept has no speed; it has "),
    ("view.percept['odometry'].velocity", "Odometry has no velocity; it has count, index, speed"),
    ("x = view.percept['odometry']; x.x", "Odometry has no x"),
    ("view.percept['objects'][0].kind", "Body has no kind"),
    ("[b.kind for b in view.percept['objects']]", "Body has no kind"),
    ("view.percept['map'].waypoints[0].z", "Waypoint has no z"),
    ("view.truth", "RoleView has no truth"),
    ("view.proposal.action.speed", "Command has no speed"),
    ("Assessed.DANGEROUS", "Assessed has no DANGEROUS; it has SAFE, UNSAFE, WARNING"),
    ("Assessment(level=1)", "Assessment: got an unexpected keyword argument 'level'"),
    ("math.sqrt(2)", "the name math is not defined"),
    ("self.seconds", "self has no seconds"),
]


@pytest.mark.parametrize("line, reason", WRONG)
def test_what_the_percept_and_the_view_do_not_have_is_refused(asked, line, reason):
    found = problems(monitor(line), asked["safety_monitor"][0])
    assert any(reason in each for each in found), found


def test_a_component_has_a_method_of_its_own_and_no_truth(asked):
    code = """\
from pytest_dura import Generator, Proposal
class open(Generator):
    def run(self, view):
        return Proposal("wait")
    def propose(self, view):
        return Proposal("wait" if view.proposal else view.past[0].proposed.maneuver)
"""
    first, second, third = problems(code, asked["generator"][0])
    assert first == "line 2: the class cannot be named open"
    assert second == "line 3: the method run is none that a draft changes"
    known = "dt, feedback, index, past, percept, time, transmit"
    assert third == f"line 6: GeneratorView has no proposal; it has {known}"


class Wheels(NamedTuple):
    """Speeds of both wheels in m/s."""

    left: float
    right: float


@pytest.mark.parametrize("action, code", [
    (Wheels(0.0, 1.0), "Wheels(left=0.0, right=1.0)"), (0, "0"), ({"left": 1.0}, "{'left': 1.0}"),
    (np.zeros(2), "[0.0, 0.0]"), ((0.0, 1.0), "(0.0, 1.0)"),
])  # fmt: skip
def test_actions_and_percepts_of_other_systems_are_known_by_what_they_hold(action, code):
    assert written(action) == code
    basis = basis_of("generator", Percept({"ranges": np.ones(3), "door": None}), action)
    imported = f"from {__name__} import Wheels" if isinstance(action, Wheels) else ""
    text = f"""\
from pytest_dura import Generator, Proposal
{imported}
class Slow(Generator):
    def propose(self, view):
        if view.percept["ranges"].min() < 1:
            return Proposal({code})
        return Proposal(view.past[-1].executed)
"""
    assert problems(text, basis) == []
    assert described(Wheels) == "Wheels(left, right): Speeds of both wheels in m/s."
    lacking = text.replace("left=0.0, ", "").replace('"ranges"', '"range"')
    expected = ["line 5: the percept has no channel 'range'; it has door, ranges"]
    if imported:
        expected.append("line 6: Wheels: missing a required argument: 'left'")
    assert problems(lacking, basis) == expected


@pytest.mark.parametrize(
    "way",
    [
        "if view.time > 1: return Assessment",
        "if view.time > 1: return\n        return Assessment",
        "if view.time > 1: return None\n        return Assessment",
    ],
)
def test_a_way_without_an_output_is_refused(asked, way):
    code = monitor().replace("return Assessment", way, 1)
    assert "line 5: run can end without Assessment" in problems(code, asked["safety_monitor"][0])


@pytest.mark.parametrize("line", [
    "x = view.percept['odometry']; x = x.speed; y = x", "x, y = 1, 2; z = [x, *'ab']; z[0] = 3",
    "x = view.proposal.action.maneuver", "self.seen = {}; self.seen['a'] = 1; self.seen.get('a')",
    "for body in view.percept['lidar']: x = body.vx", "x = view.outputs.get('other')",
    "x: tuple[float, ...] | None = None",
    "x = view.percept['map'].route.project(0.0, 0.0)", "x = (lambda a: a + 1)(view.time)",
])  # fmt: skip
def test_what_fits_is_not_refused(asked, line):
    assert problems(monitor(line), asked["safety_monitor"][0]) == []


@pytest.mark.parametrize("name", ROLES)
def test_the_prompt_shows_an_example_that_passes(asked, name):
    basis, given = asked[name]
    _, _, example = given["system"].partition("An example of the form alone:\n")
    code, _, _ = example.partition("Answer with")
    assert problems(code, basis) == []
    assert "Odometry(speed); numbers; speed [m/s]" in given["system"]
    assert "command.acceleration [m/s2] -8 to 4" in given["system"]


@pytest.mark.parametrize("code, reason", [
    ("class ../../evil(SafetyMonitor):", "it is not Python"),
    ("x = 1\n\x0cy = 2", "other characters than printable ASCII"),
    ("# \u202e", "other characters than printable ASCII"),
    ("\u0435val('1')", "other characters than printable ASCII"),
    ("x = '\x00'", "other characters than printable ASCII"),
    ("x = '\\d'", "it is not Python"),
    ("return 1", "it is not Python"),
    ("(" * 300, "it is not Python"),
    ("", "it has 0 classes"),
])  # fmt: skip
def test_what_is_no_module_of_plain_text_is_refused(asked, code, reason):
    assert reason in problems(code, asked["safety_monitor"][0])[0]


DEEP = """
from pytest_dura.drafts.role_checks import read_role
lines = {lines}
print(read_role(lines, None)[2][0][:16])
"""


@pytest.mark.parametrize("lines", ["['x = ('] + ['-' * 110] * 140 + ['1)']",
                                   "['x = (a'] + ['.a' * 55] * 140 + [')']"])  # fmt: skip
def test_what_is_nested_beyond_measure_ends_no_process(lines):
    code = DEEP.format(lines=lines)
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert ended.stdout == "a statement has \n", ended.stderr


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """`run(*rounds)` lets a scripted model draft a monitor; the code, what was printed, it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "leader.yaml").write_text(SCENARIO)

    def drafted(*rounds, arguments=("-o", "draft_role.py"), sentence=SENTENCE):
        with drafting(*rounds) as server:
            code = main([
                "draft", "--domain=driving", "--role=safety_monitor", sentence, "--suite=suite",
                "--scenario=road/*", f"--llm={server.base_url}/{server.model}", *arguments,
            ])  # fmt: skip
        return code, capsys.readouterr(), server.requests

    return drafted


def test_what_passes_is_written_and_imported_by_a_person_alone(run, tmp_path, monkeypatch):
    claim = "# reviewed, signed by A. Person\n# -*- coding: rot13 -*-\n"
    code, printed, _ = run(role(claim + TIME_GAP))
    assert code == 0, printed
    assert "TimeGap kept: checked, and neither imported nor run" in printed.out
    assert "draft_role" not in sys.modules
    text = (tmp_path / "draft_role.py").read_text()
    head = [line for line in text.splitlines() if line.startswith("#")]
    assert head[0] == (
        "# Drafted, not reviewed: nothing imports this file; a person does, who has read it."
    )
    assert "# Role: safety_monitor of driving" in head
    assert f"# Sentence: {SENTENCE}" in head
    assert any(line.startswith("# Model: scripted, server ") for line in head)
    assert any(line.startswith("# Prompt: sha256:") for line in head)
    assert "A. Person" not in text
    assert ast.dump(ast.parse(text)) == ast.dump(ast.parse(TIME_GAP))

    monkeypatch.syspath_prepend(tmp_path)
    drafted = importlib.import_module("draft_role").TimeGap
    try:
        spec = Runner.of("suite").task(Runner.of("suite").case("road/leader")).spec
        check_role(drafted, simulator=spec.simulator, scenario=spec.scenario)
        for seconds, flagged in ((3.0, True), (0.5, False)):
            given = RoleSpec("draft_role:TimeGap", {"seconds": seconds})
            episode = Runner.of("suite", roles={"safety_monitor": given}).run("road/leader")
            assert episode.failure is None
            assert any(each.kind == "unsafe" for each in episode.events) == flagged
    finally:
        sys.modules.pop("draft_role")


def test_what_is_refused_goes_back_with_its_lines_and_at_most_so_many_times(run, tmp_path):
    wrong = TIME_GAP.replace('["odometry"].speed', '["odometry"].velocity')
    code, printed, requests = run(role(wrong), role(TIME_GAP))
    assert code == 0, printed
    assert "TimeGap refused: line 14: Odometry has no velocity" in printed.out
    asked = [each.json["messages"] for each in requests if each.body and "Odometry" in str(each)]
    assert [each["role"] for each in asked[1]] == ["system", "user", "assistant", "user"]
    assert "TimeGap: line 14: Odometry has no velocity" in asked[1][3]["content"]
    given = ["-o", "draft_other.py", "--rounds=2"]
    code, printed, requests = run(role(wrong), arguments=given)
    assert code == 1
    assert len([each for each in requests if each.body and "Odometry" in str(each)]) == 2
    assert printed.out.splitlines()[-1] == "no draft passed"
    assert not (tmp_path / "draft_other.py").exists()


@pytest.mark.parametrize("answer, reason", [
    ({"reason": "x", "lines": ["x = 1"] * 151}, "schema_violation"),
    ({"reason": "x", "lines": ["#" * 5000]}, "schema_violation"),
    ({"reason": "x", "lines": ["x" * 100] * 150 + ["y" * 100] * 150}, "malformed"),
    ('{"reason": "x", "lines": ["\\ud800"]}', "malformed"),
    ({"reason": "x", "lines": [], "path": "../../conftest.py"}, "schema_violation"),
])  # fmt: skip
def test_an_answer_of_another_form_is_refused(run, answer, reason, tmp_path):
    code, printed, _ = run(answer, arguments=("-o", "draft_role.py", "--rounds=1"))
    assert code == 1
    assert reason in printed.out
    assert [each.name for each in tmp_path.iterdir()] == ["suite"]


@pytest.mark.parametrize("sentence", [
    "Stop.\nimport os\r\nos.mkdir('ran')\x0c\x0bimport os\u2028import os\x85import os",
    "coding: utf-7 +AGkAbQBwAG8AcgB0-", '"""\nopen("ran", "w")', "\\\nimport os", "\udc80\x00",
])  # fmt: skip
def test_a_sentence_stays_within_its_line_of_comment(run, sentence, tmp_path):
    code, printed, _ = run(role(TIME_GAP), sentence=sentence.replace("\udc80\x00", "\x1b"))
    assert code == 0, printed
    data = (tmp_path / "draft_role.py").read_bytes()
    assert ast.dump(ast.parse(data)) == ast.dump(ast.parse(TIME_GAP))
    names = ["draft_role.py", "suite"]
    assert sorted(each.name for each in tmp_path.iterdir()) == names


@pytest.mark.parametrize("arguments, named", [
    ([], "no file"),
    (["-o", "conftest.py"], "conftest.py"),
    (["-o", "test_draft.py"], "test_draft.py"),
    (["-o", "draft_role_test.py"], "draft_role_test.py"),
    (["-o", "draft_role.pth"], "draft_role.pth"),
    (["-o", "suite"], "suite"),
    (["-o", "link/draft_x.py"], "link"),
    (["-o", "draft_there.py"], "draft_there.py"),
    (["-o", "draft_x.py", "--warns-of=SAF-1"], "--warns-of beside --role"),
    (["-o", "draft_x.py", "--traces=suite"], "--traces beside --role"),
])  # fmt: skip
def test_a_file_that_python_or_pytest_would_load_is_refused_before_the_model_is_asked(
    run, arguments, named, tmp_path
):
    (tmp_path / "draft_there.py").symlink_to(tmp_path / "elsewhere.py")
    code, printed, requests = run(role(TIME_GAP), arguments=arguments)
    assert code == 2
    assert named in printed.err
    assert not requests
    assert not (tmp_path / "elsewhere.py").exists()


def test_the_same_role_comes_from_a_cassette_without_a_server(run, tmp_path):
    tape = ["--dura-cassette=tape.sqlite"]
    code, printed, _ = run(
        role(TIME_GAP), arguments=["-o", "draft_a.py", "--dura-llm=record", *tape]
    )
    assert code == 0, printed
    given = ["draft", "--domain=driving", "--role=safety_monitor", SENTENCE, "--suite=suite",
             "--scenario=road/*", "--dura-llm=replay", *tape]  # fmt: skip
    assert main([*given, "-o", "draft_b.py"]) == 0
    assert (tmp_path / "draft_a.py").read_text() == (tmp_path / "draft_b.py").read_text()
