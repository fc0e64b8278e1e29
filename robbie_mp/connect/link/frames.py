"""Puts a robot's name before the names of the frames in its messages, for one scene graph of all robots."""

from typing import TypeVar

from robbie_mp.messages import Message
from robbie_mp.messages.frames import renamed, without_slash

MessageType = TypeVar("MessageType", bound=Message)


def prefixed(message: MessageType, prefix: str) -> MessageType:
    """Return a message in which each name of a frame begins with a prefix; empty names stay empty.

        prefixed(odometry, "red/").child_frame_id == "red/base_link"

    Args:
        message: the message; it does not change.
        prefix: the robot's name and a slash.
    """

    def name_of(frame: str) -> str:
        name = without_slash(frame)
        return name if not name or name.startswith(prefix) else prefix + name

    return renamed(message, name_of)
