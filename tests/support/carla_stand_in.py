"""Stand-in for a server of CARLA, as small as possible: world, actors, sensors, traffic manager.

Maps, places, controls and settings are those of the real client library; only what asks a server is
replaced. Cars are single-track models whose pedals differ from what the adapter assumes.
"""

from __future__ import annotations

import fnmatch
import math
from types import SimpleNamespace

import carla
import numpy as np

from pytest_dura.driving.bodies import boxes_overlap

WHEELBASE, LOCKED = 2.8, math.radians(70.0)


class StandIn:
    """The server. ``dies_at`` is the frame that it does not reach."""

    def __init__(self):
        self.version, self.dies_at, self.late = "0.9.16", math.inf, 0
        self.loads, self.seeds, self.frame, self.next_id = [], [], 100, 1
        self.actors, self.settings = {}, carla.WorldSettings()
        self.map, self.ignoring = None, []

    def client(self, _host="", _port=0):
        return SimpleNamespace(
            set_timeout=lambda _seconds: None,
            get_client_version=lambda: "0.9.16",
            get_server_version=self.alive(lambda: self.version),
            get_world=self.alive(lambda: World(self)),
            get_trafficmanager=self.alive(lambda _port: Traffic(self)),
            generate_opendrive_world=self.alive(self.load),
            load_world_if_different=self.alive(self.load),
        )

    def alive(self, answer):
        def asked(*arguments):
            if self.frame >= self.dies_at:
                raise RuntimeError("time-out of 20000ms while waiting for the simulator")
            return answer(*arguments)

        return asked

    def load(self, text, _parameters=None):
        self.loads.append(text)
        self.map = carla.Map("stand-in", self.towns.get(text, text))

    towns: dict = {}  # noqa: RUF012 - a test's own


class World:
    id = 7

    def __init__(self, server):
        self.server = server
        self.get_settings = lambda: server.settings
        self.get_map = lambda: server.map
        self.get_snapshot = lambda: SimpleNamespace(frame=server.frame, find=server.actors.get)

    def apply_settings(self, settings):
        self.server.settings = settings

    def set_pedestrians_seed(self, seed):
        self.server.seeds.append(("world", seed))

    def get_actors(self):
        actors = list(self.server.actors.values())
        return SimpleNamespace(
            filter=lambda kind: [a for a in actors if fnmatch.fnmatch(a.type_id, kind)]
        )

    def get_blueprint_library(self):
        return SimpleNamespace(find=Blueprint)

    def try_spawn_actor(self, blueprint, transform, attach_to=None):
        actor = Actor(self.server, blueprint, transform, attach_to)
        taken = any(actor.is_solid and actor.overlaps(a) for a in self.server.actors.values())
        if taken:
            return None
        self.server.actors[actor.id] = actor
        return actor

    def tick(self, _seconds):
        server = self.server
        server.alive(lambda: None)()
        assert server.settings.synchronous_mode
        server.frame += 1
        for actor in list(server.actors.values()):
            actor.move(server.settings.fixed_delta_seconds)
        for actor in list(server.actors.values()):
            actor.sense()
        return server.frame


class Blueprint:
    def __init__(self, name):
        self.id, self.attributes = name, {}
        self.set_attribute = self.attributes.__setitem__


class Traffic:
    """Drives cars along their paths at their speeds; it sees no others."""

    def __init__(self, server):
        self.server = server
        self.set_synchronous_mode = self.auto_lane_change = lambda *_: None

    def set_random_device_seed(self, seed):
        self.server.seeds.append(("traffic", seed))

    def set_desired_speed(self, actor, speed):
        actor.desired = speed / 3.6

    def set_path(self, actor, path):
        actor.path = list(path)

    def collision_detection(self, actor, other, detect):
        self.server.ignoring.append((actor.id, other.id, detect))


class Actor:
    def __init__(self, server, blueprint, transform, parent):
        self.server, self.type_id, self.parent = server, blueprint.id, parent
        self.id, server.next_id = server.next_id, server.next_id + 1
        self.attributes = blueprint.attributes
        size = (2.4, 0.95, 0.75) if self.type_id.startswith("vehicle") else (0.3, 0.3, 0.9)
        self.bounding_box = carla.BoundingBox(carla.Location(), carla.Vector3D(*size))
        self.set_transform(transform)
        self.speed, self.control, self.path, self.desired = 0.0, carla.VehicleControl(), [], 0.0
        self.physics = True
        self.is_solid = not self.type_id.startswith("sensor")
        self.set_autopilot = self.stop = lambda *_: None

    def listen(self, heard):
        self.heard = heard

    def set_transform(self, transform):
        self.x, self.y = transform.location.x, transform.location.y
        self.yaw = math.radians(transform.rotation.yaw)

    def get_transform(self):
        yaw = math.degrees(math.remainder(self.yaw, 2 * math.pi))
        return carla.Transform(carla.Location(x=self.x, y=self.y), carla.Rotation(yaw=yaw))

    def get_velocity(self):
        return carla.Vector3D(self.speed * math.cos(self.yaw), self.speed * math.sin(self.yaw), 0.0)

    def set_simulate_physics(self, enabled):
        self.physics = enabled

    def set_target_velocity(self, velocity):
        self.speed = math.hypot(velocity.x, velocity.y)

    def apply_control(self, control):
        self.control = control

    def destroy(self):
        self.server.alive(lambda: None)()
        self.server.actors.pop(self.id, None)

    def overlaps(self, other):
        return other.is_solid and bool(boxes_overlap(self.box, other.box)[0])

    @property
    def box(self):
        extent = self.bounding_box.extent
        return np.array([[self.x, self.y, self.yaw, 2 * extent.x, 2 * extent.y]])

    def move(self, dt):
        if not self.physics or not self.type_id.startswith("vehicle"):
            return
        if self.path:
            self.follow(dt)
            return
        pedals = 4.0 * self.control.throttle - 9.0 * self.control.brake - 0.3
        self.speed = max(self.speed + pedals * dt, 0.0)
        self.yaw += self.speed * dt * math.tan(LOCKED * self.control.steer) / WHEELBASE
        self.x += self.speed * dt * math.cos(self.yaw)
        self.y += self.speed * dt * math.sin(self.yaw)

    def follow(self, dt):
        self.speed += min(max(self.desired - self.speed, -4.0 * dt), 2.0 * dt)
        left = self.speed * dt
        while self.path and left > 0.0:
            to = self.path[0]
            distance = math.hypot(to.x - self.x, to.y - self.y)
            if distance > 0.0:
                self.yaw = math.atan2(to.y - self.y, to.x - self.x)
            step = min(left, distance)
            self.x += step * math.cos(self.yaw)
            self.y += step * math.sin(self.yaw)
            left -= step
            if step == distance:
                self.path.pop(0)

    def sense(self):
        frame = self.server.frame - self.server.late
        if self.type_id == "sensor.camera.rgb":
            size = int(self.attributes["image_size_x"])
            pixel = bytes((1, 2, frame % 256, 255))
            self.heard(
                SimpleNamespace(frame=frame, width=size, height=size, raw_data=pixel * size * size)
            )
        elif self.type_id == "sensor.other.collision":
            for other in list(self.server.actors.values()):
                if other is not self.parent and self.parent.overlaps(other):
                    event = SimpleNamespace(frame=frame, actor=self.parent, other_actor=other)
                    self.heard(event)
