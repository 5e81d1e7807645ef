"""Small defects in the package, one at a time, and whether the tests notice.

Run: python benchmarks/mutants.py [--ids R,C01] [--list]

``mutants.yaml`` holds each defect: the file, a text that stands there once, what replaces it, what
then is wrong, and the test that shall notice. Only laws (``tests/properties``), sessions
(``tests/plugin``, ``tests/examples``) and conformance count as tests here: a law outlives a new
structure, and a unit test of a private module does not. Each defect is put into a copy of the tree,
in which its test must then fail; in the tree as it is, all of them must pass.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml
from machine import table

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_name("mutants.yaml")
FOLDERS = ("tests/properties/", "tests/plugin/", "tests/examples/")
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "*.pyc", ".*_cache", "dura-evidence*")
SECONDS = 600.0
"""For all tests together."""
SECONDS_WITH_DEFECT = 240.0
"""For the test of one defect: a session that hangs has noticed it, too."""
HUNG = "no end"
FAILED = 1
"""pytest's exit code where tests failed; any other is no verdict on the defect."""


def failures(tree: Path, tests: Sequence[str], seconds: float = SECONDS) -> list[str]:
    """Return what fails first of these tests in a tree; nothing if all of them pass.

    Raises:
        RuntimeError: If they could not be run.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    with subprocess.Popen(
        command,
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # with the workers that it waits for
            return [f"{HUNG} within {seconds:g} s"]
    if process.returncode not in (0, FAILED):
        raise RuntimeError(f"pytest ended with {process.returncode}: {output[-2000:]}")
    if process.returncode != FAILED:
        return []
    return [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))] or [
        output[-2000:]
    ]


def outcome(tree: Path, defect: Mapping[str, str], *, run: bool) -> str:
    """What comes of one defect: ``killed``, ``survived``, or ``gone`` where its text is.

    ``hung`` is a test that did not end, which a user notices, but which a slow machine causes, too.
    Without ``run`` a text that stands where it should is ``there``.
    """
    file = tree / "pytest_dura" / defect["file"]
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    if text.count(defect["old"]) != 1:
        return "gone"
    if not run:
        return "there"
    file.write_text(text.replace(defect["old"], defect["new"]), encoding="utf-8")
    try:
        noticed = failures(tree, [defect["test"]], SECONDS_WITH_DEFECT)
        if noticed and noticed[0].startswith(HUNG):
            return "hung"
        return "killed" if noticed else "survived"
    finally:
        file.write_text(text, encoding="utf-8")


def main() -> None:
    """Try the defects, and print what came of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ids", default="", help="ids, or their first letters")
    parser.add_argument("--list", action="store_true", help="only say which texts are there")
    given = parser.parse_args()
    chosen = tuple(given.ids.split(",")) if given.ids else ("",)
    rows = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    defects = [defect for defect in rows if defect["id"].startswith(chosen)]
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=LEFT_OUT)
        tests = sorted({defect["test"] for defect in defects})
        outside = [test for test in tests if not test.startswith(FOLDERS)]
        if outside:
            sys.exit(f"neither laws nor sessions: {', '.join(outside)}")
        failing = [] if given.list else failures(tree, tests)
        if failing:
            sys.exit("\n".join(["a test fails without any defect:", *failing]))
        for defect in defects:
            result = outcome(tree, defect, run=not given.list)
            counts[result] += 1
            print(f"{result:10} {defect['id']:4} {defect['wrong']}", flush=True)
    print(table(["result", "defects"], [[name, str(count)] for name, count in counts.items()]))
    sys.exit(1 if counts["survived"] or counts["gone"] else 0)


if __name__ == "__main__":
    main()
