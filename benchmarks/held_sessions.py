"""What a user sees of twelve sessions: kept in a directory, and compared with another one.

Run: python benchmarks/held_sessions.py run DIR [--only NAME]
     python benchmarks/held_sessions.py compare OLD NEW [--only NAME] [--renames FILE]

``run`` runs the sessions with this interpreter's package, each in a copy of ``held_sessions``, and
keeps all that they print and leave. ``compare`` prints what differs, and ends with 1 if anything
does. Masked is what differs between two runs of one commit: times of the clock and durations, ids
that are drawn, the temporary directory, hashes of kept files and of the package's own files.

The file of renames applies to the old side, but for ``added``; ``*`` is a segment of a path::

    files: {"*/*/needs.json": null}            # a file that is gone, or its new path
    keys: {"*/*/evidence.json:verdicts/*/spoilt": first_uncounted}     # a key, or null
    added: ["*/*/evidence.json:episodes/*/verdicts"]                   # keys or files
    sentences: {"no file": "not a file"}       # in each text, also in values of JSON
"""

from __future__ import annotations

import argparse
import base64
import difflib
import hashlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.reader import make_reader

import pytest_dura

PROJECT = Path(__file__).with_name("held_sessions")
EXAMPLE = Path(__file__).parents[1] / "example_suites/llm_planner"

FREE = "corridor/free corridor/biased corridor/rated test_passed.py"
WORSE = (
    "--dura-generator=corridor:Reckless"
    " --dura-baseline=../passed/corridor --dura-baseline-worse=fail"
)
CROSSING = "--dura-scenarios --dura-select=held/* --dura-evidence-level=all --dura-time-budget=60"
UNDECIDED = (
    "corridor/broken corridor/deaf corridor/vacuous corridor/still corridor/shaky corridor/stairs"
)
KILLED = "corridor/free corridor/mortal --dura-executor=in-process"
REPLAYED = "--dura-llm=replay --dura-cassette=null-model.sqlite"
HOSTILE = "corridor/hostile corridor/hostile-dies corridor/hostile-endless"
SHARED = "corridor/free corridor/biased corridor/harm corridor/rated test_passed.py"
SESSIONS = {
    "passed": (
        f"run corridor {FREE}",
        f"run crossing {CROSSING}",
        "run stumbles corridor/stumbles -vv",
        f"list {FREE}",
    ),
    "violated": (
        f"run corridor {FREE} --dura-generator=corridor:Reckless",
        f"run crossing {CROSSING} --dura-generator=aggressive",
        f"run worse {FREE} {WORSE}",
        f"run better {FREE} --dura-baseline=corridor/evidence.json",
        "dura compare ../passed/corridor corridor --json worse.json",
        "dura compare corridor ../passed/corridor --all --json better.json",
        "dura compare ../passed/crossing crossing --all",
    ),
    "undecided": (
        f"run fail {UNDECIDED} test_undecided.py --dura-executor=in-process",
        "run warn test_undecided.py corridor/vacuous --dura-undecided=warn",
        f"list {UNDECIDED}",
    ),
    "invalid": ("run evidence corridor/idle corridor/idle-wall", "list corridor/idle"),
    "waived": ("run evidence test_waived.py --reruns=1 -v -rA",),
    "retried": (
        "run evidence test_retried.py --reruns=2",
        "run repeated test_retried.py --count=2",
    ),
    "search": (
        "run evidence test_search.py --dura-generator=corridor:Hasty",
        "run again --dura-scenarios --dura-select=found/* --dura-generator=corridor:Hasty",
    ),
    "pairs": ("run evidence test_pairs.py", "list test_pairs.py"),
    "model": (
        f"run evidence test_llm_planner.py {REPLAYED} --dura-runs=1",
        f"list test_llm_planner.py {REPLAYED}",
    ),
    "shard": (
        f"run first {SHARED} --dura-shard=1/2",
        f"run second {SHARED} --dura-shard=2/2",
        "dura merge --output whole first second",
        "dura verify whole",
        f"run unsharded {SHARED}",
        "dura compare unsharded whole",
    ),
    "killed": (
        "touch kill",
        f"run evidence {KILLED}",
        "cp -r evidence partial",
        f"run evidence {KILLED} --dura-resume",
        f"run uninterrupted {KILLED}",
    ),
    "hostile": (
        f"run evidence {HOSTILE} test_hostile.py -ra",
        "list corridor/hostile test_hostile.py",
    ),
}
"""Steps of each. ``run NAME`` is a pytest session with its evidence in NAME, which is verified."""
NEEDS = {"violated": "passed"}
KEPT = ["PATH", "PYTHONPATH", "HOME", "TMPDIR", "LANG", "LC_ALL", "VIRTUAL_ENV", "LD_LIBRARY_PATH"]
"""What a session is given of the environment; ``PYTHONPATH`` may name another checkout."""


def run(out: Path, only: str | None) -> None:
    """Run the sessions below one temporary directory, and keep what they leave in OUT."""
    root = Path(tempfile.mkdtemp(prefix="held-"))
    names = list(SESSIONS) if only is None else [*filter(None, (NEEDS.get(only),)), only]
    for name in names:
        began = time.monotonic()
        codes = run_session(name, root / name)
        shutil.rmtree(out / name, ignore_errors=True)
        left_out = shutil.ignore_patterns("__pycache__", "*.sqlite*", ".episodes", ".hypothesis")
        shutil.copytree(root / name, out / name, ignore=left_out)
        print(f"{name}: {time.monotonic() - began:.1f} s, exit codes {codes}", flush=True)
    package = Path(pytest_dura.__file__).parent
    hashes = {sha256(file): str(file.relative_to(package.parent)) for file in files_in(package)}
    (out / "run.json").write_text(json.dumps({"root": str(root), "package": hashes}, indent=1))
    shutil.rmtree(root)


def run_session(name: str, folder: Path) -> list[int]:
    """Take the steps of a session in a copy of the project; each prints into a file of its own."""
    shutil.copytree(EXAMPLE if name == "model" else PROJECT, folder)
    if name == "model":
        shutil.copy(PROJECT / "pytest.ini", folder)
    codes = []
    for number, command in enumerate(commands(name)):
        env = {key: value for key, value in os.environ.items() if key in KEPT}
        env |= {
            "COLUMNS": "160",
            "NO_COLOR": "1",
            "HELD": str(number),
            "HELD_API_KEY": "Zx9/planted+Q7!wert-uiop",
            # Both change how each session runs its tests.
            "PYTEST_ADDOPTS": "-p no:flaky -p no:pytest-retry -p no:cacheprovider",
        }
        done = subprocess.run(
            command, cwd=folder, env=env, capture_output=True, check=False, timeout=300
        )
        shown = shlex.join(command).replace(sys.executable, "python").encode()
        text = b"$ %s\n%s\n[stderr]\n%s\n[exit code %d]\n"
        file = folder / f"{number:02}.out"
        file.write_bytes(text % (shown, done.stdout, done.stderr, done.returncode))
        codes.append(done.returncode)
    return codes


def commands(name: str) -> list[list[str]]:
    """The steps of a session, as command lines."""
    module = [sys.executable, "-m"]
    made: list[list[str]] = []
    for step in SESSIONS[name]:
        word, *arguments = shlex.split(step)
        if word == "run":
            folder, *rest = arguments
            files = [f"--junit-xml={folder}.xml", f"--alluredir={folder}.allure"]
            made.append([*module, "pytest", f"--dura-evidence={folder}", *files, *rest])
            made.append([*module, "pytest_dura", "verify", folder, "--junit-xml", f"{folder}.xml"])
        elif word == "list":
            made.append([*module, "pytest", "--dura-list", *arguments])
        elif word == "dura":
            made.append([*module, "pytest_dura", *arguments])
        else:
            made.append([word, *arguments])
    return made


def files_in(folder: Path) -> list[Path]:
    """The files below a folder, in their order, without bytecode."""
    return [file for file in sorted(folder.rglob("*")) if file.is_file() and file.suffix != ".pyc"]


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


MASKS = [
    (re.compile(pattern, re.MULTILINE), mask)
    for pattern, mask in (
        (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?(Z|\+00:00| UTC)?", "<time>"),
        (r"\.episodes/[0-9a-f]{2}/[0-9a-f]{64}", ".episodes/<address>"),
        (r"\.episodes/[0-9a-f]{32}\.sources", ".episodes/<session>.sources"),
        (r"\b[0-9a-f]{12}4[0-9a-f]{3}[89ab][0-9a-f]{15}\b", "<uuid>"),
        (r"\b[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}\b", "<uuid>"),
        (r"^=+ (.* in )\d+\.\d\ds( \(.*\))? =+$", r"= \1<seconds> ="),
        (r'( time=")\d+\.\d+"', r'\1<seconds>"'),
        (r'(name="hypothesis-statistics-[^"]*" value=")[^"]*"', r'\1<runtimes>"'),
        (
            r"((?i:wall clock)[^<]*|Gathering evidence[^<]*)(</th><td[^>]*>)\d+\.\d\d s",
            r"\1\2<seconds>",
        ),
        (r"(<\w+ [\w.<>]+ at )0x[0-9a-f]+>", r"\1<address>>"),
        (r"(&lt;\w+ (?:[\w.]|&lt;|&gt;)+ at )0x[0-9a-f]+&gt;", r"\1<address>&gt;"),
        (r"^process \d+ on \S+$", "process <id> on <host>"),
        (r'(hostname=")[^"]*"', r'\1<host>"'),
    )
]
CLOCK = frozenset(
    ("wall_seconds", "evidence_seconds", "processing_seconds", "processing_us", "wall_clock")
)
"""Keys of times of the clock."""
SIZES = frozenset(("bytes", "file_count"))
"""Keys of sizes of compressed traces, which hold such times, and of the package."""


class Kept:
    """What a run kept, as texts and JSON without what differs between two runs of one commit."""

    def __init__(self, folder: Path, only: str | None) -> None:
        self.folder = folder
        facts = json.loads((folder / "run.json").read_text())
        self.root = facts["root"]
        self.hashes = dict(facts["package"])
        self.sessions = sorted(
            {file.parts[0] for file in self._names()} & {only or name for name in SESSIONS}
        )
        for name in self._names():
            if name.parent.suffix != ".allure":
                self.hashes[sha256(folder / name)] = name.name
            if name.name == "evidence.json":
                record = json.loads((folder / name).read_text())
                self.hashes[record["tool"]["code"]] = "the package"
                sources = record.get("resume", {}).get("sources")
                if sources is not None:  # they hold the code of the package, and all versions
                    self.hashes[sources["digest"]] = "the sources"
            if name.name == "manifest.json":
                self.hashes[json.loads((folder / name).read_text())["digest"]] = "the record"
        self.prefixes: dict[str, list[str]] = {}
        for known in self.hashes:
            self.prefixes.setdefault(known[:7], []).append(known)

    def _names(self) -> list[Path]:
        return [file.relative_to(self.folder) for file in files_in(self.folder)]

    def views(self) -> dict[str, Any]:
        """Each kept file by its path: a list of lines, or parsed JSON."""
        found: dict[str, Any] = {}
        for name in self._names():
            if name.parts[0] in self.sessions and not name.parts[1].endswith(".allure"):
                found[str(name)] = self._view(self.folder / name)
        for session in self.sessions:
            for folder in sorted((self.folder / session).glob("*.allure")):
                found |= self._allure(folder)
        return found

    def _view(self, file: Path) -> Any:
        if file.suffix == ".mcap":
            return [self.text(line) for line in _trace(file)]
        text = file.read_bytes().decode(errors="backslashreplace")
        if file.suffix == ".json":
            return self.masked(json.loads(text))
        if file.suffix == ".html":
            text = re.sub(r"(?<=octet-stream\">)[^<]+", self._unpacked, text)
            text = re.sub(r"(?<=id=\"episode\">)[^<]+", self._unpacked, text)
        if file.suffix == ".xml":
            text = text.replace("><", ">\n<")
        return self.text(text).splitlines()

    def _unpacked(self, match: re.Match[str]) -> str:
        data = json.loads(zlib.decompress(base64.b64decode(match[0])))
        return "\n" + json.dumps(self.masked(data), indent=0)

    def _allure(self, folder: Path) -> dict[str, Any]:
        """Results by their names, with their attachments, and fixtures with their tests."""
        place = str(folder.relative_to(self.folder))
        results = [json.loads(file.read_text()) for file in folder.glob("*-result.json")]
        results.sort(key=lambda result: result["start"])
        names: dict[str, str] = {}
        found: dict[str, Any] = {}
        for result in results:
            begin = f"{place}/{result['fullName']}"
            label = f"{begin} {sum(name.startswith(begin) for name in names.values()) + 1}"
            names[result["uuid"]] = label
            found[label] = self.masked(_without_times(result))
            for number, source in enumerate(_sources(result)):
                view = self._view(folder / source)
                found[f"{label} attachment {number}{Path(source).suffix}"] = view
        fixtures = [json.loads(file.read_text()) for file in folder.glob("*-container.json")]
        for fixture in fixtures:
            fixture["children"] = sorted(map(names.__getitem__, fixture["children"]))
        lines = [json.dumps(self.masked(_without_times(fixture))) for fixture in fixtures]
        return found | {f"{place}/fixtures": sorted(lines)}

    def text(self, text: str) -> str:
        """A text without times, drawn ids, paths and hashes of files."""
        text = text.replace(self.root, "<root>")
        for pattern, mask in MASKS:
            text = pattern.sub(mask, text)
        return re.sub(r"\b[0-9a-f]{7,64}\b", self._named, text)

    def _named(self, match: re.Match[str]) -> str:
        for known in self.prefixes.get(match[0][:7], ()):
            if known.startswith(match[0]):
                return f"<sha256 of {self.hashes[known]}>"
        return match[0]

    def masked(self, value: Any) -> Any:
        """Parsed JSON without the same, and without what the clock measured."""
        if isinstance(value, dict):
            return {
                self.text(key): "<clock>" if key in CLOCK else "<size>" if key in SIZES
                else self.masked(part)
                for key, part in value.items() if not key.startswith("pytest_dura/")
            }  # fmt: skip
        if isinstance(value, list):
            return [self.masked(part) for part in value]
        return self.text(value) if isinstance(value, str) else value


def _trace(file: Path) -> Iterator[str]:
    """Messages, metadata and columns of a trace."""
    with file.open("rb") as opened:
        reader = make_reader(opened)
        for _, channel, message in reader.iter_messages():
            yield f"{channel.topic} {message.log_time} {message.data.decode()}"
        for entry in reader.iter_metadata():
            yield f"{entry.name} {entry.metadata}"
        for attachment in reader.iter_attachments():
            with np.load(io.BytesIO(attachment.data), allow_pickle=False) as columns:
                for name in columns.files:
                    yield f"{attachment.name} {name} {columns[name].tolist()}"


def _without_times(value: Any) -> Any:
    """An entry of Allure without when it began and ended, and who ran it."""
    if isinstance(value, dict):
        if value.get("name") in ("host", "thread") and "value" in value:
            return {"name": value["name"]}
        if "labels" in value:  # in the order of a set
            value["labels"].sort(key=lambda label: (label["name"], label["value"]))
        return {key: _without_times(part) for key, part in value.items()
                if key not in ("start", "stop")}  # fmt: skip
    return [_without_times(part) for part in value] if isinstance(value, list) else value


def _sources(value: Any) -> list[str]:
    """Files of the attachments below an entry of Allure."""
    if isinstance(value, list):
        return [source for part in value for source in _sources(part)]
    if not isinstance(value, dict):
        return []
    return (
        [value["source"]] if "source" in value and "type" in value else _sources([*value.values()])
    )


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The values in parsed JSON by their paths; entries of lists by their ids, if any."""
    if isinstance(value, dict) and value:
        for key, part in value.items():
            yield from leaves(part, f"{path}/{key}")
    elif isinstance(value, list) and value:
        ids = [part.get("id") if isinstance(part, dict) else None for part in value]
        named = None not in ids and len({*map(str, ids)}) == len(ids)
        for number, part in enumerate(value):
            label = str(ids[number]).replace("/", "|") if named else number
            yield from leaves(part, f"{path}/{label}")
    else:
        yield path.removeprefix("/"), value


class Renames:
    """What may differ."""

    def __init__(self, file: Path | None) -> None:
        given = {} if file is None else yaml.safe_load(file.read_text()) or {}
        self.paths = [(_pattern(old), new) for part in ("files", "keys")
                      for old, new in (given.get(part) or {}).items()]  # fmt: skip
        self.added = [_pattern(each) for each in given.get("added") or ()]
        self.sentences = dict(given.get("sentences") or {})

    def path(self, path: str) -> str | None:
        """The new path of an old one, or None if it is gone."""
        for pattern, new in self.paths:
            match = pattern.match(path)
            if match and new is None:
                return None
            if match and ("/" in new or ":" in new):
                path = _filled(new, match.groups()) + path[match.end() :]
            elif match:
                begin = max(map(match[0].rfind, "/:")) + 1
                path = match[0][:begin] + new + path[match.end() :]
        return path

    def is_added(self, path: str) -> bool:
        return any(pattern.match(path) for pattern in self.added)

    def value(self, value: Any) -> Any:
        """An old text, worded anew."""
        if isinstance(value, str):
            for old, new in self.sentences.items():
                value = value.replace(old, new)
        return value


def _filled(path: str, parts: Sequence[str]) -> str:
    """A path with these segments instead of its asterisks."""
    for part in parts:
        path = path.replace("*", part, 1)
    return path


def _pattern(path: str) -> re.Pattern[str]:
    return re.compile("([^/:]*)".join(map(re.escape, path.split("*"))) + "(?=[/:]|$)")


def compare(old: Kept, new: Kept, renames: Renames, shown: int) -> int:
    """Print what differs, and return in how many files something does."""
    before = {renames.path(name): view for name, view in old.views().items()}
    before.pop(None, None)
    after = new.views()
    differing = 0
    for name in sorted(before | after):
        if name not in before and renames.is_added(name):
            continue
        if name not in before or name not in after:
            lines = [f"only in {'OLD' if name in before else 'NEW'}"]
        elif isinstance(after[name], list) and isinstance(before[name], list):
            own = [renames.value(line) for line in before[name]]
            lines = [line.rstrip("\n") for line in difflib.unified_diff(own, after[name], n=1)][2:]
        else:
            lines = [*changes(name, before[name], after[name], renames)]
        if lines:
            differing += 1
            print(f"--- {name}: {len(lines)} lines")
            print(*(line[:400] for line in lines[:shown]), sep="\n")
    print(f"{len(after)} files, {differing} differ" if differing else f"{len(after)} files, equal")
    return differing


def changes(name: str, old: Any, new: Any, renames: Renames) -> Iterator[str]:
    """What differs between two values of JSON, key by key."""
    before = {renames.path(f"{name}:{path}"): value for path, value in leaves(old)}
    after = {f"{name}:{path}": value for path, value in leaves(new)}
    for path in sorted({*before, *after} - {None}, key=str):
        own, other = renames.value(before.get(path, "<absent>")), after.get(path, "<absent>")
        if repr(own) != repr(other) and not (path not in before and renames.is_added(str(path))):
            yield f"{str(path).removeprefix(name)}: {own!r} -> {other!r}"


def main() -> None:
    """Run or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(required=True, dest="action")
    running = actions.add_parser("run", help="run the sessions, and keep what they show")
    running.add_argument("folder", type=Path)
    comparing = actions.add_parser("compare", help="print what differs between two kept runs")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--renames", type=Path, metavar="FILE")
    comparing.add_argument("--lines", type=int, default=40, help="of each file (default: 40)")
    for action in (running, comparing):
        action.add_argument("--only", choices=SESSIONS)
    given = parser.parse_args()
    if given.action == "run":
        run(given.folder, given.only)
        return
    old, new = (Kept(folder, given.only) for folder in (given.old, given.new))
    sys.exit(1 if compare(old, new, Renames(given.renames), given.lines) else 0)


if __name__ == "__main__":
    main()
