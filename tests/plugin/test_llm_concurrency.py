"""Sessions that make many requests at once, and sessions that a limit ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from test_llm_modes import GENERATOR, cut_off, digests, prompts, run, server, speed, talking
from test_llm_planner_sessions import answers, brief, named, scripted_server

from pytest_dura.evidence import verify_bundle
from pytest_dura.llm import session as sessions
from pytest_dura.plugin import progress_display

__all__ = ["cut_off", "named", "scripted_server", "server", "talking"]

from scripted_server import answers_by

INCOMPLETE = "evidence.json: the session is interrupted: its evidence is incomplete"


class Together:
    """A behaviour that answers once so many requests are there, or after a second."""

    def __init__(self, count, text):
        self._barrier, self._answer = threading.Barrier(count), answers_by(text)
        self.met = self.most = self._now = 0
        self._lock = threading.Lock()

    def __call__(self, exchange):
        with self._lock:
            self._now += 1
            self.most = max(self.most, self._now)
        try:
            self._barrier.wait(1.0)
            self.met += 1
        except threading.BrokenBarrierError:
            self._barrier.reset()
        finally:
            with self._lock:
                self._now -= 1
        self._answer(exchange)


def test_episodes_at_once_are_replayed_one_after_the_other(talking, server, cut_off):
    server._otherwise = together = Together(3, speed)
    recorded = run(talking, "record", "--dura-llm-concurrency=3", "--dura-evidence=one", runs=6)
    recorded.assert_outcomes(passed=2)
    assert "dura: at most 3 requests to language models at once" in recorded.outlines
    assert together.most == 3 <= together.met
    asked = prompts(server)
    assert len(asked) == len(set(asked))
    cut_off()
    for number, more in enumerate(([], ["--dura-llm-concurrency=4"])):
        replayed = run(talking, "replay", f"--dura-evidence=again-{number}", *more, runs=6)
        replayed.assert_outcomes(passed=2)
        assert digests(talking, f"again-{number}") == digests(talking, "one")
    for name in ("one", "again-1"):
        assert verify_bundle(talking.path / name).problems == []
    record = talking.evidence("one")
    assert [episode.id for episode in record.episodes] == [
        episode.id for episode in talking.evidence("again-0").episodes
    ]
    assert (record.execution.executor, record.execution.llm_concurrency) == ("in-process", 3)
    (model,) = record.models
    assert (model.asked, model.missed) == (len(asked), 0)
    again = talking.evidence("again-1").cases
    assert [case.repeat.result for case in again] == ["equal"] * 2


def test_requests_beside_a_decision_are_made_at_once_and_read_as_ever(
    project, scripted_server, named, monkeypatch
):
    together = Together(2, answers)
    brief(project)
    named(scripted_server(otherwise=together))
    options = ["--dura-no-twins"]
    recorded = project.scenarios(
        *options, "--dura-llm=record", "--dura-llm-concurrency=4", select="brief/*"
    )
    assert together.most > 1
    monkeypatch.setenv("DURA_LLM_BASE_URL", "http://127.0.0.1:9/v1")
    replayed = project.scenarios(
        *options, "--dura-llm=replay", "--dura-evidence=two", select="brief/*"
    )
    assert replayed.parseoutcomes() == recorded.parseoutcomes()
    (one,), (two,) = (project.evidence(name).episodes for name in ("dura-evidence", "two"))
    assert one.digest == two.digest
    assert one.metrics.tallies == two.metrics.tallies
    assert one.metrics.tallies["unstable"].of > 0


@pytest.mark.parametrize("more", [(), ("-n", "2"), ("--dura-llm-concurrency=4",)])
def test_a_limit_ends_the_session_as_interrupted_and_it_is_resumed(talking, server, more):
    limit = "--dura-llm-limit=requests=20"
    result = run(talking, "live", limit, *more, runs=6)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    said = "the limit of 20 requests is reached (--dura-llm-limit); --dura-resume goes on"
    assert said in result.stdout.str()
    assert len(prompts(server)) == 20
    record = talking.evidence()
    assert (record.status, record.gate.result) == ("interrupted", "incomplete")
    assert "supported" not in talking.verdicts().values()
    missing = [episode for episode in record.episodes if episode.validity == "missing"]
    assert missing
    reached = "the limit of 20 requests is reached (--dura-llm-limit)"
    assert all(episode.failure.endswith(reached) for episode in missing)
    assert verify_bundle(talking.path / "dura-evidence").problems == [INCOMPLETE]
    valid = {episode.id for episode in record.episodes if episode.validity == "valid"}
    resumed = run(talking, "live", "--dura-resume", *more, runs=6)
    resumed.assert_outcomes(passed=2)
    record = talking.evidence()
    assert (record.status, record.gate.result) == ("complete", "passed")
    assert len(digests(talking)) == 12
    assert record.reuse.taken_over >= len(valid)
    assert sessions.in_use() is None


def test_a_limit_that_is_not_reached_changes_nothing(talking, server):
    run(talking, "live", "--dura-llm-limit=requests=9999,tokens=1e9", runs=1).assert_outcomes(
        passed=2
    )
    assert talking.evidence().status == "complete"


def test_progress_says_how_many_requests_are_made(talking, monkeypatch):
    monkeypatch.setattr(progress_display, "LINES_INTERVAL", 0.005)
    ini = talking.path / "pytest.ini"
    ini.write_text(ini.read_text() + "\ndura_progress_interval = 0.004\n")
    result = run(talking, "live", "--dura-llm-concurrency=2", runs=6)
    result.stdout.re_match_lines(
        [r"dura: corridor/it GAP-1: \d of 6 runs, .*\d runs/s, [\d.]+ requests/s, \d+ s left"]
    )


@pytest.mark.parametrize(
    "given, words",
    [
        ("--dura-llm-limit=5", "*--dura-llm-limit limits what a session asks*"),
        ("--dura-llm-limit=price=5", "*the limit of a price needs the price of a token*"),
        ("--dura-llm-price=cheap", "*--dura-llm-price states the price of a million tokens*"),
        ("--dura-llm-concurrency=0", "*takes a whole number*"),
    ],
)
def test_what_cannot_be_read_is_one_usage_error(talking, server, given, words):
    result = talking.scenarios(GENERATOR, given)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([words])
    assert server.requests == []


@pytest.mark.skipif(os.name == "nt", reason="no signals")
def test_ctrl_c_waits_for_no_answer_and_what_was_done_is_taken_over(talking, server):
    first = threading.Event()
    answer = answers_by(speed)

    def slow(exchange):
        if "gap" in exchange.request.prompt and len(prompts(server)) > 20:
            first.set()
            exchange.sleep(20.0)
        answer(exchange)

    server._otherwise = slow
    command = [
        *(sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"),
        *("--dura-select=corridor/it*", GENERATOR, "--dura-runs=6", "--dura-llm=record"),
        "--dura-llm-concurrency=3",
    ]
    with subprocess.Popen(
        command, cwd=talking.path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            assert first.wait(60.0)
            begun = time.monotonic()
            process.send_signal(signal.SIGINT)
            text, _ = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert time.monotonic() - begun < 15.0
    assert process.returncode == pytest.ExitCode.INTERRUPTED, text
    record = talking.evidence()
    assert (record.status, record.gate.result) == ("interrupted", "incomplete")
    assert verify_bundle(talking.path / "dura-evidence").problems == [INCOMPLETE]
    server._otherwise = answer
    resumed = run(talking, "record", "--dura-resume", "--dura-llm-concurrency=3", runs=6)
    resumed.assert_outcomes(passed=2)
    assert talking.evidence().reuse.taken_over > 0
    assert len(prompts(server)) - len(set(prompts(server))) <= 3
