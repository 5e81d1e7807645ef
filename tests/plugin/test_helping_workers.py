"""Workers that have no item left simulate for those that have, and nobody hears of it."""

from __future__ import annotations

from collections import Counter

import pytest
from corridors import scenario

LOGGING = """
import os, time
from pathlib import Path
from corridor import Careful

class Slow(Careful):
    def reset(self, context):
        super().reset(context)
        test = os.environ.get("PYTEST_CURRENT_TEST", "-")
        with Path(os.environ["HELP_LOG"]).open("a") as log:
            log.write(f"{context.seed} {os.getpid()} {test}\\n")

    def propose(self, view):
        time.sleep(float(os.environ.get("HELP_SLEEP", "0")))
        return super().propose(view)

"""
PAIR = """requirements:
  - {id: BASE, text: It holds., kind: safety, check: always (gap > 0), at_most: 0.3}
  - {id: PAIR, text: It helps., kind: safety, check: always (gap > 0), at_most: 0.3,
     paired: {without: recovery_planner}}
  - {id: WATCH, text: It watches., kind: safety, check: always (gap > 0), at_most: 0.3,
     paired: {without: safety_monitor}}
"""


@pytest.fixture
def logged(project, monkeypatch):
    """A session by so many workers, and what was simulated: ``(seed, process, test)``."""
    log = project.path / "log"
    monkeypatch.setenv("HELP_LOG", str(log))
    project.write("slow.py", LOGGING)
    project.write("scenarios/pair.yaml", PAIR)

    def run(*arguments, **given):
        log.unlink(missing_ok=True)
        base = {"duration": 1.0, "recovery_planner": "Brake", "generator": "slow:Slow"}
        scenario(project, **base | given)
        project.scenarios("--dura-no-twins", *arguments, select="corridor/it")
        lines = log.read_text().splitlines()
        return project.evidence(), [line.split(maxsplit=2) for line in lines]

    return run


def told(evidence):
    digests = {(one.id, one.digest) for one in evidence.episodes}
    words = [(one.requirement, one.verdict, one.run) for one in evidence.verdicts]
    return digests, sorted(words)


def test_who_has_no_item_left_helps_with_the_pairs_of_the_others(logged, monkeypatch):
    # One worker has both requirements on pairs, the other one the third item.
    asked = {"runs": 10, "requirements": ["PAIR", "WATCH", "BASE"]}
    alone, _ = logged(**asked)
    monkeypatch.setenv("HELP_SLEEP", "0.01")  # such that much is left when the other one is done
    evidence, simulated = logged("-n2", **asked)
    assert told(evidence) == told(alone)
    counts = Counter(seed for seed, _, _ in simulated)
    # The first run is repeated, and so are its twins of both kinds, which have cases of their own.
    assert sorted(counts.values()) == [3] * 9 + [3 + 3]
    seeds = {one.id: one.seed for one in evidence.episodes}
    repeated = [seeds[case.repeat.episode] for case in evidence.cases]
    assert repeated == [evidence.episodes[0].seed] * 3
    helped = [process for _, process, test in simulated if test == "-"]
    assert len(helped) > 1, "simulated while no test was running"
    assert len(set(helped)) == 1


def test_nobody_helps_where_the_session_may_stop_before_its_last_item(logged, monkeypatch):
    monkeypatch.setenv("HELP_SLEEP", "0.01")
    _, simulated = logged("-n2", "--maxfail=1", runs=10, requirements=["PAIR", "WATCH", "BASE"])
    assert [test for _, _, test in simulated if test == "-"] == []


def test_nobody_helps_in_a_session_that_was_stopped(logged, project, monkeypatch):
    monkeypatch.setenv("HELP_SLEEP", "0.01")
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.hookimpl(trylast=True)\n"
        "def pytest_runtest_teardown(item): item.session.shouldstop = 'the time is up'\n",
    )
    _, simulated = logged("-n2", runs=10, requirements=["PAIR", "WATCH", "BASE"])
    assert [test for _, _, test in simulated if test == "-"] == []


def test_nobody_helps_with_what_others_would_not_find(logged, project, monkeypatch):
    monkeypatch.setenv("HELP_SLEEP", "0.01")
    project.write(
        "conftest.py",
        "import pytest\nfrom slow import Slow\n"
        "@pytest.fixture(scope='session')\ndef generator(): return Slow()\n",
    )
    _, simulated = logged("-n2", runs=6, requirements=["PAIR", "WATCH", "BASE"])
    assert [test for _, _, test in simulated if test == "-"] == []


def test_helping_ends_where_the_requirement_is_decided(logged, monkeypatch):
    # Episodes so long that a busy machine's pauses are short beside them: who waits for an episode
    # begins later ones for as long as it waits.
    monkeypatch.setenv("HELP_SLEEP", "0.02")
    runs = "{until: decided, at_most: 40}"
    evidence, simulated = logged("-n2", runs=runs, requirements=["BASE", "PAIR"])
    verdicts = {one.requirement: one for one in evidence.verdicts}
    assert {one.verdict for one in verdicts.values()} == {"supported"}
    needed = verdicts["BASE"].run + verdicts["PAIR"].run
    assert needed < 40
    repeated = sum(case.repeat is not None for case in evidence.cases)
    assert repeated == 2, "one of the runs and one of their twins"
    assert len(simulated) - repeated <= needed + 2, "but for what a worker began while it waited"
