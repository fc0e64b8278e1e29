"""A ROS node that drives a robot by /cmd_vel. It is run by the Python that has rospy.

ros_hand.py Twist | TwistStamped
"""

import sys
import time
from importlib import import_module
from typing import Any

LINEAR_M_PER_S, ANGULAR_RAD_PER_S = 0.3, 0.3
RATE_HZ = 20


def main() -> None:
    """Publish until this process is ended."""
    rospy: Any = import_module("rospy")
    message_class: Any = getattr(import_module("geometry_msgs.msg"), sys.argv[1])
    rospy.init_node("hand", argv=[], disable_rosout=True, disable_signals=True)
    velocities = rospy.Publisher("/cmd_vel", message_class, queue_size=1)
    message = message_class()
    velocity = getattr(message, "twist", message)
    velocity.linear.x, velocity.angular.z = LINEAR_M_PER_S, ANGULAR_RAD_PER_S
    while not rospy.is_shutdown():
        if message is not velocity:
            message.header.stamp = rospy.Time.from_sec(time.time())
        velocities.publish(message)
        rospy.rostime.wallsleep(1 / RATE_HZ)


if __name__ == "__main__":
    main()
