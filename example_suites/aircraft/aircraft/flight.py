"""JSBSim's Cessna 172P on a course to the north, in the units that pilots read: ft, kt, ft/min."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jsbsim
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import ActionError, Line, Measure, Percept, Scene, Simulator, Tick, Tracks

RATE = 60  # Hz, of the flight dynamics
STALL = math.degrees(0.28)  # angle of attack of the greatest lift in the table of `c172p.xml`
SEA_LEVEL, SOUND = 101325.0, 661.48  # Pa, kt; of the standard atmosphere
EARTH, FOOT, MILE = 6378137.0, 0.3048, 1852.0  # m
PSF = 47.880259  # Pa in a pound per square foot
RADIO_RANGE = 2500.0  # ft; what is higher, the radio altimeter reports as this high


class Controls(NamedTuple):
    """The action: elevator and aileron from -1 to 1 (nose down, right), throttle from 0 to 1."""

    elevator: float
    aileron: float
    throttle: float


class Air(NamedTuple):
    """Pressures at the pitot tube and the static port in Pa, and the vane's angle in deg."""

    pitot: float
    static: float
    alpha: float

    @property
    def speed(self) -> float:
        """Calibrated airspeed in kt, as an air data computer makes it of both pressures."""
        impact = max(self.pitot - self.static, 0.0) / SEA_LEVEL
        return SOUND * math.sqrt(5.0 * ((impact + 1.0) ** (2.0 / 7.0) - 1.0))

    @property
    def altitude(self) -> float:
        """Altitude in ft at which the standard atmosphere has the static pressure."""
        return 145366.45 * (1.0 - (max(self.static, 1.0) / SEA_LEVEL) ** 0.190284)


class Attitude(NamedTuple):
    """Angles in deg, rates in deg/s: nose up, right wing down, clockwise from the course."""

    pitch: float
    bank: float
    heading: float
    pitch_rate: float
    roll_rate: float


class Gps(NamedTuple):
    """Place in m from where the course begins, altitude in ft, track in deg."""

    north: float
    east: float
    altitude: float
    track: float


class Panel(NamedTuple):
    """Height above the ground by radio altimeter, and the altitude assigned by radio, in ft."""

    height: float
    assigned: float


class World(BaseModel):
    """Where the flight begins, what is assigned, the air and the ground."""

    model_config = ConfigDict(extra="forbid")
    altitude: float = Field(4000.0, ge=500, le=10000, description="At first, in ft.")
    assigned: float = Field(4000.0, ge=500, le=10000, description="Altitude to hold, in ft.")
    airspeed: float = Field(85.0, ge=65, le=120, description="At first, calibrated, in kt.")
    heading: float = Field(0.0, ge=-90, le=90, description="At first, in deg from the course.")
    wind: float = Field(0.0, ge=-30, le=30, description="Towards the east, in kt.")
    turbulence: float = Field(0.0, ge=0, le=7, description="MIL-F-8785C: 3 light, 4 moderate.")
    ground: float = Field(500.0, ge=0, description="Elevation, in ft.")
    ridge: float = Field(0.0, ge=0, description="Height of a ridge across the course, in ft.")
    ridge_at: float = Field(5000.0, gt=0, description="Where it stands, in m along the course.")

    def elevation(self, north: float) -> float:
        """Elevation of the ground in ft; the ridge is 2 km wide at 37 % of its height."""
        return self.ground + self.ridge * math.exp(-(((north - self.ridge_at) / 1000.0) ** 2))


class C172(Simulator):
    """Flies JSBSim's `c172p` from trimmed level flight over a ground of our own."""

    imports = ("jsbsim",)
    measures = (
        Measure("stalled", "stall", "runs in which it stalled", lambda run: run.ever("stalled"),
                "share", "", ("stalled",), "grave", "stalled", "stall"),
        Measure("least_stall_margin", "stall margin", "least stall margin",
                lambda run: float(run.signal("stall_margin").min()), "mean", "deg"),
        Measure("greatest_sink", "sink", "greatest rate of descent",
                lambda run: float(-run.signal("vertical_speed").min()), "mean", "ft/min"),
    )  # fmt: skip

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the scenario's `world` with its defaults."""
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin in trimmed level flight."""
        self._world = world = World.model_validate(scenario["world"])
        jsbsim.FGJSBBase().debug_lvl = 0  # no banner
        self._model = model = jsbsim.FGFDMExec(None)
        model.load_model("c172p")
        model.set_dt(1.0 / RATE)
        model["simulation/randomseed"] = seed % 2**31
        model["ic/h-sl-ft"], model["ic/vc-kts"] = world.altitude, world.airspeed
        model["ic/psi-true-deg"] = world.heading % 360.0
        model.run_ic()
        model["propulsion/set-running"] = -1  # all engines
        model["fcs/mixture-cmd-norm"] = 0.9
        model["simulation/do_simple_trim"] = 1  # full
        model["atmosphere/wind-east-fps"] = world.wind * MILE / 3600.0 / FOOT
        model["atmosphere/turb-type"] = 3 if world.turbulence else 0  # of MIL-F-8785C
        model["atmosphere/turbulence/milspec/severity"] = world.turbulence
        model["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 8.0 * world.turbulence
        self._trim, self._index = model["fcs/aileron-cmd-norm"], 0
        return self._tick()

    def step(self, action: Controls) -> Tick:
        """Fly for a time step."""
        self._model["fcs/elevator-cmd-norm"] = action.elevator
        self._model["fcs/aileron-cmd-norm"] = self._trim + action.aileron
        self._model["fcs/throttle-cmd-norm"] = action.throttle
        for _ in range(round(self.time_step * RATE)):
            self._model.run()
        self._index += 1
        return self._tick()

    def check_action(self, action: Any) -> Controls:
        """Return what the controls can do of it."""
        if not isinstance(action, Controls):
            raise ActionError(f"the aircraft takes Controls, and no {action!r}")
        super().check_action(tuple(action))
        elevator, aileron, throttle = (min(1.0, max(-1.0, float(part))) for part in action)
        return Controls(elevator, aileron, max(0.0, throttle))

    def fallback_action(self) -> Controls:
        """Leave the aircraft to its trim, at three quarters of its power."""
        return Controls(0.0, 0.0, 0.75)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """See the domain for what they mean."""
        names = [name for name in ticks[0].truth if name not in ("north", "pitch")]
        return {name: np.array([tick.truth[name] for tick in ticks]) for name in names}

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, Any]:
        """Return what the air data computer makes of its two pressures."""
        air = [percept["air"] for percept in percepts]
        return {"airspeed": np.array([each.speed for each in air]),
                "altitude": np.array([each.altitude for each in air])}  # fmt: skip

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
        """Return the flight from the side; the percept is where GPS and static port put it."""
        poses = np.zeros((2, len(ticks), 1, 6), np.float32)
        poses[..., 4:] = 8.3, 2.7  # its length and height
        for row, (tick, percept) in enumerate(zip(ticks, percepts, strict=True)):
            truth, seen = tick.truth, (percept["gps"].north, percept["air"].altitude)
            for kind, (north, altitude) in enumerate([(truth["north"], truth["altitude"]), seen]):
                motion = -math.radians(truth["pitch"]), truth["airspeed"] * MILE / 3600.0
                poses[kind, row, 0, :4] = north, -altitude * FOOT, *motion  # y points down
        way = np.linspace(0.0, max(float(poses[0, -1, 0, 0]), 1.0), 100)
        ground = [(north, -self._world.elevation(north) * FOOT) for north in way]
        route = [(north, -self._world.assigned * FOOT) for north in way[[0, -1]]]
        lines = (Line("edge", np.float32(ground)), Line("route", np.float32(route)))
        return Scene(lines, *(Tracks(("c172p",), each) for each in poses), ego="c172p")

    def _tick(self) -> Tick:
        model, world = self._model, self._world
        north, east = (EARTH * model[f"position/{key}"] for key in ("lat-gc-rad", "long-gc-rad"))
        altitude, alpha = model["position/h-sl-ft"], model["aero/alpha-deg"]
        speed, height = model["velocities/vc-kts"], altitude - world.elevation(north)
        pitch, bank, heading = (model[f"attitude/{key}-deg"] for key in ("theta", "phi", "psi"))
        heading = math.remainder(heading, 360.0)
        rates = (math.degrees(model[f"velocities/{axis}-rad_sec"]) for axis in "qp")
        ways = (model[f"velocities/v-{way}-fps"] for way in ("east", "north"))
        static = PSF * model["atmosphere/P-psf"]
        impact = SEA_LEVEL * ((1.0 + 0.2 * (speed / SOUND) ** 2) ** 3.5 - 1.0)
        truth = {
            "north": north, "pitch": pitch, "altitude": altitude, "height": height,
            "altitude_error": altitude - world.assigned, "airspeed": speed, "alpha": alpha,
            "vertical_speed": 60.0 * model["velocities/h-dot-fps"], "heading": heading,
            "bank": bank, "cross_track": east / MILE, "stall_margin": STALL - alpha,
            "stalled": float(alpha >= STALL),
        }  # fmt: skip
        channels = {
            "air": Air(static + impact, static, alpha),
            "attitude": Attitude(pitch, bank, heading, *rates),
            "gps": Gps(north, east, altitude, math.degrees(math.atan2(*ways))),
            "panel": Panel(min(max(height, 0.0), RADIO_RANGE), world.assigned),
        }
        crash = "it flew into the ground" if height <= 0.0 else None
        return Tick(self._index, self._index * self.time_step, truth, channels, critical=crash)
