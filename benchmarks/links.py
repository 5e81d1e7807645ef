"""A component at the other end of a wire: what a tick costs, and how it keeps time.

Run: python benchmarks/links.py [--seconds 60] [--rate 20] [--ticks 2000] [--wires pipe dds]

The controller of `example_suites/link_tank` in this process, as a program in C on a pipe, on UDP of
the loopback interface and on a serial line (two pseudo-terminals that another process joins), and
in Python at the other end of a virtual CAN bus (UDP multicast) and of DDS topics on the loopback
interface, which the one in C does not speak.
First as quickly as the loop can, then by the wall clock. Wires that cannot be had are left out, and
named.
"""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from machine import machine, table

from pytest_dura.adapters.link.bindings import RESET
from pytest_dura.adapters.link.conversation import Link, LinkError, close_links
from pytest_dura.adapters.link.frames import Kind
from pytest_dura.adapters.link.generator import DeviceGenerator, LinkGenerator
from pytest_dura.adapters.link.transports import LinkLostError, open_transport
from pytest_dura.core import EpisodeSpec, Orchestrator, RoleSpec, Termination
from pytest_dura.core.clock import Clock, timeliness
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

SUITE = Path(__file__).parents[1] / "example_suites" / "link_tank"
WIRES = ("in process", "pipe", "udp", "serial", "can", "dds")
SERVED = {"can": "can:udp_multicast/239.74.163.2", "dds": f"dds:{os.getpid() % 200}/tank"}
"""Wires with the component in Python at the other end."""
LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name='lo'/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"""
BRIDGE = """
import os, select, tty
ends = [os.openpty() for _ in range(2)]
for _, end in ends: tty.setraw(end)
print(*(os.ttyname(end) for _, end in ends), flush=True)
one, other = ends[0][0], ends[1][0]
while True:
    for ready in select.select([one, other, 0], [], [])[0]:
        if ready == 0: raise SystemExit
        os.write(other if ready == one else one, os.read(ready, 4096))
"""
CHECK = "always (level < 2.2)"


class UnavailableError(Exception):
    """Why a wire cannot be had."""


@contextmanager
def component(wire: str) -> Iterator[RoleSpec]:
    """The component at the end of a wire, with its program for as long as it is used."""
    with programs() as started:
        yield _component(wire, started)
        close_links()


@contextmanager
def programs() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    try:
        yield started
    finally:
        close_links()
        for each in reversed(started):
            if each.stdin is not None:
                each.stdin.close()
            each.terminate()
            each.wait(10)


def _component(wire: str, started: list[subprocess.Popen[str]]) -> RoleSpec:
    binding = {"binding": "tank.link.yaml", "timeout": 10.0}
    if wire == "in process":
        return RoleSpec("tank:Fill")
    if wire == "pipe":
        return RoleSpec.of(LinkGenerator, {"transport": "pipe:./controller", **binding})
    if wire == "udp":
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        started.append(subprocess.Popen(["./controller", str(port)], text=True))
        address = f"udp:127.0.0.1:{port}"
    elif wire == "serial":
        bridge = subprocess.Popen(
            [sys.executable, "-c", BRIDGE],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(bridge)
        assert bridge.stdout is not None
        ours, theirs = bridge.stdout.readline().split()
        started.append(subprocess.Popen(["./controller", theirs], text=True))
        address = f"serial:{ours}"
    else:
        address = SERVED[wire]
        command = ["-m", "pytest_dura", "serve", "tank:Fill", "--transport", address]
        command += ["--binding", "tank.link.yaml", "--idle", "20"]
        started.append(subprocess.Popen([sys.executable, *command], text=True))
    _wait_for(address)
    return RoleSpec.of(DeviceGenerator, {"transport": address, **binding})


def _wait_for(address: str) -> None:
    """Wait until the other end answers a reset: it may start after us."""
    until = time.monotonic() + 30.0
    problem = ""
    while time.monotonic() < until:
        try:
            link = Link(open_transport(address))
        except LinkLostError as error:
            problem = str(error)
        else:
            problem = _no_answer(link)
            link.transport.close()  # without a word: at an END the program would end
        if not problem:
            return
        time.sleep(0.1)
    raise UnavailableError(problem)


def _no_answer(link: Link) -> str:
    try:
        link.ask(Kind.RESET, RESET.pack(1, 0.05) + b"{}", Kind.RESET, 0.5)
    except (LinkError, LinkLostError) as error:
        return str(error)
    return ""


def spec(role: RoleSpec, step: float, ticks: int, clock: Clock) -> EpisodeSpec:
    return EpisodeSpec(
        "tank/filling", 0, 1, RoleSpec("tank:Tank"), {"generator": role},
        scenario={"name": "tank/filling", "world": {"drain": 0.3}},
        termination=Termination(time_limit=step * ticks), time_step=step, time_budget=30.0,
        clock=clock,
    )  # fmt: skip


def cost(role: RoleSpec, ticks: int) -> list[str]:
    each = spec(role, 0.05, ticks, Clock())
    began = time.perf_counter()
    episode = Orchestrator.build(each).run(each)
    whole = (time.perf_counter() - began) / ticks
    problems = [event.detail for event in episode.events]
    if episode.failure or problems:
        raise RuntimeError(episode.failure or problems[0])
    own = [ns / 1e3 for ns in episode.metrics.processing_ns["generator"][1]]
    quick = statistics.quantiles(own, n=100)
    return [f"{whole * 1e6:.0f}", f"{statistics.median(own):.0f}", f"{quick[98]:.0f}"]


def kept_time(role: RoleSpec, rate: float, seconds: float) -> list[str]:
    each = spec(role, 1.0 / rate, round(seconds * rate), Clock(kind="wall"))
    episode = Orchestrator.build(each).run(each)
    if episode.failure:
        raise RuntimeError(episode.failure)
    decisions = len(episode.decisions["source"])
    kept = timeliness(each.clock, each.time_step, episode.signals, decisions)
    assert kept is not None
    failed = sum(event.kind == "component_failure" for event in episode.events)
    margin = JudgedEpisode.of(episode).robustness(CHECK)
    return [
        str(kept.ticks), str(kept.late), str(kept.expired), str(failed),
        f"{1000 * kept.period:.2f}", f"{1000 * kept.jitter:.2f}", f"{1000 * kept.worst:.2f}",
        f"{'satisfied' if margin > 0 else 'violated'}, {margin:.3f} m",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--wires", nargs="+", choices=WIRES, default=WIRES)
    arguments = parser.parse_args()
    costs, times, missing = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(SUITE, folder, dirs_exist_ok=True)
        os.chdir(folder)
        sys.path.insert(0, folder)
        os.environ["PYTHONPATH"] = folder
        os.environ.setdefault("CYCLONEDDS_URI", LOOPBACK)
        subprocess.run(["cc", "-O2", "-o", "controller", "controller.c"], check=True)
        for wire in arguments.wires:
            costs.append([wire])
            times.append([wire])
            try:
                with component(wire) as role:
                    costs[-1] += cost(role, arguments.ticks)
                    times[-1] += kept_time(role, arguments.rate, arguments.seconds)
            except (UnavailableError, ConfigurationError, RuntimeError) as error:
                missing.append(f"{wire}: {error}")
        os.chdir("/")
    load = "" if sys.platform == "win32" else f"; load {os.getloadavg()[0]:.1f}"
    print(f"{machine()}{load}\n")
    headers = ["wire", "us a tick", "of them the component, median", "99 %"]
    print(table(headers, [row for row in costs if len(row) > 1]), "\n")
    headers = ["wire", "ticks", "late", "expired", "failures", "period ms", "jitter ms (95 %)"]
    print(table([*headers, "worst ms", CHECK], [row for row in times if len(row) > 1]))
    for line in missing:
        print(f"\nnot measured, {line}")


if __name__ == "__main__":
    main()
