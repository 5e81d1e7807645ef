"""A server of CARLA as this process has it: connection, world in step, sensors by frame number."""

from __future__ import annotations

import queue
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil
from time import monotonic
from typing import Any

from pytest_dura.adapters.carla.maps import Place, difference, library, place_of
from pytest_dura.adapters.carla.opendrive import opendrive_of
from pytest_dura.adapters.servers import Kept, Server, ServerConnection, project_program
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.driving.roads import Road

_SUBSTEP, _SUBSTEPS = 0.01, 16
"""Step of CARLA's physics in s, and of how many a tick has at most."""
_LOADING = 120.0
"""Seconds that a server may take to start, and to load a map."""
_LOOK = 2.0
"""Seconds of one look whether a server answers."""


class CarlaError(Exception):
    """Error of the server: it does not answer, or not what was asked for."""


class Sensor:
    """A sensor on an actor, whose data are asked for by frame number."""

    def __init__(self, actor: Any) -> None:
        self.actor = actor
        self._data: queue.SimpleQueue[Any] = queue.SimpleQueue()
        """Filled by a thread of the library."""
        actor.listen(self._data.put)

    def at(self, frame: int, seconds: float) -> Any:
        """Wait for the data of a frame; older ones are dropped.

        Raises:
            CarlaError: If they do not come in time, or later ones do.
        """
        until, last = monotonic() + seconds, None
        try:
            while last is None or last.frame < frame:
                last = self._data.get(timeout=max(until - monotonic(), 0.0))
        except queue.Empty:
            seen = "nothing so far" if last is None else f"frame {last.frame} at last"
            words = f"{self.actor.type_id} gave no frame {frame} within {seconds:g} s: {seen}"
            raise CarlaError(words) from None
        if last.frame > frame:
            raise CarlaError(f"{self.actor.type_id} gave frame {last.frame} in place of {frame}")
        return last

    def so_far(self) -> Iterator[Any]:
        """Yield what has come, of a sensor that gives data at events only."""
        while not self._data.empty():
            yield self._data.get()


class Connection(ServerConnection):
    """A server, for one session at a time.

    Args:
        host: Where it listens.
        port: Where it listens.
        traffic_port: Of the traffic manager, which this process opens.
        program: Command line of a program of the project that starts it; without one it is there.
        timeout: Seconds that an answer may take.
    """

    def __init__(
        self, host: str, port: int, traffic_port: int, program: str, timeout: float
    ) -> None:
        self.address, self._timeout = f"{host}:{port}", timeout
        self._host, self._port, self.traffic_port = host, port, traffic_port
        command = project_program(program, "server") if program else ()
        super().__init__(Server(f"carla:{self.address}", command, _LOADING))
        self._loaded = ""
        self._actors: dict[int, Any] = {}
        self.client: Any = None

    def _enter(self) -> None:
        if problem := self.problem():
            raise CarlaError(f"no server of CARLA answers at {self.address}: {problem}")
        self.client = library().Client(self._host, self._port)
        self.client.set_timeout(self._timeout)
        with self.asking("compare versions"):
            ours, theirs = self.client.get_client_version(), self.client.get_server_version()
        if ours != theirs:
            raise ConfigurationError(
                "client and server of CARLA have different versions",
                key="simulator",
                found=f"client {ours}, server {theirs}",
                remedy=f"pip install carla=={theirs}, or start a server {ours}",
            )

    def problem(self) -> str:
        """Say why the server does not answer; nothing if it does."""
        try:
            socket.create_connection((self._host, self._port), _LOOK).close()
            client = library().Client(self._host, self._port)
            client.set_timeout(_LOOK)
            client.get_server_version()
        except (OSError, RuntimeError) as error:
            return str(error).splitlines()[0]
        return ""

    @contextmanager
    def asking(self, what: str, seconds: float = 0.0) -> Iterator[None]:
        """Context of calls that the server answers.

        Args:
            what: What is asked for, in messages.
            seconds: How long an answer may take; by default as usual.

        Raises:
            CarlaError: If it does not answer in time, or refuses; the connection is broken then.
        """
        if seconds:
            self.client.set_timeout(seconds)
        try:
            yield
        except RuntimeError as error:
            self._is_lost = True
            ending = self.server.ending()
            raise CarlaError(
                f"{what}: the server of CARLA at {self.address} says {str(error).strip()}"
                + (ending and f"; {ending}")
            ) from error
        finally:
            if seconds:
                self.client.set_timeout(self._timeout)

    def load(self, road: Road, town: str, junction: int) -> Place:
        """Load a town, or build a road, unless it is there; returns the junction's place.

        Raises:
            CarlaError: If the server does not.
            ConfigurationError: If the town's junction is not the road.
        """
        wanted = town or opendrive_of(road)
        if wanted != self._loaded:
            with self.asking(f"load {town or road.name}", _LOADING):
                self._loaded = ""
                if town:
                    self.client.load_world_if_different(town)
                else:
                    self.client.generate_opendrive_world(
                        wanted,
                        library().OpendriveGenerationParameters(
                            vertex_distance=0.5,
                            wall_height=0.0,
                            smooth_junctions=False,
                            enable_pedestrian_navigation=False,
                        ),
                    )
                self._loaded = wanted
        if not town:
            return Place(road, 0.0, 0.0)
        with self.asking("read the map"):
            place = place_of(self.client.get_world().get_map(), junction, road.speed_limit)
        if wrong := difference(road, place.road):
            raise ConfigurationError(
                f"the junction {junction} of {town} is not the scenario's road: {wrong}",
                key="world.road",
                found=road.name,
                remedy="`python -m pytest_dura.adapters.carla road` prints it as a scenario has it",
            )
        return place

    def begin(self, time_step: float, seed: int, *, rendering: bool) -> None:
        """Begin an episode: no actors of the one before, in step, by a seed.

        Raises:
            CarlaError: If the server refuses.
        """
        with self.asking("begin an episode"):
            self.world = self.client.get_world()
            self._map = self.world.get_map()
            for kind in ("sensor.*", "walker.*", "vehicle.*"):
                for actor in self.world.get_actors().filter(kind):
                    actor.destroy()
            settings = self.world.get_settings()
            settings.synchronous_mode, settings.fixed_delta_seconds = True, time_step
            substeps = min(ceil(time_step / _SUBSTEP - 1e-9), _SUBSTEPS)
            settings.substepping, settings.max_substeps = True, substeps
            settings.max_substep_delta_time = time_step / substeps
            settings.deterministic_ragdolls = True
            settings.no_rendering_mode = not rendering
            self.world.apply_settings(settings)
            self.world.set_pedestrians_seed(seed)
            self.traffic = self.client.get_trafficmanager(self.traffic_port)
            self.traffic.set_synchronous_mode(True)
            self.traffic.set_random_device_seed(seed)

    def ground(self, place: Any) -> float:
        """Height of the road at a place, in m."""
        return float(self._map.get_waypoint(place).transform.location.z)

    def spawn(self, blueprint: str, transform: Any, attached: Any = None, **attributes: str) -> Any:
        """Put an actor into the world, until the episode ends.

        Raises:
            CarlaError: If it does not fit there.
        """
        with self.asking(f"place a {blueprint}"):
            kind = self.world.get_blueprint_library().find(blueprint)
            for name, value in attributes.items():
                kind.set_attribute(name, value)
            actor = self.world.try_spawn_actor(kind, transform, attach_to=attached)
        if actor is None:
            raise CarlaError(f"the server of CARLA has no room for a {blueprint} at {transform}")
        self._actors[actor.id] = actor
        return actor

    def tick(self) -> Any:
        """Make a step; returns the world's state after it.

        Raises:
            CarlaError: If it is not made in time, or not alone.
        """
        with self.asking("make a step"):
            frame = self.world.tick(self._timeout)
            snapshot = self.world.get_snapshot()
        if snapshot.frame != frame:
            self._is_lost = True
            raise CarlaError(f"the world is at frame {snapshot.frame} after {frame}: who steps it?")
        return snapshot

    def remove(self, actor: Any) -> None:
        """Take an actor out of the world."""
        del self._actors[actor.id]
        with self.asking("remove an actor"):
            actor.destroy()

    def end(self) -> None:
        """Take out the actors of the episode, sensors first."""
        actors, self._actors = self._actors, {}
        for actor in reversed(actors.values()):
            if self._is_lost:
                return  # the next connection finds them, and takes them out
            with suppress(CarlaError), self.asking("remove an actor"):
                if hasattr(actor, "stop"):
                    actor.stop()
                actor.destroy()

    def close(self) -> None:
        """Leave the world as it runs by itself, and let go of the server."""
        if self.client is not None and not self._is_lost:
            with suppress(CarlaError), self.asking("leave the world"):
                settings = self.client.get_world().get_settings()
                settings.synchronous_mode, settings.fixed_delta_seconds = False, None
                self.client.get_world().apply_settings(settings)
                self.client.get_trafficmanager(self.traffic_port).set_synchronous_mode(False)
        self.client = None
        self.server.close()


CONNECTIONS = Kept(Connection)
"""Connections of this process, which episodes share."""
