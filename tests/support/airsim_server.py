"""A server of AirSim as its clients know one: MessagePack-RPC over TCP, and a multirotor.

``[0, id, method, arguments]`` is asked, ``[1, id, error, result]`` answered. The multirotor comes
to the commanded velocity within half a second; a wall stands in the north.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

import msgpack

LAG = 0.5


class AirSimServer:
    """Serves in a thread until it is closed, one client after the other or side by side.

    ``deaf`` is a method that is not answered; ``slip`` is by how much the clock is off, in s.
    """

    def __init__(self, wall=60.0):
        self.wall, self.version, self.deaf, self.slip, self.asked = wall, 4, "", 0.0, []
        self.paused, self.time, self.struck_at = False, 100.0, 0
        self.reset()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.settimeout(120.0)
        self.port = self._listening.getsockname()[1]
        self._clients = []
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def close(self):
        with suppress(OSError):  # closed before
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for client in self._clients:
            client.close()
        self._thread.join(10.0)

    def drop(self):
        """Cut the wires."""
        for client in self._clients:
            client.shutdown(socket.SHUT_RDWR)

    def _accept(self):
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            client.settimeout(120.0)
            self._clients.append(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        unpacker = msgpack.Unpacker()
        while True:
            try:
                data = client.recv(65536)
            except OSError:
                return
            if not data:
                return
            unpacker.feed(data)
            for kind, number, method, arguments in unpacker:
                assert kind == 0
                self.asked.append(method)
                if method == self.deaf:
                    continue
                try:
                    answer = [1, number, None, getattr(self, method)(*arguments)]
                except Exception as error:  # as the real one: in words
                    answer = [1, number, f"{error}", None]
                client.sendall(msgpack.packb(answer))

    def ping(self):
        return True

    def getServerVersion(self):  # noqa: N802 - its own name
        return self.version

    def getMinRequiredClientVersion(self):  # noqa: N802 - its own name
        return 4

    def getSettingsString(self):  # noqa: N802 - its own name
        return '{"SettingsVersion": 2.0, "SimMode": "Multirotor", "ClockType": "SteppableClock"}'

    def reset(self):
        self.place, self.velocity, self.wanted = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.wind, self.armed, self.controlled = [0.0, 0.0, 0.0], False, False

    def enableApiControl(self, enabled, _vehicle):  # noqa: N802 - its own name
        self.controlled = enabled

    def armDisarm(self, armed, _vehicle):  # noqa: N802 - its own name
        self.armed = armed
        return True

    def simSetWind(self, wind):  # noqa: N802 - its own name
        self.wind = [wind[key] for key in ("x_val", "y_val", "z_val")]

    def simPause(self, paused):  # noqa: N802 - its own name
        self.paused = paused

    def takeoff(self, _seconds, _vehicle):
        assert self.armed
        assert self.controlled
        assert not self.paused
        self.time += 3.0
        self.place[2] = -2.0
        return True

    def moveToZ(self, z, *_):  # noqa: N802 - its own name
        assert not self.paused
        self.time += 3.0
        self.place[2] = z
        return True

    def hover(self, _vehicle):
        self.velocity = self.wanted = [0.0, 0.0, 0.0]
        return True

    def moveByVelocity(self, vx, vy, vz, _duration, drivetrain, yaw_mode, _vehicle):  # noqa: N802 - its own name
        assert drivetrain == 0
        assert yaw_mode["is_rate"] is False
        self.wanted = [vx, vy, vz]
        return True

    def simContinueForTime(self, seconds):  # noqa: N802 - its own name
        assert self.paused
        steps = round((seconds + self.slip) / 0.003)
        for _ in range(steps):
            for axis in range(3):
                pull = self.wanted[axis] + 0.1 * self.wind[axis] - self.velocity[axis]
                self.velocity[axis] += pull * 0.003 / LAG
                self.place[axis] += self.velocity[axis] * 0.003
            self.time += 0.003
            if self.place[0] > self.wall - 0.5 and self.velocity[0] > 0.0:
                self.velocity[0] = 0.0
                self.struck_at = round(self.time * 1e9)

    def simGetCollisionInfo(self, _vehicle):  # noqa: N802 - its own name
        zero = {"x_val": 0.0, "y_val": 0.0, "z_val": 0.0}
        return {
            "has_collided": self.struck_at > 0, "normal": zero, "impact_point": zero,
            "position": zero, "penetration_depth": 0.0, "time_stamp": self.struck_at,
            "object_name": "Wall_North", "object_id": 7,
        }  # fmt: skip

    def getMultirotorState(self, vehicle):  # noqa: N802 - its own name
        def vector(values):
            return dict(zip(("x_val", "y_val", "z_val"), values, strict=True))

        still = vector((0.0, 0.0, 0.0))
        return {
            "collision": self.simGetCollisionInfo(vehicle),
            "kinematics_estimated": {
                "position": vector(self.place), "orientation": {"w_val": 1.0, **still},
                "linear_velocity": vector(self.velocity), "angular_velocity": still,
                "linear_acceleration": still, "angular_acceleration": still,
            },
            "gps_location": {"latitude": 0.0, "longitude": 0.0, "altitude": 0.0},
            "timestamp": round(self.time * 1e9), "landed_state": 1,
            "rc_data": {"timestamp": 0, "is_initialized": False, "is_valid": False},
            "ready": True, "ready_message": "", "can_arm": True,
        }  # fmt: skip

    def getDistanceSensorData(self, name, _vehicle):  # noqa: N802 - its own name
        if name not in ("", "Ahead"):
            raise ValueError(f"No distance sensor with name {name} exist on vehicle")
        zero = {"x_val": 0.0, "y_val": 0.0, "z_val": 0.0}
        return {
            "time_stamp": round(self.time * 1e9), "distance": min(self.wall - self.place[0], 40.0),
            "min_distance": 0.2, "max_distance": 40.0,
            "relative_pose": {"position": zero, "orientation": {"w_val": 1.0, **zero}},
        }  # fmt: skip
