"""Definitions of services, which rosbags has not, as their packages publish them.

``std_srvs`` is of https://github.com/ros2/common_interfaces, ``ros_gz_interfaces`` of
https://github.com/gazebosim/ros_gz (docs.ros.org shows both); constants and comments are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

SERVICES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "std_srvs/srv/Empty": ("", ""),
        "std_srvs/srv/SetBool": ("bool data", "bool success\nstring message"),
        "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
        "ros_gz_interfaces/srv/ControlWorld": (
            "ros_gz_interfaces/WorldControl world_control",
            "bool success",
        ),
    }
)
"""Fields of request and reply, by type."""
_MESSAGES = {
    "ros_gz_interfaces/msg/WorldReset": "bool all\nbool time_only\nbool model_only",
    "ros_gz_interfaces/msg/WorldControl": (
        "bool pause\nbool step\nuint32 multi_step\nros_gz_interfaces/WorldReset reset\n"
        "uint32 seed\nbuiltin_interfaces/Time run_to_sim_time"
    ),
}
_EMPTY = "uint8 structure_needs_at_least_one_member"
"""What ROS 2 gives a message without fields."""


def service_definitions() -> dict[str, Any]:
    """Return constants and fields of the messages of services, as rosbags has them, by name."""
    from rosbags.typesys import get_types_from_msg

    texts = dict(_MESSAGES)
    for name, (request, reply) in SERVICES.items():
        texts |= {f"{name}_Request": request or _EMPTY, f"{name}_Response": reply or _EMPTY}
    return {
        name: next(iter(get_types_from_msg(text, name.replace("/srv/", "/msg/")).values()))
        for name, text in texts.items()
    }
