"""Messages that only the household robot knows."""

from robbie_mp import DEFAULT, Header, Message, Reply, Request, float64, uint32
from robbie_mp.messages import Point


class FollowOrderTaken(Reply, name="home_msgs/srv/FollowOrder_Response", version=1):
    """What the robot does after the order."""

    changed: bool = DEFAULT  # False: the order changes nothing at present
    state: str = DEFAULT  # name of a state of workers/home/follow_states.py


class FollowOrder(Request[FollowOrderTaken], name="home_msgs/srv/FollowOrder_Request", version=1):
    """An order as by voice: `follow` the person in front of you, `stop`, or `here`: I am here."""

    order: str = DEFAULT


class Following(Message, name="home_msgs/msg/Following", version=1):
    """What the robot that follows a person does, and whom it follows. Published at intervals."""

    header: Header = DEFAULT  # frame_id: map
    state: str = DEFAULT  # name of a state of workers/home/follow_states.py
    reason: str = DEFAULT  # for people
    person: str = DEFAULT  # as in People; '': nobody
    position: Point = DEFAULT  # where the person was seen last, m
    unseen_s: float64 = DEFAULT  # time since then
    losses: uint32 = DEFAULT  # how often the robot has lost the person
    questions: uint32 = DEFAULT  # how often it has asked whether the person is there
