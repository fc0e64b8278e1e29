"""What many messages begin with (ROS std_msgs)."""

from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.builtin_interfaces import Time


class Header(Message, name="std_msgs/msg/Header", version=1):
    """When and in which frame the data of a message was taken."""

    stamp: Time = Time()
    frame_id: str = ""  # coordinate frame, as in "map", "odom", "base_link", "laser"
