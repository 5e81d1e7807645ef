"""AirSimSimulator: a multirotor of AirSim in step, and the domain of its flights.

Places are from where it was put down: x north, y east, altitude upwards; AirSim counts downwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as LateError
from functools import partial
from importlib import import_module
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura.adapters.servers import Kept, Server, project_program
from pytest_dura.core.errors import ActionError, ConfigurationError, shorten
from pytest_dura.core.percepts import Percept
from pytest_dura.core.roles import Generator
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import GeneratorView, Proposal, Tick
from pytest_dura.domains import Action, Domain, Signal
from pytest_dura.faults.model import Channel

_STARTING = 120.0
_LOOK = 2.0
"""Seconds that a server may take to start, and to answer a look whether it is there."""
_TAKE_OFF = 60.0
"""Seconds of wall-clock time that it may take to fly to the start."""
_COMMANDED = 2.0
"""Time steps for which a command holds, so that none ends between two of them."""
_LATE = 0.5
"""Time steps by which the clock may be beyond the tick."""
_FASTEST = 15.0
"""m/s that may be commanded."""


class AirSimError(Exception):
    """Error of the server: it does not answer, or not what was asked for."""


class Flight(BaseModel):
    """What a scenario may say under ``world``."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    altitude: float = Field(default=5.0, gt=0)
    """Of start and goal, in m."""
    goal_x: float = 40.0
    """Where it is to fly, in m north of where it was put down."""
    goal_y: float = 0.0
    """See `goal_x`; east."""
    within: float = Field(default=2.0, gt=0)
    """m from the goal at which it is there."""
    wind_x: float = 0.0
    """m/s, northwards."""
    wind_y: float = 0.0
    """m/s, eastwards."""


class Connection:
    """A server, for one session at a time; its client has a thread and an event loop of its own.

    Args:
        host: Where it listens.
        port: Where it listens.
        program: Command line of a program of the project that starts it; without one it is there.
        timeout: Seconds that an answer may take.
    """

    def __init__(self, host: str, port: int, program: str, timeout: float) -> None:
        self.address, self._timeout = f"{host}:{port}", timeout
        command = project_program(program, "server") if program else ()
        self.server = Server(f"airsim:{self.address}", command, _STARTING)
        self._make = partial(_client, host, port)
        self._thread: ThreadPoolExecutor | None = None
        self._is_lost = False

    @property
    def is_broken(self) -> bool:
        """Whether the server has ended, or did not answer."""
        return self._is_lost or bool(self.server.ending())

    def open(self) -> None:
        """Take or start the server.

        Raises:
            ConfigurationError: If another session has it, or client and server do not fit.
            ServerError: If it does not start.
            AirSimError: If it does not answer.
        """
        self.server.open(self.problem)
        try:
            self._enter()
        except BaseException:  # ctrl-C too must not leave it locked; it is raised again
            self.close()
            raise

    def _enter(self) -> None:
        if problem := self.problem():
            raise AirSimError(f"no server of AirSim answers at {self.address}: {problem}")
        self._connect(self._timeout)
        self._check_versions()

    def problem(self) -> str:
        """Say why the server does not answer; nothing if it does."""
        try:
            self._connect(_LOOK)
            self.ask("ping", seconds=_LOOK)
        except AirSimError as error:
            return str(error)
        finally:
            self._leave()
            self._is_lost = False
        return ""

    def ask(self, name: str, *arguments: Any, seconds: float = 0.0, join: bool = True) -> Any:
        """Call a method of the client.

        Args:
            name: Of the method.
            arguments: Of the method.
            seconds: How long an answer may take; by default as usual.
            join: Whether to wait for the end of what an ``Async`` method has begun.

        Raises:
            AirSimError: If the server does not answer in time, or refuses.
        """
        seconds = seconds or self._timeout

        def call() -> Any:
            answer = getattr(self._client, name)(*arguments)
            return answer.get() if name.endswith("Async") and join else answer

        assert self._thread is not None
        try:
            answer = self._thread.submit(call).result(seconds)
        except LateError:
            self._fail(f"{name}: no answer within {seconds:g} s")
        except Exception as error:  # of the client, whose own classes it does not document
            self._fail(f"{name}: {error}")
        return None if name.endswith("Async") else answer

    def close(self) -> None:
        """Let the world go on by itself, and let go of the server; twice does nothing."""
        if self._thread is not None and not self.is_broken:
            self.ask("simPause", False)
        self._leave()
        self.server.close()

    def _connect(self, seconds: float) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="airsim")
        self._client = self._thread.submit(self._make, seconds).result()

    def _leave(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.submit(self._client.client.close)
            thread.shutdown(wait=False)

    def _fail(self, what: str) -> None:
        self._is_lost = True
        ending = self.server.ending()
        raise AirSimError(f"{what} (AirSim at {self.address})" + (ending and f"; {ending}"))

    def _check_versions(self) -> None:
        ours, theirs = self._client.getClientVersion(), self.ask("getServerVersion")
        least, theirs_least = (
            self._client.getMinRequiredServerVersion(),
            self.ask("getMinRequiredClientVersion"),
        )
        if theirs < least or ours < theirs_least:
            raise ConfigurationError(
                "client and server of AirSim do not fit",
                key="simulator",
                found=f"protocol {ours} of the client, {theirs} of the server",
                expected=f"a server of {least} or later, a client of {theirs_least} or later",
                remedy="update the older one: this client is that of Cosys-AirSim",
            )


CONNECTIONS = Kept(Connection)
"""Connections of this process, which episodes share."""


def _client(host: str, port: int, seconds: float) -> Any:
    """Make a client in the thread that uses it: it takes the event loop that it finds."""
    import asyncio

    loop = asyncio.new_event_loop()
    # What the library does not take from its own tasks is that a wire is cut: `ask` says so.
    loop.set_exception_handler(lambda *_: None)
    asyncio.set_event_loop(loop)
    return _library().MultirotorClient(host, port, timeout_value=math.ceil(seconds) + 1)


def _library() -> Any:
    try:
        return import_module("cosysairsim")
    except ImportError as error:
        raise ConfigurationError(
            f"AirSim cannot be used here: {error}",
            key="simulator",
            found="no cosysairsim",
            expected="the package cosysairsim",
            remedy="pip install 'pytest-dura[airsim]'",
        ) from None


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
        _library()

    @classmethod
    def close_process(cls) -> None:
        """Leave the servers, and end those that were started here."""
        CONNECTIONS.close()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:  # noqa: ARG002 - takes none
        """Fly to the start, and pause there."""
        self._flight = flight = Flight.model_validate(dict(scenario.get("world") or {}))
        self._held, vector = CONNECTIONS.take(*self.key), _library().Vector3r
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
            _library().DrivetrainType.MaxDegreeOfFreedom,
            _library().YawMode(False, 0.0),
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
            isinstance(value, (int, float)) and abs(value) <= _FASTEST for value in given.values()
        ):
            raise ActionError(
                f"{shorten(action)} is no velocity; expected numbers {', '.join(names)} of at most "
                f"{_FASTEST:g} m/s"
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


class FlyThere(Generator):
    """Flies straight to the goal, and as fast as it can stop before what is ahead.

    Args:
        speed: At most, in m/s.
        braking: That it counts on, in m/s2.
        margin: That is left ahead when it stands, in m.
    """

    def __init__(self, *, speed: float = 5.0, braking: float = 2.0, margin: float = 3.0) -> None:
        self._speed, self._braking, self._margin = speed, braking, margin

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose a velocity; without a measured position or distance, standing in the air."""
        at, ahead = view.percept.get("position"), view.percept.get("range")
        goal, still = view.percept["goal"], {"vx": 0.0, "vy": 0.0, "climb": 0.0}
        if at is None or ahead is None:
            return Proposal(still, "no position or distance is measured")
        x, y = goal["x"] - at["x"], goal["y"] - at["y"]
        away, free = math.hypot(x, y), min(ahead["ahead"] - self._margin, 1e3)
        if not all(map(math.isfinite, (away, free, at["altitude"]))):
            return Proposal(still, "what is measured is no number")
        fastest = math.sqrt(2.0 * self._braking * max(min(away, free), 0.0))
        share = min(self._speed, fastest) / max(away, 0.1)
        climb = min(max(goal["altitude"] - at["altitude"], -1.0), 1.0)
        return Proposal({"vx": share * x, "vy": share * y, "climb": climb}, f"{away:.1f} m to fly")


_FRAME = "from where it was put down: x north, y east, upwards"
MULTIROTOR = Domain(
    name="multirotor",
    roles={"generator": "fly_there"},
    world=Flight,
    signals=(
        Signal("x", "m", "north of where it was put down"),
        Signal("y", "m", "east of it"),
        Signal("altitude", "m", "above it"),
        Signal("speed", "m/s", "in all directions", least=0.0),
        Signal("ahead", "m", "to what is ahead, by the distance sensor before any fault"),
        Signal("to_goal", "m", "to the goal, seen from above", least=0.0),
        Signal("collided", "truth", "whether it has struck anything"),
    ),
    percept_signals=(Signal("ahead", "m", "to what is ahead"),),
    actions=tuple(
        Action(name, "m/s", meaning, -_FASTEST, _FASTEST)
        for name, meaning in (("vx", "northwards"), ("vy", "eastwards"), ("climb", "upwards"))
    ),
    channels={
        "position": Channel("numbers", ("x", "y", "altitude"), units=("m",) * 3, frame=_FRAME,
                            meaning="as AirSim's estimator has it"),
        "velocity": Channel("numbers", ("vx", "vy", "climb"), units=("m/s",) * 3, frame=_FRAME,
                            meaning="as AirSim's estimator has it"),
        "range": Channel("numbers", ("ahead",), units=("m",), meaning="a distance sensor"),
        "goal": Channel("numbers", ("x", "y", "altitude"), units=("m",) * 3, frame=_FRAME,
                        meaning="where it is to fly"),
    },
    fault_targets={"number": "range.ahead", "any": "range", "command": "command.vx"},
)  # fmt: skip
"""Flights of one multirotor to a place."""
