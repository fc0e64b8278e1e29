"""Messages that move a robot: a link throws away late ones and shortens the validity of others.

These are the only messages that a link decodes.
"""

from robbie_mp.link.receiving import Arrived
from robbie_mp.link.traffic import TrafficClass
from robbie_mp.messages import (
    DriveCommand,
    Duration,
    EmergencyStop,
    JointCommand,
    MessageError,
    OperatorRequest,
    replace,
)

EXPIRING = {each.type_name: each for each in (DriveCommand, JointCommand)}
"""Commands that tell how long they last."""


def expires(message: Arrived) -> bool:
    """Whether a message must not be obeyed when it is late.

    Commands are, and the release of an emergency stop: somebody may have stopped the robot again since. So is
    the wish to drive: another operator may have taken over since. The emergency stop itself never comes too
    late.

    Args:
        message: a message that has arrived.
    """
    if message.name.type_name == EmergencyStop.type_name:
        try:
            return not EmergencyStop.decode(message.data).engaged
        except MessageError:
            return True
    return message.traffic is TrafficClass.COMMAND or message.name.type_name == OperatorRequest.type_name


def shortened(message: Arrived, age_ns: int) -> bytes | None:
    """Return a command as it is to be published: what it had to wait is taken off the time that it lasts.

    Args:
        message: a message that has arrived.
        age_ns: how long ago it was published.

    Returns:
        The encoded message; None if the time is over.
    """
    message_type = EXPIRING.get(message.name.type_name)
    if message_type is None:
        return message.data
    try:
        command = message_type.decode(message.data)
    except MessageError:
        return None
    left_ns = command.valid_for.nanoseconds - age_ns
    if left_ns <= 0:
        return None
    return replace(command, valid_for=Duration.from_nanoseconds(left_ns)).encode()
