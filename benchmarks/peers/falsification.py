"""Simulations to the first counterexample by psy-taliro and verifai, each in its own environment.

Run: python benchmarks/peers/falsification.py [--seeds 20] [--budget 1500] [--only CC1 ...]
    [--folder DIR] [--peers psy-taliro verifai]

The environments are made by this script, by pip, below the folder. A peer that cannot be had is
skipped, and the reason is printed. The plant and the robustness are ours, so that columns differ in
what is proposed alone; a peer's points come over a pipe. Cells are as in `falsification_table.py`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import venv
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from falsification.methods import Count, OverError  # noqa: E402 - beside this folder
from falsification.systems import System  # noqa: E402
from falsification_table import GROUPS, cell  # noqa: E402
from machine import machine, table  # noqa: E402

PEERS = ("psy-taliro", "verifai")


def python_of(peer: str, folder: Path, seconds: float) -> Path | str:
    """Make the environment of a peer; return its Python, or why it cannot be had."""
    home = folder / peer
    python = home / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    if (home / "installed").exists():
        return python
    venv.create(home, with_pip=True)
    command = [str(python), "-m", "pip", "install", "--quiet", peer]
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return f"pip took longer than {seconds:g} s"
    if result.returncode:
        return (result.stderr.strip().splitlines() or ["pip failed"])[-1]
    (home / "installed").touch()
    return python


def first(
    propose: Sequence[str], system: System, formula: str, seed: int, budget: int
) -> int | None:
    """Simulations of a peer up to the first counterexample; ``None`` for none.

    Raises:
        RuntimeError: If the peer ends before the budget does.
    """
    count = Count(system.objective(formula), budget)
    arguments = [str(system.layout.size), str(seed), str(budget)]
    with subprocess.Popen(
        [*propose, *arguments],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        for line in process.stdout:
            if not line.startswith("["):
                continue  # some of its libraries print
            try:
                answer = f"{count(json.loads(line)):.17g}"
            except OverError:
                answer = ""
            process.stdin.write(f"{answer}\n")
            process.stdin.flush()
            if not answer:
                break
        _, problem = process.communicate()
    if count.found is None and count.done < budget:
        last = (problem.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"{propose[-1]} ended after {count.done} of {budget} points: {last}")
    return count.found


def main() -> None:
    """Make the environments, search and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--systems", nargs="+", choices=list(GROUPS), default=["chasing-cars"])
    arguments.add_argument("--only", nargs="+", help="requirements")
    arguments.add_argument("--peers", nargs="*", choices=PEERS, default=list(PEERS))
    arguments.add_argument("--seeds", type=int, default=20)
    arguments.add_argument("--budget", type=int, default=1500)
    arguments.add_argument("--folder", type=Path, help="of the environments; by default temporary")
    arguments.add_argument("--seconds", type=float, default=600.0, help="for each installation")
    options = arguments.parse_args()
    print(f"{machine()}\n\n{options.seeds} seeds, at most {options.budget} simulations each\n")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        proposers = {}
        for peer in options.peers:
            made = python_of(peer, folder, options.seconds)
            if isinstance(made, str):
                print(f"{peer}: skipped: {made}\n")
            else:
                proposers[peer] = [str(made), str(HERE / "propose.py"), peer]
        print(table(["", *proposers], []), flush=True)
        for group in options.systems:
            for system in GROUPS[group].values():
                for formula in system.formulas:
                    if options.only and formula not in options.only:
                        continue
                    cells = [
                        cell(
                            [
                                first(propose, system, formula, seed, options.budget)
                                for seed in range(options.seeds)
                            ],
                            options.budget,
                        )
                        for propose in proposers.values()
                    ]
                    print(f"| {' | '.join([formula, *cells])} |", flush=True)


if __name__ == "__main__":
    main()
