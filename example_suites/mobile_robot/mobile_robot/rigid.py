"""The world of the robot on MuJoCo: wheels that are driven and may slip, contacts, rays."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from mobile_robot.world import ANGLES, RAYS, REACH, RobotWorld, Wheels
from pytest_dura import ConfigurationError, sealed

MODEL = Path(__file__).with_name("robot.xml")
STEP = 0.005
"""s; MuJoCo's step, of which a tick has a whole number."""
WHEEL, HEIGHT = 0.06, 0.11
"""m; radius of a wheel, and height of the lidar."""
GRIP = 0.8
"""Coefficient of friction between wheels and ground that holds."""
WALL = 0.05
"""m; half the thickness of a wall."""


def model_of(world: Any, discs: np.ndarray, grip: float) -> str:
    """Return the model of a world: the robot's file, with ground, walls and posts."""
    length, width = world.length / 2, world.width / 2
    walls = (
        (length, -WALL, length, WALL), (length, 2 * width + WALL, length, WALL),
        (-WALL, width, WALL, width), (2 * length + WALL, width, WALL, width),
    )  # fmt: skip
    things = [
        f'<geom type="box" pos="{x} {y} 0.25" size="{half_x} {half_y} 0.25"/>'
        for x, y, half_x, half_y in walls
    ]
    things += [
        f'<geom type="cylinder" pos="{x} {y} 0.25" size="{radius} 0.25"/>'
        for x, y, radius in discs.tolist()
    ]
    half = world.heading / 2
    values = {
        "@STEP@": STEP, "@GRIP@": grip, "@THINGS@": "\n    ".join(things),
        "@PLACE@": f"{world.x} {world.y} {WHEEL}",
        "@TURN@": f"{math.cos(half)} 0 0 {math.sin(half)}",
    }  # fmt: skip
    text = MODEL.read_text()
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


class RigidRobotWorld(RobotWorld):
    """The same robot, place and signals as rigid bodies: ``--dura-simulator=mobile_robot.mujoco``.

    ``slip`` is the greatest share of the wheels' grip that the ground of an episode has lost. A
    contact is one of MuJoCo's, of robot and wall, post or plant.
    """

    imports = ("mujoco",)

    def _begin(self) -> None:
        try:
            import mujoco
        except ImportError:
            raise ConfigurationError(
                "the robot's rigid bodies need the package mujoco",
                key="simulator",
                remedy="pip install 'mobile-robot-dura[mujoco]', or take the simulator "
                "mobile_robot, whose kinematics need nothing",
            ) from None
        steps = self.time_step / STEP
        if abs(steps - round(steps)) > 1e-9:
            raise ConfigurationError(
                "a tick is no whole number of MuJoCo's steps",
                key="time_step",
                found=self.time_step,
                expected=f"a multiple of {STEP} s",
            )
        self._mujoco, self._steps = mujoco, round(steps)
        grip = GRIP * (1.0 - self._slips.uniform(0.0, self._world.slip))
        self._model = mujoco.MjModel.from_xml_string(model_of(self._world, self._discs, grip))
        self._data = mujoco.MjData(self._model)
        self._robot = self._model.body("robot").id
        self._parts = {self._robot, self._model.body("left").id, self._model.body("right").id}
        self._touches = False
        mujoco.mj_forward(self._model, self._data)

    def _move(self, action: Wheels) -> None:
        """Drive the wheels; a touch at any of MuJoCo's steps is one of the tick."""
        data = self._data
        data.ctrl[:] = np.array(action) / WHEEL
        for _ in range(self._steps):
            self._mujoco.mj_step(self._model, data)
            self._touches = self._touches or self._is_touching()
        self._x, self._y = data.qpos[:2].tolist()
        w, x, y, z = data.qpos[3:7].tolist()
        self._heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        ahead = math.cos(self._heading), math.sin(self._heading)
        before, self._speed = self._speed, float(np.dot(data.qvel[:2], ahead))
        self._acceleration = (self._speed - before) / self.time_step
        self._turning = float(data.qvel[5])
        self._wheels = Wheels(*(WHEEL * data.qvel[6:8]).tolist())

    def _is_touching(self) -> bool:
        data, model = self._data, self._model
        for geom1, geom2 in data.contact.geom[: data.ncon].tolist():
            bodies = {int(model.geom_bodyid[geom1]), int(model.geom_bodyid[geom2])}
            is_ground = "ground" in (model.geom(geom1).name, model.geom(geom2).name)
            if bodies & self._parts and not is_ground:
                return True
        return False

    def _gap(self) -> float:
        return 0.0 if self._touches else max(super()._gap(), 1e-6)

    def _ranges(self) -> np.ndarray:
        """Range of each ray by MuJoCo; rays start in the robot's middle, and pass through it."""
        angles = ANGLES + self._heading
        rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RAYS)])
        start, hits = np.array([self._x, self._y, HEIGHT]), np.zeros(1, np.int32)
        group = np.array([1, 0, 0, 0, 0, 0], np.uint8)  # things; the robot's parts are of group 1
        ranges = [
            self._mujoco.mj_ray(self._model, self._data, start, ray, group, 1, -1, hits)
            for ray in rays
        ]
        far = np.array(ranges)
        return sealed(np.where((far < 0.0) | (far > REACH), REACH, far))
