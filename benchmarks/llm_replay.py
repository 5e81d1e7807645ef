"""The built-in scenarios with a language model recorded once, and replayed from its cassette.

Two sessions: one asks a server and records, one replays with the server gone. Told are the digests
of their episodes, which must be equal, and the time of both. The model is a null model of random
weights on llama.cpp's server, started here: it shows the wire and the cost, and no skill.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

from machine import machine, table

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
SERVER = ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY")


def session(folder: Path, mode: str, options: list[str], environment: dict[str, str]) -> float:
    """Seconds of a session; its evidence is in the folder's directory of the mode's name."""
    command = [
        *(sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"),
        *("--dura-generator=llm", f"--dura-llm={mode}", f"--dura-evidence={mode}", *options),
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


def evidence(folder: Path, mode: str) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((folder / mode / "evidence.json").read_text())
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3, help="episodes per case")
    parser.add_argument("--select", default="*", help="glob of cases")
    parser.add_argument("--path", type=Path, help="a directory with further scenarios")
    parser.add_argument("--keep", type=Path, help="leave evidence, output and cassette here")
    given = parser.parse_args()
    sys.path.insert(0, str(SUPPORT))
    from null_model import missing, null_model_server

    if missing():
        sys.exit(f"needs the extra dev: {missing()}")

    options = [f"--dura-runs={given.runs}", f"--dura-select={given.select}"]
    if given.path is not None:
        options.append(f"--dura-path={given.path.resolve()}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if given.keep is None else given.keep
        folder.mkdir(parents=True, exist_ok=True)
        with null_model_server(Path(temporary)) as server:
            live = session(folder, "record", options, dict(server.environment))
        replay = session(folder, "replay", options, {})
        recorded, replayed = evidence(folder, "record"), evidence(folder, "replay")
        digests = [
            {one["id"]: one["digest"] for one in each["episodes"]} for each in (recorded, replayed)
        ]
        equal = sum(digests[1].get(name) == digest for name, digest in digests[0].items())
        (model,) = recorded["models"]
        size = (folder / "dura-cassette.sqlite").stat().st_size
    print(f"{machine()}\n")
    print(
        f"{len(digests[0])} episodes, {equal} with equal digests; {model['asked']} requests asked, "
        f"{model['reused']} answered from the cassette, which has {size / 1e6:.1f} MB\n"
    )
    print(table(["session", "s"], [["recorded", f"{live:.0f}"], ["replayed", f"{replay:.0f}"]]))
    print(f"\nreplayed {live / replay:.1f} times as fast")
    if equal < len(digests[0]) or digests[0].keys() != digests[1].keys():
        sys.exit("the replayed session differs")


if __name__ == "__main__":
    main()
