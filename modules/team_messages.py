"""Messages of robots that work as a team."""

from robbie_mp import DEFAULT, Header, Message, float64
from robbie_mp.messages import Pose


class MapAlignment(Message, name="team_msgs/msg/MapAlignment", version=1):
    """Where the map of another robot lies in the map of this robot, and how sure that is."""

    header: Header = DEFAULT  # frame: this robot's map
    robot: str = DEFAULT  # the other robot
    pose: Pose = DEFAULT  # of the other robot's map; meaningless until it is known or sure
    is_known: bool = DEFAULT  # its start is known: the pose is used even if the maps do not confirm it yet
    is_sure: bool = DEFAULT  # the maps agree
    doubt: str = DEFAULT  # why it is not sure
    walls_m: float64 = DEFAULT  # length of wall that lies on walls of the other map
    agreement: float64 = DEFAULT  # 0 to 1: how much of the walls in the common area lies on walls
    ambiguity: float64 = DEFAULT  # 0 to 1: how well the best pose elsewhere fits, compared with this one
