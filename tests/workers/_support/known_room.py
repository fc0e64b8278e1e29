"""Maps of parts of a known room, in any frame, drawn from its walls."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.maps.map_alignment import GridMap
from robbie_robots.workers.planar_pose import relative, transform_points
from tests.workers._support.synthetic_room import SEGMENTS

HALF_WALL_M = 0.04
RESOLUTION_M = 0.05


def draw(
    frame: ArrayLike,
    from_x_m: float = -1.0,
    to_x_m: float = 9.0,
    segments: NDArray[np.float64] = SEGMENTS,
    resolution_m: float = RESOLUTION_M,
) -> GridMap:
    """Draw the part of the room between two values of x.

    Args:
        frame: pose of the map's frame (x m, y m, heading rad) in the room.
        from_x_m: cells with smaller x in the room are unknown.
        to_x_m: cells with larger x are unknown.
        segments: the walls `(N, 4)`, m.
        resolution_m: edge of a cell.
    """
    corners = transform_points(
        relative(frame, np.zeros(3)), [[-0.5, -0.5], [8.5, -0.5], [-0.5, 6.5], [8.5, 6.5]]
    )
    low = np.floor(corners.min(axis=0) / resolution_m) * resolution_m
    width, height = np.ceil((corners.max(axis=0) - low) / resolution_m).astype(int).tolist()
    rows, columns = np.indices((height, width)).reshape(2, -1)
    in_room = transform_points(frame, low + (np.stack([columns, rows], axis=1) + 0.5) * resolution_m)
    begin, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    share = ((in_room[:, None] - begin) * along).sum(axis=2) / (along**2).sum(axis=1)
    nearest = begin + np.clip(share, 0, 1)[..., None] * along
    is_wall = np.hypot(*np.moveaxis(in_room[:, None] - nearest, -1, 0)).min(axis=1) <= HALF_WALL_M
    x, y = in_room.T
    is_seen = (x > max(from_x_m, -0.1)) & (x < min(to_x_m, 8.1)) & (y > -0.1) & (y < 6.1)
    cells = np.where(is_seen, np.where(is_wall, 100, 0), -1).astype(np.int8)
    return GridMap(cells.reshape(height, width), resolution_m, low)
