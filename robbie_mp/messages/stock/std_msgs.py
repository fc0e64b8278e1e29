"""The common header of messages (ROS std_msgs)."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.builtin_interfaces import Time


class Header(Message, name="std_msgs/msg/Header", version=1):
    """The time and the coordinate frame of a message's data."""

    stamp: Time = DEFAULT
    frame_id: str = DEFAULT  # coordinate frame, as in "map", "odom", "base_link", "laser"


class String(Message, name="std_msgs/msg/String", version=1):
    """A text."""

    data: str = DEFAULT
