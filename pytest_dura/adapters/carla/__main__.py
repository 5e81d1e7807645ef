"""``python -m pytest_dura.adapters.carla``: try a server; print junctions of its towns as roads."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from time import monotonic
from typing import Any

import yaml

from pytest_dura.adapters.carla.maps import difference, junctions_of, library, place_of
from pytest_dura.adapters.carla.simulator import CarlaSimulator
from pytest_dura.adapters.carla.world import CONNECTIONS, Connection
from pytest_dura.adapters.checks import Check, lines_of, print_lines
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.state import Tick
from pytest_dura.driving.roads import FOUR_WAY

_EGO = {"distance": 60.0, "speed": 8.0}
_OTHERS = {
    "vehicles": [{"id": "CAR", "arm": "west", "turn": "right", "distance": 60.0, "speed": 8.0}],
    "pedestrians": [{"id": "P1", "arm": "north", "offset": 40.0, "start": 0.0}],
}
_ASIDE, _LEAST, _HARD = 1.0, 30.0, 5.0
"""m beside the route at most, m that a car drives at least, m/s2 of an emergency brake."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns 0, 1 if a check failed, 2 for a wrong call."""
    parser = argparse.ArgumentParser(prog="python -m pytest_dura.adapters.carla")
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="try a server: each check is a line")
    road = commands.add_parser("road", help="print junctions of a map as scenarios have them")
    for command in (check, road):
        command.add_argument("--host", default="127.0.0.1")
        command.add_argument("--port", type=int, default=2000)
        command.add_argument("--server", default="", help="a program of this folder that starts it")
    check.add_argument("--traffic-port", type=int, default=8000)
    check.add_argument("--vehicle", default="vehicle.lincoln.mkz_2020", help="blueprint of the ego")
    road.add_argument("--town", default="", help="a map of the server; by default what it has")
    road.add_argument("--opendrive", type=Path, metavar="FILE", help="a map; needs no server")
    options = vars(parser.parse_args(arguments))
    if options.pop("command") == "road":
        return print_lines(_roads(**options), CONNECTIONS.close)
    checks: list[Check] = [
        (_client, "pip install 'pytest-dura[carla]'"),
        (_server, "start CarlaUE4.sh first, or give --host, --port or --server"),
        (_road, "report the line: CARLA builds another road than is asked for"),
        (_ego, "give another --vehicle, or change `Pedals` of a subclass's road"),
        (_brake, "give another --vehicle, or change `Pedals` of a subclass's road"),
        (_traffic, "give another --traffic-port; one traffic manager listens at each"),
        (_camera, "start the server with rendering, or leave `front_camera` out"),
        (_repeats, "declare what was found as `tolerances` of a subclass"),
    ]
    return print_lines(lines_of(checks, **options), CONNECTIONS.close)


def _client(**_where: Any) -> str:
    return f"{version('carla')}, {library().__name__}"


def _server(**where: Any) -> str:
    held = _held(**where)
    return f"{held.client.get_server_version()} at {held.address}, the client's version"


def _road(**where: Any) -> str:
    held, begun = _held(**where), monotonic()
    held.load(FOUR_WAY, "", 0)
    built = held.client.get_world().get_map()
    (junction,) = junctions_of(built)
    if wrong := difference(FOUR_WAY, place_of(built, junction).road):
        raise ValueError(wrong)
    return f"{FOUR_WAY.name} is built in {monotonic() - begun:.1f} s, and is what was asked for"


def _ego(**where: Any) -> str:
    words = []
    for turn in ("straight", "left", "right"):
        ticks, cost = _run({"ego": {**_EGO, "turn": turn}}, **where)
        aside = max(abs(tick.truth["ego"].lateral) for tick in ticks)
        way = ticks[-1].truth["ego"].s - ticks[0].truth["ego"].s
        words.append(
            f"{turn} {way:.0f} m, up to {aside:.2f} m beside its route, {cost:.0f} ms a tick"
        )
        if aside > _ASIDE or way < _LEAST:
            raise ValueError(words[-1])
    return "; ".join(words)


def _brake(**where: Any) -> str:
    ticks, _ = _run({"ego": _EGO}, "emergency_brake", 40, **where)
    hardest = -min(tick.truth["ego"].acceleration for tick in ticks)
    words = f"up to {hardest:.1f} m/s2, {ticks[-1].truth['ego'].speed:.2f} m/s in the end"
    if hardest < _HARD or ticks[-1].truth["ego"].speed > 0.0:
        raise ValueError(words)
    return words


def _traffic(**where: Any) -> str:
    ticks, _ = _run({"ego": {**_EGO, "speed": 0.0}, **_OTHERS}, "wait", 60, **where)
    first, last = (ticks[number].truth["bodies"] for number in (0, -1))
    ways = {
        name: abs(
            complex(last.get(name).x - first.get(name).x, last.get(name).y - first.get(name).y)
        )
        for name in ("CAR", "P1")
    }
    words = ", ".join(f"{name} moves {way:.1f} m" for name, way in ways.items()) + " in 6 s"
    if ways["CAR"] < _LEAST or ways["P1"] < 1.0:
        raise ValueError(words)
    return words


def _camera(**where: Any) -> str:
    simulator, frames = CarlaSimulator(**where, front_camera=True), []
    try:
        ticks = [simulator.reset({"world": {"ego": _EGO}, "duration": 60.0}, 1)]
        for _ in range(10):
            frames.append(ticks[-1].channels["camera_front"].get())
            ticks.append(simulator.step(simulator.check_action("proceed")))
    finally:
        simulator.close()
    changed = sum((a != b).any() for a, b in pairwise(frames))
    words = f"{frames[0].shape}, {changed} of {len(frames) - 1} frames differ from the one before"
    if not all(frame.any() for frame in frames):
        raise ValueError(f"{words}; a frame is black")
    return words


def _repeats(**where: Any) -> str:
    world = {"ego": _EGO, **_OTHERS}
    (first, _), (second, _) = _run(world, **where), _run(world, **where)
    far = speeds = 0.0
    for a, b in zip(first, second, strict=False):
        one, other = a.truth["ego"], b.truth["ego"]
        far = max(far, abs(one.s - other.s))
        speeds = max(speeds, abs(one.speed - other.speed))
    words = f"two runs of a seed differ by up to {far:.3f} m and {speeds:.3f} m/s of the ego"
    if speeds > CarlaSimulator.tolerances["speed"]:
        raise ValueError(words)
    return words


def _run(world: dict[str, Any], action: str = "proceed", ticks: int = 100, **where: Any) -> Any:
    """Drive for some ticks, to the goal or into something; returns them and ms for each."""
    simulator = CarlaSimulator(**where)
    try:
        seen: list[Tick] = [simulator.reset({"world": world, "duration": 60.0}, 1)]
        begun = monotonic()
        while len(seen) <= ticks and not (seen[-1].goal or seen[-1].critical):
            seen.append(simulator.step(simulator.check_action(action)))
    finally:
        simulator.close()
    return seen, 1000.0 * (monotonic() - begun) / len(seen)


def _held(**where: Any) -> Connection:
    return CONNECTIONS.take(*CarlaSimulator(**where).key)


def _roads(town: str, opendrive: Path | None, **where: Any) -> Iterator[str]:
    """Yield each junction of a map that is a road, and why others are none."""
    if opendrive is not None:
        world_map = library().Map(opendrive.stem, opendrive.read_text("utf-8"))
    else:
        held = _held(**where)
        if town:
            held.client.load_world_if_different(town)
        world_map = held.client.get_world().get_map()
    for junction in sorted(junctions_of(world_map)):
        try:
            road = place_of(world_map, junction).road
        except ConfigurationError as error:
            yield f"# {str(error).splitlines()[0]}"
            continue
        data = {"arms": [asdict(arm) for arm in road.arms], "speed_limit": road.speed_limit}
        yield f"# junction: {junction}\n" + yaml.safe_dump({"road": data}, sort_keys=False)


if __name__ == "__main__":
    sys.exit(main())
