"""Sessions with a language model: asked live, recorded, and replayed without it."""

from __future__ import annotations

import json
import re
import sqlite3
import subprocess
import sys
from base64 import b64encode
from contextlib import closing
from pathlib import Path

import openai.resources.chat  # noqa: F401 - see below
import pytest
from corridors import scenario
from test_fault_campaigns_option import BIAS, NOISE, near_the_wall
from test_secrets import texts

from pytest_dura.__main__ import main
from pytest_dura.evidence import SessionRecord, record_problems, verify_bundle
from pytest_dura.llm import session as sessions
from pytest_dura.llm.record import cassette_of, models_of

SUPPORT = str(Path(__file__).parents[1] / "support")
if SUPPORT not in sys.path:
    sys.path.insert(0, SUPPORT)

from scripted_server import (  # noqa: E402 - support modules lie elsewhere
    ScriptedServer,
    answers,
    answers_by,
    echoes_the_key,
    fails,
)

KEY = "planted-Zx9Q7wert-key"
TALKER = '''
"""A component that lets a language model say how fast it goes."""

from pytest_dura import Generator, Proposal
from pytest_dura.llm import session
from pytest_dura.llm.port import Message, Request

HIDES = {hides}


class Talker(Generator):
    def __init__(self, model=None, fingerprint=None, capabilities=None, prompts=None):
        self.model, self.fingerprint = model, fingerprint

    @classmethod
    def resolve_parameters(cls, params):
        if params.get("fingerprint"):
            return params
        found = session.current().describe(params.get("model"))
        return {{
            **params,
            "model": found.model,
            "fingerprint": found.fingerprint,
            "capabilities": dict(found.capabilities),
            "prompts": "a" * 64,
        }}

    def propose(self, view):
        text = f"SIGHT\\ngap {{view.percept['gap']:.3f}}\\nasked {words}"
        request = Request(self.model, (Message("user", text),))
        try:
            answer = session.current().ask(request, 5.0, fingerprint=self.fingerprint)
        except Exception:  # a component that hides what went wrong must not get away with it
            if not HIDES:
                raise
            return Proposal(0.5)
        if answer.failure:
            return Proposal(0.0, answer.detail, failure=f"{{answer.failure}}: {{answer.detail}}")
        return Proposal(float(answer.text), answer.text, latency=answer.seconds)
'''
CAREFULLY = "2.0 if view.percept['gap'] > 3.0 else 0.0"
CASES = ("it", "it-too")
GENERATOR = "--dura-generator=talker:Talker"


def talker(*, words="politely", hides=False):
    return TALKER.format(words=words, hides=hides)


def speed(request):
    """Slower near the wall, and another number for each thing that is asked."""
    gap = next((word for word in request.prompt.split() if word[:1].isdigit()), "0")
    return f"{min(2.0, float(gap) / 3 + 0.1):.6f}" if "gap" in request.prompt else "the sea"


@pytest.fixture
def server():
    with ScriptedServer(otherwise=answers_by(speed)) as found:
        yield found


@pytest.fixture
def talking(project, server, monkeypatch):
    for name, value in {**server.environment, "DURA_LLM_API_KEY": KEY}.items():
        monkeypatch.setenv(name, value)
    project.write("talker.py", talker())
    for name in CASES:
        crossing(project, name)
    return project


def crossing(project, name, **given):
    """Runs of half a second that differ."""
    spread = "{world.wall: {min: 3.0, max: 5.0}}"
    scenario(project, name, world="{wall: 4.0}", variation=spread, requirements="[GAP-1]", **given)


@pytest.fixture
def cut_off(talking, monkeypatch):
    """Nothing names the server, and no connection can be made."""

    def alone():
        for name in ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY"):
            monkeypatch.delenv(name, raising=False)

        def refuse(*_):
            raise AssertionError("a replay makes no connection")

        for way in ("connect", "connect_ex"):
            monkeypatch.setattr(f"socket.socket.{way}", refuse, raising=False)

    return alone


def run(project, mode, *more, runs=2):
    arguments = [GENERATOR, f"--dura-llm={mode}", f"--dura-runs={runs}", *more]
    return project.scenarios(*arguments, select="corridor/it*")


def digests(project, folder="dura-evidence"):
    return {one.id: one.digest for one in project.evidence(folder).episodes}


def prompts(server):
    return [one.prompt for one in server.requests if "gap" in one.prompt]


def test_what_two_workers_record_one_process_replays_alone_and_two_together(
    talking, server, cut_off
):
    recorded = run(talking, "record", "-n", "2", "--dura-evidence=one", runs=3)
    recorded.assert_outcomes(passed=2)
    asked = prompts(server)
    assert len(asked) == len(set(asked)) > 20
    cut_off()
    before = (talking.path / "dura-cassette.sqlite").read_bytes()
    replayed = run(talking, "replay", "--dura-evidence=two", runs=3)
    replayed.assert_outcomes(passed=2)
    assert digests(talking, "one") == digests(talking, "two")
    assert len(digests(talking, "two")) == 6
    run(talking, "replay", "--dura-evidence=three", "-n", "2", runs=3).assert_outcomes(passed=2)
    assert digests(talking, "three") == digests(talking, "two")
    assert (talking.path / "dura-cassette.sqlite").read_bytes() == before
    assert prompts(server) == asked
    specs = [one.spec for one in talking.evidence("two").episodes]
    params = {json.dumps(one.roles["generator"].params, sort_keys=True) for one in specs}
    (told,) = map(json.loads, params)
    assert told["model"] == server.model
    assert told["capabilities"]["enforced"] is False
    # The controller alone asked what the server can do, and then for the list of its models.
    probing = [one for one in server.requests if "gap" not in one.prompt]
    assert len(probing) == told["capabilities"]["requests"] - 1
    assert sorted(told) == ["capabilities", "fingerprint", "model", "prompts"]


def counts_as_draws(project, result):
    """Whether the runs of the session count as draws, by all that says so."""
    draws = "; the runs count as draws: a live language model answers"
    told = project.evidence()
    assert verify_bundle(project.path / "dura-evidence").intact
    (repeated,) = {case.repeat.result for case in told.cases}
    (counted,) = {verdict.reason.endswith(draws) for verdict in told.verdicts}
    assert counted == ("the runs count as draws on corridor/it (Talker)" in result.stdout.str())
    assert repeated == ("skipped" if counted else "equal")
    return counted


def test_an_equal_request_is_asked_once_in_record_and_each_time_in_live(talking, server):
    assert counts_as_draws(talking, run(talking, "record"))
    once = len(prompts(server))
    assert counts_as_draws(talking, run(talking, "record"))
    assert len(prompts(server)) == once
    told = models_of(talking.evidence())[0]
    assert (told.asked, told.reused) == (0, once)
    assert not counts_as_draws(talking, run(talking, "replay"))
    assert counts_as_draws(talking, run(talking, "live"))
    assert len(prompts(server)) == 2 * once


def test_workers_go_by_what_the_controller_found_out(talking, server):
    run(talking, "live", "-n", "2", "--dura-evidence=one", runs=1)
    probing = [one for one in server.requests if "gap" not in one.prompt]
    (told,) = models_of(talking.evidence("one"))
    assert told.asked == len(prompts(server)) > 0
    assert len(probing) == told.capabilities["requests"] - 1


def test_the_evidence_names_model_server_and_cassette_also_of_a_replay(talking, server, cut_off):
    result = run(talking, "record")
    can = "structured output json_schema (not enforced), vision no, seed yes, "
    can += "at most 30 s for a decision"
    line = f"dura: language model {server.model} at {server.base_url} (record), {can}"
    assert line in result.outlines
    (told,) = models_of(talking.evidence())
    tape = cassette_of(talking.evidence())
    with closing(sqlite3.connect(talking.path / "dura-cassette.sqlite")) as opened:
        (stored,) = opened.execute("SELECT COUNT(*) FROM exchanges").fetchone()
    assert tape.file == "dura-cassette.sqlite"
    assert tape.exchanges == stored == told.asked == len(prompts(server))
    assert (told.reused, told.injected, told.missed) == (0, 0, 0)
    assert (told.component, told.model, told.mode) == ("Talker", server.model, "record")
    assert told.base_url == server.base_url
    assert told.prompts == "a" * 64
    assert told.capabilities["vision"] is False
    (given,) = [one for one in talking.evidence().inputs if one.kind == "cassette"]
    assert given.path == "dura-cassette.sqlite"
    assert given.sha256 == tape.sha256
    assert not given.changed
    bundle = talking.path / "dura-evidence"
    assert verify_bundle(bundle).intact
    record = talking.evidence().to_json()
    (fact,) = [fact for fact in record["facts"] if fact["about"] == "cassette"]
    fact["data"]["sha256"] = "0" * 64
    forged = SessionRecord.of(record, bundle)
    why, *_ = record_problems(forged)
    assert "the cassette dura-cassette.sqlite is not among them" in why
    for page in ("report.html", "summary.md"):
        assert server.base_url in (talking.path / "dura-evidence" / page).read_text()
    cut_off()
    run(talking, "replay")
    (again,) = models_of(talking.evidence())
    assert (again.mode, again.asked, again.missed) == ("replay", 0, 0)
    assert again.reused == told.asked
    assert cassette_of(talking.evidence()).exchanges == tape.exchanges
    for key in ("base_url", "fingerprint", "capabilities", "prompts"):
        assert getattr(again, key) == getattr(told, key)


def first_line(result):
    return next(line for line in result.outlines if line.startswith("dura: "))


@pytest.mark.parametrize("about, workers", [("a parrot", ("-n", "1")), ("", ())])
def test_the_first_line_of_a_replay_and_the_evidence_name_what_spoke(
    talking, cut_off, monkeypatch, about, workers
):
    monkeypatch.setenv("DURA_LLM_ABOUT", about)
    recorded = run(talking, "record", "--dura-cassette=tapes/one.sqlite", runs=1)
    after = f"; {about}" if about else ""
    assert any(line.endswith(f"at most 30 s for a decision{after}") for line in recorded.outlines)
    assert not first_line(recorded).startswith("dura: answers replayed")
    monkeypatch.setenv("DURA_LLM_ABOUT", "another one, that did not speak")
    cut_off()
    result = run(talking, "replay", "--dura-cassette=tapes/one.sqlite", *workers, runs=1)
    (told,) = models_of(talking.evidence())
    spoke = rf"dura: answers replayed from tapes/one\.sqlite: {about or told.model}, recorded "
    assert re.fullmatch(spoke + r"\d{4}-\d\d-\d\d", first_line(result))
    assert told.about == about
    summary = (talking.path / "dura-evidence" / "summary.md").read_text()
    assert (f"({about})" if about else f"| {told.model} |") in summary


STOPPED = """
from pathlib import Path

def test_it(orchestrator):
    orchestrator.campaign("corridor/it", runs=2).require("always (gap > -99)", at_most=0.9)

def test_last():
    assert not Path("broken").exists()
"""


@pytest.mark.parametrize("another", [False, True], ids=["the same", "another"])
def test_a_session_goes_on_with_the_episodes_of_its_own_cassette_alone(
    talking, server, cut_off, another
):
    """Of another one the component hears other answers, though all else is as it was."""
    talking.write("test_it.py", STOPPED)

    def session(mode, folder, *more):
        talking.run(
            "test_it.py", GENERATOR, f"--dura-llm={mode}", f"--dura-evidence={folder}", *more
        )
        return digests(talking, folder)

    tape = talking.path / "dura-cassette.sqlite"
    first = session("record", "first")
    kept = tape.read_bytes()
    tape.unlink()
    # What it can do, which it is asked first, is the same.
    server._otherwise = answers_by(
        lambda request: "0.100000" if "gap" in request.prompt else speed(request)
    )
    second = session("record", "second")
    assert not {*first.values()} & {*second.values()}
    cut_off()
    recorded = tape.read_bytes()
    tape.write_bytes(kept)
    talking.write("broken", "")
    assert session("replay", "third", "-x") == first
    (talking.path / "broken").unlink()
    if another:
        tape.write_bytes(recorded)
    assert session("replay", "third", "--dura-resume") == (second if another else first)
    assert talking.evidence("third").status == "complete"
    assert talking.evidence("third").resume.taken_over == (0 if another else len(first))


def test_words_about_the_model_that_are_no_line_end_the_session(talking, monkeypatch):
    monkeypatch.setenv("DURA_LLM_ABOUT", "parrot " * 30)
    result = run(talking, "record", runs=1)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "DURA_LLM_ABOUT" in result.stderr.str()


@pytest.mark.parametrize("hides", [False, True])
def test_a_miss_is_no_failure_of_the_component_and_the_gate_fails(talking, cut_off, hides):
    run(talking, "record", runs=1)
    talking.write("talker.py", talker(words="rudely", hides=hides))
    cut_off()
    result = run(talking, "replay", runs=1)
    assert result.ret == 1
    words = "infrastructure: cassette at tick 0 (t = 0.0 s): the cassette dura-cassette.sqlite has "
    for one in talking.evidence().episodes:
        assert one.validity == "missing"
        assert one.failure.startswith(words)
        differs = "line 3, block SIGHT (recorded 'asked politely', asked 'asked rudely')"
        assert one.failure.endswith(differs)
    assert set(talking.verdicts().values()) == {"undecided"}
    assert talking.evidence().gate.result == "failed"
    assert models_of(talking.evidence())[0].missed == len(talking.evidence().episodes)


def test_an_episode_is_replayed_from_the_cassette(talking, server, cut_off):
    run(talking, "record")
    asked = len(prompts(server))
    cut_off()
    arguments = ["--dura-replay=corridor/it#1", "--dura-llm=replay"]
    result = talking.run(*arguments)
    assert result.ret == 0
    result.stdout.fnmatch_lines(["corridor/it#1 (Talker, *", "  the same"])
    assert len(prompts(server)) == asked
    assert sessions.in_use() is None


def test_a_model_that_answers_otherwise_is_told_where_a_replay_differs(talking, server):
    numbers = iter(range(1, 10_000))
    server._otherwise = answers_by(
        lambda request: f"{1 / next(numbers):.6f}" if "gap" in request.prompt else "the sea"
    )
    run(talking, "live")
    told = "  a language model was asked anew and may have answered otherwise; *"
    arguments = ["--dura-replay=corridor/it#1", "--dura-llm=record"]
    result = talking.run(*arguments)
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  DIFFERENT: *", told])
    # It is all in the cassette by now, and the code is to blame.
    result = talking.run(*arguments)
    result.stdout.fnmatch_lines(["  DIFFERENT: *"])
    result.stdout.no_fnmatch_line(told)


def test_a_component_of_a_conftest_is_replayed_with_what_it_was_settled_to(talking, cut_off):
    talking.write(
        "conftest.py",
        "import pytest\n"
        "from talker import Talker\n"
        "class Local(Talker): pass\n"
        "@pytest.fixture(scope='session')\n"
        "def generator(): return Local\n",
    )
    talking.scenarios("--dura-llm=record", select="corridor/it")
    role = talking.evidence().episodes[0].spec.roles["generator"]
    assert role.path == "conftest.py:Local"
    assert role.params["model"] == "scripted"
    assert models_of(talking.evidence())[0].component == "Local"
    cut_off()
    result = talking.run("--dura-replay=corridor/it#1", "--dura-llm=replay")
    assert "  the same" in result.outlines


def test_the_commands_that_are_printed_replay_from_the_same_cassette(talking, cut_off):
    broken = talker().replace("Proposal(float(answer.text)", "Proposal(50.0")
    talking.write("talker.py", broken)
    result = run(talking, "record", "--dura-cassette=my tape.sqlite")
    (line, *_) = [one for one in result.outlines if "--dura-replay=" in one and "replay:" in one]
    command = line.partition("pytest ")[2]
    assert "--dura-llm=replay --dura-cassette='my tape.sqlite'" in command
    summary = (talking.path / "dura-evidence/summary.md").read_text()
    assert "--dura-llm=replay --dura-cassette='my tape.sqlite'" in summary
    reruns = [one for one in result.outlines if "rerun:" in one]
    assert all("--dura-llm=record --dura-cassette='my tape.sqlite'" in one for one in reruns)
    assert reruns


def test_a_reduction_asks_for_what_is_new_and_can_be_done_again_without_a_server(talking, cut_off):
    near_the_wall(talking, faults=f"[{NOISE}, {BIAS}]", runs=1)
    talking.write("talker.py", talker().replace("float(answer.text)", CAREFULLY))
    arguments = ["--dura-llm=record", "--dura-evidence=out", "--dura-time-budget=30"]
    assert talking.run("corridor/it", GENERATOR, *arguments).ret == 1
    told = [talking.run("--dura-reduce=corridor/it#0", *arguments).outlines]
    cut_off()
    again = ["--dura-llm=replay", "--dura-evidence=out"]
    told.append(talking.run("--dura-reduce=corridor/it#0", *again).outlines)
    assert told[0] == told[1]
    (smallest,) = [line for line in told[0] if line.startswith("smallest set")]
    assert smallest.startswith("smallest set that violates GAP-1: bias ")
    assert any("out-reduced --dura-llm=replay" in line for line in told[0])
    replayed = talking.run(
        "--dura-replay=corridor/it+bias#0", "--dura-evidence=out-reduced", *again[:1]
    )
    assert "  the same" in replayed.outlines
    assert sessions.in_use() is None


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--dura-llm=replay"], ["*there is no such cassette", "*--dura-cassette", "*remedy*"]),
        (["--dura-cassette=tape"], ["*a live session has none", "*--dura-llm=record or*"]),
        (
            ["--dura-llm=record", "--dura-cassette=corridor.py"],
            ["*corridor.py: the cassette cannot be *"],
        ),
        (["--dura-llm=sometimes"], ["*invalid choice: 'sometimes'*"]),
    ],
)
def test_what_cannot_be_used_is_one_usage_error(talking, server, arguments, words):
    result = talking.scenarios(GENERATOR, *arguments)
    assert result.ret == 4
    result.stderr.fnmatch_lines(words)
    assert "Traceback" not in result.stderr.str() + result.stdout.str()
    assert server.requests == []
    assert not (talking.path / "dura-evidence").exists()


@pytest.mark.parametrize("given", ["option", "scenario"])
def test_a_server_that_is_not_there_ends_the_session_before_it_begins(talking, monkeypatch, given):
    monkeypatch.setenv("DURA_LLM_BASE_URL", "http://127.0.0.1:9/v1")
    arguments = ["--dura-scenarios", "--dura-select=corridor/it"]
    if given == "option":
        arguments.append(GENERATOR)
    else:
        crossing(talking, "it", generator="talker:Talker")
    result = talking.run(*arguments)
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: the language model 'scripted' at http://127.0.0.1:9/v1 *"])
    assert not (talking.path / "dura-evidence").exists()


CONFTESTS = {
    "name": "import talker\nPLANNER = talker.Talker\n{fixture}    return PLANNER\n",
    "import": "{fixture}    from talker import Talker\n    return Talker\n",
    "spec": "from pytest_dura import RoleSpec\n{fixture}    return RoleSpec('talker:Talker')\n",
}
FIXTURE = "import pytest\n@pytest.fixture(scope='session')\ndef generator():\n"


@pytest.mark.parametrize("written, workers", [("import", ()), ("spec", ()), ("name", ("-n", "1"))])
def test_the_header_names_the_model_of_a_conftest_and_its_time(talking, server, written, workers):
    talking.write("conftest.py", CONFTESTS[written].format(fixture=FIXTURE))
    result = talking.scenarios("--dura-runs=1", *workers, select="corridor/it*")
    result.assert_outcomes(passed=2)
    lines = [line for line in result.outlines if line.startswith("dura: language model")]
    (line,) = lines
    assert f"language model {server.model} at {server.base_url} (live)" in line
    assert line.endswith(", at most 30 s for a decision")


def test_the_header_names_the_time_of_the_option_and_those_of_several_scenarios(talking):
    crossing(talking, "it-slow")
    file = talking.path / "scenarios/corridor/it-slow.yaml"
    file.write_text(file.read_text().replace("time_budget: 30.0", "time_budget: 40.0"))
    several = run(talking, "live", runs=1)
    assert any(line.endswith(", at most 30 to 40 s for a decision") for line in several.outlines)
    one = run(talking, "live", "--dura-time-budget=20.5", runs=1)
    assert any(line.endswith(", at most 20.5 s for a decision") for line in one.outlines)


def test_a_model_of_a_conftest_that_is_not_named_is_one_usage_error(talking, monkeypatch):
    talking.write("conftest.py", CONFTESTS["name"].format(fixture=FIXTURE))
    monkeypatch.delenv("DURA_LLM_BASE_URL")
    result = talking.scenarios("--dura-llm=record", select="corridor/it*")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert (
        result.stderr.str().count("no language model is named: DURA_LLM_BASE_URL is not set") == 1
    )
    assert "collected" not in result.stdout.str()


@pytest.mark.parametrize(
    "body",
    [
        "    print('set up')\n    return 'talker:Talker'\n",
        "    yield 'talker:Talker'\n",
        "    return str('talker:Talker')\n",
        "    from not_there import Talker\n    return Talker\n",
    ],
)
def test_a_fixture_that_does_something_is_set_up_by_its_items_alone(talking, body, monkeypatch):
    talking.write("conftest.py", FIXTURE + body)
    monkeypatch.delenv("DURA_LLM_BASE_URL")
    result = talking.scenarios("-s", "--dura-runs=1", select="corridor/it*")
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert result.stdout.str().count("set up") == body.count("set up")


@pytest.mark.parametrize("used", ["autouse", "ini"])
def test_a_model_that_a_fixture_of_every_item_names_is_not_asked_before(
    talking, server, used, monkeypatch
):
    autouse = used == "autouse"
    talking.write(
        "conftest.py",
        FIXTURE
        + "    return 'talker:Talker'\n"
        + f"@pytest.fixture(scope='session', autouse={autouse})\n"
        + "def address():\n"
        + "    import os\n"
        + f"    os.environ['DURA_LLM_BASE_URL'] = {server.base_url!r}\n",
    )
    monkeypatch.delenv("DURA_LLM_BASE_URL")
    ini = () if autouse else ("-o", "usefixtures=address")
    result = talking.scenarios("--dura-runs=1", *ini, select="corridor/it*")
    result.assert_outcomes(passed=2)


def test_collecting_and_listing_ask_nobody(talking, server):
    assert talking.scenarios(GENERATOR, "--collect-only").ret == 0
    assert talking.run("--dura-list", GENERATOR).ret == 0
    assert server.requests == []


def test_what_one_session_found_out_is_forgotten_in_the_next(talking, server):
    with ScriptedServer(otherwise=answers("0.1")) as other:
        run(talking, "live", "--dura-evidence=one")
        first = models_of(talking.evidence("one"))
        talking.pytester._monkeypatch.setenv("DURA_LLM_BASE_URL", other.base_url)
        run(talking, "live", "--dura-evidence=two")
        second = models_of(talking.evidence("two"))
    assert [one.base_url for one in (*first, *second)] == [server.base_url, other.base_url]
    assert cassette_of(talking.evidence("one")) is None
    assert first[0].reused == 0
    assert sessions.in_use() is None


def test_a_session_around_this_one_keeps_its_model(talking, tmp_path_factory):
    outer = sessions.ModelSession("record", tmp_path_factory.mktemp("outer") / "tape.sqlite")
    with sessions.using(outer):
        run(talking, "live")
        assert sessions.current() is outer
    assert len(outer.cassette) == 0
    outer.close()


def test_a_key_that_the_server_sends_back_is_in_no_file(talking, server):
    seen = [0]

    def leak(exchange):
        seen[0] += 1
        header = exchange.request.headers["authorization"]
        if seen[0] % 3 and "gap" in exchange.request.prompt:
            echoes_the_key(500)(exchange)
        elif "gap" in exchange.request.prompt:
            answers(f"your key is {header}")(exchange)
        else:
            answers(f"the sea and {header}")(exchange)

    server._otherwise = leak
    talking.write(
        "talker.py",
        talker().replace("float(answer.text)", "1.0 if 'key' in answer.text else 0.9"),
    )
    result = run(talking, "record", "--dura-evidence-level=all", "--junit-xml=junit.xml", "-rA")
    assert any(KEY in one.headers["authorization"] for one in server.requests)
    told = talking.evidence()
    assert "Incorrect API key provided" in json.dumps(told.to_json(include={"episodes"}))
    assert "your key is" in (talking.path / "dura-cassette.sqlite").read_text("latin-1")
    assert KEY not in result.stdout.str() + result.stderr.str()
    for form in (KEY.encode(), b64encode(KEY.encode()).rstrip(b"="), KEY.encode("utf-32-le")):
        assert [name for name, data in texts(talking.path) if form in data] == []


def test_a_session_without_a_language_model_imports_nothing_that_one_needs(project):
    code = (
        "import sys, pytest\n"
        "pytest.main(['--dura-scenarios', '--dura-select=corridor/free', '--dura-runs=1', '-q'])\n"
        "names = ['pytest_dura.llm.session', 'openai', 'PIL']\n"
        "print([one for one in names if one in sys.modules])"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=project.path
    )
    assert told.stdout.splitlines()[-1] == "[]"
    assert models_of(project.evidence()) == []


def busy_at_first(times, *, retry_after=0):
    """As :func:`speed`, but for the first requests about a gap, which find the server busy."""
    left = [times]

    def behave(exchange):
        if "gap" in exchange.request.prompt and left[0]:
            left[0] -= 1
            fails(429, retry_after=retry_after)(exchange)
        else:
            answers_by(speed)(exchange)

    return behave


@pytest.mark.parametrize("given", ["environment", "workers"])
def test_a_server_that_is_busy_is_asked_again_where_it_is_wanted(
    talking, server, monkeypatch, given
):
    server._otherwise = busy_at_first(3)
    more = ["--dura-llm-retries=3", "-n", "1"] if given == "workers" else []
    if given == "environment":
        monkeypatch.setenv("DURA_LLM_RETRIES", "3")
    result = run(talking, "live", *more, runs=1)
    (told,) = models_of(talking.evidence())
    assert (told.repeated, told.unavailable) == (3, {"HTTP 429": 3})
    assert told.asked + told.repeated == len(prompts(server))
    line = f"language model {server.model}: unavailable in 3 calls (3 x HTTP 429); 3 requests *"
    result.stdout.fnmatch_lines([line])
    failures = [one.metrics.violations for one in talking.evidence().episodes]
    assert not any("generator" in one for one in failures)
    for page in ("summary.md", "report.html"):
        assert "3 x HTTP 429" in (talking.path / "dura-evidence" / page).read_text()
    assert verify_bundle(talking.path / "dura-evidence").intact


def test_otherwise_it_is_not_and_the_record_says_why_it_failed(talking, server):
    server._otherwise = busy_at_first(3)
    result = run(talking, "live", runs=1)
    (told,) = models_of(talking.evidence())
    assert (told.repeated, told.unavailable) == (0, {"HTTP 429": 3})
    result.stdout.fnmatch_lines(["*unavailable in 3 calls (3 x HTTP 429); none was repeated"])


def test_a_recording_goes_on_where_the_server_was_not_available(talking, server, cut_off):
    run(talking, "record", runs=1)
    crossing(talking, "it-fails")
    server._otherwise = busy_at_first(1)
    server.requests.clear()
    run(talking, "record", runs=1)
    (refused,) = prompts(server)
    tape = talking.path / "dura-cassette.sqlite"
    assert main(["cassette", str(tape), "--drop-failures"]) == 0
    server.requests.clear()
    run(talking, "record", runs=1)
    # What failed is asked again, with what comes after it now, and nothing of the other cases.
    again = prompts(server)
    assert again[0] == refused
    (told,) = models_of(talking.evidence())
    assert told.asked == len(again) < told.reused
    assert told.unavailable == {}
    cut_off()
    run(talking, "replay", runs=1)
    (told,) = models_of(talking.evidence())
    assert (told.missed, told.unavailable) == (0, {})


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--dura-llm-retries=-1"], "a whole number of at least 0"),
        (["--dura-llm-retries=21"], "repeats a request too often"),
        (["--dura-llm-retries=2", "--dura-executor=processes:2"], "set DURA_LLM_RETRIES=2 where"),
    ],
)
def test_a_number_of_retries_that_cannot_be_used_is_one_usage_error(
    talking, server, arguments, words
):
    result = talking.scenarios(GENERATOR, *arguments)
    assert result.ret == 4
    assert words in result.stderr.str()
    assert server.requests == []
