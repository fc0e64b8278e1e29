"""Between messages and what planar workers take."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp import Header
from robbie_mp.messages import (
    Frontiers,
    LaserScan,
    MapMetaData,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
)
from workers.exploration.frontiers import Frontier


class MapCells(NamedTuple):
    """The cells of a map `(H, W) int8`, their edge (m), and the corner of the first (m, map frame)."""

    cells: NDArray[np.int8]
    resolution_m: float
    corner_xy_m: tuple[float, float]


class GridMessage(Protocol):
    """A message that holds a grid in the map frame, as OccupancyGrid does."""

    @property
    def info(self) -> MapMetaData:
        """Size, resolution and place of the grid."""

    @property
    def data(self) -> NDArray[np.int8]:
        """`(height * width,)`, row by row."""


def planar(pose: Pose) -> tuple[float, float, float]:
    """Return x (m), y (m) and heading (rad) of a pose."""
    return pose.position.x, pose.position.y, pose.orientation.yaw


def pose_stamped(pose: ArrayLike, header: Header) -> PoseStamped:
    """Make a message of x (m), y (m) and heading (rad)."""
    x_m, y_m, heading_rad = np.asarray(pose, float).tolist()
    place = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))
    return PoseStamped(header=header, pose=place)


def map_cells(grid: GridMessage) -> MapCells:
    """Return the cells of a map and where they lie."""
    corner = grid.info.origin.position
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    return MapCells(cells, grid.info.resolution, (corner.x, corner.y))


def frontiers_message(frontiers: Sequence[Frontier], header: Header) -> Frontiers:
    """Make a message of frontiers, the longest of which come first."""
    told = frontiers[: Frontiers.MOST]
    middles = [Point(x=x_m, y=y_m) for x_m, y_m in (frontier.middle_xy_m.tolist() for frontier in told)]
    lengths_m = np.array([frontier.length_m for frontier in told], np.float64)
    return Frontiers(header=header, middles=middles, lengths_m=lengths_m)


def angles_rad(scan: LaserScan) -> NDArray[np.float64]:
    """Return the direction of each beam of a scan in the laser's frame: (N,)."""
    return scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges), dtype=np.float64)


def laser_mount(message: TFMessage) -> NDArray[np.float64] | None:
    """Return where the laser sits on the robot (x m, y m, heading rad), if the message says so."""
    for transform in message.transforms:
        if transform.child_frame_id == "laser":
            place = transform.transform
            return np.array([place.translation.x, place.translation.y, place.rotation.yaw])
    return None
