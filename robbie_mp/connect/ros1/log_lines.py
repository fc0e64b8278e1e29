"""What modules log, as ROS 1's /rosout has it."""

from typing import Final

from robbie_mp.messages import Log, Message, from_dict
from robbie_mp.messages.schema_parser import message_type_from_schema

LOG: Final = message_type_from_schema(
    "rosgraph_msgs/msg/Log",
    """byte DEBUG=1
byte INFO=2
byte WARN=4
byte ERROR=8
byte FATAL=16
std_msgs/Header header
byte level
string name
string msg
string file
string function
uint32 line
string[] topics
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
""",
)
LEVELS: Final = {Log.DEBUG: 1, Log.INFO: 2, Log.WARN: 4, Log.ERROR: 8, Log.FATAL: 16}


def ros1_log(line: Log) -> Message:
    """Return a line of the trace as ROS 1's message.

    Args:
        line: as the bridge to ROS 2 sends it.
    """
    stamp = {"sec": line.stamp.sec, "nanosec": line.stamp.nanosec}
    fields = {name: getattr(line, name) for name in ("name", "msg", "file", "function", "line")}
    return from_dict(LOG, {"header": {"stamp": stamp}, "level": LEVELS[line.level], **fields})
