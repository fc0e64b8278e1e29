"""The tree of coordinate frames (ROS tf2_msgs)."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.geometry_msgs import TransformStamped


class TFMessage(Message, name="tf2_msgs/msg/TFMessage", version=1):
    """Transforms between frames that have changed."""

    transforms: list[TransformStamped] = DEFAULT
