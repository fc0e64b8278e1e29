"""Costmaps (ROS nav2_msgs)."""

from enum import IntEnum

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_CELL_M, MIN_CELL_M, Flaw, outside, wrong_size
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, uint8, uint32
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.geometry_msgs import Pose
from robbie_mp.messages.stock.std_msgs import Header


class Cost(IntEnum):
    """Costs of cells with a meaning of their own, as in nav2_costmap_2d."""

    FREE = 0
    AVOIDED = 252
    """The most: from 1 to this, paths may lead there, but avoid it."""
    TOO_NEAR = 253
    """For the robot's centre: an obstacle is beside it."""
    OBSTACLE = 254
    UNKNOWN = 255


class CostmapMetaData(Message, name="nav2_msgs/msg/CostmapMetaData", version=1):
    """The values of cells of a costmap."""

    map_load_time: Time = DEFAULT
    update_time: Time = DEFAULT
    layer: str = DEFAULT  # of which layer the costs are
    resolution: float32 = DEFAULT  # m, edge of a cell
    size_x: uint32 = DEFAULT  # cells along x
    size_y: uint32 = DEFAULT  # cells along y
    origin: Pose = DEFAULT  # of the corner of cell (0, 0), in the frame of the map

    def flaw(self) -> Flaw | None:
        """Return a size of cells that is none, unless there are no cells."""
        least = 0.0 if self.size_x * self.size_y == 0 else MIN_CELL_M
        return outside(self, least, MAX_CELL_M, "resolution")


class Costmap(Message, name="nav2_msgs/msg/Costmap", version=1):
    """Where a robot may be, and which places it prefers to avoid."""

    header: Header = DEFAULT
    metadata: CostmapMetaData = DEFAULT
    data: Array[uint8] = DEFAULT  # (size_y * size_x,) row-major, as `Cost`

    def flaw(self) -> Flaw | None:
        """Return whether there are more or fewer cells than its size says."""
        size = self.metadata.size_x * self.metadata.size_y
        return wrong_size(self, "data", size, "metadata.size_x times metadata.size_y")
