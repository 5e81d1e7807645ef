"""AirSimSimulator: a multirotor of AirSim in step. AirSim counts downwards."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.adapters.airsim.flights import FASTEST, MULTIROTOR, Flight
from pytest_dura.adapters.airsim.server import CONNECTIONS, AirSimError, library
from pytest_dura.core.errors import ActionError, shorten
from pytest_dura.core.percepts import Percept
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick

_TAKE_OFF = 60.0
"""Seconds of wall-clock time that it may take to fly to the start."""
_COMMANDED = 2.0
"""Time steps for which a command holds, so that none ends between two of them."""
_LATE = 0.5
"""Time steps by which the clock may be beyond the tick."""


class AirSimSimulator(Simulator):
    """A flight from above the place where AirSim puts it down to the scenario's goal.

    The world is paused between ticks. Nothing in AirSim takes a seed: runs are draws. One process,
    pytest's own, runs them. A server that is lost in an episode is found, or started, for the next.

    Args:
        host: Of the server.
        port: Of the server.
        server: Command line of a program of the project that starts it where nothing answers.
        vehicle: Its name in AirSim's settings; by default the first.
        distance_sensor: Name of the distance sensor, which looks ahead; by default the first.
        timeout: Seconds of wall-clock time that the server may take to answer.
    """

    instances = "one"
    deterministic: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False
    tolerances: ClassVar[Mapping[str, float]] = {"x": 0.2, "y": 0.2, "altitude": 0.2}

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 41451,
        server: str = "",
        vehicle: str = "",
        distance_sensor: str = "",
        timeout: float = 20.0,
    ) -> None:
        self.key = host, port, server, timeout
        """Of the connection that its episodes share."""
        self._vehicle, self._sensor, self._timeout = vehicle, distance_sensor, timeout
        self._index = 0

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world with all defaults filled in."""
        return Flight.model_validate(dict(world)).model_dump()

    @classmethod
    def open_process(cls) -> None:
        """Check that the library is there; a server is found at the first reset."""
        library()

    @classmethod
    def close_process(cls) -> None:
        """Leave the servers, and end those that were started here."""
        CONNECTIONS.close()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - takes none
        """Fly to the start, and pause there."""
        self._flight = flight = Flight.model_validate(dict(scenario.get("world") or {}))
        self._held, vector = CONNECTIONS.take(*self.key), library().Vector3r
        ask, name = self._held.ask, self._vehicle
        ask("simPause", False)
        ask("reset")
        ask("enableApiControl", True, name)
        ask("armDisarm", True, name)
        ask("simSetWind", vector(flight.wind_x, flight.wind_y, 0.0))
        fly = partial(ask, seconds=_TAKE_OFF)
        fly("takeoffAsync", _TAKE_OFF, name)
        fly("moveToZAsync", -flight.altitude, 2.0)
        fly("hoverAsync", name)
        ask("simPause", True)
        self._index, self._start, self._struck = 0, 0.0, self._collision().time_stamp
        state = ask("getMultirotorState", name)
        self._start = state.timestamp / 1e9
        return self._tick(state)

    def step(self, action: Any) -> Tick:
        """Command a velocity, and let the world go on to the next tick.

        Raises:
            AirSimError: If the clock does not come to the tick, or is beyond it.
        """
        ask, name, dt = self._held.ask, self._vehicle, self.time_step
        self._index += 1
        due, now = self._start + self._index * dt, self._now
        velocity = action["vx"], action["vy"], -action["climb"]
        freely, facing = (
            library().DrivetrainType.MaxDegreeOfFreedom,
            library().YawMode(False, 0.0),
        )
        held = _COMMANDED * dt
        ask("moveByVelocityAsync", *velocity, held, freely, facing, name, join=False)
        ask("simContinueForTime", due - now)
        state = ask("getMultirotorState", name)
        off = state.timestamp / 1e9 - due
        if abs(off) > _LATE * dt:
            where = "beyond" if off > 0.0 else "before"
            raise AirSimError(f"AirSim's clock is {abs(off):.3f} s {where} the tick: is it paused?")
        return self._tick(state)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Return the signals of the truth."""
        names = [signal.name for signal in MULTIROTOR.signals or ()]
        return {name: np.array([float(tick.truth[name]) for tick in ticks]) for name in names}

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, NDArray[np.float64]]:
        """Return the measured distance; NaN where a fault removed it."""
        seen = [(percept.get("range") or {}).get("ahead", math.nan) for percept in percepts]
        return {"ahead": np.array(seen, dtype=np.float64)}

    def check_action(self, action: Any) -> dict[str, float]:
        """Return the velocity that is commanded: numbers ``vx``, ``vy``, ``climb``, in m/s.

        Raises:
            ActionError: For anything else.
        """
        names = [each.name for each in MULTIROTOR.actions]
        given = action if isinstance(action, Mapping) else {}
        if set(given) != set(names) or not all(
            isinstance(value, (int, float)) and abs(value) <= FASTEST for value in given.values()
        ):
            raise ActionError(
                f"{shorten(action)} is no velocity; expected numbers {', '.join(names)} of at most "
                f"{FASTEST:g} m/s"
            )
        return {name: float(given[name]) for name in names}

    def fallback_action(self) -> dict[str, float]:
        """Standing in the air."""
        return dict.fromkeys((each.name for each in MULTIROTOR.actions), 0.0)

    def _collision(self) -> Any:
        return self._held.ask("simGetCollisionInfo", self._vehicle)

    def _tick(self, state: Any) -> Tick:
        self._now = state.timestamp / 1e9
        motion = state.kinematics_estimated
        place, velocity = motion.position, motion.linear_velocity
        ahead = self._held.ask("getDistanceSensorData", self._sensor, self._vehicle).distance
        collision = self._collision()
        struck = collision.has_collided and collision.time_stamp > self._struck
        numbers = {"x": place.x_val, "y": place.y_val, "altitude": -place.z_val}
        flight = self._flight
        away = math.hypot(flight.goal_x - place.x_val, flight.goal_y - place.y_val)
        truth = {
            **numbers,
            "speed": math.hypot(velocity.x_val, velocity.y_val, velocity.z_val),
            "ahead": ahead,
            "to_goal": away,
            "collided": struck,
        }
        speeds = {"vx": velocity.x_val, "vy": velocity.y_val, "climb": -velocity.z_val}
        channels = {
            "position": MappingProxyType(numbers),
            "velocity": MappingProxyType(speeds),
            "range": MappingProxyType({"ahead": ahead}),
            "goal": MappingProxyType({"x": flight.goal_x, "y": flight.goal_y,
                                      "altitude": flight.altitude}),
        }  # fmt: skip
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth=MappingProxyType(truth),
            channels=MappingProxyType(channels),
            goal=away <= flight.within and not struck,
            critical=f"it has struck {collision.object_name}" if struck else None,
        )
