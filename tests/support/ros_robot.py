"""A robot and its controller behind ROS 2: ros_robot.py world|controller|services DOMAIN [MORE].

The messages are written down here by hand, as a second source beside the package's. MORE of a world
is the number of commands at which it ends; of a world behind services, how it answers a reset.
"""

import json
import math
import os
import sys
from dataclasses import dataclass, field
from time import monotonic, sleep

from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, int64, uint8, uint32, uint64
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

IDLE = 60.0
"""Seconds without a message after which it ends."""
LAG = 0.005
"""Seconds from one topic of a step to the next."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time = field(default_factory=Time)


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


def zeros():
    return [0.0] * 36


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=zeros)


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=zeros)


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    data: float64 = 0.0


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str = ""


@dataclass
class EmptyRequest(IdlStruct, typename="std_srvs::srv::dds_::Empty_Request_"):
    guid: uint64 = 0
    seq: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class EmptyResponse(IdlStruct, typename="std_srvs::srv::dds_::Empty_Response_"):
    guid: uint64 = 0
    seq: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64 = 0
    seq: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False
    message: str = ""


@dataclass
class SetBoolRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: uint64 = 0
    seq: int64 = 0
    data: bool = False


@dataclass
class SetBoolResponse(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False
    message: str = ""


@dataclass
class WorldReset(IdlStruct, typename="ros_gz_interfaces::msg::dds_::WorldReset_"):
    all: bool = False
    time_only: bool = False
    model_only: bool = False


@dataclass
class WorldControl(IdlStruct, typename="ros_gz_interfaces::msg::dds_::WorldControl_"):
    pause: bool = False
    step: bool = False
    multi_step: uint32 = 0
    reset: WorldReset = field(default_factory=WorldReset)
    seed: uint32 = 0
    run_to_sim_time: Time = field(default_factory=Time)


@dataclass
class ControlRequest(IdlStruct, typename="ros_gz_interfaces::srv::dds_::ControlWorld_Request_"):
    guid: uint64 = 0
    seq: int64 = 0
    world_control: WorldControl = field(default_factory=WorldControl)


@dataclass
class ControlResponse(IdlStruct, typename="ros_gz_interfaces::srv::dds_::ControlWorld_Response_"):
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False


SERVICES = {
    "std_srvs/srv/Empty": (EmptyRequest, EmptyResponse),
    "std_srvs/srv/Trigger": (TriggerRequest, TriggerResponse),
    "std_srvs/srv/SetBool": (SetBoolRequest, SetBoolResponse),
    "ros_gz_interfaces/srv/ControlWorld": (ControlRequest, ControlResponse),
}


class Robot:
    """Drives towards a wall at 5 m; commands act through a lag."""

    def __init__(self, lag):
        self.x = self.speed = 0.0
        self.lag = lag

    def move(self, speed, seconds):
        self.speed += (speed - self.speed) * min(seconds / self.lag, 1.0)
        self.x += self.speed * seconds

    @property
    def distance(self):
        return 5.0 - self.x


def wanted_speed(distance):
    return min(0.8 * (distance - 0.5), 1.0)


class Node:
    """Topics of ROS 2, reliable as its defaults are."""

    def __init__(self, domain):
        self.participant = DomainParticipant(domain)
        self.qos = Qos(
            Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10)
        )
        self.waiting = WaitSet(self.participant)

    def writer(self, name, kind, prefix="rt"):
        topic = Topic(self.participant, f"{prefix}{name}", kind)
        return DataWriter(self.participant, topic, qos=self.qos)

    def reader(self, name, kind, prefix="rt"):
        reader = DataReader(
            self.participant, Topic(self.participant, f"{prefix}{name}", kind), qos=self.qos
        )
        states = SampleState.Any | ViewState.Any | InstanceState.Any
        self.waiting.attach(ReadCondition(reader, states))
        return reader

    def service(self, name, kind):
        request, response = SERVICES[kind]
        requests = self.reader(f"{name}Request", request, "rq")
        return requests, self.writer(f"{name}Reply", response, "rr"), response

    def spin(self, act):
        last = monotonic()
        while monotonic() - last < IDLE:
            self.waiting.wait(duration(milliseconds=100))
            if act():
                last = monotonic()


def taken(reader):
    return [sample for sample in reader.take(100) if not isinstance(sample, InvalidSample)]


def stamp(nanoseconds):
    return Time(*divmod(nanoseconds, 10**9))


def world(domain, death=math.inf):
    node = Node(domain)
    odometry, distance = node.writer("/odom", Odometry), node.writer("/distance", Float64)
    clock = node.writer("/clock", Clock)
    resets, commands = node.reader("/reset", String), node.reader("/cmd_vel", Twist)
    state = {"robot": Robot(0.3), "now": 10**9, "step": 0.1, "commands": 0}

    def show(*, again=False):
        """Write the state; again, as sensors do at rates of their own, where it is the old one."""
        robot, now = state["robot"], state["now"]
        if not again:
            distance.write(Float64(robot.distance))
            sleep(LAG)
        message = Odometry(header=Header(stamp(now), "odom"))
        message.pose.pose.position.x, message.twist.twist.linear.x = robot.x, robot.speed
        odometry.write(message)
        clock.write(Clock(stamp(now)))

    def act():
        came = taken(resets)
        for each in came:
            given = json.loads(each.data)
            state.update(robot=Robot(given["world"].get("lag", 0.3)), step=given["time_step"])
            show()
        orders = taken(commands)
        for each in orders:
            state["commands"] += 1
            if state["commands"] == death:
                os._exit(3)
            show(again=True)
            state["robot"].move(each.linear.x, state["step"])
            state["now"] += round(state["step"] * 1e9)
            show()
        return came or orders

    node.spin(act)


def services(domain, answers="std_srvs/srv/Trigger"):
    """World that is reset and steps by services, as Gazebo's bridge has them.

    A request waits for the text, or the command, that was written before it: DDS orders messages of
    one topic alone.
    """
    node = Node(domain)
    odometry, distance = node.writer("/odom", Odometry), node.writer("/distance", Float64)
    clock = node.writer("/clock", Clock)
    texts, commands = node.reader("/reset", String), node.reader("/cmd_vel", Twist)
    reset, replies, answer = node.service(
        "/reset_world", answers if "/" in answers else "std_srvs/srv/Trigger"
    )
    control, controlled, _ = node.service(
        "/world/room/control", "ros_gz_interfaces/srv/ControlWorld"
    )
    state = {"robot": Robot(0.3), "now": 10**9}
    given, orders, asked, late = [], [], [], []

    def show():
        robot, now = state["robot"], state["now"]
        distance.write(Float64(robot.distance))
        message = Odometry(header=Header(stamp(now), "odom"))
        message.pose.pose.position.x, message.twist.twist.linear.x = robot.x, robot.speed
        odometry.write(message)
        clock.write(Clock(stamp(now)))

    def step(request):
        order = request.world_control
        assert order.pause
        assert order.seed == 0
        state["robot"].move(orders.pop(0).linear.x, order.multi_step / 1000)
        state["now"] += order.multi_step * 10**6
        show()
        controlled.write(ControlResponse(request.guid, request.seq, answers != "stuck"))

    def begin(request):
        if answers == "silent":
            return
        if answers == "late" and not late:
            late.append(answer(request.guid, request.seq, False, "this is late"))
            given.clear()
            return
        for each in late:
            replies.write(each)
        state.update(robot=Robot(json.loads(given.pop(0).data)["world"].get("lag", 0.3)))
        show()
        values = {}
        if hasattr(answer, "success"):
            values = {"success": True}
        if answers == "refuses":
            values = {"success": False, "message": "the physics engine is not loaded"}
        replies.write(answer(request.guid ^ (answers == "others"), request.seq, **values))

    def act():
        given.extend(taken(texts))
        orders.extend(taken(commands))
        asked.extend((begin, each) for each in taken(reset))
        asked.extend((step, each) for each in taken(control))
        due = [pair for pair in asked if (given if pair[0] is begin else orders)]
        for function, request in due:
            asked.remove((function, request))
            function(request)
        return due

    node.spin(act)


def controller(domain):
    node = Node(domain)
    command = node.writer("/cmd_vel", Twist)
    distances, clocks = node.reader("/distance", Float64), node.reader("/clock", Clock)
    odometry = node.reader("/odom", Odometry)
    last = {"distance": math.nan, "speed": math.nan, "due": []}

    def act():
        for each in taken(distances):
            last["due"].append(each.data)
        came = taken(clocks)
        taken(odometry)
        for distance in last["due"]:
            command.write(Twist(linear=Vector3(x=wanted_speed(distance))))
        last["due"].clear()
        return came

    node.spin(act)


if __name__ == "__main__":
    role, number, *rest = sys.argv[1:]
    if role == "services":
        services(int(number), *rest)
    else:
        {"world": world, "controller": controller}[role](int(number), *map(int, rest))
