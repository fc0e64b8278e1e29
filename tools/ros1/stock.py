"""The stock types that Debian's ROS 1 has."""

from typing import Final

from robbie_mp.messages import Message, stock_registry

PACKAGES = ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "tf2_msgs")
TYPES_OF_ROS1: Final[tuple[type[Message], ...]] = tuple(
    one for one in stock_registry() if one.type_name.split("/")[0] in PACKAGES
)


def topic_of(message_type: type[Message]) -> str:
    """Return the topic on which the robot of a trial publishes a type."""
    return f"all/{message_type.__name__}"
