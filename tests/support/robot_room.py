"""The robot of `ros_robot.py` in one process, and what a scenario of it needs."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from ros_robot import Robot, wanted_speed

from pytest_dura import Action, Channel, Domain, Generator, Proposal, Signal, Simulator, Tick
from pytest_dura.adapters.ros2.simulator import Ros2Simulator

BINDING = """\
domain: robot_room:ROOM
topics:
  /odom: nav_msgs/msg/Odometry
  /distance: std_msgs/msg/Float64
  /cmd_vel: geometry_msgs/msg/Twist
percept:
  - {name: odometry.speed, unit: m/s, topic: /odom, field: twist.twist.linear.x}
  - {name: sonar.distance, unit: m, topic: /distance, field: data}
command:
  - {name: speed, unit: m/s, topic: /cmd_vel, field: linear.x}
truth:
  - {name: x, unit: m, topic: /odom, field: pose.pose.position.x}
reset: /reset
"""


class Room(Simulator):
    def reset(self, scenario, seed):
        self._robot = Robot((scenario.get("world") or {}).get("lag", 0.3))
        self._index = 0
        return self._tick()

    def step(self, action):
        self._robot.move(action, self.time_step)
        self._index += 1
        return self._tick()

    def signals(self, ticks):
        return {"x": np.array([tick.truth["x"] for tick in ticks])}

    def fallback_action(self):
        return 0.0

    def _tick(self):
        channels = {
            "odometry": {"speed": self._robot.speed},
            "sonar": {"distance": self._robot.distance},
        }
        truth = MappingProxyType({"x": self._robot.x})
        return Tick(self._index, self._index * self.time_step, truth, channels)


class Approach(Generator):
    def propose(self, view):
        return Proposal(wanted_speed(view.percept["sonar"]["distance"]))


class RosRoom(Ros2Simulator):
    tolerances = {"x": 1e-9}  # noqa: RUF012 - declared as a class variable by the base


ROOM = Domain(
    name="room",
    roles={"generator": "robot_room:Approach"},
    signals=(Signal("x", "m", "towards the wall"),),
    actions=(Action("speed", "m/s", "wanted", -1.0, 1.0),),
    channels={
        "odometry": Channel("numbers", ("speed",), units=("m/s",)),
        "sonar": Channel("numbers", ("distance",), units=("m",)),
    },
    fault_targets={"number": "sonar.distance", "any": "sonar", "command": "command.speed"},
)
