"""Log lines (ROS rcl_interfaces)."""

from typing import ClassVar

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import uint8, uint32
from robbie_mp.messages.stock.builtin_interfaces import Time


class Log(Message, name="rcl_interfaces/msg/Log", version=1):
    """A line that a module logged."""

    DEBUG: ClassVar[uint8] = 10
    INFO: ClassVar[uint8] = 20
    WARN: ClassVar[uint8] = 30
    ERROR: ClassVar[uint8] = 40
    FATAL: ClassVar[uint8] = 50

    stamp: Time = DEFAULT
    level: uint8 = DEFAULT  # one of the constants above
    name: str = DEFAULT  # of the logger
    msg: str = DEFAULT
    file: str = DEFAULT  # source file that logged it
    function: str = DEFAULT
    line: uint32 = DEFAULT  # in the file
