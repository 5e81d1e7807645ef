"""The built-in scenarios with a language model recorded once, and replayed from its cassette.

Two sessions: one asks a server and records, one replays with the server gone. Told are the digests
of their episodes, which must be equal, and the time of both. The model is a null model of random
weights on llama.cpp's server, started here: it shows the wire and the cost, and no skill.

With ``--ship`` it records the cassette of ``example_suites/llm_planner`` anew: the suite's own
tests and a built-in scenario, one run each, replayed as well before the file is put there.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter

from machine import machine, table

from pytest_dura.evidence import SessionRecord, open_record
from pytest_dura.llm.record import models_of

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
SERVER = ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY", "DURA_LLM_ABOUT")
ABOUT = "null model (random weights, knows nothing of driving)"
SCENARIOS = ("--dura-scenarios", "--dura-generator=llm")
SUITE = Path(__file__).parents[1] / "example_suites" / "llm_planner"
SHIPPED = SUITE / "null-model.sqlite"
SHIPPED_SESSIONS = {
    "suite": ("--dura-runs=1",),
    "scenario": (*SCENARIOS, "--dura-select=intersection/nominal", "--dura-runs=1"),
}
"""What the shipped cassette answers, as the suite's README has it."""
PAGE = 1024
"""Bytes of a page of the shipped file: its rows are short, and larger pages stay half empty."""


def session(folder: Path, mode: str, options: Sequence[str], environment: dict[str, str]) -> float:
    """Seconds of a session; its evidence is in the folder's directory of the mode's name."""
    command = [
        *(sys.executable, "-m", "pytest", "-p", "no:cacheprovider"),
        *(f"--dura-llm={mode}", f"--dura-evidence={mode}", *options),
    ]
    inherited = {key: value for key, value in os.environ.items() if key not in SERVER}
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
    (folder / f"{mode}.txt").write_text(done.stdout)
    if done.returncode not in {0, 1}:  # 1: a null model need not meet the requirements
        sys.exit(done.stdout + done.stderr)
    return seconds


def evidence(folder: Path, mode: str) -> SessionRecord:
    return open_record(folder / mode / "evidence.json")


def digests(folder: Path, mode: str) -> dict[str, str]:
    """The digest of each episode."""
    return {each.id: each.digest for each in evidence(folder, mode).episodes()}


def ship(folder: Path, environment: dict[str, str]) -> None:
    """Record what the example suite ships, and put it there once a replay gives equal digests."""
    suite = shutil.copytree(SUITE, folder / "suite", ignore=shutil.ignore_patterns("*.sqlite"))
    folders = {"suite": suite, "scenario": folder}
    for name, shipped in SHIPPED_SESSIONS.items():
        options = (*shipped, f"--dura-cassette={folder / SHIPPED.name}")  # one file for both
        live = session(folders[name], "record", options, environment)
        replay = session(folders[name], "replay", options, {})
        recorded = digests(folders[name], "record")
        if digests(folders[name], "replay") != recorded:
            sys.exit(f"{name}: the replayed session differs")
        print(f"{name}: {len(recorded)} episodes; recorded in {live:.0f} s, replayed {replay:.0f}")
    with closing(sqlite3.connect(folder / SHIPPED.name, isolation_level=None)) as opened:
        opened.execute(f"PRAGMA page_size = {PAGE}")
        opened.execute("VACUUM")
        (exchanges,) = opened.execute("SELECT COUNT(*) FROM exchanges").fetchone()
    shutil.copyfile(folder / SHIPPED.name, SHIPPED)
    print(f"{SHIPPED.name}: {exchanges} exchanges, {SHIPPED.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3, help="episodes per case")
    parser.add_argument("--select", default="*", help="glob of cases")
    parser.add_argument("--path", type=Path, help="a directory with further scenarios")
    parser.add_argument("--keep", type=Path, help="leave evidence, output and cassette here")
    parser.add_argument("--ship", action="store_true", help="record the example suite's cassette")
    given = parser.parse_args()
    sys.path.insert(0, str(SUPPORT))
    from null_model import missing, null_model_server

    if missing():
        sys.exit(f"needs the extra dev: {missing()}")

    options = [*SCENARIOS, f"--dura-runs={given.runs}", f"--dura-select={given.select}"]
    if given.path is not None:
        options.append(f"--dura-path={given.path.resolve()}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if given.keep is None else given.keep
        folder.mkdir(parents=True, exist_ok=True)
        with null_model_server(Path(temporary)) as server:
            environment = {**server.environment, "DURA_LLM_ABOUT": ABOUT}
            if given.ship:
                ship(folder, environment)
                return
            live = session(folder, "record", options, environment)
        replay = session(folder, "replay", options, {})
        recorded, replayed = digests(folder, "record"), digests(folder, "replay")
        equal = sum(replayed.get(name) == digest for name, digest in recorded.items())
        (model,) = models_of(evidence(folder, "record").head)
        size = (folder / "dura-cassette.sqlite").stat().st_size
    print(f"{machine()}\n")
    print(
        f"{len(recorded)} episodes, {equal} with equal digests; {model.asked} requests asked, "
        f"{model.reused} answered from the cassette, which has {size / 1e6:.1f} MB\n"
    )
    print(table(["session", "s"], [["recorded", f"{live:.0f}"], ["replayed", f"{replay:.0f}"]]))
    print(f"\nreplayed {live / replay:.1f} times as fast")
    if recorded != replayed:
        sys.exit("the replayed session differs")


if __name__ == "__main__":
    main()
