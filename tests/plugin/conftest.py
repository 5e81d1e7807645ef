from __future__ import annotations

import copy
import functools
import gc
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from dask_clusters import Cluster
from deep_calls import with_room
from forked_workers import AVAILABLE, WITHOUT_RETRIES, ForkedWorkers, import_all
from kept_metadata import kept_metadata

from pytest_dura.evidence import all_formats
from pytest_dura.evidence.model import WholeRecord
from pytest_dura.execution import sources
from pytest_dura.library import builtin_paths, loading, read_yaml

# In-process runs forget what they imported: what is ours would be compiled anew for each of them,
# and numpy and its like cannot be imported twice.
import_all()
list(all_formats())

(BUILTIN,) = builtin_paths()
PROJECT = Path(__file__).with_name("project")

MODES = {
    "plain": [],
    "n0": ["-n", "0"],
    "n2": ["-n", "2"],
    "without xdist": ["-p", "no:xdist"],
}


class Outcome:
    """What a session left in its folder."""

    path: Path

    def evidence(self, folder="dura-evidence"):
        """The record, read and checked by the models alone."""
        text = (self.path / folder / "evidence.json").read_text()
        return WholeRecord.from_data(json.loads(text))

    def verdict(self, requirement, case="corridor/it"):
        (verdict,) = [
            verdict
            for verdict in self.evidence().verdicts
            if (verdict.requirement, verdict.case) == (requirement, case)
        ]
        return verdict

    def verdicts(self):
        return {
            (verdict.case, verdict.requirement): verdict.verdict
            for verdict in self.evidence().verdicts
        }


class Reference(Outcome):
    """A session of the example project with a reckless component, for reading alone.

    Two of its three verdicts are violated. It wrote ``junit.xml`` and, into ``allure``, results
    for Allure; a warning would have failed it. ``result`` is what pytest printed and returned.
    """

    def __init__(self, folder: Path, workers: ForkedWorkers, *mode: str) -> None:
        self.path = folder
        shutil.copytree(PROJECT, self.path, dirs_exist_ok=True)
        kept = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
        done = subprocess.run(
            workers.command(
                "-m", "pytest", "-p", "no:cacheprovider", "-W", "error", *mode,
                "--dura-scenarios", "--dura-select=corridor/*",
                "--dura-generator=corridor:Reckless", "--alluredir=allure",
                "--junit-xml=junit.xml",
            ),
            cwd=self.path, env=kept, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        self.result = pytest.RunResult(
            done.returncode, done.stdout.splitlines(), done.stderr.splitlines(), 0.0
        )


class Project(Outcome):
    """A copy of the example project, in which pytest runs in this process."""

    def __init__(self, pytester: pytest.Pytester, workers: ForkedWorkers) -> None:
        self.pytester = pytester
        self.workers = workers
        self.path = pytester.path
        shutil.copytree(PROJECT, self.path, dirs_exist_ok=True)

    def run(self, *arguments):
        return with_room(lambda: self.pytester.runpytest_inprocess(*arguments))

    def run_apart(self, *arguments):
        """A session in a process of its own, forked from one that has imported what it needs."""
        command = self.workers.command("-m", "pytest", "-p", "no:cacheprovider", *arguments)
        return self.pytester.run(*command)

    def scenarios(self, *arguments, select="corridor/*"):
        # The project has scenarios of its own, which alone would run.
        builtin = "=builtin" if select.startswith("intersection/") else ""
        return self.run(f"--dura-scenarios{builtin}", f"--dura-select={select}", *arguments)

    def write(self, name, text):
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


@functools.cache
def _read_once(file):
    return pickle.dumps(read_yaml(file))


def _read(file, *, trusted=False):
    """As ``read_yaml``; the built-in files, which each session reads, are parsed once."""
    # Of pickled ones a copy is made ten times as quickly as by `copy.deepcopy`.
    return pickle.loads(_read_once(file)) if trusted else read_yaml(file)


@functools.cache
def _check_once(checked):
    """As ``check_scenario``; a built-in scenario, which each session checks, is checked once."""
    found = {}

    def check(scenario):
        if BUILTIN not in Path(scenario.file).parents:
            return checked(scenario)
        if scenario.file not in found:
            found[scenario.file] = checked(scenario)
        problems, faults = found[scenario.file]
        return [*problems], copy.deepcopy(faults)

    return check


KEPT = kept_metadata()


@pytest.fixture
def fast_sessions(request, monkeypatch, forked_workers):
    # A process that has run thousands of tests takes long to fork. What is about processes says so.
    executor = getattr(request.module, "EXECUTOR", "in-process")
    given = f" --dura-executor={executor}" if executor else ""
    monkeypatch.setenv("PYTEST_ADDOPTS", WITHOUT_RETRIES + given)
    # Milliseconds each, for what no test can see: that files survive a loss of power.
    monkeypatch.setattr(os, "fsync", lambda _: None)
    # What this process has imported by now is of the suite, and of no project.
    imported, begin = frozenset(sys.modules), sources.LoadedModules.__init__

    def begin_with_them(modules):
        begin(modules)
        modules._seen.update(imported)

    monkeypatch.setattr(sources.LoadedModules, "__init__", begin_with_them)
    monkeypatch.setattr(loading, "read_yaml", _read)
    monkeypatch.setattr(loading, "check_scenario", _check_once(loading.check_scenario))
    for distribution, name, kept in KEPT:
        monkeypatch.setattr(distribution, name, kept)
    # Python counts them one by one, and all that there was before this test is frozen.
    monkeypatch.setattr(gc, "get_freeze_count", lambda: 1)
    if AVAILABLE:
        monkeypatch.setattr("execnet.gateway_io.popen_args", forked_workers.arguments)


@pytest.fixture(scope="session")
def reference(tmp_path_factory, forked_workers):
    """The reference session of a mode, made when the first test asks for it."""

    @functools.cache
    def made(mode):
        folder = tmp_path_factory.mktemp(f"reference-{mode}")
        return Reference(folder, forked_workers, *MODES[mode])

    return made


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """What sessions leave in the project of the first test that asks, copied for the others.

    ``made_once(project, key, make)`` returns what ``make()`` returned, for reading alone; the
    project is the test's own, and may be changed.
    """
    kept = {}

    def made(project, key, make):
        key = make.__module__, key
        if key in kept:
            shutil.copytree(kept[key][0], project.path, symlinks=True, dirs_exist_ok=True)
        else:
            returned, folder = make(), tmp_path_factory.mktemp("made-once")
            shutil.copytree(project.path, folder, symlinks=True, dirs_exist_ok=True)
            kept[key] = folder, returned
        return kept[key][1]

    return made


@pytest.fixture
def project(pytester, fast_sessions, forked_workers):
    return Project(pytester, forked_workers)


@pytest.fixture(scope="session")
def dask_worker(tmp_path_factory):
    """The only worker of a Dask cluster; its ``executor`` is the option that names the cluster."""
    cluster = Cluster(tmp_path_factory.mktemp("dask"))
    worker = cluster.worker()
    worker.executor = f"--dura-executor=dask://127.0.0.1:{cluster.port}"
    yield worker
    cluster.close()


@pytest.fixture(params=list(MODES))
def mode(request):
    return MODES[request.param]
