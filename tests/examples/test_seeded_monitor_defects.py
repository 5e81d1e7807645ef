"""Tool confidence: each built-in monitor flags the defect that it is there for.

Each row is a situation that one monitor must flag. Two things are set beside it: a sound situation,
which it must not flag, and a monitor that is broken in one place, which must miss the defect; else
the row would show nothing.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from roads import spec_of_drive

from pytest_dura import Episode, EpisodeSpec, RoleSpec
from pytest_dura.driving.roles import performance, safety, security
from pytest_dura.execution import run_episode

RULE_BASED = RoleSpec("pytest_dura.driving.roles.planners:RuleBased")
MONITORS = {
    "safety_monitor": "pytest_dura.driving.roles.safety:SeparationMonitor",
    "security_assessor": "pytest_dura.driving.roles.security:PlausibilityAssessor",
    "performance_oracle": "pytest_dura.driving.roles.performance:DrivingOracle",
}
NEVER = 1e9


def defect(name: str, **params: Any) -> RoleSpec:
    return RoleSpec(f"defects:{name}", params)


@dataclass(frozen=True)
class Row:
    """A situation that ``flag`` must stand for, a sound one, and how the monitor is broken.

    Args:
        role: The monitor.
        flag: How the event's text begins.
        generator: The component of the situation.
        sound: The component of the sound one, in the same world but for its ``sound_ego``, and with
            neither faults nor ``car``.
        broken: Parameters of the broken monitor.
        patched: Constants of its module that are broken instead.
        lead: Seconds before the end of the episode by which the flag must stand.
    """

    role: str
    flag: str
    generator: RoleSpec = RULE_BASED
    sound: RoleSpec = RULE_BASED
    sound_ego: Mapping[str, Any] | None = None
    world: Mapping[str, Any] = field(default_factory=dict)
    faults: Sequence[Mapping[str, Any]] = ()
    duration: float = 10.0
    car: RoleSpec | None = None
    broken: Mapping[str, Any] = field(default_factory=dict)
    patched: Mapping[str, Any] = field(default_factory=dict)
    lead: float = 0.0

    def spec(self, **monitor: Any) -> EpisodeSpec:
        roles = {self.role: RoleSpec(MONITORS[self.role], monitor)}
        spec = spec_of_drive(
            self.world, generator=self.generator, faults=self.faults, duration=self.duration,
            roles=roles,
        )  # fmt: skip
        return spec if self.car is None else replace(spec, simulator=self.car)

    def sound_spec(self) -> EpisodeSpec:
        world = self.world if self.sound_ego is None else {**self.world, "ego": self.sound_ego}
        return replace(self, generator=self.sound, world=world, faults=(), car=None).spec()


PEDESTRIAN = {
    "ego": {"distance": 45.0, "speed": 8.0},
    "pedestrians": [{"id": "P1", "arm": "south", "offset": 8.0, "start": 2.3}],
}
LEADER = {
    "ego": {"distance": 60.0, "speed": 10.0},
    "vehicles": [{"id": "LEADER", "arm": "south", "distance": 52.5, "speed": 10.0}],
}
PRIORITY = {"vehicles": [{"id": "WEST", "arm": "west", "distance": 60.0}]}
VICTIM = {"vehicles": [{"id": "VICTIM", "arm": "east", "distance": 55.0}]}
TURN = {"ego": {"distance": 20.0, "speed": 3.0, "turn": "right"}}
GHOST = {"type": "ghost-obstacle", "target": "lidar", "activation": {"at": 2.0}, "duration": 4.0}
SPOOF = {"type": "trajectory-spoof", "target": "lidar", "activation": {"at": 2.0}, "duration": 5.0}
STOPS_FAR = defect("AtSpeed", speed=8.0, stop_before=25.0)
STOPS_HARD, STOPS = defect("StopsHard"), defect("AtSpeed", speed=8.0, stop_before=5.0)
SLOW = defect("AtSpeed", speed=3.0)
SAFETY, SECURITY, PERFORMANCE = MONITORS

ROWS: dict[str, Row] = {
    "separation": Row(
        SAFETY, "comes within", defect("BlindToPedestrians"), STOPS_FAR, world=PEDESTRIAN,
        broken={"horizon": 0.25}, lead=0.5,
    ),
    "separation, threshold": Row(
        SAFETY, "comes within", defect("BlindToPedestrians"), STOPS_FAR, world=PEDESTRIAN,
        broken={"unsafe": -NEVER},
    ),
    "following": Row(
        SAFETY, "follows LEADER", defect("Steady", maneuver="accelerate"), world=LEADER,
        sound_ego={"distance": 70.0, "speed": 10.0}, broken={"reaction": 0.0},
    ),
    "right_of_way": Row(
        SAFETY, "takes the right of way of WEST", defect("NeverGivesWay"), world=PRIORITY,
        patched={"ENTRY": 0.0},
    ),
    "object_from_nowhere": Row(
        SECURITY, "object_from_nowhere", faults=[GHOST], patched={"RANGE": 0.0}
    ),
    "velocity_contradicts_displacement": Row(
        SECURITY, "velocity_contradicts_displacement", world=VICTIM, faults=[SPOOF],
        broken={"displacement_tolerance": NEVER},
    ),
    "lidar_contradicts_radar": Row(
        SECURITY, "lidar_contradicts_radar", faults=[GHOST], broken={"confirm": 1000}
    ),
    "command_outside_envelope": Row(
        SECURITY, "command_outside_envelope", defect("Steady", acceleration=9.0),
        patched={"MAX_ACCELERATION": NEVER},
    ),
    "acceleration": Row(
        PERFORMANCE, "acceleration", STOPS_HARD, broken={"acceleration_limit": NEVER}
    ),
    "lateral_acceleration": Row(
        PERFORMANCE, "lateral_acceleration", defect("AtSpeed", speed=7.0), SLOW, world=TURN,
        broken={"lateral_limit": NEVER},
    ),
    "jerk": Row(
        PERFORMANCE, "jerk", STOPS_HARD, car=defect("BrakesAtOnce"), broken={"jerk_limit": NEVER}
    ),
    "gridlock": Row(
        PERFORMANCE, "gridlock", STOPS, duration=30.0, broken={"gridlock_after": NEVER}
    ),
    "clearance_time": Row(
        PERFORMANCE, "clearance_time", STOPS, duration=62.0, broken={"clearance_limit": NEVER}
    ),
    "response_time": Row(
        PERFORMANCE, "response_time", defect("Steady", latency=0.5), defect("Steady", latency=0.05),
        broken={"response_limit": NEVER},
    ),
}  # fmt: skip
"""At least one row for each thing that a built-in monitor of driving can flag."""


def flagged(row: Row, episode: Episode) -> bool:
    """Whether an event of the monitor says what the row is about, and in time."""
    assert episode.failure is None
    by = float(episode.time[-1]) - row.lead
    for event in episode.events:
        text = {
            "unsafe": event.detail, "alert": event.detail, "performance_fail": event.subject,
        }.get(event.kind, "")  # fmt: skip
        if event.time <= by and any(part.startswith(row.flag) for part in text.split("; ")):
            return True
    return False


@pytest.mark.parametrize("name", ROWS)
def test_the_monitor_flags_the_defect_and_nothing_sound(name: str) -> None:
    row = ROWS[name]
    assert flagged(row, run_episode(row.spec()))
    assert not flagged(row, run_episode(row.sound_spec()))


@pytest.mark.parametrize("name", ROWS)
def test_a_broken_monitor_misses_the_defect(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row = ROWS[name]
    assert bool(row.broken) != bool(row.patched), "one thing is broken"
    for constant, value in row.patched.items():
        module = {SAFETY: safety, SECURITY: security, PERFORMANCE: performance}[row.role]
        monkeypatch.setattr(module, constant, value)
    assert not flagged(row, run_episode(row.spec(**row.broken)))


def rows_of(role: str) -> set[str]:
    return {name.partition(",")[0] for name, row in ROWS.items() if row.role == role}


def test_every_reason_of_the_safety_monitor_has_a_row() -> None:
    checks = re.findall(r"    def _([a-z]\w*)\(", inspect.getsource(safety.SeparationMonitor))
    assert set(checks) == rows_of(SAFETY)


def test_every_pattern_of_the_security_assessor_has_a_row() -> None:
    patterns = set(re.findall(r'Alert\(\s*"(\w+)"', inspect.getsource(security)))
    assert patterns == rows_of(SECURITY)
    assert all(pattern in (security.PlausibilityAssessor.__doc__ or "") for pattern in patterns)


def test_every_threshold_of_the_performance_oracle_has_a_row() -> None:
    failures = set(re.findall(r'failures\.append\("(\w+)"\)', inspect.getsource(performance)))
    failures |= set(performance.COMFORT_FAILURES.values())
    assert failures == rows_of(PERFORMANCE)
    limits = set(inspect.signature(performance.DrivingOracle).parameters)
    assert limits == {
        name for row in ROWS.values() if row.role == PERFORMANCE for name in row.broken
    }
