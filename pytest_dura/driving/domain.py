"""The domain ``driving``: what it declares to files, faults, searches and reports.

Its simulator, roles and fault types are registered beside it, by entry points.
"""

from __future__ import annotations

from collections.abc import Mapping

from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.domains import Action, Domain, Signal
from pytest_dura.driving.bodies import GAP_CAP, TTC_CAP
from pytest_dura.driving.criticality import DECELERATION_CAP, HEADWAY_CAP, NEAR, PET_CAP
from pytest_dura.driving.explanations import MEANINGS, SIGNALS
from pytest_dura.driving.maneuvers import MAX_ACCELERATION, MAX_BRAKING
from pytest_dura.driving.scenario import DrivingWorld, concrete_world
from pytest_dura.driving.sensors import CHANNELS, FAULT_TARGETS
from pytest_dura.driving.signals import NAMES, PERCEPT_NAMES
from pytest_dura.driving.traffic_rules import BRAKING_CAP, CAP, LEADER_CAP

_ABOUT: Mapping[str, tuple[str, str]] = {
    "gap": ("m", f"least distance between footprints; 0 on contact, at most {GAP_CAP:g}"),
    "ttc": ("s", f"time to collision at constant velocity; at most {TTC_CAP:g}"),
    "leader_gap": ("m", f"to the bumper of the car ahead in its path; at most {LEADER_CAP:g}"),
    "following_margin": (
        "m", f"beyond the safe distance to its leader; {LEADER_CAP:g} without a leader",
    ),
    "priority_arrival": (
        "s", f"until the next car with priority reaches the conflict; at most {CAP:g}",
    ),
    "priority_braking": (
        "m/s2", f"braking that its crossing asks of those with priority; at most {BRAKING_CAP:g}",
    ),
    "gap_time": ("s", "least time between the ego leaving a conflict and a car with priority"),
    "speed": ("m/s", "of the ego along its heading"),
    "acceleration": ("m/s2", "of the ego along its heading"),
    "jerk": ("m/s3", "change of the acceleration"),
    "lateral_acceleration": ("m/s2", "across the ego, clockwise positive"),
    "lateral_jerk": ("m/s3", "change of the lateral acceleration"),
    "progress": ("m", "along the route since the start"),
    "in_conflict_zone": (TRUTH, "any part of the ego is past the stop line and before the exit"),
    "collided": (TRUTH, "in contact with anything, whatever caused it"),
    "struck": (TRUTH, "in contact with what ran into the ego"),
    "struck_standing": (TRUTH, "in contact with what ran into the ego while it stood"),
    "cleared": (TRUTH, "the ego's rear has left the junction, from then on"),
    "command_error": ("m/s2", "between the acceleration and the commanded one"),
    "background_crashes": ("1", "crashes so far among the other cars"),
    "time_headway": (
        "s", f"until its front is where the leader's rear is now; at most {HEADWAY_CAP:g}",
    ),
    "drac": (
        "m/s2", ("deceleration that avoids a crash with its leader, which keeps its speed; "
        f"at most {DECELERATION_CAP:g}"),
    ),
    "required_deceleration": (
        "m/s2", ("least braking with which it stays behind all that is in its straight path or "
        f"crosses it at constant velocity; at most {DECELERATION_CAP:g}"),
    ),
    "pet": (
        "s", ("post-encroachment time: from one of two on crossing courses leaving the place where "
        f"the ego is until the other reaches it; at most {PET_CAP:g}"),
    ),
    "near_misses": (
        "1", f"objects so far whose time to collision fell below {NEAR:g} s without contact",
    ),
}  # fmt: skip
"""Unit and meaning of each ground-truth signal."""
_RANGES: Mapping[str, tuple[float | None, float | None]] = {
    "gap": (0.0, GAP_CAP),
    "ttc": (0.0, TTC_CAP),
    "leader_gap": (0.0, LEADER_CAP),
    "following_margin": (None, LEADER_CAP),
    "priority_arrival": (0.0, CAP),
    "priority_braking": (0.0, BRAKING_CAP),
    "gap_time": (-CAP, CAP),
    "command_error": (0.0, None),
    "background_crashes": (0.0, None),
    "time_headway": (0.0, HEADWAY_CAP),
    "drac": (0.0, DECELERATION_CAP),
    "required_deceleration": (0.0, DECELERATION_CAP),
    "pet": (0.0, PET_CAP),
    "near_misses": (0.0, None),
}
"""Least and greatest value of those that have ends."""


def _signal(name: str) -> Signal:
    return Signal(name, *_ABOUT[name], *_RANGES.get(name, ()))


def _of_proposals(name: str) -> Signal:
    if name in MEANINGS:
        return Signal(name, TRUTH, MEANINGS[name])
    return Signal(name, "s", "since the percept behind the last decision of the component's own")


DRIVING = Domain(
    name="driving",
    roles={
        "generator": "rule_based",
        "safety_monitor": "separation",
        "security_assessor": "plausibility",
        "fault_injector": "campaign",
        "performance_oracle": "driving",
        "recovery_planner": "emergency_brake",
    },
    # Parameters are recorded as they are, so functions are named by their import path.
    parameters={"stl": {"signals": "pytest_dura.driving.signals:percept_at"}},
    world=DrivingWorld,
    signals=tuple(map(_signal, NAMES)),
    percept_signals=tuple(map(_signal, PERCEPT_NAMES)),
    proposal_signals=tuple(map(_of_proposals, SIGNALS)),
    actions=(
        Action(
            "acceleration",
            "m/s2",
            "of the ego along its heading; negative to brake",
            least=-MAX_BRAKING,
            greatest=MAX_ACCELERATION,
        ),
    ),
    channels=CHANNELS,
    fault_targets=FAULT_TARGETS,
    provokers=("aggressive", "tactical"),
    concrete=concrete_world,
)
