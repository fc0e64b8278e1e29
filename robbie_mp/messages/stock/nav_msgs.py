"""Maps, paths and odometry (ROS nav_msgs)."""

from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, int8, uint32
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.geometry_msgs import Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance
from robbie_mp.messages.stock.std_msgs import Header


class MapMetaData(Message, name="nav_msgs/msg/MapMetaData", version=1):
    """What the cells of an occupancy grid mean."""

    map_load_time: Time
    resolution: float32  # m, edge of a cell
    width: uint32  # cells along x
    height: uint32  # cells along y
    origin: Pose  # of the corner of cell (0, 0), in the frame of the map


class OccupancyGrid(Message, name="nav_msgs/msg/OccupancyGrid", version=1):
    """A map of cells that are free, occupied or unknown."""

    header: Header
    info: MapMetaData
    data: Array[int8]  # (height * width,) row-major from cell (0, 0): 0 free … 100 occupied, -1 unknown


class Odometry(Message, name="nav_msgs/msg/Odometry", version=1):
    """Where the robot is and how it moves, summed up from its own motion: smooth, but it drifts."""

    header: Header  # frame_id: the frame of the pose
    child_frame_id: str  # the frame of the twist: the robot's own
    pose: PoseWithCovariance
    twist: TwistWithCovariance


class Path(Message, name="nav_msgs/msg/Path", version=1):
    """Poses to follow, in order."""

    header: Header
    poses: list[PoseStamped]
