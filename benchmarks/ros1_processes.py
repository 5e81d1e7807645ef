"""Two processes over ROS 1: episodes in step against one process, and a minute of real time.

Run: python benchmarks/ros1_processes.py [--episodes 10] [--seconds 60] [--rate 20]

The robot and its controller of `tests/support/ros1_robot.py` behind topics of a real master, each
in a process of its own, with the bindings of docs/ros2.md. In step, signals and verdicts are
compared with those of one process; by the wall clock it is counted what comes late. Needs rospy and
rosmaster for this Python (docs/ros2.md says how); without them it says so.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from machine import machine, table

from pytest_dura import Episode, EpisodeSpec, Orchestrator, RoleSpec, Termination
from pytest_dura.adapters.ros2.bus import close_buses
from pytest_dura.core.clock import Clock, timeliness
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
CHECK = "always (x < 4.52)"
LAGS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.9, 1.1, 1.2)
"""Of the robot, in s; the episodes are as different as these."""
SPEC = EpisodeSpec(
    "room/wall", 0, 0, RoleSpec("robot_room:Room"),
    {"generator": RoleSpec("robot_room:Approach")},
    scenario={"name": "a", "world": {"lag": 0.3}}, termination=Termination(time_limit=6.0),
    time_budget=60.0,
)  # fmt: skip
BINDING = {"binding": "room.ros2.yaml", "timeout": 20.0}
ENDS: dict[str, dict[str, Any]] = {
    "world": {"simulator": RoleSpec("pytest_dura.adapters.ros1:Ros1Simulator", BINDING)},
    "controller": {
        "roles": {"generator": RoleSpec("pytest_dura.adapters.ros1:Ros1Generator", BINDING)}
    },
}  # fmt: skip
"""What is at the other end, and what stands for it here."""


@contextmanager
def node(*arguments: str) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, str(SUPPORT / "ros1_robot.py"), *arguments])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def master() -> Iterator[None]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    with node("master", str(port)):
        for _ in range(300):
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                break
            except OSError:
                time.sleep(0.1)
        yield


def run(**changes: Any) -> tuple[Episode, float]:
    """An episode, and what a tick of it took, in us."""
    spec = replace(SPEC, **changes)
    orchestrator = Orchestrator.build(spec)
    began = time.perf_counter()
    episode = orchestrator.run(spec)
    seconds = time.perf_counter() - began
    problems = [event.detail for event in episode.events]
    if episode.failure or problems:
        raise RuntimeError(episode.failure or problems[0])
    return episode, 1e6 * seconds / len(episode.signal("x"))


def in_step(end: str, episodes: int) -> list[str]:
    equal, verdicts, costs, satisfied = 0, 0, [], 0
    for lag in LAGS[:episodes]:
        scenario = {"name": "a", "world": {"lag": lag}}
        here, _ = run(scenario=scenario)
        there, cost = run(scenario=scenario, **ENDS[end])
        margins = [JudgedEpisode.of(episode).robustness(CHECK) for episode in (here, there)]
        equal += here.signal("x").tolist() == there.signal("x").tolist()
        verdicts += margins[0] == margins[1]
        satisfied += margins[1] > 0
        costs.append(cost)
    number = len(costs)
    spread = f"{satisfied} satisfied, {number - satisfied} violated"
    return [end, f"{equal} of {number}", f"{verdicts} of {number}: {spread}", f"{min(costs):.0f}"]


def kept_time(end: str, rate: float, seconds: float) -> list[str]:
    clock = Clock(kind="wall")
    episode, _ = run(
        clock=clock, time_step=1.0 / rate, termination=Termination(time_limit=seconds), **ENDS[end]
    )
    kept = timeliness(clock, 1.0 / rate, episode.signals, len(episode.decisions["source"]))
    assert kept is not None
    failed = sum(event.kind == "component_failure" for event in episode.events)
    margin = JudgedEpisode.of(episode).robustness(CHECK)
    return [
        end, str(kept.ticks), str(kept.late), str(failed), f"{1000 * kept.period:.2f}",
        f"{1000 * kept.jitter:.2f}", f"{1000 * kept.worst:.2f}",
        f"{'satisfied' if margin > 0 else 'violated'}, {margin:.3f} m",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=len(LAGS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=20.0)
    arguments = parser.parse_args()
    steps, times = [], []
    print(f"{machine()}; load {os.getloadavg()[0]:.1f}\n")
    if any(importlib.util.find_spec(name) is None for name in ("rospy", "rosmaster")):
        print("rospy and rosmaster cannot be imported by this Python: nothing was measured\n")
    else:
        sys.path.insert(0, str(SUPPORT))
        from robot_room import BINDING as TEXT

        with tempfile.TemporaryDirectory() as folder, master():
            os.chdir(folder)
            os.environ["ROS_HOME"] = folder
            text = TEXT.replace("reset: /reset\n", "")
            for end in ENDS:
                written = TEXT if end == "world" else text + "clock: null\n"
                Path("room.ros2.yaml").write_text(written, "utf-8")
                with node(end):
                    steps.append(in_step(end, arguments.episodes))
                    times.append(kept_time(end, arguments.rate, arguments.seconds))
                close_buses()  # or the other end's topics would meet those of this process
            os.chdir("/")
    print(
        table(["behind topics", "equal to the last bit", "equal verdicts", "us a tick"], steps),
        "\n",
    )
    headers = ["behind topics", "ticks", "late", "failures", "period ms", "jitter ms (95 %)"]
    print(table([*headers, "worst ms", CHECK], times))


if __name__ == "__main__":
    main()
