"""Whether two checkouts come to the same: digests of episodes, verdicts, and each file of bundles.

Run: python benchmarks/same_results.py run TREE OUT [--only NAME]
     python benchmarks/same_results.py compare OUT OTHER
     python benchmarks/same_results.py executors [--runs 20] [--torch]

``run`` runs sessions of the built-in scenarios with the package of a checkout and keeps their
evidence in OUT: the default gate, ``aggressive``, the catalogue of faults, and 480 runs by four
planners. ``compare`` reads two such directories. ``executors`` runs the latter in pytest's own
process, in children, by two workers of pytest-xdist and by two workers of Dask, and compares
digests and verdicts; with ``--torch`` torch is imported and has used its threads before, and
warnings are errors. Masked is what differs between two runs of one
checkout: times, durations, ids of sessions, digests of code and of files that hold such. What is
masked is replaced and not left out, so that a missing line shows, but for events of a component
that was slow on the clock. Traces and the player's data hold such times as well; the digests of
their episodes stand for them.
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from machine import machine, table

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests/support"))
from dask_clusters import Cluster  # noqa: E402 - it lies there

SESSIONS = {
    "default": (),
    "aggressive": ("--dura-generator=aggressive",),
    "catalogue": ("--dura-faults=catalogue", "--dura-runs=2"),
    **{
        f"digests-{planner}": (
            f"--dura-generator={planner}",
            "--dura-runs=20",
            "--dura-seed=11",
            "--dura-faults=none",
        )
        for planner in ("rule_based", "tactical", "reactive", "aggressive")
    },
}
BUNDLES = ("default", "aggressive", "catalogue")
VOLATILE = frozenset(
    (
        *("created", "finished", "command", "environment", "tool", "session", "inputs"),
        *("timings", "processing_us", "processing_seconds", "wall_clock", "answer_seconds"),
        *("file_count", "files", "sha256", "sources", "bytes"),
    )
)
"""Keys of the record whose values differ between two runs of one checkout."""
COMPONENT = frozenset(("digest", "files", "file_count"))
MASKS = (
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?(Z|\+00:00| UTC)?"), "<time>"),
    (re.compile(r"\b[0-9a-f]{64}\b"), "<sha256>"),
    (re.compile(r"\b[0-9a-f]{20,63}\b"), "<id>"),
    (re.compile(r'(<script type="application/octet-stream">)[^<]*'), r"\1<player>"),
    (re.compile(r"\b\d+(\.\d+)?(e-\d+)? ?(ms|us|MiB|kB|MB)\b"), "<cost>"),
    (re.compile(r"urn:uuid:[0-9a-f-]{36}"), "<uuid>"),
    (re.compile(r"\b\d+ files\b"), "<files>"),
    (re.compile(r"\bdigest [0-9a-f]+"), "digest <sha256>"),
    (re.compile(r"(?i)(wall.clock|gathering evidence)(.*?)\d+\.\d+ s"), r"\1\2<cost>"),
)
WALL_CLOCK = "wall_clock:"
TORCH = """
import torch

torch.set_num_threads(2)
torch.rand(600, 600) @ torch.rand(600, 600)
"""
SLOW = ("performance_fail", "response_time")
SHOWN = 20


def run(tree: Path, out: Path, only: str | None) -> None:
    """Run the sessions."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "pytest.ini").write_text("[pytest]\n")
    for name, options in SESSIONS.items():
        if only in (None, name):
            command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
            done = subprocess.run(
                [*command, "--dura-scenarios", f"--dura-evidence={name}", *options],
                check=False,
                cwd=out,
                env={**os.environ, "PYTHONPATH": str(tree.resolve())},
                capture_output=True,
                text=True,
            )
            (out / f"{name}.out").write_text(done.stdout + done.stderr)
            print(f"{name}: exit code {done.returncode}", flush=True)


def executors(runs: int, torch: bool) -> bool:
    """Compare digests and verdicts of sessions that differ in who simulates, and print a table."""
    rows, equal = [], True
    with tempfile.TemporaryDirectory(prefix="dura-same-") as name:
        folder = Path(name)
        strict = "filterwarnings = error\n" if torch else ""
        (folder / "pytest.ini").write_text(f"[pytest]\n{strict}")
        (folder / "conftest.py").write_text(TORCH if torch else "")
        cluster = Cluster(folder, {"PYTHONPATH": str(ROOT)})
        try:
            for _ in range(2):
                cluster.worker({"PYTHONPATH": str(ROOT)})
            modes = {
                "in-process": ("--dura-executor=in-process",),
                "children": ("--dura-executor=processes:2",),
                "pytest-xdist": ("-n", "2"),
                "Dask": (f"--dura-executor=dask://127.0.0.1:{cluster.port}",),
            }
            for planner in [each for each in SESSIONS if each.startswith("digests-")]:
                first: tuple[Any, Any] | None = None
                for mode, arguments in modes.items():
                    _run_session(folder, planner, mode, *arguments, f"--dura-runs={runs}")
                    found = _outcome(record(folder, mode))
                    first = first or found
                    equal &= found == first
                    rows.append(_row(planner, mode, found, first))
                    print(*rows[-1], file=sys.stderr, flush=True)
        finally:
            cluster.close()
    print(f"Measured on: {machine()}\n")
    headers = ["planner", "who simulates", "episodes", "digests", "verdicts"]
    print(table(headers, rows))
    return equal


def _run_session(folder: Path, planner: str, mode: str, *arguments: str) -> None:
    options = [each for each in SESSIONS[planner] if not each.startswith("--dura-runs")]
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"]
    done = subprocess.run(
        [*command, f"--dura-evidence={mode}", *options, *arguments], check=False, cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode > 1:
        raise SystemExit(done.stdout + done.stderr)


def _outcome(data: Any) -> tuple[Any, Any]:
    digests = sorted((each["id"], each["digest"]) for each in data["episodes"])
    return digests, [
        [row[key] for key in ("requirement", "case", "verdict", "violations", "run")]
        for row in data["verdicts"]
    ]


def _row(planner: str, mode: str, found: tuple[Any, Any], first: tuple[Any, Any]) -> list[str]:
    cells = []
    for own, other in zip(found, first, strict=True):
        shared = sum((Counter(map(str, own)) & Counter(map(str, other))).values())
        cells.append(f"{shared} of {max(len(own), len(other))} equal")
    return [planner.partition("-")[2], mode, str(len(found[0])), *cells]


def record(out: Path, name: str) -> Any:
    """The record of one session."""
    return json.loads((out / name / "evidence.json").read_text())


def masked(value: Any) -> Any:
    """A record without what differs between two runs of one checkout."""
    if isinstance(value, dict):
        volatile = VOLATILE | (COMPONENT if "distribution" in value else frozenset())
        return {
            key: "<masked>" if key in volatile else masked(part)
            for key, part in value.items()
            if not key.startswith(WALL_CLOCK)
        }
    if isinstance(value, list):
        return [masked(part) for part in value if not _is_slow_event(part)]
    return masked_text(value) if isinstance(value, str) else value


def _is_slow_event(value: Any) -> bool:
    """Whether it says that the component was slow on this machine, at this moment."""
    return isinstance(value, dict) and (value.get("kind"), value.get("subject")) == SLOW


def masked_text(text: str) -> str:
    """A text without times, digests and costs."""
    for pattern, mask in MASKS:
        text = pattern.sub(mask, text)
    return text


def lines_of(path: Path) -> list[str]:
    """A file of a bundle as comparable lines."""
    if path.suffix == ".mcap":
        return ["<trace>"]
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return json.dumps(masked(json.loads(text)), indent=1).splitlines()
    return masked_text(text).splitlines()


def compare(own: Path, other: Path) -> bool:
    """Print what differs, and return whether nothing does."""
    equal = True
    total = 0
    for name in SESSIONS:
        records = [record(out, name) for out in (own, other)]
        digests = [
            {episode["id"]: episode["digest"] for episode in data["episodes"]} for data in records
        ]
        verdicts = [
            {
                (row["requirement"], row["case"]): (row["verdict"], row["violations"], row["run"])
                for row in data["verdicts"]
            }
            for data in records
        ]
        same = digests[0] == digests[1]
        print(
            f"{name}: {len(digests[0])} episodes, digests {'equal' if same else 'DIFFER'}; "
            f"{len(verdicts[0])} verdicts {'equal' if verdicts[0] == verdicts[1] else 'DIFFER'}"
        )
        total += len(digests[0])
        equal &= same and verdicts[0] == verdicts[1]
    print(f"{total} episodes in all")
    for name in BUNDLES:
        files = [
            {
                str(path.relative_to(out / name))
                for path in (out / name).rglob("*")
                if path.is_file()
            }
            for out in (own, other)
        ]
        if files[0] != files[1]:
            print(f"{name}: other files: {sorted(files[0] ^ files[1])}")
            equal = False
        for file in sorted(files[0] & files[1]):
            equal &= _is_same_file(name, file, own, other)
    return equal


def _is_same_file(name: str, file: str, own: Path, other: Path) -> bool:
    left, right = lines_of(own / name / file), lines_of(other / name / file)
    changes = [
        line
        for line in difflib.unified_diff(left, right, lineterm="", n=0)
        if not line.startswith(("---", "+++", "@@"))
    ]
    if changes:
        print(f"{name}/{file}: {len(changes)} lines differ")
        for line in changes[:SHOWN]:
            print("   ", line[:240])
    elif not file.startswith("episodes/"):
        print(f"{name}/{file}: {len(left)} lines, equal")
    return not changes


def main() -> None:
    """Run or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(required=True, dest="action")
    running = actions.add_parser("run")
    running.add_argument("tree", type=Path)
    running.add_argument("out", type=Path)
    running.add_argument("--only")
    comparing = actions.add_parser("compare")
    comparing.add_argument("own", type=Path)
    comparing.add_argument("other", type=Path)
    running = actions.add_parser("executors")
    running.add_argument("--runs", type=int, default=20)
    running.add_argument("--torch", action="store_true")
    given = parser.parse_args()
    if given.action == "executors":
        sys.exit(0 if executors(given.runs, given.torch) else 1)
    if given.action == "run":
        run(given.tree, given.out, given.only)
        return
    sys.exit(0 if compare(given.own, given.other) else 1)


if __name__ == "__main__":
    main()
