"""A domain of a cart with sensors of several kinds, for what is refused when files are read."""

from __future__ import annotations

from pytest_dura import Action, Domain
from pytest_dura.faults import Channel

CART = Domain(
    name="cart",
    roles={"generator": "thermostat:Controller"},
    channels={
        "lidar": Channel("objects"),
        "radar": Channel("array", columns=3, units=("m", "rad", "m/s")),
        "imu": Channel("numbers", ("acceleration", "yaw_rate"), units=("m/s2", "rad/s")),
        "odometry": Channel("numbers", ("speed",), units=("m/s",)),
        "command": Channel("numbers", ("acceleration",), units=("m/s2",)),
    },
    actions=(Action("acceleration", "m/s2", "ahead"),),
    fault_targets={"number": "odometry.speed"},
)
