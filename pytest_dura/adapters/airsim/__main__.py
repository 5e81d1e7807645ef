"""``python -m pytest_dura.adapters.airsim check``: try a server; each check is a line."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.metadata import version
from time import monotonic
from typing import Any

from pytest_dura.adapters.airsim.server import CONNECTIONS
from pytest_dura.adapters.airsim.simulator import AirSimSimulator
from pytest_dura.adapters.checks import Check, lines_of, print_lines
from pytest_dura.core.state import Tick

_TICKS = 20
_SPEED = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the checks; returns 0, 1 if one failed, 2 for a wrong call."""
    parser = argparse.ArgumentParser(prog="python -m pytest_dura.adapters.airsim")
    check = parser.add_subparsers(required=True).add_parser("check", help="try a server")
    check.add_argument("--host", default="127.0.0.1")
    check.add_argument("--port", type=int, default=41451)
    check.add_argument("--server", default="", help="a program of this folder that starts it")
    check.add_argument("--vehicle", default="", help="its name in settings.json; else the first")
    check.add_argument("--distance-sensor", default="", help="its name; by default the first")
    sensor = '"Sensors": {"Ahead": {"SensorType": 5, "Enabled": true}}'
    checks: list[Check] = [
        (_client, "pip install 'pytest-dura[airsim]'"),
        (_server, "start Cosys-AirSim first, or give --host, --port or --server"),
        (_settings, 'set "SimMode": "Multirotor" in settings.json'),
        (_distance, f"add {sensor} to the vehicle in settings.json, or give --distance-sensor"),
        (_flight, "set the vehicle to SimpleFlight in settings.json, at a place with room above"),
        (_steps, 'set "ClockType": "SteppableClock" in settings.json; let no other client pause'),
        (_repeats, "declare what was found as `tolerances` of a subclass"),
    ]
    return print_lines(lines_of(checks, **vars(parser.parse_args(arguments))), CONNECTIONS.close)


def _client(**_where: Any) -> str:
    return version("cosysairsim")


def _server(**where: Any) -> str:
    held = CONNECTIONS.take(*AirSimSimulator(**where).key)
    return f"protocol {held.ask('getServerVersion')} at {held.address}"


def _settings(**where: Any) -> str:
    held = CONNECTIONS.take(*AirSimSimulator(**where).key)
    settings = json.loads(held.ask("getSettingsString") or "{}")
    known = {key: settings.get(key, "by default") for key in ("SimMode", "ClockType")}
    words = ", ".join(f"{key} {value}" for key, value in known.items())
    if settings.get("SimMode") not in (None, "", "Multirotor"):
        raise ValueError(words)
    return words


def _distance(distance_sensor: str, vehicle: str, **where: Any) -> str:
    held = CONNECTIONS.take(*AirSimSimulator(**where).key)
    seen = held.ask("getDistanceSensorData", distance_sensor, vehicle)
    if not seen.max_distance > 0.0:
        raise ValueError("there is no distance sensor")
    return f"{seen.distance:.1f} m, up to {seen.max_distance:g} m"


def _flight(**where: Any) -> str:
    ticks, _ = _flown(**where)
    way, height = ticks[-1].truth["x"] - ticks[0].truth["x"], ticks[-1].truth["altitude"]
    words = f"{way:.1f} m northwards in {_TICKS / 10:g} s at {_SPEED:g} m/s, {height:.1f} m high"
    if not (way > 0.3 * _SPEED * _TICKS / 10 and height > 2.0):
        raise ValueError(words)
    return words


def _steps(**where: Any) -> str:
    _, cost = _flown(**where)
    return f"each tick comes to its time, {cost:.0f} ms of wall-clock time each"


def _repeats(**where: Any) -> str:
    (first, _), (second, _) = _flown(**where), _flown(**where)
    far = max(
        abs(a.truth[name] - b.truth[name] - first[0].truth[name] + second[0].truth[name])
        for a, b in zip(first, second, strict=True)
        for name in AirSimSimulator.tolerances
    )
    words = f"two flights differ by up to {far:.3f} m, from where each began"
    if far > max(AirSimSimulator.tolerances.values()):
        raise ValueError(words)
    return words


def _flown(**where: Any) -> tuple[list[Tick], float]:
    """Fly northwards for some ticks; returns them, and ms for each."""
    simulator = AirSimSimulator(**where)
    first, command = simulator.reset({"world": {}}, 0), {"vx": _SPEED, "vy": 0.0, "climb": 0.0}
    begun = monotonic()
    ticks = [first, *(simulator.step(command) for _ in range(_TICKS))]
    return ticks, 1000.0 * (monotonic() - begun) / _TICKS


if __name__ == "__main__":
    sys.exit(main())
