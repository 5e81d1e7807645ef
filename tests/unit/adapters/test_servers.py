"""Servers: found, started, locked, watched, ended, also with a session that is killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import free_ports
import pytest

from pytest_dura import ConfigurationError
from pytest_dura.adapters.servers import Server, ServerError, claim, project_program

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="servers are started on POSIX")

LISTENS = """\
import os, socket, subprocess, sys, time
from pathlib import Path
helper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(120)"])
Path(sys.argv[2]).write_text(f"{os.getpid()} {helper.pid}")
with socket.create_server(("127.0.0.1", int(sys.argv[1]))) as server:
    server.settimeout(120)
    while True:
        server.accept()[0].close()
"""
HOLDS = """\
import sys, time
from test_servers import answering
from pytest_dura.adapters.servers import Server
server = Server(f"tcp:127.0.0.1:{sys.argv[1]}", ["./listens.py", sys.argv[1], "pids"])
server.open(answering(int(sys.argv[1])))
print("open", flush=True)
time.sleep(120)
"""


def answering(port):
    def problem():
        try:
            socket.create_connection(("127.0.0.1", port), 5.0).close()
        except OSError as error:
            return str(error)
        return ""

    return problem


def is_running(process):
    """Whether a process runs; one that has ended and is not waited for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().split(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until_ended(processes):
    until = time.monotonic() + 20.0
    while any(map(is_running, processes)) and time.monotonic() < until:
        time.sleep(0.05)
    return not any(map(is_running, processes))


@pytest.fixture
def port():
    return free_ports.free_port()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    program = tmp_path / "listens.py"
    program.write_text(f"#!{sys.executable}\n{LISTENS}")
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def processes(folder):
    return [int(number) for number in (folder / "pids").read_text().split()]


def test_a_server_that_is_not_there_is_started_and_ended_with_all_that_it_started(
    folder, port
) -> None:
    server = Server(f"tcp:127.0.0.1:{port}", ["./listens.py", str(port), "pids"])
    server.open(answering(port))
    started = processes(folder)
    assert [is_running(process) for process in started] == [True, True]
    assert server.ending() == ""
    server.close()
    server.close()
    assert wait_until_ended(started)
    server.open(answering(port))  # and again
    assert processes(folder) != started
    server.close()


def test_one_that_is_found_is_used_and_left_running(folder, port) -> None:
    found = subprocess.Popen(["./listens.py", str(port), "pids"])
    try:
        until = time.monotonic() + 20.0
        while answering(port)() and time.monotonic() < until:
            time.sleep(0.05)
        server = Server(f"tcp:127.0.0.1:{port}", ["./listens.py", str(port), "pids"])
        server.open(answering(port))
        server.close()
        assert found.poll() is None
        assert answering(port)() == ""
    finally:
        os.kill(processes(folder)[1], signal.SIGKILL)
        found.kill()
        found.wait()


def test_one_that_has_ended_says_how_with_its_last_words(folder, port) -> None:
    (folder / "ends.py").write_text(f"#!{sys.executable}\nprint('no licence'); exit(7)\n")
    (folder / "ends.py").chmod(0o755)
    server = Server(f"tcp:127.0.0.1:{port}", ["./ends.py"], seconds=20.0)
    words = r"ends.py ended with exit code 7 \(its output: no licence\), before it answered at tcp"
    with pytest.raises(ServerError, match=words):
        server.open(answering(port))
    server = Server(f"tcp:127.0.0.1:{port}", ["./listens.py", str(port), "pids"])
    server.open(answering(port))
    os.kill(processes(folder)[0], signal.SIGSEGV)
    assert wait_until_ended(processes(folder))
    until = time.monotonic() + 20.0
    while not server.ending() and time.monotonic() < until:
        time.sleep(0.05)
    assert server.ending().endswith("ended with signal 11")
    server.close()


def test_one_that_does_not_answer_in_time_is_ended(folder, port) -> None:
    server = Server(f"tcp:127.0.0.1:{port}", ["./listens.py", str(port), "pids"], seconds=1.0)
    with pytest.raises(ServerError, match=r"does not answer at tcp.* within 1 s: never"):
        server.open(lambda: "never" if (folder / "pids").exists() else "not yet")
    assert wait_until_ended(processes(folder))
    claim(f"tcp:127.0.0.1:{port}").release()  # and its lock is free


def test_it_ends_with_a_session_that_is_killed_and_a_second_session_does_not_get_it(
    folder, port
) -> None:
    places = Path(__file__).parent, Path(free_ports.__file__).parent
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, places))}
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(port)],
        stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    try:
        assert holder.stdout.readline() == "open\n"
        second = Server(f"tcp:127.0.0.1:{port}", ["./listens.py", str(port), "pids"])
        with pytest.raises(ConfigurationError, match="another process uses this device or server"):
            second.open(answering(port))
        assert all(map(is_running, processes(folder)))
    finally:
        holder.kill()
        holder.wait()
        holder.stdout.close()
    assert wait_until_ended(processes(folder))
    second.open(answering(port))
    second.close()


def test_a_program_that_is_not_a_file_is_refused() -> None:
    for command, words in (("./nothing", "there is no such program"), ("'x", "no command line")):
        with pytest.raises(ConfigurationError, match=words):
            project_program(command, "server")
