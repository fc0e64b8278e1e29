"""Messages that only the rescue robot knows: its mission, and the victims it finds."""

from typing import ClassVar

from robbie_mp import DEFAULT, Array, Header, Message, float32, float64, int8, uint8, uint32
from robbie_mp.messages import Image, MapMetaData, Pose


class MissionOrder(Message, name="rescue_msgs/msg/MissionOrder", version=1):
    """The operator orders the mission to do something. The answer is a `MissionStatus`."""

    START: ClassVar[uint8] = 0  # also: continue after a pause
    PAUSE: ClassVar[uint8] = 1  # stop, and stand still until START
    ABORT: ClassVar[uint8] = 2  # stop, and end the mission where the robot is
    RETURN: ClassVar[uint8] = 3  # drive home at once

    header: Header = DEFAULT
    order: uint8 = START


class MissionStatus(Message, name="rescue_msgs/msg/MissionStatus", version=1):
    """The mission's state, and the orders that it accepts now. Published on each change and at intervals."""

    header: Header = DEFAULT
    state: str = DEFAULT  # of its state machine, such as EXPLORE, PAUSE, RETURN, DONE
    text: str = DEFAULT  # description of the state and its reason
    orders: Array[uint8] = DEFAULT  # constants of MissionOrder that the mission accepts now
    refusal: str = DEFAULT  # why the mission refused the latest order; '' if it obeyed


class VictimFound(Message, name="rescue_msgs/msg/VictimFound", version=1):
    """What the robot knows about one victim. Published again whenever it knows more."""

    SUSPECTED: ClassVar[uint8] = (
        0  # seen, but not well enough to ask the operator; or the operator answered LATER
    )
    ASKED: ClassVar[uint8] = 1  # the operator has not answered yet
    CONFIRMED: ClassVar[uint8] = 2
    REJECTED: ClassVar[uint8] = 3

    header: Header = DEFAULT  # stamp: time of the last image that shows it; frame_id: map frame
    id: uint32 = DEFAULT
    name: str = DEFAULT  # name to display
    pose: Pose = DEFAULT  # the x axis points out of the wall
    spread_m: float64 = DEFAULT  # standard deviation of the position
    confidence: float32 = DEFAULT  # 0 … 1: how certain it is that the victim exists
    views: uint32 = DEFAULT  # number of images that show it
    state: uint8 = SUSPECTED
    answer_within_s: float32 = DEFAULT  # time left to answer, if ASKED; otherwise 0
    image: Image = DEFAULT  # the best view; empty if there is none


class SearchedWalls(Message, name="rescue_msgs/msg/SearchedWalls", version=1):
    """The walls on which a victim could hang, and which of them the camera has searched."""

    header: Header = DEFAULT  # frame_id: map frame
    info: MapMetaData = DEFAULT  # size and position of the grid
    data: Array[int8] = DEFAULT  # (height * width,) 100: searched, 0: not searched, -1: no wall


class VictimConfirmation(Message, name="rescue_msgs/msg/VictimConfirmation", version=1):
    """The operator's answer to the question about one victim."""

    NO: ClassVar[uint8] = 0
    YES: ClassVar[uint8] = 1
    LATER: ClassVar[uint8] = 2  # ask again when more is known

    header: Header = DEFAULT
    id: uint32 = DEFAULT  # id of the victim
    answer: uint8 = NO
