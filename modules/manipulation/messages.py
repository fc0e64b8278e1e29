"""Messages that only the robot with the arm knows."""

from robbie_mp import DEFAULT, Header, Message, uint32
from robbie_mp.messages import Pose


class TabletopTruth(Message, name="manipulation_msgs/msg/TabletopTruth", version=1):
    """Where the simulated objects truly are. Robots do not subscribe to it."""

    header: Header = DEFAULT  # frame_id: arena
    names: list[str] = DEFAULT
    poses: list[Pose] = DEFAULT  # of their middles
    fallen: list[str] = DEFAULT  # names of those that have fallen over
    held: str = DEFAULT  # what is in the hand; '': nothing
    slips: uint32 = DEFAULT  # how often something slipped out of the hand
    contacts: uint32 = DEFAULT  # how often the arm, or what it holds, began to touch a table or the floor
