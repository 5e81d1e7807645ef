"""The small model of ``example_suites/tiny_driver``: what it computes, how it drives, how it fails.

Run: python benchmarks/tiny_driver.py logits|drives|modes|paper|ship [--runs 15] [--model FILE]

``logits`` compares llama.cpp's probabilities with those of the same weights in torch (which it
needs). ``drives`` puts the model beside its teacher, random maneuvers, and a null model of random
weights that is asked the same; ``modes`` compares the failure modes of the two models. ``paper`` is
the paper's table with the model as the Generator, attacks and recovery on and off. ``ship`` records
the suite's cassette anew. Servers of llama.cpp are started here (extra dev).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import mean
from time import perf_counter

from machine import machine, table
from paper_table import Arms, Outcome, keys_of, places, print_tables, run

from pytest_dura.core import RoleSpec
from pytest_dura.evidence import SessionRecord, open_record
from pytest_dura.llm.driving.planner import LlmPlanner
from pytest_dura.llm.session import ModelSession, using
from pytest_dura.reports.failure_modes import failure_modes_by_component

ROOT = Path(__file__).parents[1]
SUITE = ROOT / "example_suites" / "tiny_driver"
CASSETTE = SUITE / "tiny-driver.sqlite"
sys.path += [str(SUITE), str(SUITE / "train"), str(ROOT / "tests" / "support")]

import serve  # noqa: E402 - the suite's own

PARAMETERS = {
    "templates": str(SUITE / "templates"), "history": 0, "samples": 1, "beside": ()
}  # fmt: skip
"""Those of the suite's conftest, without the questions beside a decision."""
SERVER = ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY", "DURA_LLM_ABOUT")
SHIPPED = ("--dura-scenarios", "--dura-runs=1")
"""The session that the shipped cassette answers, as the suite's README has it."""
PAGE = 1024


@contextlib.contextmanager
def null_served() -> Iterator[dict[str, str]]:
    """The null model's server; gives its environment."""
    from null_model import null_model_server

    with tempfile.TemporaryDirectory() as scratch, null_model_server(Path(scratch)) as server:
        yield {**server.environment, "DURA_LLM_ABOUT": "null model (random weights)"}


def planner(environment: dict[str, str], **params: object) -> RoleSpec:
    """The role with the model of an environment."""
    model = {"model": environment["DURA_LLM_MODEL"]}
    return RoleSpec(f"{LlmPlanner.__module__}:{LlmPlanner.__name__}", PARAMETERS | model | params)


def arms_of(role: str | RoleSpec, runs: int, *, attacks_only: bool = False) -> Arms:
    """All episodes of a component, or those with attacks and recovery alone, on equal seeds."""
    scenarios, attacks = places()
    keys = keys_of(scenarios, attacks, runs)
    if attacks_only:
        keys = [key for key in keys if key[1] and key[2] == "recover"]
    outcomes = {}
    for number, key in enumerate(keys, start=1):
        outcomes |= [run((key, role, 0))]
        print(f"\r{number} of {len(keys)} episodes", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return Arms(outcomes, runs)


def row_of(outcomes: list[Outcome]) -> str:
    """Flagged, collided, cleared in %, and the mean clearance time."""
    times = [each.clearance for each in outcomes if each.clearance is not None]
    counts = [sum(each.flagged for each in outcomes), sum(each.collided for each in outcomes)]
    shares = [f"{100 * count / len(outcomes):.0f}" for count in (*counts, len(times))]
    return " / ".join([*shares, f"{mean(times):.1f}" if times else "-"])


@contextlib.contextmanager
def asked(environment: dict[str, str]) -> Iterator[ModelSession]:
    """A session with a server, in which equal requests are asked once."""
    with tempfile.TemporaryDirectory() as scratch:
        session = ModelSession("record", Path(scratch) / "asked.sqlite", environ=environment)
        with using(session):
            yield session
        session.close()


COMPONENTS = ("tiny", "teacher", "random", "null model")


def driven(component: str, model: Path, runs: int) -> Arms:
    """The episodes of a component, attacks and recovery on."""
    if component in ("teacher", "random"):
        role = "random" if component == "random" else RoleSpec("corpus:TeacherPlanner")
        return arms_of(role, runs, attacks_only=True)
    server = serve.served(model) if component == "tiny" else null_served()
    with server as environment, asked(environment):
        return arms_of(planner(environment), runs, attacks_only=True)


def drives(model: Path, runs: int, components: Sequence[str] = COMPONENTS) -> None:
    """Print the closed-loop scores."""
    scenarios, _ = places()
    arms = {name: driven(name, model, runs) for name in components}
    rows = [
        [scenario, *(row_of(each.of(scenario)) for each in arms.values())] for scenario in scenarios
    ]
    together = [
        row_of([outcome for scenario in scenarios for outcome in each.of(scenario)])
        for each in arms.values()
    ]
    print(
        f"{runs} runs a scenario, attacks and recovery on; flagged / collided / cleared in %, s\n"
    )
    print(table(["scenario", *arms], [*rows, ["all", *together]]))


def paper(model: Path, runs: int) -> None:
    """Print the paper's table with the model as the Generator."""
    scenarios, attacks = places()
    with serve.served(model) as environment, asked(environment) as session:
        begun = perf_counter()
        arms = arms_of(planner(environment), runs)
        seconds = perf_counter() - begun
        (asked_of, reused) = (
            sum(count for (_, _, how), count in session.counts.items() if how == kind)
            for kind in ("asked", "reused")
        )
    print_tables(f"the small driver, {runs} paired seeds a scenario", arms, scenarios, attacks)
    print(f"{asked_of} requests asked, {reused} asked before, {seconds:.0f} s in all")


def logits(model: Path, prompts: int = 40) -> None:
    """Compare the next token's probabilities behind prompts of a held-out seed."""
    import corpus
    import torch
    from model import read_gguf
    from tokenizer import BEGIN

    torch.set_num_threads(1)
    llama, tokenizer = read_gguf(model)
    samples = next(corpus.episodes(corpus.HELD_OUT_SEED + 1, 1))[:prompts]
    worst, same, tokens_differ = 0.0, 0, 0
    with serve.served(model) as environment:
        root = environment["DURA_LLM_BASE_URL"].removesuffix("/v1")

        def post(path: str, data: dict[str, object]) -> dict[str, object]:
            body = json.dumps(data).encode()
            request = urllib.request.Request(  # noqa: S310 - our own server
                root + path, body, {"Content-Type": "application/json"}
            )
            with urllib.request.urlopen(request) as answer:  # noqa: S310
                return json.load(answer)

        for number, sample in enumerate(samples):
            # Behind more and more of the answer: not only its first token.
            begun = sample.answer[: number * 7 % len(sample.answer)]
            text = f"{sample.system}\n{sample.user}\n{begun}"
            ids = [BEGIN, *tokenizer.encode(text)]
            theirs = post("/tokenize", {"content": text, "add_special": True})["tokens"]
            tokens_differ += theirs != ids
            settings = {"n_predict": 1, "n_probs": 10, "temperature": 0.0, "cache_prompt": False}
            answer = post("/completion", {"prompt": text, **settings})
            top = answer["completion_probabilities"][0]["top_logprobs"]
            with torch.no_grad():
                own = llama(torch.tensor([ids]))[0, -1].log_softmax(-1)
            same += int(own.argmax()) == top[0]["id"]
            likely = [each for each in top if each["logprob"] > -10.0]
            gaps = [abs(float(own[each["id"]]) - each["logprob"]) for each in likely]
            worst = max(worst, *gaps)
    print(
        f"{len(samples)} prompts: {tokens_differ} with other tokens, {same} with the same "
        f"likeliest next token; log probabilities of likely tokens differ by {worst:.4f} at most"
    )


def session_of(folder: Path, mode: str, options: tuple[str, ...], environment: dict) -> float:
    """Seconds of a session in a copy of the suite; its evidence is in ``folder/mode``."""
    inherited = {key: value for key, value in os.environ.items() if key not in SERVER}
    inherited["PYTHONPATH"] = str(ROOT)
    command = [
        *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"),
        *(f"--dura-llm={mode}", f"--dura-evidence={mode}", "--dura-evidence-level=summary"),
        *options,
    ]
    begun = perf_counter()
    done = subprocess.run(
        command,
        cwd=folder,
        env=inherited | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = perf_counter() - begun
    if done.returncode not in {0, 1}:  # 1: a small model need not meet the requirements
        sys.exit(done.stdout + done.stderr)
    return seconds


def evidence(folder: Path, mode: str) -> SessionRecord:
    return open_record(folder / mode / "evidence.json")


def suite_copy(folder: Path) -> Path:
    return Path(
        shutil.copytree(SUITE, folder / "suite", ignore=shutil.ignore_patterns("*.sqlite", "work"))
    )


def modes(model: Path, runs: int) -> None:
    """Print the failure modes of the model and of the null model, by the suite's own session."""
    figures: dict[str, dict[str, str]] = {}
    servers = {"tiny": lambda: serve.served(model), "null model": null_served}
    for name, server in servers.items():
        with tempfile.TemporaryDirectory() as scratch, server() as environment:
            folder = suite_copy(Path(scratch))
            options = ("--dura-scenarios", f"--dura-runs={runs}", "--dura-no-twins")
            session_of(folder, "live", options, environment)
            (measured,) = failure_modes_by_component(evidence(folder, "live").head.cases).values()
        for mode in measured:
            share = "-" if mode.share is None else f"{100 * mode.share:.1f}"
            figures.setdefault(mode.name, {})[name] = f"{share} ({mode.hits}/{mode.of})"
    rows = [[mode, *(cells.get(name, "-") for name in servers)] for mode, cells in figures.items()]
    print(f"Failure modes in % of the decisions that could show them, {runs} runs a scenario\n")
    print(table(["failure mode", *servers], rows))


def ship(model: Path) -> None:
    """Record the suite's cassette, and put it there once a replay gives equal digests."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = suite_copy(Path(scratch))
        cassette = Path(scratch) / CASSETTE.name
        options = (*SHIPPED, f"--dura-cassette={cassette}")
        with serve.served(model) as environment:
            live = session_of(folder, "record", options, environment)
        replay = session_of(folder, "replay", options, {})
        recorded, replayed = (
            {each.id: each.digest for each in evidence(folder, mode).episodes()}
            for mode in ("record", "replay")
        )
        if recorded != replayed:
            sys.exit("the replayed session differs")
        with contextlib.closing(sqlite3.connect(cassette, isolation_level=None)) as opened:
            opened.execute(f"PRAGMA page_size = {PAGE}")
            opened.execute("VACUUM")
            (exchanges,) = opened.execute("SELECT COUNT(*) FROM exchanges").fetchone()
        shutil.copyfile(cassette, CASSETTE)
    size = CASSETTE.stat().st_size / 1e6
    print(
        f"{len(recorded)} episodes, {exchanges} exchanges, {size:.1f} MB; "
        f"recorded in {live:.0f} s, replayed in {replay:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("logits", "drives", "modes", "paper", "ship"))
    parser.add_argument("--runs", type=int, default=15, help="of each scenario")
    parser.add_argument(
        "--component", action="append", choices=COMPONENTS, help="of drives; default: all"
    )
    parser.add_argument("--model", type=Path, default=serve.MODEL, help="a GGUF file")
    given = parser.parse_args()
    print(f"{machine()}\n")
    model = given.model.resolve()
    if given.what == "logits":
        logits(model)
    elif given.what == "ship":
        ship(model)
    elif given.what == "drives":
        drives(model, given.runs, given.component or COMPONENTS)
    else:
        {"modes": modes, "paper": paper}[given.what](model, given.runs)


if __name__ == "__main__":
    main()
