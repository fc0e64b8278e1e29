"""Messages of the link between robots."""

import math
from typing import Any, ClassVar

from robbie_mp.messages.declaration import Upgrade
from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import float32, float64, int32, uint8, uint16, uint32, uint64
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.std_msgs import Header


class LinkChannel(Message, name="robbie_msgs/msg/LinkChannel", version=1):
    """The books of one channel: sent = received + replaced + dropped + lost + under_way."""

    robot: str = DEFAULT  # the other one
    is_sent: bool = DEFAULT  # False: this robot receives it, and knows only received and dropped
    traffic: str = DEFAULT  # urgent, command, state, reliable or bulk
    message_type: str = DEFAULT
    topic: str = DEFAULT
    sent: uint64 = DEFAULT  # messages taken from the bus for that robot
    received: uint64 = DEFAULT  # published by the receiving robot
    replaced: uint64 = DEFAULT
    dropped: uint64 = DEFAULT  # for lack of room; or late, not allowed or refused where they arrived
    lost: uint64 = DEFAULT  # may have arrived, but no report says so
    under_way: uint64 = DEFAULT


class LinkPeer(Message, name="robbie_msgs/msg/LinkPeer", version=1):
    """The link with one other robot. What is not known is NaN."""

    robot: str = DEFAULT
    is_up: bool = DEFAULT  # a beat came in the last half second
    session: uint64 = DEFAULT  # of the other link; 0: it was never heard
    sessions: uint32 = DEFAULT  # how many there have been
    round_trip_s: float64 = DEFAULT
    loss: float32 = DEFAULT  # ratio of packets that had to be sent again
    bandwidth_bytes_per_s: float64 = DEFAULT  # what arrived there in the last second
    under_way_bytes: uint64 = DEFAULT
    newest_state_age_s: float64 = DEFAULT
    clock_offset_s: float64 = DEFAULT  # the other robot's clock minus this one's
    clock_uncertainty_s: float64 = DEFAULT
    duplicates: uint64 = DEFAULT  # packets that had arrived before
    stale: uint64 = DEFAULT  # packets of sessions that are over


class LinkRefusal(Message, name="robbie_msgs/msg/LinkRefusal", version=1):
    """How many messages of a kind were refused where they came in, because they were ill-formed."""

    message_type: str = DEFAULT  # full name; "other types" for those of which there were too many kinds
    field: str = DEFAULT  # the field that was wrong, such as info.origin.position.x
    refused: uint64 = DEFAULT  # since the link's last start


def _without_refusals(fields: dict[str, Any]) -> dict[str, Any]:
    """Name no ill-formed messages: version 1 did not tell them."""
    return {**fields, "ill_formed": []}


class LinkState(
    Message, name="robbie_msgs/msg/LinkState", version=2, upgrades={1: Upgrade(_without_refusals)}
):
    """How the link of one robot is doing."""

    stamp: Time = DEFAULT
    robot: str = DEFAULT
    session: uint64 = DEFAULT
    malformed: uint64 = DEFAULT  # packets that no link has sent
    strangers: uint64 = DEFAULT  # packets of robots that may not exchange messages with this one
    overflowed: uint64 = DEFAULT  # packets for which the module was too slow
    refused: uint64 = DEFAULT  # messages that the setting `accept` does not allow
    late: uint64 = DEFAULT  # commands that were too old, or of which the age was not known
    mismatched: uint64 = DEFAULT  # messages of types that are declared differently here
    peers: list[LinkPeer] = DEFAULT
    channels: list[LinkChannel] = DEFAULT
    ill_formed: list[LinkRefusal] = DEFAULT  # the most frequent kinds first


class OperatorRequest(Message, name="robbie_msgs/msg/OperatorRequest", version=1):
    """An operator wants to have control of a robot, or gives it up; the link knows which operator.

    The last two are orders to the robot: the link calls `SetControl` for the operator, because calls do not
    pass a link. Only the operator with the command may let the robot go on.
    """

    TAKE: ClassVar[uint8] = 0  # if nobody holds it
    TAKE_OVER: ClassVar[uint8] = 1  # also from another operator
    GIVE_UP: ClassVar[uint8] = 2
    GO_ON: ClassVar[uint8] = 3  # modules drive the robot again
    HOLD: ClassVar[uint8] = 4  # the robot stands until it is told to go on

    wish: uint8 = TAKE


class OperatorState(Message, name="robbie_msgs/msg/OperatorState", version=1):
    """Which operator has control of a robot: only this one's commands are obeyed."""

    robot: str = DEFAULT
    operator: str = DEFAULT  # the name of that side of the link, or of the robot for its own page; "": nobody
    since: Time = DEFAULT
    refused: uint64 = DEFAULT  # commands of other operators
    refused_operator: str = DEFAULT  # who sent the newest of them


class LinkType(Message, name="robbie_msgs/msg/LinkType", version=1):
    """A message type of a robot, for those who have no class of it."""

    name: str = DEFAULT  # full, such as zoo/msg/Sample
    version_number: uint32 = DEFAULT
    schema: str = DEFAULT  # its ros2msg text, with the texts of the types in it


class LinkTypes(Message, name="robbie_msgs/msg/LinkTypes", version=1):
    """What a robot sends over its link besides the stock types; on the latched topic `link_types`."""

    robot: str = DEFAULT
    types: list[LinkType] = DEFAULT


class ToolRequest(Message, name="robbie_msgs/msg/ToolRequest", version=1):
    """Has a robot run a command of `robbie` for somebody at the other end of its link.

    Its topic is the command, such as `param`, so the setting `accept` can tell commands apart.
    """

    request: uint64 = DEFAULT  # a random number, which the replies repeat
    robot: str = DEFAULT  # the robot that is to run it
    arguments: list[str] = DEFAULT  # after the command
    input: str = DEFAULT  # its standard input
    columns: uint16 = 80  # of the terminal
    interrupts: bool = DEFAULT  # do not run it, but interrupt the one of this number, as Ctrl-C does


class ToolReply(Message, name="robbie_msgs/msg/ToolReply", version=1):
    """What a command that a robot runs for somebody else has printed since the last reply."""

    request: uint64 = DEFAULT
    robot: str = DEFAULT
    number: uint32 = DEFAULT  # of this reply, from 0
    output: str = DEFAULT
    error: str = DEFAULT  # what it has printed on standard error, or why it is not run
    is_over: bool = DEFAULT  # it has ended, and this is the last reply
    exit_code: int32 = DEFAULT


class RobotAlarm(Message, name="robbie_msgs/msg/RobotAlarm", version=1):
    """Something that is wrong with a robot."""

    level: uint8 = DEFAULT  # 1: note, 2: caution, 3: danger
    text: str = DEFAULT  # one sentence


class RobotSummary(Message, name="robbie_msgs/msg/RobotSummary", version=1):
    """What operators of several robots see of each. Its operator station publishes it on `robot_summary`."""

    header: Header = DEFAULT
    robot: str = DEFAULT  # the name that its pages show
    colour: str = DEFAULT  # such as #ff6f00
    page: str = DEFAULT  # address of its own page; "": it has none that others reach
    mode: str = DEFAULT  # AUTO, MANUAL or HOLD; "": not known
    state: str = DEFAULT  # of its mission; "": it has none
    battery: float32 = math.nan  # charge from 0 to 1; NaN: not known
    alarms: list[RobotAlarm] = DEFAULT  # the most urgent first
