"""Conversions between messages and the types of planar workers."""

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
from robbie_robots.workers.exploration.frontiers import Frontier
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.maps.turned_grid import axis_aligned

LASER = "laser"
"""Frame of the robot's laser, or of the one that looks ahead."""


class MapCells(NamedTuple):
    """A map's cells `(H, W) int8`, their edge (m), and the outer corner of cell (0, 0) (m, map frame)."""

    cells: NDArray[np.int8]
    resolution_m: float
    corner_xy_m: tuple[float, float]


class GridMessage(Protocol):
    """A message that holds a grid in the map frame, as OccupancyGrid does."""

    @property
    def info(self) -> MapMetaData:
        """Size, resolution and position of the grid."""

    @property
    def data(self) -> NDArray[np.int8]:
        """`(height * width,)`, row by row."""


def planar(pose: Pose) -> tuple[float, float, float]:
    """Return x (m), y (m) and heading (rad) of a pose."""
    return pose.position.x, pose.position.y, pose.orientation.yaw


def pose_stamped(pose: ArrayLike, header: Header) -> PoseStamped:
    """Return the message for a pose (x m, y m, heading rad)."""
    x_m, y_m, heading_rad = np.asarray(pose, float).tolist()
    place = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))
    return PoseStamped(header=header, pose=place)


def map_cells(grid: GridMessage) -> MapCells:
    """Return a map's cells and their position.

    All modules get the cells of maps here, so here a map with a turned origin becomes one along the axes.
    """
    x_m, y_m, yaw_rad = planar(grid.info.origin)
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    cells, resolution_m, corner = axis_aligned(cells, grid.info.resolution, (x_m, y_m), yaw_rad)
    return MapCells(cells, resolution_m, (float(corner[0]), float(corner[1])))


def frontiers_message(frontiers: Sequence[Frontier], header: Header) -> Frontiers:
    """Return the message for frontiers, given longest first; it holds at most `Frontiers.MAX_PIECES`."""
    longest = frontiers[: Frontiers.MAX_PIECES]
    middles = [Point(x=x_m, y=y_m) for x_m, y_m in (frontier.middle_xy_m.tolist() for frontier in longest)]
    lengths_m = np.array([frontier.length_m for frontier in longest], np.float64)
    return Frontiers(header=header, middles=middles, lengths_m=lengths_m)


def sweep_of(scan: LaserScan) -> LaserSweep:
    """Return a scan's sweep, with the scan's own geometry."""
    return LaserSweep.from_ranges(
        scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max
    )


def laser_mount(message: TFMessage) -> NDArray[np.float64] | None:
    """Return the laser's mounting pose on the robot (x m, y m, heading rad); None if not in the message."""
    return planar_mounts(message).get(LASER)


def planar_mounts(message: TFMessage) -> dict[str, NDArray[np.float64]]:
    """Return the pose of each frame on the robot (x m, y m, heading rad), by the frame's name."""
    return {
        one.child_frame_id: np.array(
            [one.transform.translation.x, one.transform.translation.y, one.transform.rotation.yaw]
        )
        for one in message.transforms
    }
