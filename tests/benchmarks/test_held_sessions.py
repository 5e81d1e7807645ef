"""What two runs of sessions kept, compared: each changed number, sentence and file is shown."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks/held_sessions.py"
RECORD = {
    "tool": {"code": "c0" * 32},
    "created": "2026-11-27T06:27:51+00:00",
    "timings": {"wall_seconds": 5.7},
    "verdicts": [{"violations": 2, "reason": "is no file", "spoilt": {"run": 1}}],
}
TERMINAL = "gate: failed, 2 violated\n===== 1 failed in 5.04s =====\n"


def keep(folder, root="/tmp/held-one", record=RECORD, terminal=TERMINAL):
    """What a run keeps of one session, by hand."""
    bundle = folder / "passed/evidence"
    bundle.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps({"root": root, "package": {}}))
    (bundle / "evidence.json").write_text(json.dumps(record))
    digest = hashlib.sha256((bundle / "evidence.json").read_bytes()).hexdigest()
    manifest = {"digest": "d0" * 32, "files": {"evidence.json": digest}}
    (bundle / "manifest.json").write_text(json.dumps(manifest))
    (folder / "passed/00.out").write_text(f"rootdir: {root}/passed\n{terminal}")
    return folder


@pytest.fixture
def old(tmp_path):
    return keep(tmp_path / "old")


def compared(old, new, *options):
    done = subprocess.run(
        [sys.executable, SCRIPT, "compare", old, new, *options],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    return done.returncode, done.stdout


def changed(**keys):
    return {**RECORD, "verdicts": [{**RECORD["verdicts"][0], **keys}]}


def test_what_differs_between_two_runs_of_one_commit_is_masked(tmp_path, old):
    later = {**RECORD, "created": "2026-11-28T00:00:00+00:00", "timings": {"wall_seconds": 9.1}}
    terminal = TERMINAL.replace("5.04s", "61.50s (0:01:01)")
    new = keep(tmp_path / "new", "/tmp/held-two", later, terminal)
    assert compared(old, new) == (0, "3 files, equal\n")


@pytest.mark.parametrize(
    "change, line",
    [
        ({"record": changed(violations=3)}, ":verdicts/0/violations: 2 -> 3"),
        ({"record": changed(reason="is none")}, ":verdicts/0/reason: 'is no file' -> 'is none'"),
        ({"record": changed(more=[])}, ":verdicts/0/more: '<absent>' -> []"),
        ({"record": changed(violations=2.0)}, ":verdicts/0/violations: 2 -> 2.0"),
        ({"terminal": TERMINAL.replace("2 v", "3 v")}, "+gate: failed, 3 violated"),
        ({"terminal": TERMINAL.replace("1 failed", "2 failed")}, "+= 2 failed in <seconds> ="),
    ],
)
def test_each_change_is_shown(tmp_path, old, change, line):
    code, shown = compared(old, keep(tmp_path / "new", **change))
    assert code == 1
    assert line in shown.splitlines()
    assert shown.endswith("3 files, 1 differ\n")


def test_a_file_more_or_less_is_shown(tmp_path, old):
    new = shutil.copytree(old, tmp_path / "new")
    (new / "passed/evidence/manifest.json").rename(new / "passed/evidence/list.json")
    code, shown = compared(old, new)
    assert code == 1
    assert "only in OLD" in shown
    assert "only in NEW" in shown


def test_listed_renames_are_no_differences_and_hide_no_other(tmp_path, old):
    names = tmp_path / "renames.yaml"
    names.write_text(
        "files: {'*/00.out': '*/first.out'}\n"
        "keys: {'*/*/evidence.json:verdicts/*/spoilt': first_uncounted}\n"
        "added: ['*/*/evidence.json:verdicts/*/more']\n"
        "sentences: {is no file: is not a file}\n"
    )
    verdict = {"violations": 2, "reason": "is not a file", "first_uncounted": {"run": 1}}
    new = keep(tmp_path / "new", record={**RECORD, "verdicts": [{**verdict, "more": 1}]})
    (new / "passed/00.out").rename(new / "passed/first.out")
    assert compared(old, new)[0] == 1
    assert compared(old, new, "--renames", names) == (0, "3 files, equal\n")
    other = keep(
        tmp_path / "other",
        record={**RECORD, "verdicts": [{**verdict, "first_uncounted": {"run": 2}}]},
    )
    (other / "passed/00.out").rename(other / "passed/first.out")
    code, shown = compared(old, other, "--renames", names)
    assert code == 1
    assert ":verdicts/0/first_uncounted/run: 1 -> 2" in shown
