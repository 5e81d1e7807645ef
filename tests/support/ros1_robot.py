"""A robot, its controller and a master by rospy alone: ros1_robot.py ROLE, a function below."""

import json
import os
import queue
import sys
from time import monotonic, sleep

IDLE = 90.0
"""Seconds without a message after which it ends."""


class Robot:
    """Drives towards a wall at 5 m; commands act through a lag."""

    def __init__(self, lag):
        self.x = self.speed = 0.0
        self.lag = lag

    def move(self, speed, seconds):
        self.speed += (speed - self.speed) * min(seconds / self.lag, 1.0)
        self.x += self.speed * seconds


def spin(came, act):
    last = monotonic()
    while monotonic() - last < IDLE:
        try:
            act(*came.get(timeout=1.0))
        except queue.Empty:
            continue
        last = monotonic()


def world(death="0"):
    import rospy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import Float64, String

    rospy.init_node("world", disable_signals=True, disable_rostime=True, disable_rosout=True)
    came = queue.SimpleQueue()
    odometry = rospy.Publisher("/odom", Odometry, queue_size=9)
    distance = rospy.Publisher("/distance", Float64, queue_size=9)
    clock = rospy.Publisher("/clock", Clock, queue_size=9)
    state = {"robot": Robot(0.3), "now": 1.0, "step": 0.1, "commands": 0}

    def act(topic, message):
        if topic == "reset":
            given = json.loads(message.data)
            state.update(robot=Robot(given["world"].get("lag", 0.3)), step=given["time_step"])
        else:
            state["commands"] += 1
            if state["commands"] == int(death):
                os._exit(3)
            state["robot"].move(message.linear.x, state["step"])
            state["now"] += state["step"]
        robot, now = state["robot"], rospy.Time.from_sec(state["now"])
        distance.publish(Float64(5.0 - robot.x))
        sleep(0.002)  # one topic may come after another
        sent = Odometry()
        sent.header.stamp = now
        sent.pose.pose.position.x, sent.twist.twist.linear.x = robot.x, robot.speed
        odometry.publish(sent)
        clock.publish(Clock(now))

    rospy.Subscriber("/reset", String, lambda m: came.put(("reset", m)), tcp_nodelay=True)
    rospy.Subscriber("/cmd_vel", Twist, lambda m: came.put(("command", m)), tcp_nodelay=True)
    spin(came, act)


def services(answers="good"):
    """World that is reset and steps by services; each waits for what was published before it."""
    import rospy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import Float64, String
    from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

    rospy.init_node("world", disable_signals=True, disable_rostime=True, disable_rosout=True)
    texts, commands, asked = queue.SimpleQueue(), queue.SimpleQueue(), queue.SimpleQueue()
    odometry = rospy.Publisher("/odom", Odometry, queue_size=9)
    distance = rospy.Publisher("/distance", Float64, queue_size=9)
    clock = rospy.Publisher("/clock", Clock, queue_size=9)
    state = {"robot": Robot(0.3), "now": 1.0}

    def show():
        robot, now = state["robot"], rospy.Time.from_sec(state["now"])
        distance.publish(Float64(5.0 - robot.x))
        sent = Odometry()
        sent.header.stamp = now
        sent.pose.pose.position.x, sent.twist.twist.linear.x = robot.x, robot.speed
        odometry.publish(sent)
        clock.publish(Clock(now))

    def begin(_request):
        asked.put((None,))
        if answers == "silent":
            sleep(5.0)
        if answers == "broken":
            raise ValueError("no physics")
        state.update(robot=Robot(json.loads(texts.get(timeout=5.0).data)["world"].get("lag", 0.3)))
        show()
        return TriggerResponse(answers != "refuses", "the physics engine is not loaded")

    def step(request):
        asked.put((None,))
        assert request.data
        state["robot"].move(commands.get(timeout=5.0).linear.x, 0.1)
        state["now"] += 0.1
        show()
        return SetBoolResponse(True, "")

    rospy.Subscriber("/reset", String, texts.put, tcp_nodelay=True)
    rospy.Subscriber("/cmd_vel", Twist, commands.put, tcp_nodelay=True)
    rospy.Service("/reset_world", Trigger, begin)
    rospy.Service("/step", SetBool, step)
    spin(asked, lambda _: None)


def controller():
    import rospy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from std_msgs.msg import Float64

    rospy.init_node("controller", disable_signals=True, disable_rostime=True, disable_rosout=True)
    came = queue.SimpleQueue()
    command = rospy.Publisher("/cmd_vel", Twist, queue_size=9)

    def act(message):
        sent = Twist()
        sent.linear.x = min(0.8 * (message.data - 0.5), 1.0)
        command.publish(sent)

    rospy.Subscriber("/odom", Odometry, lambda _: None)
    rospy.Subscriber("/distance", Float64, lambda m: came.put((m,)), tcp_nodelay=True)
    spin(came, act)


def master(port):
    import rosmaster

    rosmaster.rosmaster_main(["rosmaster", "--core", "-p", port])


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    roles = {"world": world, "services": services, "controller": controller, "master": master}
    roles[role](*rest)
