"""Sessions that make many requests at once, and sessions that a limit ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time

import pytest
from test_llm_modes import GENERATOR, cut_off, digests, prompts, run, server, speed, talking
from test_llm_planner_sessions import answers, brief, named, scripted_server

from pytest_dura.evidence import SessionRecord, read_trace, verify_bundle
from pytest_dura.evidence.verify import conclusion_problems
from pytest_dura.llm import session as sessions
from pytest_dura.llm.record import models_of
from pytest_dura.plugin.session import progress

__all__ = ["cut_off", "named", "scripted_server", "server", "talking"]

from scripted_server import answers_by, completion

INCOMPLETE = "evidence.json: the session is interrupted: its evidence is incomplete"


def run_brief(project, *arguments):
    options = ["-v", "--dura-no-twins", "--dura-evidence-level=all", *arguments]
    return project.scenarios(*options, select="brief/*")


class Together:
    """A behaviour that answers requests with a word once so many are there at once, and all others.

    Those that find no company are answered after two seconds.
    """

    def __init__(self, count, text, word):
        self._barrier, self._answer = threading.Barrier(count), answers_by(text)
        self._word = word
        self.met = self.most = self._now = 0
        self._lock = threading.Lock()

    def __call__(self, exchange):
        with self._lock:
            self._now += 1
            self.most = max(self.most, self._now)
        try:
            if self._word in exchange.request.prompt and not self.met:
                self._barrier.wait(2.0)
                with self._lock:
                    self.met += 1
        except threading.BrokenBarrierError:
            self._barrier.reset()
        finally:
            with self._lock:
                self._now -= 1
        self._answer(exchange)


def test_episodes_at_once_are_replayed_one_after_the_other(talking, server, cut_off):
    server._otherwise = together = Together(3, speed, "gap")
    recorded = run(talking, "record", "--dura-llm-concurrency=3", "--dura-evidence=one", runs=6)
    recorded.assert_outcomes(passed=2)
    assert "dura: at most 3 requests to language models at once" in recorded.outlines
    assert together.most == together.met == 3
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
    assert record.execution.executor == "in-process"
    assert record.execution.at_once == {"requests to language models": 3}
    (model,) = models_of(record)
    assert (model.asked, model.missed) == (len(asked), 0)
    again = talking.evidence("again-1").cases
    assert [case.repeat.result for case in again] == ["equal"] * 2


def test_requests_beside_a_decision_are_made_at_once_and_read_as_ever(
    project, scripted_server, named, monkeypatch
):
    together = Together(2, answers, "EGO")
    brief(project)
    named(scripted_server(otherwise=together))
    options = ["-v", "--dura-no-twins"]
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


@pytest.mark.parametrize("more", [("-n", "2"), ("--dura-llm-concurrency=4",)])
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
    assert record.resume.taken_over >= len(valid)
    assert sessions.in_use() is None


def test_a_limit_that_is_not_reached_changes_nothing(talking, server):
    run(talking, "live", "--dura-llm-limit=requests=9999,tokens=1e9", runs=1).assert_outcomes(
        passed=2
    )
    assert talking.evidence().status == "complete"


def tokens(entry):
    return entry.prompt, entry.completion, entry.uncounted


def test_tokens_of_decisions_cases_and_session_are_the_same_in_a_replay(
    project, scripted_server, named, monkeypatch
):
    asked = []

    def counts_tokens(exchange):
        usage = {"prompt_tokens": 1000, "completion_tokens": 50}
        if "EGO" in exchange.request.prompt:
            asked.append(1)
            usage = {} if len(asked) == 1 else usage
        body = completion(answers(exchange.request))
        exchange.send({**body, "usage": usage})

    brief(project)
    named(scripted_server(otherwise=counts_tokens))
    recorded = run_brief(project, "--dura-llm=record")
    monkeypatch.setenv("DURA_LLM_BASE_URL", "http://127.0.0.1:9/v1")
    replayed = run_brief(project, "--dura-llm=replay", "--dura-evidence=two")
    count = models_of(project.evidence())[0].asked
    spent = (1000 * (count - 1), 50 * (count - 1), 1)
    for folder, result, how in (
        ("dura-evidence", recorded, f"{count} requests to the server"),
        ("two", replayed, f"{count} answers from the cassette"),
    ):
        record = project.evidence(folder)
        (model,), (episode,) = models_of(record), record.episodes
        (row,) = record.conclusions["tokens"].rows
        by_server = folder != "two"
        assert tokens(model.asked_tokens) == (spent if by_server else (0, 0, 0))
        assert tokens(model.reused_tokens) == ((0, 0, 0) if by_server else spent)
        usage = episode.metrics.answer_usage
        assert (usage["prompt"], usage["completion"], usage["uncounted"]) == spent
        decisions = len(episode.metrics.answer_seconds)
        assert row[2:7] == (1, decisions, count, *spent[:2])
        words = f"{how}: {spent[0]} + {spent[1]} tokens (prompts + answers)"
        shown = " ".join(result.stdout.str().split())
        assert f"{words}; the server counted none for 1 answer" in shown
        per_decision = f"{(spent[0] + spent[1]) / decisions:.0f}"
        row = f"{decisions} {count} {spent[0]} {spent[1]} {per_decision} 1"
        assert f"brief/crossing LlmPlanner 1 {row}" in shown
        summary = (project.path / folder / "summary.md").read_text()
        assert f"{spent[0]} | {spent[1]} | {per_decision} | 1 |" in summary
        assert verify_bundle(project.path / folder).problems == []
    one, two = (project.evidence(name).episodes[0] for name in ("dura-evidence", "two"))
    assert one.digest == two.digest
    trace = next((project.path / "two").glob("episodes/*.mcap"))
    accounts = read_trace(trace).recording.accounts
    fresh = [each["usage"] for each in accounts if each.get("decided")]
    assert sum(each["requests"] for each in fresh) == count
    assert sum(each["prompt"] for each in fresh) == spent[0]


def test_a_record_whose_case_does_not_add_up_its_tokens_is_found(project, scripted_server, named):
    brief(project)
    named(scripted_server(otherwise=answers_by(answers)))
    run_brief(project, "--dura-llm=record")
    bundle = project.path / "dura-evidence"
    record = project.evidence().to_json()
    record["conclusions"]["tokens"]["rows"][0][5] += 1
    problems = conclusion_problems(SessionRecord.of(record, bundle))
    assert any("conclusions/tokens/rows/0/5" in each for each in problems)


AT_MOST = re.compile(
    r"language model: at most (\d+) requests? in (\d+) episodes?, pairs and twins included, "
    r"if each episode lasts its whole time"
)


def test_a_list_counts_the_requests_of_a_session_and_makes_none(project, scripted_server, named):
    brief(project)
    server = scripted_server(otherwise=answers_by(answers))
    named(server)
    listing = ["--dura-list", "--dura-select=brief/*", "--dura-runs=2", "--dura-llm=record"]
    lines = project.run(*listing).outlines
    assert server.requests == []
    (at,) = [number for number, line in enumerate(lines) if AT_MOST.fullmatch(line)]
    assert lines[at + 1].strip() == "what the cassette has by now is not asked again"
    project.scenarios("--dura-llm=record", "--dura-runs=2", select="brief/*")
    (model,) = models_of(project.evidence())
    assert AT_MOST.fullmatch(lines[at]).groups() == (str(model.asked), "2")


def test_a_list_says_what_it_cannot_count(talking, server):
    result = talking.run("--dura-list", GENERATOR, "--dura-runs=3")
    assert result.ret == 0
    assert not any(AT_MOST.match(line) for line in result.outlines)
    line = "6 episodes ask a language model; how often is not known"
    assert (
        line
        in talking.run(
            "--dura-list", "--dura-select=corridor/it*", GENERATOR, "--dura-runs=3"
        ).outlines
    )
    assert server.requests == []


def test_progress_says_how_many_requests_are_made(talking, monkeypatch):
    monkeypatch.setattr(progress, "REFRESH", 0.005)
    ini = talking.path / "pytest.ini"
    ini.write_text(ini.read_text() + "\ndura_progress_interval = 0.004\n")
    result = run(talking, "live", "--dura-llm-concurrency=2", runs=20)
    result.stdout.re_match_lines(
        [r"dura: corridor/it(-too)? GAP-1: \d+ of 20 runs, .*, [\d.]+ requests/s, .*left"]
    )


@pytest.mark.parametrize(
    "given, words",
    [
        ("--dura-llm-limit=5", "*--dura-llm-limit limits what a session asks*"),
        ("--dura-llm-limit=price=5", "*--dura-llm-limit limits what a session asks*"),
        ("--dura-llm-price=2/10", "*unrecognized arguments: --dura-llm-price*"),
        ("--dura-llm-concurrency=0", "*takes a whole number*"),
    ],
)
def test_what_cannot_be_read_is_one_usage_error(talking, server, given, words):
    result = talking.scenarios(GENERATOR, given)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([words])
    assert server.requests == []


@pytest.mark.skipif(os.name == "nt", reason="no signals")
@pytest.mark.usefixtures("hears_keys")
def test_ctrl_c_waits_for_no_answer_and_what_was_done_is_taken_over(talking, server):
    first = threading.Event()
    answer = answers_by(speed)

    def slow(exchange):
        if "gap" in exchange.request.prompt and len(prompts(server)) > 45:
            first.set()
            exchange.sleep(60.0)
        answer(exchange)

    server._otherwise = slow
    command = [
        *(sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"),
        *("--dura-select=corridor/it*", GENERATOR, "--dura-runs=12", "--dura-llm=record"),
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
    assert time.monotonic() - begun < 40.0
    assert process.returncode == pytest.ExitCode.INTERRUPTED, text
    record = talking.evidence()
    assert (record.status, record.gate.result) == ("interrupted", "incomplete")
    assert verify_bundle(talking.path / "dura-evidence").problems == [INCOMPLETE]
    (model,) = models_of(record)  # also of the item that was interrupted
    assert model.asked == len(prompts(server)) > 45
    server._otherwise = answer
    resumed = run(talking, "record", "--dura-resume", "--dura-llm-concurrency=3", runs=12)
    resumed.assert_outcomes(passed=2)
    assert talking.evidence().resume.taken_over > 0
    assert len(prompts(server)) - len(set(prompts(server))) <= 6
