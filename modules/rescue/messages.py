"""Messages that only the rescue robot knows: its mission, and the victims it finds."""

from typing import ClassVar

from robbie_mp import DEFAULT, Array, Header, Message, float32, float64, int8, uint8, uint32
from robbie_mp.messages import Image, MapMetaData, Pose


class MissionOrder(Message, name="rescue_msgs/msg/MissionOrder", version=1):
    """The operator orders the mission to do something. The answer is a `MissionStatus`."""

    START: ClassVar[uint8] = 0  # or go on after a pause
    PAUSE: ClassVar[uint8] = 1  # stop, and stand until START
    ABORT: ClassVar[uint8] = 2  # stop, and end the mission where the robot is
    RETURN: ClassVar[uint8] = 3  # drive home at once

    header: Header = DEFAULT
    order: uint8 = START


class MissionStatus(Message, name="rescue_msgs/msg/MissionStatus", version=1):
    """What the mission does, and which orders it takes now; sent on each change and at intervals."""

    header: Header = DEFAULT
    state: str = DEFAULT  # of its state machine, as EXPLORE, PAUSE, RETURN, DONE
    text: str = DEFAULT  # what the state means and why it holds, for people
    orders: Array[uint8] = DEFAULT  # of MissionOrder: those that the mission takes now
    refusal: str = DEFAULT  # why the newest order was refused; '' if it was obeyed


class VictimFound(Message, name="rescue_msgs/msg/VictimFound", version=1):
    """What the robot knows of one victim; sent again whenever it knows more."""

    SUSPECTED: ClassVar[uint8] = 0  # seen, but not well enough to ask; or the operator answered LATER
    ASKED: ClassVar[uint8] = 1  # the operator has been asked and has not answered yet
    CONFIRMED: ClassVar[uint8] = 2
    REJECTED: ClassVar[uint8] = 3

    header: Header = DEFAULT  # stamp: of the last image that shows it; frame_id: of the map
    id: uint32 = DEFAULT
    name: str = DEFAULT  # for people
    pose: Pose = DEFAULT  # x axis: out of the wall
    spread_m: float64 = DEFAULT  # standard deviation of the position
    confidence: float32 = DEFAULT  # 0 … 1: that there is a victim
    views: uint32 = DEFAULT  # number of images that show it
    state: uint8 = SUSPECTED
    answer_within_s: float32 = DEFAULT  # ASKED: time left to answer; else 0
    image: Image = DEFAULT  # the best view of it; empty: there is none


class SearchedWalls(Message, name="rescue_msgs/msg/SearchedWalls", version=1):
    """The walls on which a victim could hang, and which of them the camera has searched."""

    header: Header = DEFAULT  # frame_id: of the map
    info: MapMetaData = DEFAULT  # of the grid
    data: Array[int8] = DEFAULT  # (height * width,) 100: searched, 0: not searched, -1: no wall


class VictimConfirmation(Message, name="rescue_msgs/msg/VictimConfirmation", version=1):
    """The operator's answer to the question about one victim."""

    NO: ClassVar[uint8] = 0
    YES: ClassVar[uint8] = 1
    LATER: ClassVar[uint8] = 2  # ask again when more is known

    header: Header = DEFAULT
    id: uint32 = DEFAULT  # of the victim
    answer: uint8 = NO
