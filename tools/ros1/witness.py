"""A ROS node that knows nothing of Robbie-MP. It is run by the Python that has rospy.

    witness.py NAME '{"/scan": "sensor_msgs/LaserScan"}' [--drive]

It prints a line with each topic, when the first message of it has come, has been decoded by ROS's own code,
and serialised again to the same bytes. With --drive it publishes velocities, and once, when somebody
listens, a goal, an initial pose, and a status of a type that the robot does not know.
"""

import io
import json
import os
import sys
from importlib import import_module
from typing import Any

rospy: Any = import_module("rospy")
get_message_class: Any = import_module("roslib.message").get_message_class

SPEED_M_PER_S = 0.25
RATE_HZ = 20


def listen(topic: str, type_name: str) -> None:
    """Report the first message of a topic."""
    message_class = get_message_class(type_name)
    done: list[str] = []

    def take(raw: Any) -> None:
        message = message_class().deserialize(raw._buff)
        again = io.BytesIO()
        message.serialize(again)
        assert raw._connection_header["md5sum"] == message_class._md5sum, topic
        assert again.getvalue() == raw._buff, topic
        if not done:
            done.append(topic)
            os.write(1, f"{topic}\n".encode())  # whole: rospy has a thread for each connection

    rospy.Subscriber(topic, rospy.AnyMsg, take)


def drive() -> None:
    """Publish until this process is ended."""
    types = {name: get_message_class(f"geometry_msgs/{name}") for name in
             ("Twist", "PoseStamped", "PoseWithCovarianceStamped")}  # fmt: skip
    velocity, goal = types["Twist"](), types["PoseStamped"]()
    pose = types["PoseWithCovarianceStamped"]()
    velocity.linear.x, goal.pose.position.x, pose.pose.pose.position.x = SPEED_M_PER_S, 2.0, 3.0
    status = get_message_class("actionlib_msgs/GoalStatusArray")
    velocities = rospy.Publisher("/cmd_vel", types["Twist"], queue_size=1)
    rare = [
        (rospy.Publisher("/move_base_simple/goal", types["PoseStamped"], queue_size=1), goal),
        (rospy.Publisher("/initialpose", types["PoseWithCovarianceStamped"], queue_size=1), pose),
        (rospy.Publisher("/move_base/status", status, queue_size=1), status()),
    ]
    while not rospy.is_shutdown():
        velocities.publish(velocity)
        heard = [one for one in rare if one[0].get_num_connections()]
        for publisher, message in heard:
            publisher.publish(message)
        rare = [one for one in rare if one not in heard]
        rospy.rostime.wallsleep(1 / RATE_HZ)


if __name__ == "__main__":
    rospy.init_node(sys.argv[1], argv=[], disable_rosout=True, disable_signals=True)
    for each, its_type in json.loads(sys.argv[2]).items():
        listen(each, its_type)
    if "--drive" in sys.argv:
        drive()
    sys.stdin.read()
