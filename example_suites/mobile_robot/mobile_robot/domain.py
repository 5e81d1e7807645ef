"""What the domain declares to files, faults, searches and reports."""

from __future__ import annotations

from mobile_robot.world import RAYS, REACH, TOP_SPEED, World
from pytest_dura import Action, Channel, Domain, Signal

_GAP = "between the body and the nearest thing; 0 on contact"
_BODY = "robot: ahead; yaw and bearing clockwise"

MOBILE_ROBOT = Domain(
    name="mobile_robot",
    roles={
        "generator": "follow_gap",
        "safety_monitor": "braking",
        "recovery_planner": "stop",
    },
    provokers=("hasty",),
    world=World,
    signals=(
        Signal("gap", "m", _GAP),
        Signal("contact", "0 or 1", "it touches something"),
        Signal("speed", "m/s", "of the body, ahead positive"),
        Signal("goal_distance", "m", "from the middle of the robot to the goal"),
        Signal("arrived", "0 or 1", "it has been at the goal"),
        Signal("slipping", "m/s", "between the speed of the wheels and that of the body"),
    ),
    percept_signals=(
        Signal("speed", "m/s", "by odometry"),
        Signal("gap", "m", "by lidar"),
    ),
    proposal_signals=(),
    actions=(
        Action("left", "m/s", "speed of the left wheel", -TOP_SPEED, TOP_SPEED),
        Action("right", "m/s", "speed of the right wheel", -TOP_SPEED, TOP_SPEED),
    ),
    channels={
        "lidar": Channel(
            "array",
            frame=f"robot: {RAYS} rays clockwise from behind, at most {REACH:g} m",
            meaning="range of each ray in m",
        ),
        "odometry": Channel(
            "numbers", ("speed", "yaw_rate"), units=("m/s", "rad/s"), frame=_BODY,
            meaning="as the wheels turn",
        ),
        "imu": Channel(
            "numbers", ("acceleration", "yaw_rate"), units=("m/s2", "rad/s"), frame=_BODY,
            meaning="as the body moves",
        ),
        "goal": Channel(
            "numbers", ("distance", "bearing"), units=("m", "rad"), frame=_BODY,
            meaning="the beacon at the goal",
        ),
    },
    fault_targets={"number": "odometry.speed", "any": "lidar", "command": "command.left"},
)  # fmt: skip
