"""ROS 1 by ``rospy``, where it is installed: the topics and bindings of ROS 2, by a master.

A binding is that of :mod:`pytest_dura.adapters.ros2`, with the names that ROS 2 has for types:
``nav_msgs/msg/Odometry`` is ``nav_msgs/Odometry`` here. One process is one node; its master is that
of ``ROS_MASTER_URI``.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections import deque
from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

from pytest_dura.adapters.ros2.bus import Bus, Ros2Error
from pytest_dura.adapters.ros2.generator import Ros2Generator
from pytest_dura.adapters.ros2.services import ServiceCall
from pytest_dura.adapters.ros2.simulator import Ros2Simulator
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import NOTHING

_QUEUE = 512
"""Messages that wait to be sent."""
_PROBE = 0.1
"""Seconds in which a service is looked for, each time."""


def master_uri() -> str:
    """Address of the master."""
    return os.environ.get("ROS_MASTER_URI", "http://localhost:11311")


@cache
def _library() -> Any:
    """Return ``rospy``, with this process as a node.

    Raises:
        ConfigurationError: If it is not installed.
    """
    try:
        import rosgraph
        import rospy
    except ImportError as error:
        raise ConfigurationError(
            f"ROS 1 cannot be used here: {error}",
            key="simulator",
            found="no rospy",
            expected="rospy, for this Python",
            remedy="install Debian's python3-rospy, or source the setup of a ROS installation",
        ) from None
    try:
        rosgraph.Master("/pytest_dura").getPid()  # a node would wait for a master without end
    except (OSError, rosgraph.MasterException) as error:
        raise Ros2Error(f"no master of ROS 1 answers at {master_uri()}: {error}") from None
    rospy.init_node(
        "pytest_dura", argv=[], anonymous=True, disable_signals=True, disable_rostime=True,
        disable_rosout=True,
    )  # fmt: skip
    atexit.register(rospy.signal_shutdown, "the session has ended")
    return rospy


@cache
def message_type(name: str) -> Any:
    """Return the class of a message or a service, by its name in ROS 2.

    Raises:
        ConfigurationError: If its package is not installed.
    """
    from roslib.message import get_message_class, get_service_class

    package, folder, short = name.split("/")
    found = {"msg": get_message_class, "srv": get_service_class}[folder](f"{package}/{short}")
    if found is None:
        raise ConfigurationError(
            f"ROS 1 has no {'message' if folder == 'msg' else 'service'} type {name!r} here",
            key="topics",
            found=name,
            expected="a type of an installed package",
            remedy=f"install ros-{package.replace('_', '-')}, or correct the name",
        )
    return found


class Writer:
    """Writer of a topic."""

    def __init__(self, publisher: Any) -> None:
        self.end = publisher

    @property
    def matched(self) -> int:
        """Number of readers."""
        return int(self.end.get_num_connections())

    def write(self, message: Any) -> None:
        """Write a message."""
        self.end.publish(message)


class Reader:
    """Reader of a topic."""

    def __init__(self, subscriber: Any, came: deque[Any]) -> None:
        self.end, self._came = subscriber, came

    @property
    def matched(self) -> int:
        """Number of writers."""
        return int(self.end.get_num_connections())

    def take(self) -> list[Any]:
        """Take what has come."""
        return [self._came.popleft() for _ in range(len(self._came))]


class Node:
    """Writers and readers of one bus; the arguments are those of a participant of DDS.

    Raises:
        ConfigurationError: Without ``rospy``.
        Ros2Error: Without a master.
    """

    def __init__(self, _domain: int = 0) -> None:
        self.rospy, self.came = _library(), threading.Event()
        self._ends: list[Writer | Reader] = []

    def writer(self, name: str, kind: Any) -> Writer:
        """Make a writer of a topic."""
        self._ends.append(writer := Writer(self.rospy.Publisher(name, kind, queue_size=_QUEUE)))
        return writer

    def reader(self, name: str, kind: Any, *, best_effort: bool = False) -> Reader:
        """Make a reader of a topic; ROS 1 repeats nothing, and loses nothing on a wire."""
        del best_effort
        came: deque[Any] = deque()

        def heard(message: Any) -> None:
            came.append(message)
            self.came.set()

        subscriber = self.rospy.Subscriber(name, kind, heard, tcp_nodelay=True)
        self._ends.append(reader := Reader(subscriber, came))
        return reader

    def wait(self, seconds: float) -> None:
        """Wait until something has come since the last call, for so long at most."""
        self.came.wait(max(seconds, 0.0))
        self.came.clear()

    def close(self) -> None:
        """Take the topics back."""
        for each in self._ends:
            each.end.unregister()
        self._ends.clear()


class Client:
    """Client of a service; a call goes on in a thread of its own, since ``rospy``'s has no end."""

    def __init__(self, node: Node, call: ServiceCall) -> None:
        self._node, self._name, self._replies = node, call.service, deque[Any]()
        self._ask = node.rospy.ServiceProxy(call.service, message_type(call.type))

    @property
    def matched(self) -> int:
        """Whether a server answers."""
        try:
            self._node.rospy.wait_for_service(self._name, _PROBE)
        except self._node.rospy.ROSException:
            return 0
        return 1

    def send(self, call: ServiceCall, seed: int) -> None:
        """Send a request; a reply to one before it counts no longer."""
        request = call.request_of(seed, self._ask.request_class())
        self._replies = replies = deque[Any]()

        def ask() -> None:
            try:
                replies.append(self._ask(request))
            except self._node.rospy.ServiceException as error:
                replies.append(SimpleNamespace(success=False, message=str(error)))
            self._node.came.set()

        threading.Thread(target=ask, daemon=True).start()

    def take(self) -> Any:
        """Take the reply to the last request, ``None`` if it has not come."""
        return self._replies.popleft() if self._replies else None


class Ros1Bus(Bus):
    """Topics and services of ROS 1."""

    participant = Node
    client = Client
    prefix = ""

    @classmethod
    def message_type(cls, name: str) -> Any:
        """Return the class of a message."""
        return message_type(name)

    @classmethod
    def zero(cls, name: str) -> Any:
        """Make a message with 0, empty texts and empty lists in it."""
        return message_type(name)()

    @classmethod
    def address(cls, domain: int) -> str:
        """Name of the master, by which what is at the other end is locked."""
        del domain
        return f"ros1:{master_uri()}"


class Ros1Simulator(Ros2Simulator):
    """As :class:`Ros2Simulator`, by ROS 1.

    Args:
        binding: See the base.
        timeout: See the base.
        fallback: See the base.
        server: See the base; the master is there before.
    """

    bus = Ros1Bus

    def __init__(
        self,
        binding: str,
        *,
        timeout: float = 10.0,
        fallback: Mapping[str, float] = NOTHING,
        server: str = "",
    ) -> None:
        super().__init__(binding, timeout=timeout, fallback=fallback, server=server)


class Ros1Generator(Ros2Generator):
    """As :class:`Ros2Generator`, by ROS 1.

    Args:
        binding: See the base.
        timeout: See the base.
    """

    bus = Ros1Bus

    def __init__(self, binding: str, *, timeout: float = 1.0) -> None:
        super().__init__(binding, timeout=timeout)
