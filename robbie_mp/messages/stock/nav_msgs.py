"""Maps, paths and odometry (ROS nav_msgs)."""

import math

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_CELL_M, MIN_CELL_M, Flaw, outside, wrong_size
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, int8, uint32
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.geometry_msgs import Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance
from robbie_mp.messages.stock.std_msgs import Header

MAX_TILT_RAD = 0.01
MAX_TURNED_CELLS = 100_000_000
"""A grid with a yaw is used as one along the axes, which is larger."""


class MapMetaData(Message, name="nav_msgs/msg/MapMetaData", version=1):
    """The values of cells of an occupancy grid."""

    map_load_time: Time = DEFAULT
    resolution: float32 = DEFAULT  # m, edge of a cell
    width: uint32 = DEFAULT  # cells along x
    height: uint32 = DEFAULT  # cells along y
    origin: Pose = DEFAULT  # of the corner of cell (0, 0), in the frame of the map

    def flaw(self) -> Flaw | None:
        """Return a size of cells that is none, unless there are no cells, or an origin no reader can use."""
        least = 0.0 if self.width * self.height == 0 else MIN_CELL_M
        return outside(self, least, MAX_CELL_M, "resolution") or self._tilted() or self._too_large()

    def _tilted(self) -> Flaw | None:
        turn = self.origin.orientation
        if math.hypot(turn.x, turn.y) <= math.sin(MAX_TILT_RAD / 2):
            return None
        return Flaw(
            "origin.orientation", (turn.x, turn.y, turn.z, turn.w), "a rotation about the z axis only"
        )

    def _too_large(self) -> Flaw | None:
        """Return whether a grid along the axes that holds this one is far larger: it is long and narrow."""
        yaw = self.origin.orientation.yaw
        cosine, sine = abs(math.cos(yaw)), abs(math.sin(yaw))
        cells = (cosine * self.width + sine * self.height) * (sine * self.width + cosine * self.height)
        if cells <= max(MAX_TURNED_CELLS, 4 * self.width * self.height):
            return None
        most = f"a yaw with which at most {MAX_TURNED_CELLS:,} cells along the axes hold the grid"
        return Flaw("origin.orientation", yaw, most)


class OccupancyGrid(Message, name="nav_msgs/msg/OccupancyGrid", version=1):
    """A map of cells that are free, occupied or unknown."""

    header: Header = DEFAULT
    info: MapMetaData = DEFAULT
    data: Array[int8] = DEFAULT  # (height * width,) row-major: 0 free … 100 occupied, -1 unknown

    def flaw(self) -> Flaw | None:
        """Return whether there are more or fewer cells than its size says."""
        return wrong_size(self, "data", self.info.width * self.info.height, "info.width times info.height")


class Odometry(Message, name="nav_msgs/msg/Odometry", version=1):
    """Where the robot is and how it moves, summed up from its own motion: smooth, but it drifts."""

    header: Header = DEFAULT  # frame_id: the frame of the pose
    child_frame_id: str = DEFAULT  # the frame of the twist: the robot's own
    pose: PoseWithCovariance = DEFAULT
    twist: TwistWithCovariance = DEFAULT


class Path(Message, name="nav_msgs/msg/Path", version=1):
    """Poses to follow, in order."""

    header: Header = DEFAULT
    poses: list[PoseStamped] = DEFAULT
