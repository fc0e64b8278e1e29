"""Messages that move a robot: a link drops late ones and shortens the validity of others.

These are the only messages that a link decodes.
"""

from typing import NamedTuple

from robbie_mp.connect.link.clock_offset import AHEAD_NS
from robbie_mp.connect.link.receiving import Arrived
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.messages import (
    DriveCommand,
    Duration,
    EmergencyStop,
    JointCommand,
    Message,
    MessageError,
    OperatorRequest,
    PanTiltCommand,
    Time,
    ToolRequest,
    replace,
)

EXPIRING = {each.type_name: each for each in (DriveCommand, JointCommand, PanTiltCommand)}
"""Commands that tell how long they last, and what they rest on."""

_ORDERS = (EmergencyStop.type_name, OperatorRequest.type_name, ToolRequest.type_name)


class Ages(NamedTuple):
    """How old a message is that has arrived: the least and the greatest age since it was published, in ns."""

    least_ns: int
    greatest_ns: int


def expires(message: Arrived) -> bool:
    """Whether a message must not be obeyed when it is late.

    Commands are, and the release of an emergency stop: somebody may have stopped the robot again since. So is
    the wish to drive: another operator may have taken over since. The emergency stop itself, and the
    wish that the robot holds, never come too late. What moves a robot is a command in whatever class the
    other side has sent it.

    Args:
        message: a message that has arrived.
    """
    return not stops(message.name.type_name, message.data) and (
        message.traffic is TrafficClass.COMMAND or message.name.type_name in (*EXPIRING, *_ORDERS)
    )


def stops(type_name: str, data: bytes) -> bool:
    """Whether a message lets the robot stand, by an emergency stop or a wish, or ends a command.

    Args:
        type_name: of the message.
        data: the encoded message.
    """
    try:
        if type_name == EmergencyStop.type_name:
            return EmergencyStop.decode(data).engaged
        if type_name == OperatorRequest.type_name:
            return OperatorRequest.decode(data).wish == OperatorRequest.HOLD
        if type_name == ToolRequest.type_name:
            return ToolRequest.decode(data).interrupts
    except MessageError:
        return False
    return False


def shortened(message: Arrived, ages: Ages, now_ns: int, max_age_ns: int) -> bytes | None:
    """Return a command as it is to be published: in the clock of this robot, and with the time that is left.

    What it had to wait is taken off the time that it lasts. Its stamps become those of this robot's clock, by
    the greatest age that it can have. The other robot's stamps count only by their differences.

    Args:
        message: a message that has arrived.
        ages: how long ago it was published.
        now_ns: the present time, by the clock of this robot's stamps.
        max_age_ns: greatest age of what it rests on. A command to stand may rest on anything.

    Returns:
        The encoded message; None if the time is over, or what it rests on is too old.
    """
    message_type = EXPIRING.get(message.name.type_name)
    if message_type is None:
        return message.data
    try:
        command = message_type.decode(message.data)
    except MessageError:
        return None
    left_ns = command.valid_for.nanoseconds - sum(ages) // 2
    rested_ns = command.header.stamp.nanoseconds - command.based_on.nanoseconds
    based_on_ns = now_ns - ages.greatest_ns - max(0, rested_ns)
    if left_ns <= 0 or based_on_ns <= 0:
        return None
    if not command.based_on.nanoseconds:
        based_on_ns = 0  # it does not say, and the device refuses it
    elif _moves(command) and not -AHEAD_NS <= rested_ns <= max_age_ns - ages.greatest_ns:
        return None
    stamp = Time.from_nanoseconds(now_ns - ages.greatest_ns)
    return replace(
        command,
        header=replace(command.header, stamp=stamp),
        valid_for=Duration.from_nanoseconds(left_ns),
        based_on=Time.from_nanoseconds(based_on_ns),
    ).encode()


def _moves(command: Message) -> bool:
    """Whether a command is more than one to stand."""
    return not isinstance(command, DriveCommand) or bool(command.linear_m_per_s or command.angular_rad_per_s)
