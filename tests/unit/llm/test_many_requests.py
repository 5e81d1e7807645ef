"""Several requests at once: at most so many, each equal one once, and no more than the limits."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from pytest_dura.core import ComponentEnvironmentError, ConfigurationError, environment_errors
from pytest_dura.llm import Answer, Message, ModelSession, Request
from pytest_dura.llm.session import uncounted
from pytest_dura.llm.usage import Limits, Meter, Tokens, estimate_tokens

SECONDS = 0.1
USAGE = {"prompt_tokens": 100, "completion_tokens": 20}


class WaitingServer:
    """Answers with what it is asked, after a while, and counts how many wait at once."""

    model, base_url = "m", "http://127.0.0.1:9/v1"

    def __init__(self, usage: dict[str, int] | None = None) -> None:
        self.usage = USAGE if usage is None else usage
        self.asked: list[str] = []
        self.at_once = self.most = 0
        self.together = 1
        """So many are waited for before the first one is answered."""
        self._lock = threading.Lock()
        self.there = threading.Event()

    def ask(self, request: Request, budget: float, repeats: Any = None) -> Answer:
        text = request.messages[-1].text
        with self._lock:
            self.asked.append(text)
            self.at_once += 1
            self.most = max(self.most, self.at_once)
            if self.most >= self.together:
                self.there.set()
        self.there.wait(30.0)
        time.sleep(SECONDS if text != "slow" else 3 * SECONDS)
        with self._lock:
            self.at_once -= 1
        return Answer(f"to {text}", seconds=SECONDS, usage=self.usage)

    def probe(self) -> tuple[str, dict[str, Any]]:
        return "f", {}

    def scrub(self, text: str) -> str:
        return text


def request(text: str) -> Request:
    return Request("m", (Message("user", text),))


def requests(count: int) -> list[Request]:
    return [request(str(number)) for number in range(count)]


def texts(answers: list[Answer]) -> list[str]:
    return [answer.text for answer in answers]


@pytest.fixture
def server() -> WaitingServer:
    return WaitingServer()


def made(server: WaitingServer, mode: Any = "live", tape: Path | None = None, **more: Any) -> Any:
    return ModelSession(mode, tape, environ={}, connect=lambda *_: server, **more)


@pytest.mark.parametrize("width, most", [(1, 1), (3, 3), (20, 7)])
def test_so_many_are_under_way_at_once_and_answers_keep_their_order(server, width, most) -> None:
    server.together = most
    session = made(server, concurrency=width)
    assert texts(session.ask_all(requests(7), 5.0)) == [f"to {number}" for number in range(7)]
    assert server.most == most
    if width == 1:
        assert server.asked == list(map(str, range(7)))


def test_threads_together_make_no_more_requests_than_there_are_places(server) -> None:
    server.together = 3
    session = made(server, concurrency=3)
    with ThreadPoolExecutor(5) as threads:
        results = list(threads.map(lambda _: texts(session.ask_all(requests(4), 5.0)), range(5)))
    assert results == [[f"to {number}" for number in range(4)]] * 5
    assert server.most == 3
    assert session.counts["m", "f", "asked"] == 20


def test_an_equal_request_that_is_under_way_is_asked_once_where_it_is_recorded(
    server, tmp_path
) -> None:
    session = made(server, "record", tmp_path / "tape", concurrency=8)
    same = [request(text) for text in ("a", "slow", "a", "slow", "slow", "b")]
    assert texts(session.ask_all(same, 5.0)) == [f"to {each.messages[0].text}" for each in same]
    assert sorted(server.asked) == ["a", "b", "slow"]
    assert session.counts == {("m", "f", "asked"): 3, ("m", "f", "reused"): 3}
    session.close()
    replay = made(server, "replay", tmp_path / "tape", concurrency=8)
    assert texts(replay.ask_all(same, 5.0)) == [f"to {each.messages[0].text}" for each in same]
    assert len(server.asked) == 3


def test_whoever_waits_for_an_equal_request_that_fails_asks_itself(tmp_path) -> None:
    class Fails(WaitingServer):
        def ask(self, request: Request, budget: float, repeats: Any = None) -> Answer:
            answer = super().ask(request, budget, repeats)
            if len(self.asked) == 1:
                raise KeyError("as a time limit ends it")
            return answer

    session = made(Fails(), "record", tmp_path / "tape", concurrency=2)
    with pytest.raises(KeyError):
        session.ask_all([request("a"), request("a")], 5.0)
    assert session.ask(request("a"), 5.0).text == "to a"
    assert session.counts["m", "f", "asked"] == 2


def test_a_miss_among_many_is_that_of_the_first(server, tmp_path) -> None:
    session = made(server, "record", tmp_path / "tape")
    session.ask(request("0"), 5.0)
    session.close()
    replay = made(server, "replay", tmp_path / "tape", concurrency=4)
    with environment_errors() as errors, pytest.raises(ComponentEnvironmentError):
        replay.ask_all(requests(3), 5.0)
    assert len(errors) == 1


def test_requests_of_a_repetition_enter_no_count_in_any_thread(server) -> None:
    session = made(server, concurrency=4)
    with uncounted():
        session.ask_all(requests(4), 5.0)
    assert session.counts == {}
    session.ask(request("a"), 5.0)
    assert session.counts == {("m", "f", "asked"): 1}


@pytest.mark.parametrize(
    "limits, asked, reached",
    [
        (Limits(requests=5), 5, "5 requests"),
        (Limits(tokens=360), 3, "360 tokens"),
    ],
)
def test_a_limit_keeps_the_next_request_from_its_server(server, limits, asked, reached) -> None:
    # 100 and 20 tokens at 1,000 and 2,000 a million: 0.14 a request
    session = made(server, meter=Meter(limits))
    for each in requests(asked):
        session.ask(each, 5.0)
    assert session.ended_by == ""
    with environment_errors() as errors, pytest.raises(ComponentEnvironmentError) as caught:
        session.ask(request("one more"), 5.0)
    assert session.ended_by == f"the limit of {reached} is reached (--dura-llm-limit)"
    assert session.ended_by in str(caught.value)
    assert errors == [caught.value]
    assert len(server.asked) == session.counts["m", "f", "asked"] == asked


def test_a_limit_of_requests_is_kept_also_by_many_at_once(server) -> None:
    session = made(server, concurrency=8, meter=Meter(Limits(requests=5)))
    with environment_errors(), pytest.raises(ComponentEnvironmentError):
        session.ask_all(requests(12), 5.0)
    time.sleep(2 * SECONDS)
    assert len(server.asked) == 5


def test_what_the_cassette_answers_counts_against_no_limit(server, tmp_path) -> None:
    session = made(server, "record", tmp_path / "tape", meter=Meter(Limits(requests=1)))
    for _ in range(3):
        assert session.ask(request("a"), 5.0).text == "to a"
    assert session.ended_by == ""


def test_processes_share_a_limit_by_a_file(server, tmp_path) -> None:
    limits, file = Limits(requests=3), tmp_path / "spent"
    sessions = [made(server, meter=Meter(limits, file)) for _ in range(2)]
    for number in range(3):
        sessions[number % 2].ask(request("a"), 5.0)
    for session in sessions:
        with environment_errors(), pytest.raises(ComponentEnvironmentError):
            session.ask(request("a"), 5.0)
    assert len(server.asked) == 3


def test_tokens_that_no_server_counts_are_estimated_for_the_limit() -> None:
    server = WaitingServer(usage={})
    session = made(server, meter=Meter(Limits(tokens=300)))
    session.ask(request("x" * 1200), 5.0)
    with environment_errors(), pytest.raises(ComponentEnvironmentError):
        session.ask(request("a"), 5.0)
    assert estimate_tokens("abcd", "abcde", "") == 3


def test_a_session_that_has_ended_asks_and_records_nothing_more(server, tmp_path) -> None:
    server.together = 2  # the first one is not answered before the session has ended
    session = made(server, "record", tmp_path / "tape", concurrency=2)
    with ThreadPoolExecutor(1) as threads:

        def late() -> None:
            with environment_errors(), pytest.raises(ComponentEnvironmentError):
                session.ask(request("slow"), 5.0)

        future = threads.submit(late)
        while not server.asked:
            time.sleep(0.01)
        session.stop()
        server.there.set()
        future.result(10.0)
    with environment_errors(), pytest.raises(ComponentEnvironmentError):
        session.ask(request("a"), 5.0)
    assert server.asked == ["slow"]
    assert len(session.cassette) == 0


@pytest.mark.parametrize(
    "text, limits",
    [
        ("requests=5000", Limits(requests=5000)),
        ("requests=5000, tokens=2e6", Limits(5000, 2_000_000)),
    ],
)
def test_limits_are_read(text, limits) -> None:
    assert Limits.parse(text, "--x") == limits


@pytest.mark.parametrize(
    "text",
    ["", "5000", "requests", "requests=0", "requests=1.5", "tokens=-1", "tokens=inf", "price=nan",
     "days=3", "requests=1,requests=2", "requests=1,"],
)  # fmt: skip
def test_limits_that_cannot_be_read_are_one_error(text) -> None:
    with pytest.raises(ConfigurationError, match="--x limits what a session asks"):
        Limits.parse(text, "--x")


def test_tokens_are_those_that_the_server_counted() -> None:
    assert Tokens.of(USAGE, answered=True) == Tokens(100, 20)
    assert Tokens.of({}, answered=True) == Tokens(uncounted=1)
    assert Tokens.of({}, answered=False) == Tokens()
    assert Tokens.of({"prompt_tokens": 5}, answered=True) == Tokens(5, 0, 1)
    assert Tokens(3, 2, 1) + Tokens(1, 1, 1) == Tokens(4, 3, 2)
