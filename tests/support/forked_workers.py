"""Processes that begin as copies of one in which a session was run before.

A process of its own spends two seconds on imports, and has a few episodes to run. Here one process
is started, runs a session of the example project, forgets that project, and forks for each worker
of pytest-xdist, each ``python -m pytest`` and each script that is asked for. That an earlier
session leaves nothing behind that matters is what the tests that run in this process assume as
well; processes that start afresh are in the tests of the installation, of the first run of each
example suite, and of what a process imports.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import pickle
import pkgutil
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from kept_metadata import kept_metadata

AVAILABLE = sys.platform == "linux" and find_spec("pytest_dura.driving") is not None
"""Elsewhere a process may not be forked that has used system libraries; the session that copies
begin with is of the built-in domain."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Threads of a numeric library are not there in a copy."""

WITHOUT_RETRIES = "-p no:flaky -p no:pytest-retry -p no:rerunfailures"
"""Options without which these plugins change how each session runs its tests, or leave a thread and
a socket of each session behind; a session that is to have one asks for it: ``-p flaky``."""

OF_EXTRAS = (
    "fmpy.simulation", "fmpy.validation", "httpcore2", "markdown_it", "openai.resources.chat",
    "openai.resources.models", "PIL.ImageDraw", "PIL.ImageFont", "truststore",
)  # fmt: skip
"""What packages of extras import at first use. A session in this process forgets it, and the next
use would import it once more: errors of ``httpcore2`` are then not those that ``httpx2`` knows."""

CI_VARIABLES = (
    "CI", "TF_BUILD", "GITHUB_ACTIONS", "GITLAB_CI", "JENKINS_URL", "TEAMCITY_VERSION",
    "BUILDKITE", "CIRCLECI", "CIRRUS_CI", "CODEBUILD_BUILD_ID", "HEROKU_TEST_RUN_ID",
    "TRAVIS", "bamboo.buildKey",
)  # fmt: skip
"""Hypothesis tells by these that it runs in a CI."""

CLIENT = """
import os, pickle, socket, sys
with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
    server.connect(sys.argv[1])
    told = pickle.dumps((os.getcwd(), dict(os.environb), sys.argv[2:]))
    socket.send_fds(server, [len(told).to_bytes(4, "big")], [0, 1, 2])
    server.sendall(told)
    for number in (0, 1):
        os.close(number)
    code = b"".join(iter(lambda: server.recv(1), b""))  # until the copy is no more
# A worker tells none; a command that tells none was killed.
sys.exit(code[0] if code else bool(sys.argv[2:]))
"""
"""What is started: it hands its pipes to the copy, lasts as long as it does, and tells its code."""


class ForkedWorkers:
    """Starts the process that forks when the first worker is asked for."""

    def __init__(self, project: Path) -> None:
        self.project = project
        self.folder = tempfile.mkdtemp(prefix="dura-")  # a socket's name must be short
        self.process: subprocess.Popen[bytes] | None = None

    def arguments(self, _spec: object = None) -> list[str]:
        """The command of a worker, as ``execnet.gateway_io.popen_args``."""
        return self.command()

    def command(self, *arguments: str) -> list[str]:
        """As ``python`` with these arguments: ``-m`` and a module, or the path of a script."""
        if not AVAILABLE:
            return [sys.executable, *arguments]
        address = str(Path(self.folder, "socket"))
        if self.process is None:
            # Nothing of the test that happens to be the first one to want a worker, nor of a CI:
            # Hypothesis looks for that while it is imported, which happens before a test can
            # take it away.
            kept = {
                name: value
                for name, value in os.environ.items()
                if not ("PYTEST" in name or "CORRIDOR" in name or name in CI_VARIABLES)
            }
            self.process = subprocess.Popen(
                [sys.executable, __file__, address, str(self.project)],
                env=kept | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            assert self.process.stdout is not None
            assert self.process.stdout.readline() == b"ready\n", "no worker can be forked"
        return [sys.executable, "-IS", "-c", CLIENT, address, *arguments]

    def close(self) -> None:
        """End the process; workers end with the sessions that asked for them."""
        if self.process is not None:
            self.process.communicate(timeout=60)
        shutil.rmtree(self.folder)


def import_all() -> None:
    """Every module of ours, and what some import at first use."""
    import pytest_dura

    ours = [one.name for one in pkgutil.walk_packages(pytest_dura.__path__, "pytest_dura.")]
    others = ["filelock", "hypothesis.strategies", "jinja2", "mcap.reader", "mcap.writer"]
    extras = [name for name in OF_EXTRAS if find_spec(name.partition(".")[0]) is not None]
    for name in (*ours, *others, "scipy.special", "scipy.stats.qmc", *extras):
        if not name.endswith(".__main__"):
            importlib.import_module(name)


def decide_once(is_own: Callable[[str], bool]) -> Callable[[str], bool]:
    """Whether a module is the user's own, asked once of each file: there are hundreds of modules.

    A session asks where each of them lies, which takes as long as all else that a short one does.
    """
    known: dict[tuple[str, str | None], bool] = {}

    def decided(name: str) -> bool:
        key = name, getattr(sys.modules.get(name), "__file__", None)
        if key not in known:
            known[key] = is_own(name)
        return known[key]

    return decided


def _run_a_session(project: str) -> None:
    """What a session imports is imported then, by the hook that pytest expects to have done it."""
    import pytest

    from pytest_dura.execution import sources

    sources._is_own = decide_once(sources._is_own)
    with tempfile.TemporaryDirectory() as name:
        folder = shutil.copytree(project, Path(name, "project"))
        here = Path.cwd()
        os.chdir(folder)
        with Path(os.devnull).open("w") as quiet, contextlib.redirect_stdout(quiet):
            off = "-p no:cacheprovider -p no:xdist", WITHOUT_RETRIES
            code = pytest.main([*" ".join(off).split(), "corridor/free"])
        os.chdir(here)
        if code:
            raise SystemExit(f"the session that workers begin with ended with {code!r}")
        import_all()
        for distribution, attribute, kept in kept_metadata():
            setattr(distribution, attribute, kept)
        for key, module in list(sys.modules.items()):
            if (getattr(module, "__file__", None) or "").startswith(str(folder)):
                del sys.modules[key]


def _serve(address: str) -> tuple[int, list[str]]:
    """Fork for each client; returns in the child, whose pipes, folder and environment are set.

    Returned are the socket of the client, which closes with the child, and the arguments.
    """
    stops = sys.stdin.fileno()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(address)
        server.listen()
        assert threading.active_count() == 1, "a thread of the session would be missing in a copy"
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        while stops not in select.select([stops, server], [], [])[0]:
            client = server.accept()[0]
            size, pipes, _, _ = socket.recv_fds(client, 4, 3)
            with client.makefile("rb") as stream:
                told = stream.read(int.from_bytes(size, "big"))
            child = os.fork() == 0
            if child:
                for number, pipe in enumerate(pipes):
                    os.dup2(pipe, number)
            for pipe in pipes:
                os.close(pipe)
            if child:
                return client.detach(), _become(*pickle.loads(told))
            client.close()
    raise SystemExit


def _become(folder: str, environment: dict[bytes, bytes], arguments: list[str]) -> list[str]:
    os.chdir(folder)
    os.environb.clear()
    os.environb.update(environment)
    os.environ.setdefault("PYTEST_ADDOPTS", WITHOUT_RETRIES)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    sys.stdin, sys.stdout, sys.stderr = map(os.fdopen, range(3), ("r", "w", "w"))
    sys.argv = arguments or ["-c"]
    importlib.invalidate_caches()
    return arguments


def _reap(*_: object) -> None:
    """Wait for the copies that have ended, so that their time counts as time of the tests."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _leave(code: int) -> NoReturn:
    """End this copy as Python does, but for what takes a second: taking all modules apart."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run_script(path: str) -> None:
    """As ``runpy.run_path``, but its module is also the one that its own processes call main."""
    module = ModuleType("__main__")
    module.__file__ = path
    sys.modules["__main__"] = sys.modules["__mp_main__"] = module
    exec(compile(Path(path).read_bytes(), path, "exec"), module.__dict__)


def _run(client: int, arguments: list[str], address: str) -> None:
    """As Python runs a module or a script, and tell the client the exit code.

    Workers of pytest-xdist that it starts are forked from where this copy is from.
    """
    import execnet.gateway_io

    worker = [sys.executable, "-IS", "-c", CLIENT, address]
    execnet.gateway_io.popen_args = lambda _spec: worker
    code = 1
    places = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    sys.path[:0] = [place for place in places if place and place not in sys.path]
    try:
        if arguments[0] == "-m":
            sys.path.insert(0, str(Path.cwd()))
            sys.argv = arguments[1:]
            runpy.run_module(arguments[1], run_name="__main__", alter_sys=True)
        else:
            sys.path.insert(0, str(Path(arguments[0]).parent))
            _run_script(arguments[0])
        code = 0
    except SystemExit as end:
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
        else:
            code = int(end.code or 0)
    finally:
        os.write(client, bytes([code]))
    _leave(code)


if __name__ == "__main__":
    # What a shell starts in the background ignores Ctrl-C, and so would its copies.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.path[0] = ""
    before = list(sys.path)
    _run_a_session(sys.argv[2])
    signal.signal(signal.SIGCHLD, _reap)
    from garbage import freeze  # it imports Hypothesis, which that session does itself

    freeze()  # a copy that searches what was there before for garbage copies all of it
    gc.get_freeze_count = lambda: 1  # Python counts a million objects one by one
    address = sys.argv[1]
    client, arguments = _serve(address)
    if arguments:
        sys.path[:] = before[1:]
        _run(client, arguments, address)
    else:
        sys.path[:] = before
        exec(eval(sys.stdin.readline()))  # as execnet begins a worker
        _leave(0)
