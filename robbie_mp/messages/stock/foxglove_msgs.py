"""Messages of Foxglove that ROS has none for."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, uint8, uint32
from robbie_mp.messages.stock.builtin_interfaces import Time


class RawAudio(Message, name="foxglove_msgs/msg/RawAudio", version=1):
    """A block of sound, as Foxglove's audio panel plays it."""

    timestamp: Time = DEFAULT  # of the first sample
    data: Array[uint8] = DEFAULT  # (N,) samples of the channels in turn, little-endian
    format: str = DEFAULT  # "pcm-s16": 16 bits, signed
    sample_rate: uint32 = DEFAULT  # Hz
    number_of_channels: uint32 = DEFAULT
