"""Messages that only the rescue robot knows: its mission, and the victims it finds."""

import math
from typing import Any, ClassVar

from robbie_mp import (
    DEFAULT,
    Array,
    Header,
    Message,
    Reply,
    Request,
    float32,
    float64,
    int8,
    int32,
    uint8,
    uint32,
)
from robbie_mp.messages import Image, MapMetaData, Pose, Upgrade
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond, outside, wrong_size


class OrderAccepted(Reply, name="rescue_msgs/srv/OrderMission_Response", version=1):
    """The mission obeys."""

    state: str = DEFAULT  # of its state machine, after the order


class OrderMission(Request[OrderAccepted], name="rescue_msgs/srv/OrderMission_Request", version=1):
    """The operator orders the mission to do something. The mission refuses what does not fit its state."""

    START: ClassVar[uint8] = 0  # also: continue after a pause, or begin another mission after the end of one
    PAUSE: ClassVar[uint8] = 1  # stop, and stand still until START
    ABORT: ClassVar[uint8] = 2  # stop, and end the mission where the robot is
    RETURN: ClassVar[uint8] = 3  # drive home at once, also after the end of the mission

    order: uint8 = START


def _without_refusal(fields: dict[str, Any]) -> dict[str, Any]:
    """Leave out why the last order was refused: a refusal now goes to the one who gave the order."""
    return {name: value for name, value in fields.items() if name != "refusal"}


def _with_time(fields: dict[str, Any]) -> dict[str, Any]:
    """Add the times, which are not known."""
    return {**fields, "used_s": math.nan, "limit_s": math.nan}


class MissionStatus(
    Message,
    name="rescue_msgs/msg/MissionStatus",
    version=3,
    upgrades={1: Upgrade(_without_refusal), 2: Upgrade(_with_time)},
):
    """The mission's state, and the orders that it accepts now. Published on each change and at intervals."""

    header: Header = DEFAULT
    state: str = DEFAULT  # of its state machine, such as EXPLORE, PAUSE, RETURN, DONE, FAILED, ABORTED
    text: str = DEFAULT  # description of the state and its reason
    orders: Array[uint8] = DEFAULT  # constants of OrderMission that the mission accepts now
    used_s: float32 = math.nan  # time of the mission, which stands in a pause; NaN: not known
    limit_s: float32 = math.nan  # time by which the robot is to be home; NaN: not known


def _without_files(fields: dict[str, Any]) -> dict[str, Any]:
    """Add how the mission has ended, and its files, which are not known."""
    return {**fields, "state": "DONE", "files": []}


class MissionResult(
    Message,
    name="rescue_msgs/msg/MissionResult",
    version=2,
    upgrades={1: Upgrade(_without_files)},
):
    """The results of a mission that has ended. Published once, latched."""

    header: Header = DEFAULT
    state: str = "DONE"  # DONE, FAILED or ABORTED
    reason: str = DEFAULT  # why the mission has ended
    used_s: float32 = DEFAULT  # time of the mission, without its pauses
    limit_s: float32 = DEFAULT  # time by which the robot was to be home
    confirmed: uint32 = DEFAULT  # number of victims that are confirmed
    unconfirmed: uint32 = DEFAULT  # number of others that were seen, without the rejected ones
    mapped_m2: float32 = DEFAULT  # area on the map that is not unknown
    searched: float32 = math.nan  # 0 … 1: ratio of the walls that the camera has searched; NaN: not known
    travelled_m: float32 = DEFAULT
    collisions: int32 = -1  # number of times that the bumper was pressed; -1: there is no bumper
    battery: float32 = math.nan  # 0 … 1: charge that is left; NaN: not known
    notes: list[str] = DEFAULT  # what went wrong
    files: list[str] = DEFAULT  # names of the report's files in the folder for results


class VictimFound(Message, name="rescue_msgs/msg/VictimFound", version=1):
    """The robot's knowledge about one victim. Published again when it knows more."""

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

    def flaw(self) -> Flaw | None:
        """Return a number that is not finite."""
        states = outside(self, self.SUSPECTED, self.REJECTED, "state")
        return (
            states
            or outside(self, 0.0, MAX_MAGNITUDE, "spread_m")
            or beyond(self, MAX_MAGNITUDE, "confidence", "answer_within_s")
        )


class SearchedWalls(Message, name="rescue_msgs/msg/SearchedWalls", version=1):
    """The walls on which a victim could hang, and which of them the camera has searched."""

    header: Header = DEFAULT  # frame_id: map frame
    info: MapMetaData = DEFAULT  # size and position of the grid
    data: Array[int8] = DEFAULT  # (height * width,) 100: searched, 0: not searched, -1: no wall

    def flaw(self) -> Flaw | None:
        """Return whether there are more or fewer cells than the size of the grid says."""
        return wrong_size(self, "data", self.info.width * self.info.height, "info.width times info.height")


class VictimAnswered(Reply, name="rescue_msgs/srv/AnswerVictim_Response", version=1):
    """The operator's answer is remembered."""

    state: uint8 = DEFAULT  # the victim's state now: a constant of VictimFound


class AnswerVictim(Request[VictimAnswered], name="rescue_msgs/srv/AnswerVictim_Request", version=1):
    """The operator answers the question about one victim. Refused if there is no such victim or answer."""

    NO: ClassVar[uint8] = 0
    YES: ClassVar[uint8] = 1
    LATER: ClassVar[uint8] = 2  # ask again when more is known

    id: uint32 = DEFAULT  # id of the victim
    answer: uint8 = NO
