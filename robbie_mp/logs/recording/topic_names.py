"""Names of a robot's topics in the world of ROS: in logs, in Foxglove, and on bridges.

A name depends on the type and the topic alone, not on what else the robot has. So a topic has one name, live
and in every log.
"""

import re

ACCOMPANY = frozenset(
    {
        "CallRefusal",
        "CallsAnswer",
        "CallsQuestion",
        "CameraInfo",
        "Detection2DArray",
        "DeviceState",
        "GoalCancel",
        "GoalEnd",
        "JointCommand",
        "JointLimits",
        "PointsOfInterest",
        "SettingChange",
        "SettingChanged",
        "SimulatedDoors",
        "SimulatedPeople",
        "Tick",
    }
)
"""Types that have the topic of something else, such as that of a module or of an image.

Their names have the type behind the topic. Apps find a camera's calibration by its name, `.../camera_info`.
"""
_PART_OF_CALL = re.compile(r".*_(Request|Response|Goal|Result|Feedback)")


def ros_topic(type_name: str, topic: str) -> str:
    """Return the name of a topic in ROS, without the slash before it.

    Args:
        type_name: full name of the type of its messages.
        topic: the robot's topic; without one, the type is the name.
    """
    name, short = plain_topic(type_name, topic), type_name.rpartition("/")[2]
    accompanies = topic and (short in ACCOMPANY or _PART_OF_CALL.fullmatch(short))
    return f"{name}/{snake_case(type_name)}" if accompanies else name


def plain_topic(type_name: str, topic: str) -> str:
    """Return a topic as a name that ROS allows; without one, the type is the name. Arguments as above."""
    return other_name(topic) or snake_case(type_name)


def other_name(topic: str) -> str:
    """Return a topic as a name that ROS allows: characters that it does not allow become underscores."""
    parts = [re.sub(r"[^A-Za-z0-9_]", "_", part) for part in topic.split("/") if part]
    return "/".join(f"_{part}" if part[0].isdigit() else part for part in parts)


def snake_case(type_name: str) -> str:
    """Return the last part of a type's name as `laser_scan` for `sensor_msgs/msg/LaserScan`."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type_name.rpartition("/")[2])
    return words.lower()
