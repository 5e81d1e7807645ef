"""Who answers: a server each time, a server once, or the cassette alone."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pytest_dura.core import ComponentEnvironmentError, ConfigurationError, environment_errors
from pytest_dura.llm import Answer, Cassette, Delivery, Image, Message, ModelSession, Request
from pytest_dura.llm import session as sessions
from pytest_dura.llm.misses import LONGEST_MISS, CassetteMissError

KEY = "planted-key-1234567"
PROMPT = "EGO\nspeed 8.0 m/s\nLIDAR\nV1 at 12.0 m\nV2 at 30.0 m"


class CountingServer:
    """Numbers its answers, so that no two of them are equal by chance."""

    base_url = "http://127.0.0.1:9/v1"

    def __init__(self, model="m", fingerprint="f1", seconds=0.25, text="answer"):
        self.model, self.fingerprint, self.seconds, self.text = model, fingerprint, seconds, text
        self.asked: list[Request] = []
        self.probes = 0

    def ask(self, request, budget, repeats=None):
        self.asked.append(request)
        text = f"{self.text} {len(self.asked)}"
        return Answer(text=text, seconds=self.seconds, usage={"total_tokens": 7})

    def probe(self):
        self.probes += 1
        return self.fingerprint, {"structured": "json_schema", "seed": True}

    def scrub(self, text):
        return text.replace(KEY, "[key]")


def request(text=PROMPT, **changes):
    told = {"model": "m", "messages": (Message("system", "drive"), Message("user", text))}
    return Request(**(told | changes))


def nobody(environ, model):
    raise AssertionError("nobody is to be asked")


@pytest.fixture
def tape(tmp_path):
    return tmp_path / "tape.sqlite"


def made(mode, tape, server, **more):
    return ModelSession(mode, tape, environ={}, connect=lambda *_: server, **more)


@pytest.fixture
def server():
    return CountingServer()


@pytest.fixture
def recorded(tape, server):
    session = made("record", tape, server)
    session.ask(request(), 5.0)
    session.close()
    return tape


def replaying(tape):
    return ModelSession("replay", tape, environ={}, connect=nobody)


def missed(tape, asked, **more):
    with environment_errors() as heard, pytest.raises(CassetteMissError) as caught:
        replaying(tape).ask(asked, 5.0, **more)
    assert heard == [caught.value]
    return str(caught.value)


def test_what_another_process_found_out_holds_for_the_same_server_alone(server):
    first = made("live", None, server)
    first.describe()
    told = [one.to_json() for one in first.descriptions]
    for name in (None, "m"):
        second = made("live", None, server)
        second.know(told)
        assert second.describe(name) == first.describe()
    assert server.probes == 1
    server.base_url = "http://127.0.0.1:10/v1"
    other = made("live", None, server)
    other.know(told)
    assert other.describe().base_url == server.base_url
    assert server.probes == 2


def test_live_asks_each_time_and_keeps_nothing(tape, server):
    session = made("live", None, server)
    assert [session.ask(request(), 5.0).text for _ in range(2)] == ["answer 1", "answer 2"]
    assert session.counts == {("m", "f1", "asked"): 2}
    assert not tape.exists()


def test_record_asks_once_also_in_a_later_session(tape, server):
    first = made("record", tape, server)
    answers = [first.ask(request(), 5.0) for _ in range(2)]
    first.close()
    answers.append(made("record", tape, server).ask(request(), 5.0))
    assert len(server.asked) == 1
    assert len(set(map(repr, answers))) == 1
    assert first.counts == {("m", "f1", "asked"): 1, ("m", "f1", "reused"): 1}


def test_replay_gives_what_was_recorded_and_asks_nobody(recorded):
    answer = replaying(recorded).ask(request(), 5.0)
    assert answer == Answer(text="answer 1", seconds=0.25, usage={"total_tokens": 7})


@pytest.mark.parametrize(
    "answer",
    [
        Answer(failure="timeout", detail="late", seconds=5.0),
        Answer(text="half a \ud800 pair\x00\x1b[31m", finish="stop", seconds=0.1 + 0.2),
    ],
)
def test_every_answer_comes_back_as_it_was(tape, server, answer):
    server.ask = lambda *_: answer
    first = made("record", tape, server).ask(request(), 5.0)
    assert first == replaying(tape).ask(request(), 5.0) == answer


@pytest.mark.parametrize("workers", [2, 8])
def test_several_that_ask_the_same_at_once_use_what_was_stored_first(tape, workers):
    servers = [CountingServer(text=f"server {number}") for number in range(workers)]
    together = threading.Barrier(workers)

    def work(server):
        session = made("record", tape, server, session="one")
        together.wait()
        return [session.ask(request(f"{PROMPT} {number}"), 5.0).text for number in range(10)]

    with ThreadPoolExecutor(workers) as pool:
        found = list(pool.map(work, servers))
    assert all(one == found[0] for one in found)
    assert len(Cassette(tape, writable=False)) == 10


def test_images_are_stored_by_their_digest_alone(tape, server):
    image = Image("camera_front", np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    asked = request(messages=(Message("user", "look", (image,)),))
    made("record", tape, server).ask(asked, 5.0)
    (one,) = Cassette(tape, writable=False).exchanges()
    told = {"name": "camera_front", "sha256": image.digest}
    assert one.request["messages"] == [{"role": "user", "text": "look", "images": [told]}]
    assert image.pixels.tobytes() not in tape.read_bytes()


def test_the_key_is_neither_sent_in_a_prompt_nor_stored(tape, server):
    server.text = f"I know {KEY}"
    session = made("record", tape, server, scrub=lambda plain: _without(plain, "my-other-secret"))
    answer = session.ask(request(f"note {KEY} my-other-secret"), 5.0)
    assert answer.text == "I know [key] 1"
    assert server.asked[0].messages[1].text == "note [key] my-other-secret"
    session.close()
    assert KEY.encode() not in tape.read_bytes()
    assert b"my-other-secret" not in tape.read_bytes()
    assert replaying(tape).ask(request("note [key] my-other-secret"), 5.0) == answer


def _without(plain, secret):
    return json.loads(json.dumps(plain).replace(secret, "[redacted]"))


@pytest.mark.parametrize("mode", ["live", "record", "replay"])
def test_an_injected_fault_reaches_nobody_and_is_not_recorded(tape, server, mode):
    if mode == "replay":
        made("record", tape, server).close()
    session = made(mode, tape, server if mode != "replay" else None)
    answer = session.ask(request(), 5.0, Delivery(fault="http_500", delay=0.5), fingerprint="f1")
    assert answer.failure == "unavailable"
    assert answer.seconds == 0.5
    assert server.asked == []
    assert session.counts == {("m", "f1", "injected"): 1}
    assert mode == "live" or len(Cassette(tape, writable=False)) == 0


@pytest.mark.parametrize(
    "delay, budget, expected",
    [
        (0.5, 5.0, ("", 0.75, 1)),
        (0.5, None, ("", 0.75, 1)),
        (0.8, 1.0, ("timeout", 1.0, 1)),
        (1.0, 1.0, ("timeout", 1.0, 0)),
        (0.0, 0.2, ("timeout", 0.2, 1)),
    ],
)
def test_a_delay_counts_against_the_budget(tape, server, delay, budget, expected):
    session = made("record", tape, server)
    answer = session.ask(request(), budget, Delivery(delay=delay))
    assert (answer.failure, answer.seconds, len(server.asked)) == expected
    if server.asked:
        again = replaying(tape).ask(request(), budget, Delivery(delay=delay))
        assert again == answer
        assert replaying(tape).ask(request(), 5.0).text == "answer 1"


def test_a_server_is_probed_once_per_process_and_model(tape, server):
    session = made("record", tape, server)
    found = [session.describe(), session.describe("m"), session.describe()]
    assert found[0] == found[1] == found[2]
    assert server.probes == 1
    assert found[0].capabilities == {"structured": "json_schema", "seed": True}
    assert session.descriptions == [found[0]]


def test_what_one_process_found_out_holds_for_its_session_and_no_later_one(tape):
    servers = [CountingServer(fingerprint=name) for name in ("f1", "f2", "f3")]
    names = ["one", "one", "another"]
    found = [
        made("record", tape, server, session=name).describe().fingerprint
        for server, name in zip(servers, names, strict=True)
    ]
    assert found == ["f1", "f1", "f3"]
    assert [one.probes for one in servers] == [1, 0, 1]
    assert replaying(tape).describe().fingerprint == "f3"


def test_a_description_that_failed_fails_the_same_way_without_being_asked_again():
    calls = []

    def refuse(environ, model):
        calls.append(model)
        raise ConfigurationError("no language model is named")

    session = ModelSession(environ={}, connect=refuse)
    for _ in range(2):
        with pytest.raises(ConfigurationError, match="no language model is named"):
            session.describe()
    assert calls == [None]


def test_replay_needs_a_name_only_where_there_are_several_models(tape):
    for name in ("m", "n"):
        made("record", tape, CountingServer(model=name)).describe()
    with pytest.raises(ConfigurationError, match=r"several models(.*\n)+.*m, n"):
        replaying(tape).describe()
    with pytest.raises(ConfigurationError, match="knows no model 'o'"):
        replaying(tape).describe("o")
    assert replaying(tape).describe("n").model == "n"
    named = ModelSession("replay", tape, environ={"DURA_LLM_MODEL": "m"}, connect=nobody)
    assert named.describe().model == "m"


def test_a_replay_knows_each_model_by_its_last_description(tape):
    for name, text in (("m", "first"), ("n", ""), ("m", f"second {KEY}")):
        environ = {"DURA_LLM_ABOUT": text}
        server = CountingServer(model=name)
        session = ModelSession("record", tape, environ=environ, connect=lambda *_, s=server: s)
        session.describe()
        assert session.replayed == []
        session.close()
    found = replaying(tape).replayed
    assert [(each.model, each.spoken_of) for each in found] == [("m", "second [key]"), ("n", "n")]


def test_a_cassette_from_before_models_were_described_in_words_is_read(tape, server):
    session = made("record", tape, server)
    found = session.describe().to_json()
    del found["about"]
    session.cassette.describe({**found, "model": "old"}, "an older session")
    session.close()
    assert replaying(tape).describe("old").spoken_of == "old"


def test_a_server_that_is_another_than_the_spec_says_is_not_the_components_failure(server):
    session = made("live", None, server)
    with (
        environment_errors() as heard,
        pytest.raises(ComponentEnvironmentError, match="the server is another"),
    ):
        session.ask(request(), 5.0, fingerprint="f0")
    assert heard
    assert heard[0].source == "language model"
    assert server.asked == []


def test_a_replay_of_an_older_server_is_answered_by_its_fingerprint(recorded):
    made("record", recorded, CountingServer(fingerprint="f2", text="new")).ask(request(), 5.0)
    session = replaying(recorded)
    assert session.ask(request(), 5.0).text == "new 1"
    assert session.ask(request(), 5.0, fingerprint="f1").text == "answer 1"


@pytest.mark.parametrize(
    "asked, words",
    [
        (request(seed=7), "seed (recorded nothing, asked 7)"),
        (request(temperature=0.5), "temperature (recorded 0.0, asked 0.5)"),
        (request(sample=1), "sample (recorded 0, asked 1)"),
        (request(structured="json_object"), "structured (recorded 'none', asked 'json_object')"),
        (request(schema={"type": "object"}), "the schema of the answer"),
        (
            request(PROMPT.replace("30.0", "31.0")),
            "message 2 (user), line 5, block LIDAR (recorded 'V2 at 30.0 m', asked 'V2 at 31.0 m')",
        ),
        (
            request(PROMPT + "\nRADAR"),
            "message 2 (user), line 6, block RADAR (recorded nothing, asked 'RADAR')",
        ),
        (
            request("x" * 500, messages=(Message("system", "drive"),)),
            "the number of messages (recorded 2, asked 1)",
        ),
        (
            request(messages=(Message("system", "fly"), Message("user", PROMPT))),
            "message 1 (system), line 1 (recorded 'drive', asked 'fly')",
        ),
    ],
)
def test_a_miss_says_what_differs_from_the_nearest_request(recorded, asked, words):
    found = missed(recorded, asked)
    assert found == (
        "the cassette tape.sqlite has no answer to a request to 'm'; "
        f"from the nearest of 1 recorded ones it differs in {words}"
    )


def test_a_miss_names_the_image_the_fingerprint_and_the_model(recorded, server):
    image = Image("camera_front", np.zeros((2, 2, 3), np.uint8))
    messages = (Message("system", "drive"), Message("user", PROMPT, (image,)))
    assert "message 2 (user), image 'camera_front'" in missed(recorded, request(messages=messages))
    words = "the server's fingerprint (recorded 'f1', asked 'f9')"
    assert missed(recorded, request(), fingerprint="f9").endswith(words)
    words = "of this model it has none; it knows ['m']"
    assert missed(recorded, request(model="n"), fingerprint="f1").endswith(words)


def test_the_nearest_request_is_the_one_with_the_most_in_common(tape, server):
    session = made("record", tape, server)
    for number in range(40):
        session.ask(request(PROMPT.replace("12.0", f"{number}.5")), 5.0)
    session.ask(request(PROMPT.replace("12.0", "7.5").replace("8.0", "9.0"), sample=1), 5.0)
    found = missed(tape, request(PROMPT.replace("12.0", "7.5").replace("30.0", "29.0")))
    assert "line 5, block LIDAR (recorded 'V2 at 30.0 m', asked 'V2 at 29.0 m')" in found
    assert "sample" not in found


def test_the_message_of_a_miss_is_bounded_and_shows_where_long_lines_differ(tape, server):
    made("record", tape, server).ask(request("a" * 50_000 + "b" + "c" * 1000), 5.0)
    found = missed(tape, request("a" * 50_000 + "d" + "c" * 1000, model="m"))
    assert "ab" in found
    assert "ad" in found
    assert len(found) <= LONGEST_MISS
    assert "\n" not in missed(tape, request("one\x1b[31m\u2028two" * 3000))


def test_a_miss_is_counted_even_if_the_component_hides_it(recorded):
    session = replaying(recorded)
    with pytest.raises(CassetteMissError):
        session.ask(request("else"), 5.0)
    assert session.counts == {("m", "f1", "missed"): 1}


def test_replay_opens_no_socket_and_needs_no_sdk(recorded):
    code = (
        "import socket, sys\n"
        "def refuse(*_, **__): raise SystemExit('a socket was made')\n"
        "socket.socket.__init__ = refuse\n"
        "from pathlib import Path\n"
        "from pytest_dura.llm.session import ModelSession\n"
        f"session = ModelSession('replay', Path({str(recorded)!r}))\n"
        "from pytest_dura.llm.port import Message, Request\n"
        "messages = (Message('system', 'drive'), Message('user', " + repr(PROMPT) + "))\n"
        "print(session.ask(Request('m', messages), 5.0).text)\n"
        "print(sorted({'openai', 'httpx', 'httpx2', 'PIL', 'jinja2'} & set(sys.modules)))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={}
    )
    assert found.stdout.splitlines() == ["answer 1", "[]"]


def test_a_session_is_in_use_until_it_is_put_back(server):
    session = made("live", None, server)
    before = sessions.current()
    assert before.mode == "live"
    with sessions.using(session):
        assert sessions.current() is session
    assert sessions.current() is before
    sessions.use(None)
    assert sessions.current() is not before


def test_a_mode_that_needs_a_cassette_says_so():
    with pytest.raises(ConfigurationError, match="the mode replay needs a cassette"):
        ModelSession("replay")


def test_a_request_is_the_same_whatever_object_it_is(recorded):
    assert replaying(recorded).ask(replace(request(), schema={}), 5.0).text == "answer 1"


class SlowServer(CountingServer):
    """A model that needs so many seconds for an answer."""

    def ask(self, request, budget, repeats=None):
        answer = super().ask(request, budget)
        if budget >= self.seconds:
            return answer
        return Answer(failure="timeout", detail="no whole answer", seconds=budget)


def test_a_time_out_is_an_answer_for_budgets_up_to_its_own_alone(tape):
    server = SlowServer(seconds=20.0)
    session = made("record", tape, server)
    assert session.ask(request(), 5.0).failure == "timeout"
    assert session.ask(request(), 4.0) == Answer(
        failure="timeout", detail="no whole answer", seconds=4.0
    )
    session.close()
    assert replaying(tape).ask(request(), 5.0).failure == "timeout"
    with environment_errors(), pytest.raises(CassetteMissError, match=r"time-out after 5 s.* 60 s"):
        replaying(tape).ask(request(), 60.0)
    session = made("record", tape, server)
    assert session.ask(request(), 60.0).text == "answer 2"
    session.close()
    assert replaying(tape).ask(request(), 60.0).text == "answer 2"


def test_a_model_that_never_answers_in_time_ends_the_session_at_the_third_answer():
    server = SlowServer(seconds=20.0)
    session = made("live", None, server)
    for number in range(3):
        assert session.ask(request(f"{number}"), 5.0).failure == "timeout"
    assert "took longer than the 5 s" in session.ended_by
    assert "raise --dura-time-budget" in session.ended_by
    with environment_errors(), pytest.raises(ComponentEnvironmentError, match="took longer"):
        session.ask(request("4"), 5.0)
    assert len(server.asked) == 3


def test_a_model_that_was_in_time_once_may_be_late_ever_after():
    server = SlowServer(seconds=20.0)
    session = made("live", None, server)
    for budget in (5.0, 5.0, 30.0, 5.0, 5.0, 5.0, 5.0):
        session.ask(request(f"{len(server.asked)}"), budget)
    assert session.ended_by == ""
    assert len(server.asked) == 7


@pytest.mark.parametrize("context, per_token, fits", [
    (1000 + 25, 4.0, True), (1000 + 24, 4.0, False), (1000 + 25, 2.0, False), (None, 2.0, True),
    (1000 + 25, None, True),
])  # fmt: skip
def test_a_first_prompt_that_the_context_cannot_hold_is_not_sent(context, per_token, fits):
    class Known(CountingServer):
        def probe(self):
            return self.fingerprint, {"context": context, "characters_per_token": per_token}

    server = Known()
    session = made("live", None, server)
    asked = replace(request(), messages=(Message("user", "x" * 100),), max_tokens=1000)
    if fits:
        assert session.ask(asked, 5.0).text == "answer 1"
        return
    with environment_errors(), pytest.raises(ComponentEnvironmentError, match="the context of m"):
        session.ask(asked, 5.0)
    assert server.asked == []
    assert session.ended_by
