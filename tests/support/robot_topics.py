"""Episodes of the robot in one process and behind topics, for both versions of ROS."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from pytest_dura import Episode, EpisodeSpec, Orchestrator, RoleSpec, Termination
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

CHECK = "always (x < 4.52)"
SPEC = EpisodeSpec(
    case="room/wall",
    run=0,
    seed=0,
    simulator=RoleSpec("robot_room:Room"),
    roles={"generator": RoleSpec("robot_room:Approach")},
    scenario={"name": "a", "world": {"lag": 0.3}},
    termination=Termination(time_limit=6.0),
    time_budget=60.0,
)
SCAN = """\
topics: {/scan: sensor_msgs/msg/LaserScan, /joints: sensor_msgs/msg/JointState,
         /count: std_msgs/msg/Int32}
percept:
  - {name: ranges, unit: cm, scale: 100, topic: /scan, field: ranges}
  - {name: arm.second, unit: rad, topic: /joints, field: position.1}
  - {name: count, unit: "1", topic: /count, field: data}
command: [{name: count, unit: "1", topic: /count, field: data}]
"""
"""A binding with a list, an element of a list and an integer."""


@contextmanager
def running(program: Path, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """Context with a program of Python, which is killed at its end."""
    process = subprocess.Popen([sys.executable, str(program), *map(str, arguments)])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def episode_of(lag: float, **changes: Any) -> Episode:
    """Run the robot whose drive has a lag, with changes of its spec."""
    spec = replace(SPEC, scenario={"name": "a", "world": {"lag": lag}}, **changes)
    return Orchestrator.build(spec).run(spec)


def check_equal_episodes(lags: Iterable[float], **changes: Any) -> None:
    """Assert that the changes change no episode, and that some lags violate the check."""
    margins = []
    for lag in lags:
        here, there = episode_of(lag), episode_of(lag, **changes)
        assert there.failure is None
        assert (there.validity, there.events) == ("valid", ())
        assert there.signal("x").tolist() == here.signal("x").tolist()
        margins.append(JudgedEpisode.of(there).robustness(CHECK))
        assert margins[-1] == JudgedEpisode.of(here).robustness(CHECK)
    assert min(margins) < 0.0 < max(margins)
