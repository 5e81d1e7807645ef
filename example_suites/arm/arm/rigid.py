"""The cell on MuJoCo: inertia and motors of the arm, contacts, and how hard these are."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from arm.cell import BRAKING, CLOSE, PARTS, Cell, Joints, Person, arm_speed
from pytest_dura import ConfigurationError, Tick

MODEL = Path(__file__).with_name("arm.xml")
PERIOD, STEPS = 0.01, 10  # s of the arm's controller, and MuJoCo's steps in it
BESIDE = 0.15  # m, from where on each step is looked at: tool and hand move 0.05 m in a period
LEAD = {"trunk": 0.4, "hand": 0.1}  # s by which a person aims ahead, as much as each part lags
TOOL, LIMB = 1.0, 0.75  # kg without a part in it; m of a limb behind the hand
PARTED = 0.01  # m, from where on a contact is over; within it a hand that bounces is the same one


class RigidCell(Cell):
    """The same cell as rigid bodies: ``--dura-simulator=arm.mujoco``.

    Motors have limits, so that a heavy part is stopped later. Trunk and hand have the masses and
    stiffnesses of ISO/TS 15066, and the force of a contact is that of their compressed tissue.
    """

    imports = ("mujoco",)
    lacks = {}  # noqa: RUF012

    def _begin(self) -> Person:
        try:
            import mujoco
        except ImportError:
            raise ConfigurationError(
                "the arm's rigid bodies need the package mujoco",
                key="simulator",
                remedy="pip install 'arm-dura[mujoco]', or take the simulator arm, whose "
                "kinematics need nothing",
            ) from None
        self._periods = round(self.time_step / PERIOD)
        if abs(self._periods * PERIOD - self.time_step) > 1e-9:
            raise ConfigurationError("a tick is no whole number of the controller's periods",
                                     key="time_step", found=self.time_step,
                                     expected=f"a multiple of {PERIOD} s")  # fmt: skip
        world, text = self._world, MODEL.read_text()
        limb = f"{LIMB * math.cos(world.bearing)} {LIMB * math.sin(world.bearing)}"
        for name, value in {"@TOOL@": TOOL + world.payload, "@LIMB@": limb}.items():
            text = text.replace(name, str(value))
        self._step, self._model = mujoco.mj_step, mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._due: str | None = None
        self._speed, self._force, self._touches = 0.0, 0.0, False
        trunk, hand, _ = world.person(0.0)
        self._data.qpos[:2], self._data.qpos[2:4], self._data.qpos[6:8] = self._angles, trunk, hand
        return self._look(self._person())

    def _person(self) -> Person:
        """Trunk and hand where their skin is, and the speed of the faster one."""
        places, rates = self._data.qpos, self._data.qvel
        fastest = max(np.hypot(*rates[2:4]), np.hypot(*rates[6:8]))
        return places[2:4] + places[4:6], places[6:8] + places[8:10], float(fastest)

    def _move(self, action: Joints) -> Person:
        """Lead the motors' set points as the brakes of the kinematics do, and the person's aims."""
        data, now, self._force, touched = self._data, self._index * self.time_step, 0.0, False
        is_close = self._near < CLOSE
        for part in range(1, self._periods + 1):
            change = np.array(action) - data.ctrl[:2]
            data.ctrl[:2] += np.clip(change, -BRAKING * PERIOD, BRAKING * PERIOD)
            for place, name in enumerate(PARTS):
                aim = self._world.person(now + part * PERIOD + LEAD[name])[place]
                data.ctrl[2 + 2 * place : 4 + 2 * place] = aim
            parts = STEPS if self._near < BESIDE else 1
            for _ in range(parts):
                speed = arm_speed(data.qpos[1], data.qvel[:2])
                self._step(self._model, data, nstep=STEPS // parts)
                if data.ncon and not self._touches:
                    self._touches, self._speed = True, speed
                if data.ncon:
                    touched = True
                    for place, (_, stiffness) in enumerate(PARTS.values()):
                        skin = np.hypot(*data.qpos[4 + 4 * place : 6 + 4 * place])
                        self._force = max(self._force, float(stiffness * skin))
            if is_close or part == self._periods:
                self._angles, self._rates = data.qpos[:2].copy(), data.qvel[:2].copy()
                person = self._look(self._person())
            self._touches = self._touches and self._near < PARTED
            if self._touches:
                self._speed = max(self._speed, arm_speed(data.qpos[1], data.ctrl[:2]))
        self._near = 0.0 if touched else max(self._near, 1e-6)
        return person

    def _touch(self) -> tuple[float, float]:
        """Speed of the arm, in a contact that at which it began, and the greatest force."""
        in_contact = self._touches or self._near <= 0.0
        return self._speed if in_contact else super()._touch()[0], self._force

    def _tick(self, person: Person) -> Tick:
        """Report a blow a tick later, when its force has been at its greatest."""
        tick, due = super()._tick(person), self._due
        self._due = tick.critical
        return replace(tick, critical=due)
